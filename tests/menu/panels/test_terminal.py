"""The terminal panel on a pseudo-terminal: keys in, text out, and the terminal restored."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator

import pytest
from pseudo_terminal import HELPERS, Terminal, program_environment
from sampling import some

from camctl.errors import UsageError
from camctl.interface.backends import PANELS, load
from camctl.menu.panels.terminal import TerminalPanel

MENU = """
from panel_fakes import FakeJob
from camctl.menu.app import run
from camctl.menu.panels.terminal import TerminalPanel
print("returned", run(TerminalPanel(), FakeJob))
"""
MENU_THAT_KEEPS_SHOOTING = """
import sys
from camctl.system.interrupts import Interrupt, run_interruptible, signal_handlers
from panel_fakes import FakeJob
from camctl.menu.app import run
from camctl.menu.panels.terminal import TerminalPanel
job = FakeJob()
job.frame_may_end.clear()
with signal_handlers():
    try:
        print("returned", run_interruptible(lambda: run(TerminalPanel(), lambda: job)))
    except Interrupt as interrupt:
        sys.exit(128 + interrupt.number)
"""
MENU_WITH_ERROR_BEYOND_ASCII = """
from camctl.errors import CaptureError
from panel_fakes import FakeJob
from camctl.menu.app import run
from camctl.menu.panels.terminal import TerminalPanel
class FailingJob(FakeJob):
    def plan(self, choice, cancelled):
        raise CaptureError("nichts für uns")
run(TerminalPanel(), FailingJob)
"""
OPEN_PANEL = """
from camctl.errors import CamctlError
from camctl.menu.panels.terminal import TerminalPanel
try:
    TerminalPanel().__enter__()
except CamctlError as error:
    print(type(error).__name__, error)
"""
UP, DOWN, RIGHT, LEFT = "\x1bOA", "\x1bOB", "\x1bOC", "\x1bOD"
FULL_SCREEN, NORMAL_SCREEN = "\x1b[?1049h", "\x1b[?1049l"

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
            terminal = Terminal(["-c", code], columns, rows, kind, locale)
            stack.callback(terminal.close)
            return terminal

        yield begin


def test_menu_is_operated_with_the_keys(start: Start) -> None:
    terminal = start(MENU)
    terminal.wait_for("camctl", "[Set]")
    terminal.type("\r")
    terminal.wait_for(">Constant contrast", "enter: take exit: back")
    assert re.search(r"\x1b\[(0;)?7m>Constant contrast", terminal.raw)  # in reverse video
    terminal.type(DOWN)
    terminal.wait_for(">Linear")
    terminal.type(UP + "\r")
    terminal.wait_for("Dynamic range")
    terminal.type(UP + LEFT)
    terminal.wait_for(">Constant contrast")
    terminal.type(RIGHT)
    terminal.wait_for(">High 1:16,000")
    terminal.type("\r")
    terminal.wait_for(">Recommended")
    terminal.type(4 * DOWN)
    terminal.wait_for(">3 exposures")
    terminal.type("\r")
    terminal.wait_for("0.0033 s", "[Shoot]")
    terminal.type("\r")
    terminal.wait_for("Done", "97 effective levels, 98 planned")
    terminal.type("\x1b")
    terminal.wait_for("[Set]")
    terminal.type("q")
    terminal.wait_for("Quit the menu?")
    terminal.type(RIGHT + "\r")
    assert terminal.wait_for_end() == 0
    assert "folder='captures/x'" in terminal.raw


def test_serial_console_without_arrow_keys_has_letters_and_digits(start: Start) -> None:
    terminal = start(MENU, kind="vt100")
    terminal.wait_for("[Set]")
    terminal.type("5")
    terminal.wait_for(">Constant")
    terminal.type("j2")
    terminal.wait_for(">Gamma")
    terminal.type("k")
    terminal.wait_for(">Linear")
    terminal.type("l")
    terminal.wait_for("Dynamic")
    terminal.type("h")
    terminal.wait_for(">Linear")


@pytest.mark.parametrize("size", some([((16, 2),), ((20, 4),), ((23, 7),)], every=3))
def test_small_terminal_is_used_to_its_last_cell(start: Start, size: tuple[int, int]) -> None:
    terminal = start(MENU, *size)
    terminal.wait_for("[Set]")
    terminal.type("\r")
    terminal.wait_for(">", "100")
    terminal.type("\r")
    terminal.wait_for(">Auto")


def test_panel_adapts_to_the_size_of_the_terminal(start: Start) -> None:
    terminal = start(MENU, 80, 24)
    terminal.wait_for("[Set]")
    terminal.type("\r")
    terminal.wait_for("1.79 s exposed, 1.88 s in all")
    terminal.resize(22, 4)
    terminal.notify_resize()
    terminal.wait_until(
        lambda screen: (
            ">Constant contrast" in screen
            and "1.88 s, 100 levels" in screen
            and "exposed" not in screen
        )
    )
    terminal.resize(10, 3)
    terminal.notify_resize()
    terminal.wait_for("make the t")
    terminal.resize(100, 40)
    terminal.notify_resize()
    terminal.wait_for("1.79 s exposed, 1.88 s in all")


@pytest.mark.parametrize(("locale", "shown"), [("C.UTF-8", "für"), ("C", "f?r")])
def test_characters_outside_the_locale_are_replaced(start: Start, locale: str, shown: str) -> None:
    terminal = start(MENU_WITH_ERROR_BEYOND_ASCII, locale=locale)
    for text in ("[Set]", ">Constant", "Dynamic range", "Exposures"):
        terminal.wait_for(text)
        terminal.type("\r")
    terminal.wait_for(f"nichts {shown} uns")


@pytest.mark.parametrize(
    ("end_with", "status"),
    some([("quit", 0), (signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)], every=2),
)
def test_terminal_is_restored(start: Start, end_with: str | signal.Signals, status: int) -> None:
    terminal = start(MENU_THAT_KEEPS_SHOOTING)
    for text in ("[Set]", ">Constant", "Dynamic range", ">Recommended", "[Shoot]"):
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
        terminal.type("q")
        terminal.wait_for("[Set]")
        terminal.type("q")
        terminal.wait_for("Quit the menu?")
        terminal.type(RIGHT + "\r")
    assert terminal.wait_for_end() == status
    assert terminal.raw.rindex(NORMAL_SCREEN) > terminal.raw.rindex(FULL_SCREEN)
    assert termios.tcgetattr(terminal.slave) == terminal.before


@pytest.mark.parametrize(
    ("columns", "rows", "kind", "line"),
    [
        (10, 1, "xterm", "the terminal has only 10 x 1 characters; enlarge it to 16 x 2"),
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
        env=program_environment(),
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
