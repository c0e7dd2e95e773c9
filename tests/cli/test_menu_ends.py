"""How `camctl menu` ends on a real pseudo-terminal: by signals, and when the terminal is closed."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from crash_sweep import damaged
from pseudo_terminal import Terminal

MENU = """
import sys, time
from pathlib import Path
from camctl.__main__ import run
from camctl.menu.camera_job import CameraJob
from camctl.sim.camera import SimulatedCamera

shoot, frame, stopped = CameraJob.shoot, SimulatedCamera._counted_frame, []

def shoot_until(job, plan, on_progress, cancelled):
    stopped.append(cancelled)
    return shoot(job, plan, on_progress, cancelled)

def second_frame_waits(camera, shot, requested):
    if shot.index > 0:
        Path("../second-frame").touch()
        while not stopped[-1]():
            time.sleep(0.01)
    return frame(camera, shot, requested)

CameraJob.shoot, SimulatedCamera._counted_frame = shoot_until, second_frame_waits
sys.argv = ["camctl", "menu", "-O", "size=24x16"]
sys.exit(run())
"""
"""`camctl menu` with a camera whose second frame comes when the capture has been cancelled."""


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Start the menu in an empty folder, with its defaults; takes whether it ignores SIGHUP."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "pictures"
    folder.mkdir()
    with ExitStack() as stack:

        def begin(ignores_hangup: bool) -> tuple[Terminal, Path]:
            terminal = Terminal(("-c", MENU), folder=folder, ignores_hangup=ignores_hangup)
            stack.callback(terminal.close)
            return terminal, folder

        yield begin


Start = Callable[[bool], tuple[Terminal, Path]]


def end(terminal: Terminal) -> tuple[int, str]:
    """Wait for the end of the menu; return its exit status and standard error."""
    status = terminal.wait_for_end()
    assert terminal.process.stderr is not None
    return status, terminal.process.stderr.read().decode()


@pytest.mark.parametrize(
    ("ignores_hangup", "status", "err"),
    [
        pytest.param(True, 1, "camctl: the terminal was closed\n", marks=pytest.mark.slow),
        (False, 129, "camctl: interrupted by SIGHUP\n"),
    ],
)
def test_menu_ends_when_its_terminal_is_closed(
    start: Start, ignores_hangup: bool, status: int, err: str
) -> None:
    terminal, _ = start(ignores_hangup)
    terminal.wait_for("[Set]")
    terminal.hang_up()
    assert end(terminal) == (status, err)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end_with", "status", "err"),
    [
        ("closed terminal", 129, "interrupted by SIGHUP"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ("closed terminal, SIGHUP ignored", 1, "the terminal was closed"),
                ("SIGTERM", 143, "interrupted by SIGTERM"),
                ("SIGINT", 130, "interrupted"),
            )
        ),
    ],
)
def test_menu_that_ends_during_a_capture_keeps_the_frames(
    start: Start, end_with: str, status: int, err: str
) -> None:
    terminal, folder = start(end_with.endswith("ignored"))
    for text in ("[Set]", ">Constant", "Dynamic range"):
        terminal.wait_for(text)
        terminal.type("\r")
    terminal.wait_for(">Recommended")
    terminal.type("jjjj")
    for text in (">3 exposures", "[Shoot]"):
        terminal.wait_for(text)
        terminal.type("\r")
    # The capture is not asked to stop before: after its first frame it would end with that one.
    while not (folder.parent / "second-frame").exists():
        assert terminal.process.poll() is None
        time.sleep(0.005)
    if end_with.startswith("closed"):
        terminal.hang_up()
    else:
        terminal.process.send_signal(getattr(signal, end_with))
    ended, text = end(terminal)
    assert ended == status
    (capture,) = folder.iterdir()
    expected = f"2 of 3 frames are kept; shoot the others (camctl resume {capture.name})"
    assert text == f"camctl: {err}; cancelled; {expected}\n"
    assert [path.name for path in sorted(capture.glob("frames/*"))] == [
        "frame-01.npy",
        "frame-02.npy",
    ]
    assert damaged(capture) == []
