"""The menu in a terminal: arrow keys, enter, and escape or q for exit."""

from __future__ import annotations

import curses
import locale
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType, TracebackType
from typing import Any, NoReturn, Self

from camctl.errors import UsageError
from menu.ports import SMALLEST, Highlight, Key

_LARGEST = (60, 16)
"""(columns, rows) that the menu uses in a larger terminal."""

_FRAME = 1
"""Width of the frame, characters on each side."""

_TITLE = " camctl "

_ESCAPE_WAIT_MS = 50
"""Time after which escape is the key and not the start of an arrow key's code, ms."""

_KEYS = {
    curses.KEY_UP: Key.UP,
    curses.KEY_DOWN: Key.DOWN,
    curses.KEY_LEFT: Key.LEFT,
    curses.KEY_RIGHT: Key.RIGHT,
    curses.KEY_ENTER: Key.ENTER,
    10: Key.ENTER,
    13: Key.ENTER,
    27: Key.EXIT,
    ord("q"): Key.EXIT,
}

_REDRAW = 12
"""Control-L, which redraws the screen as in other programs."""


class TerminalPanel:
    """A framed panel in the middle of the terminal; it adapts when the terminal is resized."""

    def __init__(self) -> None:
        self._screen: curses.window | None = None
        self._last: tuple[Sequence[str], Highlight | None] = ((), None)
        self._restore: list[Callable[[], Any]] = []

    def __enter__(self) -> Self:
        """Switch the terminal to full screen and return the panel.

        Raises:
            UsageError: there is no terminal, it cannot place the cursor, or it is too small
        """
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise UsageError(
                "the terminal panel needs a terminal", hint="run it without pipes or redirection"
            )
        self._check_terminal()
        try:
            self._open()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Restore the terminal."""
        self._close()

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) within the frame."""
        rows, columns = self._opened.getmaxyx()
        inner = (columns - 2 * _FRAME, rows - 2 * _FRAME)
        return (
            min(max(inner[0], SMALLEST[0]), _LARGEST[0]),
            min(max(inner[1], SMALLEST[1]), _LARGEST[1]),
        )

    def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
        """Show `lines` in the frame, the highlight in reverse video, the first line bold."""
        self._last = (lines, highlight)
        screen = self._opened
        screen.erase()
        try:
            self._draw(screen, lines, highlight)
        except curses.error:
            # The user is making the terminal smaller than the panel.
            screen.erase()
            screen.insnstr(0, 0, "make the terminal larger", screen.getmaxyx()[1])
        screen.refresh()

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; None after `timeout_s`, an unused key or a resize."""
        self._opened.timeout(max(0, round(1000 * timeout_s)))
        code = self._opened.getch()
        if code == _REDRAW:
            self._opened.redrawwin()
        if code in (_REDRAW, curses.KEY_RESIZE):
            self.show(*self._last)
        return _KEYS.get(code)

    @property
    def _opened(self) -> curses.window:
        if self._screen is None:
            raise ValueError("the terminal panel is not open: use it in a with statement")
        return self._screen

    def _check_terminal(self) -> None:
        name = os.environ.get("TERM", "")
        try:
            curses.setupterm(fd=sys.stdout.fileno())
        except curses.error as error:
            raise UsageError(f"unknown terminal type TERM={name}", hint="set TERM=xterm") from error
        if not curses.tigetstr("cup"):
            raise UsageError(
                f"the terminal type TERM={name} cannot place the cursor",
                hint="use another terminal, or set TERM",
            )
        columns, rows = shutil.get_terminal_size()  # as curses, from COLUMNS and LINES first
        smallest = (SMALLEST[0] + 2 * _FRAME, SMALLEST[1] + 2 * _FRAME)
        if columns < smallest[0] or rows < smallest[1]:
            raise UsageError(
                f"the terminal has only {columns} x {rows} characters",
                hint=f"enlarge it to {smallest[0]} x {smallest[1]}",
            )

    def _open(self) -> None:
        before = locale.setlocale(locale.LC_CTYPE)
        locale.setlocale(locale.LC_CTYPE, "")  # else curses refuses characters outside ASCII
        self._restore.append(lambda: locale.setlocale(locale.LC_CTYPE, before))
        if threading.current_thread() is threading.main_thread():
            # Without a handler, SIGTERM would end the process with the terminal in full screen.
            handler = signal.signal(signal.SIGTERM, _exit_with_signal)
            self._restore.append(lambda: signal.signal(signal.SIGTERM, handler))
        screen = curses.initscr()
        self._restore.append(curses.endwin)
        self._screen = screen
        curses.noecho()
        self._restore.append(curses.echo)
        curses.cbreak()
        self._restore.append(curses.nocbreak)
        screen.keypad(True)
        self._restore.append(lambda: screen.keypad(False))
        curses.set_escdelay(_ESCAPE_WAIT_MS)
        if curses.tigetstr("civis"):
            curses.curs_set(0)
            self._restore.append(lambda: curses.curs_set(1))

    def _close(self) -> None:
        while self._restore:
            self._restore.pop()()
        self._screen = None

    def _draw(
        self, screen: curses.window, lines: Sequence[str], highlight: Highlight | None
    ) -> None:
        height, width = screen.getmaxyx()
        columns, rows = max(map(len, lines), default=0), len(lines)
        top = max(0, (height - rows - 2 * _FRAME) // 2)
        left = max(0, (width - columns - 2 * _FRAME) // 2)
        frame = screen.derwin(rows + 2 * _FRAME, columns + 2 * _FRAME, top, left)
        frame.box()
        frame.addstr(0, 2, _TITLE, curses.A_BOLD)
        for row, text in enumerate(lines):
            line = text.encode(screen.encoding, "replace").decode(screen.encoding)
            frame.addstr(row + _FRAME, _FRAME, line, curses.A_BOLD if row == 0 else 0)
        if highlight is not None:
            row, column, count = highlight.row, highlight.column, highlight.width
            frame.chgat(row + _FRAME, column + _FRAME, count, curses.A_REVERSE)


def _exit_with_signal(number: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + number)
