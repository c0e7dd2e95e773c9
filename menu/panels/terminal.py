"""The menu in a terminal: arrow keys, enter, and escape or q for exit; see `TerminalPanel`."""

from __future__ import annotations

import curses
import locale
import os
import select
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Self

from camctl.errors import CamctlError, UsageError
from camctl.menu.layout import SMALLEST, Grid, grid
from camctl.menu.ports import Key, Screen
from camctl.system.interrupts import uninterrupted

_LARGEST = (60, 16)
"""(columns, rows) that the menu uses in a larger terminal."""

_FRAME = 1
"""Width of the frame, characters on each side, where there is room for one."""

_LEAST_FRAMED = (24, 8)
"""(columns, rows) of a terminal that shows a frame; smaller ones show the menu alone."""

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
    **{
        ord(character): key
        for characters, key in (
            ("k8", Key.UP),
            ("j2", Key.DOWN),
            ("h4", Key.LEFT),
            ("l6", Key.RIGHT),
            (" 5", Key.ENTER),
        )
        for character in characters
    },
}

_REDRAW = 12
"""Control-L, which redraws the screen as in other programs."""


class TerminalPanel:
    """A panel in the middle of the terminal; it adapts when the terminal is resized.

    A terminal without cursor keys, such as a serial console, has h, j, k, l and the digits 2, 4, 6,
    8 in their place.
    """

    def __init__(self) -> None:
        self._screen: curses.window | None = None
        self._last: Screen | None = None
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

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        self._close()

    def show(self, screen: Screen) -> int:
        """Show `screen`, in a frame where there is room for one; return its last offset."""
        self._last = screen
        window = self._opened
        rows, columns = window.getmaxyx()
        is_framed = columns >= _LEAST_FRAMED[0] and rows >= _LEAST_FRAMED[1]
        border = 2 * _FRAME * is_framed
        # The last cell of a terminal cannot be written without scrolling it.
        size = (
            min(columns - border, _LARGEST[0]),
            min(rows - border, _LARGEST[1]),
        )
        window.erase()
        last_offset = 0
        try:
            shown = grid(screen, max(size[0], SMALLEST[0]), max(size[1], SMALLEST[1]))
            last_offset = shown.last_offset
            self._draw(window, shown, is_framed=is_framed)
        except curses.error:
            # The user is making the terminal smaller than the panel.
            window.erase()
            with suppress(curses.error):
                window.insnstr(0, 0, "make the terminal larger", columns)
        window.refresh()
        return last_offset

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; None after `timeout_s`, an unused key or a resize.

        Raises:
            CamctlError: the terminal was closed
        """
        self._opened.timeout(max(0, round(1000 * timeout_s)))
        code = self._opened.getch()
        if code == curses.ERR and _is_closed(sys.stdin.fileno()):
            raise CamctlError("the terminal was closed")
        if code == _REDRAW:
            self._opened.redrawwin()
        if code in (_REDRAW, curses.KEY_RESIZE):
            assert self._last is not None  # the menu shows a screen before it asks for keys
            self.show(self._last)
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
        if columns < SMALLEST[0] or rows < SMALLEST[1]:
            raise UsageError(
                f"the terminal has only {columns} x {rows} characters",
                hint=f"enlarge it to {SMALLEST[0]} x {SMALLEST[1]}",
            )

    def _open(self) -> None:
        before = locale.setlocale(locale.LC_CTYPE)
        locale.setlocale(locale.LC_CTYPE, "")  # else curses refuses characters outside ASCII
        self._restore.append(lambda: locale.setlocale(locale.LC_CTYPE, before))
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
            with suppress(curses.error):  # the terminal may be gone
                self._restore.pop()()
        self._screen = None

    def _draw(self, screen: curses.window, shown: Grid, *, is_framed: bool) -> None:
        height, width = screen.getmaxyx()
        border = _FRAME * is_framed
        columns, rows = len(shown.lines[0]), len(shown.lines)
        top = max(0, (height - rows - 2 * border) // 2)
        left = max(0, (width - columns - 2 * border) // 2)
        frame = screen.derwin(rows + 2 * border, columns + 2 * border, top, left)
        if is_framed:
            frame.box()
            frame.addstr(0, 2, _TITLE, curses.A_BOLD)
        for row, text in enumerate(shown.lines):
            line = text.encode(screen.encoding, "replace").decode(screen.encoding)
            bold = curses.A_BOLD if row == 0 and rows > 2 else 0
            # Unlike addstr, this writes the last cell of the terminal without scrolling it.
            frame.insnstr(row + border, border, line, columns, bold)
            if is_framed:
                frame.insch(row + border, columns + border, curses.ACS_VLINE)
        if shown.highlight is not None:
            row, column = shown.highlight.row, shown.highlight.column
            frame.chgat(row + border, column + border, shown.highlight.width, curses.A_REVERSE)


def _is_closed(terminal: int) -> bool:
    """Return whether the other end of a terminal is gone: reading it returns at once, without end.

    SIGHUP reports that as well, but a process may ignore it.
    """
    poll = select.poll()
    poll.register(terminal, 0)
    return bool(poll.poll(0))
