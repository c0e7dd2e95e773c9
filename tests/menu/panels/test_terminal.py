"""The terminal panel on a pseudo-terminal: keys in, text out, and the terminal restored."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from camctl.backends import PANELS, load
from camctl.errors import UsageError
from menu.panels.terminal import TerminalPanel

HELPERS = Path(__file__).parents[2] / "helpers"
MENU = """
from panel_fakes import FakeJob
from menu.app import run
from menu.panels.terminal import TerminalPanel
print("returned", run(TerminalPanel(), FakeJob()))
"""
MENU_THAT_KEEPS_SHOOTING = """
from panel_fakes import FakeJob
from menu.app import run
from menu.panels.terminal import TerminalPanel
job = FakeJob()
job.frame_may_end.clear()
print("returned", run(TerminalPanel(), job))
"""
MENU_WITH_ERROR_BEYOND_ASCII = """
from camctl.errors import CaptureError
from panel_fakes import FakeJob
from menu.app import run
from menu.panels.terminal import TerminalPanel
class FailingJob(FakeJob):
    def predict(self, response, dynamic_range):
        raise CaptureError("nichts für uns")
run(TerminalPanel(), FailingJob())
"""
OPEN_PANEL = """
from camctl.errors import CamctlError
from menu.panels.terminal import TerminalPanel
try:
    TerminalPanel().__enter__()
except CamctlError as error:
    print(type(error).__name__, error)
"""
REDRAW = "\x0c"
UP, DOWN, RIGHT, LEFT = "\x1bOA", "\x1bOB", "\x1bOC", "\x1bOD"
FULL_SCREEN, NORMAL_SCREEN = "\x1b[?1049h", "\x1b[?1049l"

QUIET_S = 0.1
"""After this time without output, s, the screen is asked for again."""


def _environment(**more: str) -> dict[str, str]:
    """Return the environment of a program that imports the test helpers."""
    kept = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    path = os.pathsep.join([str(HELPERS), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**kept, "PYTHONPATH": path, **more}


class Terminal:
    """A Python program on a pseudo-terminal.

    Waits have no limit of their own: the time-out of the test ends a wait that is in vain.
    """

    def __init__(
        self,
        code: str,
        columns: int = 80,
        rows: int = 24,
        kind: str = "xterm",
        locale: str = "C.UTF-8",
    ) -> None:
        self.master, self.slave = pty.openpty()
        self.resize(columns, rows)
        self.before = termios.tcgetattr(self.slave)
        self.raw = ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            cwd=HELPERS,
            env=_environment(TERM=kind, LC_ALL=locale),
            start_new_session=True,
        )

    def resize(self, columns: int, rows: int) -> None:
        """Set the size; a running program is notified by `notify_resize`."""
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def notify_resize(self) -> None:
        """Send the signal that a terminal sends when its size has changed."""
        os.kill(self.process.pid, signal.SIGWINCH)

    def type(self, keys: str) -> None:
        """Press keys."""
        os.write(self.master, keys.encode())

    def _read(self, quiet_s: float) -> str:
        """Return the output that comes within `quiet_s`, "" for none."""
        if not select.select([self.master], [], [], quiet_s)[0]:
            return ""
        text = os.read(self.master, 65536).decode(errors="replace")
        self.raw += text
        return text

    def wait_until(self, condition: Callable[[str], bool]) -> None:
        """Wait until the text of the screen meets a condition.

        The program is asked to draw the screen, and again whenever it has been quiet.
        """
        while self._read(0):
            pass
        while True:
            self.type(REDRAW)
            drawn = ""
            while text := self._read(QUIET_S):
                drawn += text
                without_codes = re.sub(r"\x1b\[[\d;?]*[A-Za-z]|\x1b[()][A-Z0]", " ", drawn)
                if condition(" ".join(without_codes.split())):
                    return
            assert self.process.poll() is None, f"the program has ended: {self.raw!r}"

    def wait_for(self, *texts: str) -> None:
        """Wait until all `texts` are on the screen."""
        self.wait_until(lambda screen: all(text in screen for text in texts))

    def wait_for_end(self) -> int:
        """Return the exit status once the program has ended and its output is read."""
        while self.process.poll() is None:
            self._read(QUIET_S)
        while self._read(0):
            pass
        return self.process.returncode

    def close(self) -> None:
        """Kill the program and close the terminal."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        os.close(self.master)
        os.close(self.slave)


Start = Callable[..., Terminal]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a program on a terminal of its own; takes the arguments of `Terminal`."""
    with contextlib.ExitStack() as stack:

        def begin(
            code: str,
            columns: int = 80,
            rows: int = 24,
            kind: str = "xterm",
            locale: str = "C.UTF-8",
        ) -> Terminal:
            terminal = Terminal(code, columns, rows, kind, locale)
            stack.callback(terminal.close)
            return terminal

        yield begin


def test_menu_is_operated_with_the_keys(start: Start) -> None:
    terminal = start(MENU)
    terminal.wait_for("camctl", ">Constant contrast", "enter: next exit: quit")
    terminal.type(DOWN)
    terminal.wait_for(">Linear")
    terminal.type(UP + "\r")
    terminal.wait_for("Dynamic range")
    terminal.type(DOWN + LEFT)
    terminal.wait_for(">Constant contrast")
    terminal.type(RIGHT)
    terminal.wait_for(">Low 1:256")
    terminal.type("\r")
    terminal.wait_for("> 3")
    terminal.type("\r")
    terminal.wait_for("3.3 ms", "[Shoot]")
    terminal.type("\r")
    terminal.wait_for("Done", "390 effective levels, 392 planned")
    terminal.type(RIGHT + RIGHT + "\r")
    assert terminal.wait_for_end() == 0
    assert "folder='captures/x'" in terminal.raw


def test_selected_line_is_shown_in_reverse_video(start: Start) -> None:
    terminal = start(MENU)
    terminal.wait_for(">Constant contrast")
    assert re.search(r"\x1b\[(0;)?7m>Constant contrast", terminal.raw)


def test_escape_and_q_are_the_exit_key(start: Start) -> None:
    terminal = start(MENU)
    terminal.wait_for(">Constant")
    terminal.type("\r")
    terminal.wait_for("Dynamic range")
    terminal.type("\x1b")
    terminal.wait_for(">Constant")
    terminal.type("q")
    assert terminal.wait_for_end() == 0
    assert terminal.raw.endswith("returned None\r\n")


def test_panel_adapts_to_the_size_of_the_terminal(start: Start) -> None:
    terminal = start(MENU, 80, 24)
    terminal.wait_for("equal steps of contrast")
    terminal.resize(22, 6)
    terminal.notify_resize()
    terminal.wait_until(
        lambda screen: (
            ">Constant contrast" in screen and "Gamma 1/2" in screen and "equal steps" not in screen
        )
    )
    terminal.resize(10, 3)
    terminal.notify_resize()
    terminal.wait_for("make the t")
    terminal.resize(100, 40)
    terminal.notify_resize()
    terminal.wait_for("equal steps of contrast")


@pytest.mark.parametrize(("locale", "shown"), [("C.UTF-8", "für"), ("C", "f?r")])
def test_characters_outside_the_locale_are_replaced(start: Start, locale: str, shown: str) -> None:
    terminal = start(MENU_WITH_ERROR_BEYOND_ASCII, locale=locale)
    for text in (">Constant", "Dynamic range"):
        terminal.wait_for(text)
        terminal.type("\r")
    terminal.wait_for(f"nichts {shown} uns")


@pytest.mark.parametrize(
    ("end_with", "status"),
    [("quit", 0), (signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)],
)
def test_terminal_is_restored(start: Start, end_with: str | signal.Signals, status: int) -> None:
    terminal = start(MENU_THAT_KEEPS_SHOOTING)
    for text in (">Constant", "Dynamic range", "> 3", "[Shoot]"):
        terminal.wait_for(text)
        terminal.type("\r")
    terminal.wait_for("Shooting")
    assert FULL_SCREEN in terminal.raw
    assert termios.tcgetattr(terminal.slave) != terminal.before
    if isinstance(end_with, signal.Signals):
        os.kill(terminal.process.pid, end_with)
    else:
        terminal.type("q")
        terminal.wait_for("stopped after 0 frames")
        terminal.type(RIGHT + RIGHT + "\r")
    assert terminal.wait_for_end() == status
    assert terminal.raw.rindex(NORMAL_SCREEN) > terminal.raw.rindex(FULL_SCREEN)
    assert termios.tcgetattr(terminal.slave) == terminal.before


@pytest.mark.parametrize(
    ("columns", "rows", "kind", "line"),
    [
        (19, 5, "xterm", "the terminal has only 19 x 5 characters; enlarge it to 22 x 6"),
        (
            80,
            24,
            "dumb",
            "the terminal type TERM=dumb cannot place the cursor; use another terminal, "
            "or set TERM",
        ),
        (80, 24, "unheard", "unknown terminal type TERM=unheard; set TERM=xterm"),
    ],
)
def test_unusable_terminal_is_refused(
    start: Start, columns: int, rows: int, kind: str, line: str
) -> None:
    terminal = start(OPEN_PANEL, columns, rows, kind)
    assert terminal.wait_for_end() == 0
    assert " ".join(terminal.raw.split()) == f"UsageError {line}"
    assert terminal.raw.count("\n") == 1
    assert termios.tcgetattr(terminal.slave) == terminal.before


def test_panel_without_a_terminal_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-c", OPEN_PANEL],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        cwd=HELPERS,
        env=_environment(),
        check=True,
    )
    assert done.stdout == (
        "UsageError the terminal panel needs a terminal; run it without pipes or redirection\n"
    )


def test_panel_is_loaded_by_its_name() -> None:
    assert load(PANELS, "panel", "terminal") is TerminalPanel
    with pytest.raises(UsageError, match=r"unknown panel 'terminl'; did you mean terminal\?"):
        load(PANELS, "panel", "terminl")


def test_panel_that_is_not_open_refuses_to_work() -> None:
    with pytest.raises(ValueError, match="the terminal panel is not open"):
        TerminalPanel().key(0)
