"""The terminal panel on a pseudo-terminal: keys in, screen text out, the terminal given back."""

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
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from camctl.backends import PANELS, load
from camctl.errors import UsageError
from menu.panels.terminal import TerminalPanel

HELPERS = Path(__file__).parents[2] / "helpers"
MENU = """
from panel_fakes import FakeJob
from menu.app import run
from menu.panels.terminal import TerminalPanel
print("gave", run(TerminalPanel(), FakeJob()))
"""
HOLD = MENU.replace("FakeJob())", "job)").replace(
    "print", "job = FakeJob(); job.frame_may_end.clear()\nprint"
)
FOREIGN = """
from camctl.errors import CaptureError
from panel_fakes import FakeJob
from menu.app import run
from menu.panels.terminal import TerminalPanel
class Foreign(FakeJob):
    def predict(self, response, dynamic_range):
        raise CaptureError("nichts für uns")
run(TerminalPanel(), Foreign())
"""
REFUSED = """
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


_ENVIRONMENT = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}


class Terminal:
    """A program on a pseudo-terminal."""

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
            env={**_ENVIRONMENT, "TERM": kind, "LC_ALL": locale, "PYTHONPATH": _python_path()},
            start_new_session=True,
        )

    def resize(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def read(self, wait_s: float) -> str:
        """What has come out, until it is silent for `wait_s`."""
        data = b""
        while select.select([self.master], [], [], wait_s)[0]:
            data += os.read(self.master, 65536)
        text = data.decode(errors="replace")
        self.raw += text
        return text

    def screen(self) -> str:
        """The text of the screen, drawn anew."""
        self.read(0.05)
        self.type(REDRAW)
        drawn = re.sub(r"\x1b\[[\d;?]*[A-Za-z]|\x1b[()][A-Z0]", " ", self.read(0.15))
        return " ".join(drawn.split())

    def wait_for(self, words: str) -> str:
        deadline = time.monotonic() + 20
        screen = ""
        while words not in screen:
            assert time.monotonic() < deadline, f"waits for {words!r}, sees {screen!r}"
            assert self.process.poll() is None, f"ended with {self.raw!r}"
            screen = self.screen()
        return screen

    def ended(self) -> int:
        """The exit status, with the rest of the output read."""
        status = self.process.wait(20)
        self.read(0.1)
        return status

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        os.close(self.master)
        os.close(self.slave)


def _python_path() -> str:
    return os.pathsep.join([str(HELPERS), *filter(None, [os.environ.get("PYTHONPATH")])])


@pytest.fixture
def start() -> Iterator[Any]:
    running: list[Terminal] = []

    def begin(*arguments: Any, **options: Any) -> Terminal:
        running.append(Terminal(*arguments, **options))
        return running[-1]

    yield begin
    for terminal in running:
        terminal.close()


def test_the_whole_way_with_keys(start: Any) -> None:
    terminal = start(MENU)
    first = terminal.wait_for(">Constant contrast")
    assert "camctl" in first
    assert "enter: next exit: quit" in first
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
    assert "3.3 ms" in terminal.wait_for("[Shoot]")
    terminal.type("\r")
    assert "390 levels" in terminal.wait_for("Done")
    terminal.type(RIGHT + RIGHT + "\r")
    assert terminal.ended() == 0
    assert "folder='captures/x'" in terminal.raw


def test_the_selected_line_is_reversed(start: Any) -> None:
    terminal = start(MENU)
    terminal.wait_for(">Constant contrast")
    assert re.search(r"\x1b\[(0;)?7m>Constant contrast", terminal.raw)


def test_escape_and_q_are_exit(start: Any) -> None:
    terminal = start(MENU)
    terminal.wait_for(">Constant")
    terminal.type("\r")
    terminal.wait_for("Dynamic range")
    terminal.type("\x1b")
    terminal.wait_for(">Constant")
    terminal.type("q")
    assert terminal.ended() == 0
    assert terminal.raw.endswith("gave None\r\n")


def test_it_follows_the_size_of_the_terminal(start: Any) -> None:
    terminal = start(MENU, 80, 24)
    terminal.wait_for("equal steps of contrast")
    terminal.resize(22, 6)
    os.kill(terminal.process.pid, signal.SIGWINCH)
    small = terminal.wait_for(">Constant contrast")
    while "equal steps" in small:
        small = terminal.screen()
    assert "Gamma 1/2" in small
    terminal.resize(10, 3)
    os.kill(terminal.process.pid, signal.SIGWINCH)
    terminal.wait_for("make the t")
    terminal.resize(100, 40)
    os.kill(terminal.process.pid, signal.SIGWINCH)
    terminal.wait_for("equal steps of contrast")


@pytest.mark.parametrize(("locale", "shown"), [("C.UTF-8", "für"), ("C", "f?r")])
def test_what_the_terminal_cannot_write_is_replaced(start: Any, locale: str, shown: str) -> None:
    terminal = start(FOREIGN, locale=locale)
    for words in (">Constant", "Dynamic range"):
        terminal.wait_for(words)
        terminal.type("\r")
    terminal.wait_for(f"nichts {shown} uns")


@pytest.mark.parametrize("how", ["quit", signal.SIGINT, signal.SIGTERM])
def test_the_terminal_is_given_back(start: Any, how: str | signal.Signals) -> None:
    terminal = start(HOLD)
    for words in (">Constant", "Dynamic range", "> 3", "[Shoot]"):
        terminal.wait_for(words)
        terminal.type("\r")
    terminal.wait_for("Shooting")
    assert FULL_SCREEN in terminal.raw
    assert termios.tcgetattr(terminal.slave) != terminal.before
    if isinstance(how, signal.Signals):
        os.kill(terminal.process.pid, how)
    else:
        terminal.type("q")
        terminal.wait_for("stopped after 0 frames")
        terminal.type(RIGHT + RIGHT + "\r")
    status = terminal.ended()
    assert status == {"quit": 0, signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 143}[how]
    assert terminal.raw.rindex(NORMAL_SCREEN) > terminal.raw.rindex(FULL_SCREEN)
    assert termios.tcgetattr(terminal.slave) == terminal.before


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            {"columns": 19, "rows": 5},
            "UsageError the terminal has 19 x 5 characters; the menu needs 22 x 6; make it larger",
        ),
        ({"kind": "dumb"}, "UsageError the terminal TERM='dumb' cannot be drawn on;"),
        ({"kind": "nonsense"}, "UsageError unknown terminal TERM='nonsense'; set TERM=xterm"),
    ],
)
def test_what_cannot_be_drawn_on_is_said_in_one_line(
    start: Any, options: dict[str, Any], line: str
) -> None:
    terminal = start(REFUSED, **options)
    assert terminal.ended() == 0
    assert terminal.raw.startswith(line)
    assert terminal.raw.count("\n") == 1
    assert termios.tcgetattr(terminal.slave) == terminal.before


def test_without_a_terminal_it_says_so() -> None:
    found = subprocess.run(
        [sys.executable, "-c", REFUSED],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        cwd=HELPERS,
        env={**os.environ, "PYTHONPATH": _python_path()},
        check=True,
    )
    assert found.stdout == (
        "UsageError the terminal panel needs a terminal; run it without pipes and redirection\n"
    )


def test_it_is_found_by_its_name() -> None:
    assert load(PANELS, "panel", "terminal") is TerminalPanel
    with pytest.raises(UsageError, match="did you mean terminal"):
        load(PANELS, "panel", "terminl")


def test_a_panel_that_is_not_open_says_so() -> None:
    with pytest.raises(ValueError, match="not open"):
        TerminalPanel().key(0)
