"""Control-C, SIGTERM and SIGHUP at many points of the commands: status, message, camera, folder."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any

import pytest
from command_line import Run
from crash_sweep import checked
from sampling import some

import camctl
from camctl.interface.camera import CameraBase, Frame
from camctl.records.folder import CaptureFolder
from camctl.records.folder_store import FolderStore
from camctl.records.frame_store import KeptFiles
from camctl.sim.camera import SimulatedCamera
from camctl.system.interrupts import run_interruptible

SHOOT = "shoot -O size=24x16 --ratios 1,8 --base 0.03 -o out"
SIGNALS = [(signal.SIGINT, ""), (signal.SIGTERM, " by SIGTERM"), (signal.SIGHUP, " by SIGHUP")]
CLOSING = "camctl.sim.camera:SimulatedCamera._close"
RESUME = "shoot the others (camctl resume out)"
COMPLETE = "make the picture of them (camctl resume out)"


class Cameras:
    """Counts the simulated cameras that were opened and closed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.opened = self.closed = 0
        open_, close = SimulatedCamera._open, SimulatedCamera._close

        def count_opened(camera: SimulatedCamera) -> None:
            open_(camera)
            self.opened += 1

        def count_closed(camera: SimulatedCamera) -> None:
            close(camera)
            self.closed += 1

        monkeypatch.setattr(SimulatedCamera, "_open", count_opened)
        monkeypatch.setattr(SimulatedCamera, "_close", count_closed)


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> Cameras:
    return Cameras(monkeypatch)


@pytest.fixture(autouse=True)
def surviving() -> Iterator[None]:
    """A signal that a command does not handle fails the test, and does not end all tests."""

    def fail(number: int, _frame: FrameType | None) -> None:
        raise AssertionError(f"{signal.Signals(number).name} was not handled")

    before = {number: signal.signal(number, fail) for number, _ in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def at_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, signal.Signals], None]:
    """Send a signal to this process when "module:function" is called for the first time."""
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))  # nothing is solved before

    def install(point: str, number: signal.Signals) -> None:
        module, _, path = point.partition(":")
        owner: Any = import_module(module)
        *names, last = path.split(".")
        for name in names:
            owner = getattr(owner, name)
        function = getattr(owner, last)
        left = [number]

        def call(*arguments: Any, **named: Any) -> Any:
            if left:
                os.kill(os.getpid(), left.pop())
            return function(*arguments, **named)

        monkeypatch.setattr(owner, last, call)

    return install


AtCall = Callable[[str, signal.Signals], None]


@pytest.mark.parametrize(("number", "by"), SIGNALS)
@pytest.mark.parametrize(
    ("line", "point", "end"),
    [
        (SHOOT, "camctl.captures.sequencer:plan_capture", ""),
        ("shoot -O size=24x16 -n 2 -o out", "camctl.sim.camera:SimulatedCamera.preview", ""),
        (
            "shoot -O size=24x16 -n 2 --range 3 --base 0.01 -o out",
            "camctl.exposure.accurate.sets:AccurateSets.within",
            "",
        ),
        (SHOOT, "camctl.sim.camera:SimulatedCamera._frames", f"; 0 of 2 frames are kept; {RESUME}"),
        (SHOOT, "camctl.captures.sequence:complete", f"; 2 of 2 frames are kept; {COMPLETE}"),
        (SHOOT, "tifffile:imwrite", f"; 2 of 2 frames are kept; {COMPLETE}"),
        (SHOOT, CLOSING, "; the capture in out is complete"),
        (SHOOT, "camctl.cli.capture_output:capture_text", "; the capture in out is complete"),
        ("solve -n 2", "camctl.exposure.solver:solve", ""),
        ("simulate --size 24x16", "camctl.sim.render:Renderer.expose", ""),
        ("simulate --size 24x16", CLOSING, ""),
        ("calibrate delay -O size=24x16", "camctl.sim.camera:SimulatedCamera.step", ""),
        (
            "table build -n 1 --bits 3 --workers 1",
            "camctl.exposure.build:solve_job",
            " after 0 of 9 rows",
        ),
    ],
)
def test_signal_ends_a_command(
    run: Run,
    cameras: Cameras,
    at_call: AtCall,
    number: signal.Signals,
    by: str,
    line: str,
    point: str,
    end: str,
) -> None:
    at_call(point, number)
    ran = run(*line.split())
    assert ran.status == 128 + number
    assert ran.error == f"interrupted{by}{end}"
    assert cameras.closed == cameras.opened
    if "camctl resume" in end:
        assert checked(Path("out"))["wrong"] == []


@pytest.mark.parametrize(
    "first", some(["camctl.sim.camera:SimulatedCamera._frames", "tifffile:imwrite"], every=2)
)
@pytest.mark.parametrize(
    "second",
    [CLOSING, "camctl.captures.sequence:Sequence._failure", "camctl.cli:_report"],
)
def test_second_signal_changes_nothing(
    run: Run, cameras: Cameras, at_call: AtCall, first: str, second: str
) -> None:
    at_call(first, signal.SIGTERM)
    at_call(second, signal.SIGINT)
    ran = run(*SHOOT.split())
    assert ran.status == 143
    assert ran.error.startswith("interrupted by SIGTERM; ")
    assert ran.error.endswith("(camctl resume out)")
    assert (cameras.opened, cameras.closed) == (1, 1)
    assert checked(Path("out"))["wrong"] == []


def test_signal_while_an_error_is_reported_changes_nothing(run: Run, at_call: AtCall) -> None:
    at_call("camctl.cli:_report", signal.SIGTERM)
    ran = run("solve", "-n", "77")
    assert ran.status == 2
    assert ran.error.startswith("invalid value for --exposures: 77")


def deliver(number: signal.Signals, frame: FrameType) -> None:
    """Call the handler of a signal as the interpreter does where it finds the signal in `frame`."""
    handler = signal.getsignal(number)
    assert callable(handler)
    handler(number, frame)


@pytest.mark.parametrize("function", [CameraBase.__enter__, CameraBase.open])
def test_signal_while_an_open_camera_is_entered_closes_it(
    run: Run, cameras: Cameras, function: FunctionType
) -> None:
    """The signal finds the function's own code, between opening and the body of ``with``."""

    def interrupt(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call" and cameras.opened and frame.f_code is function.__code__:
            sys.setprofile(None)
            deliver(signal.SIGTERM, frame)

    sys.setprofile(interrupt)
    try:
        ran = run(*SHOOT.split())
    finally:
        sys.setprofile(None)
    # The signal waits 0.1 s; a capture in virtual time may have printed its end by then.
    assert ran.status == 143
    assert ran.err.startswith("camctl: interrupted by SIGTERM")
    assert ran.err.count("\n") == 1
    assert (cameras.opened, cameras.closed) == (1, 1)


@pytest.mark.parametrize(("name", "event"), [("__enter__", "c_return"), ("__exit__", "call")])
def test_signal_at_the_ends_of_a_with_block_frees_the_folder(
    run: Run, name: str, event: str
) -> None:
    """The signal finds contextlib's own code: when the folder was locked, before it is freed."""
    owned: Any = CaptureFolder(Path("out")).owned()
    code, left = getattr(type(owned), name).__code__, [signal.SIGTERM]

    def interrupt(frame: FrameType, happened: str, _argument: object) -> None:
        if happened != event or frame.f_code is not code:
            return
        if frame.f_locals["self"].gen.gi_code is owned.gen.gi_code:
            sys.setprofile(None)
            deliver(left.pop(), frame)

    sys.setprofile(interrupt)
    try:
        ran = run(*SHOOT.split())
    finally:
        sys.setprofile(None)
    assert left == []
    # As above, the signal waits 0.1 s; the folder is removed where there was no report by then.
    assert ran.status == 143
    assert ran.err.startswith("camctl: interrupted by SIGTERM")
    assert not Path("out").exists() or checked(Path("out"))["wrong"] == []


def test_signal_while_the_thread_for_frames_starts_keeps_the_frame(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The executor does not know the thread yet, and would not wait for it."""
    keep, sent = FolderStore.keep, []

    def keep_slowly(store: FolderStore, frame: Frame, position: int) -> KeptFiles:
        time.sleep(0.3)
        return keep(store, frame, position)

    def interrupt(frame: FrameType, event: str, _argument: object) -> None:
        before = frame.f_back
        if event != "call" or before is None or frame.f_code is not threading.Event.wait.__code__:
            return
        thread = before.f_locals.get("self")
        if isinstance(thread, threading.Thread) and thread.name.startswith("camctl-frame"):
            sys.setprofile(None)
            sent.append(signal.SIGTERM)
            deliver(signal.SIGTERM, frame)

    monkeypatch.setattr(FolderStore, "keep", keep_slowly)
    sys.setprofile(interrupt)
    try:
        ran = run(*SHOOT.split())
    finally:
        sys.setprofile(None)
    assert not [each for each in threading.enumerate() if each.name.startswith("camctl-frame")]
    assert (sent, ran.status) == ([signal.SIGTERM], 143)
    assert ran.error == f"interrupted by SIGTERM; 1 of 2 frames are kept; {RESUME}"
    assert checked(Path("out"))["wrong"] == []


@pytest.mark.slow
@pytest.mark.timeout(1200)  # 25 s of processor time, of which a busy machine makes minutes
# Libraries leave files open where they are interrupted.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("count", [40, pytest.param(150, marks=pytest.mark.proof)])
def test_signal_at_any_call_leaves_a_capture_that_can_be_resumed(
    run: Run, cameras: Cameras, tmp_path: Path, count: int
) -> None:
    """The signal arrives at `count` of the calls of Python functions in the main thread."""
    run_until(run, tmp_path / "imports", sys.maxsize)  # imports take most of the calls
    total = run_until(run, tmp_path / "whole", sys.maxsize)
    assert total > 2000
    ends = set()
    for k in range(0, total, total // count):
        folder = tmp_path / str(k)
        cameras.opened = cameras.closed = 0
        run_until(run, folder, k)
        assert cameras.closed == cameras.opened, k
        if folder.exists():
            found = checked(folder)
            assert found["wrong"] == [], k
            ends.add(found["done"])
    gc.collect()  # in this test, not in the next one, which does not ignore such files
    assert {"resumed", "complete"} <= ends


def run_until(run: Run, folder: Path, k: int) -> int:
    """Shoot with SIGTERM at call number k; check the end, and return the number of calls."""
    calls, inside = 0, False

    def count(frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls, inside
        if frame.f_code is run_interruptible.__code__:
            inside = (inside or event == "call") and event != "return"  # it calls C functions, too
        elif inside and event == "call":
            calls += 1
            if calls > k:
                sys.setprofile(None)
                deliver(signal.SIGTERM, frame)

    sys.setprofile(count)
    try:
        ran = run("shoot", "-O", "size=24x16", "--ratios", "1,8", "--base", "0.03", "-o", folder)
    finally:
        sys.setprofile(None)
    if calls > k:
        assert ran.status == 128 + signal.SIGTERM, (k, ran)
        assert ran.err.startswith("camctl: interrupted by SIGTERM"), (k, ran)
        assert ran.err.count("\n") == 1, (k, ran)
    else:
        assert (ran.status, ran.err) == (0, "")
    return calls


def start(*arguments: str, folder: Path, **settings: Any) -> subprocess.Popen[str]:
    """Start camctl as a process of its own in a folder."""
    return subprocess.Popen(
        [sys.executable, "-m", "camctl", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **settings,
    )


POLL_S = 0.005
"""A test that asks again at once takes a core from what it waits for."""


def wait_for_file(process: subprocess.Popen[str], path: Path) -> None:
    """Wait until a process has made a file, or one whose name has a `*` in place of a part."""
    while not any(path.parent.glob(path.name)):
        assert process.poll() is None, process.communicate()
        time.sleep(POLL_S)


LONG = ("shoot", "-O", "size=24x16", "--ratios", "1,250", "--base", "0.2", "-O", "time=real")
"""A capture whose second frame takes 50 s, with its folder in "out"."""


@pytest.mark.parametrize(
    ("number", "by"),
    [SIGNALS[1], *(pytest.param(*each, marks=pytest.mark.slow) for each in SIGNALS[::2])],
)
def test_signal_from_another_process_keeps_the_frames(
    tmp_path: Path, number: signal.Signals, by: str
) -> None:
    process = start(*LONG, "-o", "out", folder=tmp_path)
    wait_for_file(process, tmp_path / "out/frames/frame-01.npy")
    process.send_signal(number)
    out, err = process.communicate()
    assert process.returncode == 128 + number
    assert out == ""
    assert err == f"camctl: interrupted{by}; 1 of 2 frames are kept; {RESUME}\n"
    assert checked(tmp_path / "out")["wrong"] == []


EARLY = """
import builtins, os, signal, sys
real, left = builtins.__import__, [signal.{name}]
def with_signal(name, *arguments, **named):
    if name == {module!r} and left:
        os.kill(os.getpid(), left.pop())
    return real(name, *arguments, **named)
from camctl.__main__ import run
builtins.__import__ = with_signal
sys.argv[1:] = ["solve", "-n", "2"]
sys.exit(run())
"""


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("SIGTERM", "camctl.cli"),
        ("SIGINT", "click"),
        *(
            pytest.param(name, module, marks=pytest.mark.slow)
            for name in ("SIGINT", "SIGTERM", "SIGHUP")
            for module in ("camctl.cli", "camctl.errors", "camctl.cli.commands", "numpy")
        ),
    ],
)
def test_signal_while_the_program_is_loaded(name: str, module: str, tmp_path: Path) -> None:
    program = EARLY.format(name=name, module=module)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    by = "" if name == "SIGINT" else f" by {name}"
    assert (done.stderr, done.stdout) == (f"camctl: interrupted{by}\n", "")
    assert done.returncode == 128 + getattr(signal, name)


LATE = """
import atexit, os, sys
from signal import *
from camctl import cli
from camctl.__main__ import run
def send(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)
class Last:
    def __del__(self, send=send, numbers=(SIGINT, SIGTERM, SIGHUP)):
        send(*numbers)
last = Last()  # deleted when the interpreter clears the modules
real = cli.main
def main(**named):
    status = real(**named)
    send(SIGHUP)
    return status
cli.main = main
atexit.register(send, SIGINT, SIGTERM, SIGHUP)  # called after that of `run`
sys.argv[1:] = ["--version"]
status = run()
atexit.register(send, *{numbers})
sys.exit(status)
"""


def run_late(numbers: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Show the version; signals arrive after the command, and `numbers` when Python ends."""
    program = [sys.executable, "-c", LATE.format(numbers=numbers)]
    return subprocess.run(program, cwd=folder, capture_output=True, text=True, check=False)


def test_signals_after_the_last_step_change_nothing(tmp_path: Path) -> None:
    done = run_late("[SIGINT, SIGTERM]", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"camctl {camctl.__version__}\n", "")


def test_second_signal_ends_what_does_not_exit(tmp_path: Path) -> None:
    done = run_late("[SIGTERM, SIGTERM]", tmp_path)
    assert done.returncode == 143
    assert done.stderr == "camctl: interrupted by SIGTERM\n"


@pytest.mark.slow
def test_ignored_hangup_stays_ignored(tmp_path: Path) -> None:
    """As with nohup: the capture goes on; SIGTERM still ends it."""

    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = start(*LONG, "-o", "out", folder=tmp_path, preexec_fn=ignore)
    wait_for_file(process, tmp_path / "out/frames/frame-01.npy")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate()
    assert process.returncode == 143
    assert err.startswith("camctl: interrupted by SIGTERM; 1 of 2 frames are kept")


def start_build(folder: Path) -> subprocess.Popen[str]:
    """Start the building of a table in two processes; wait for its first row."""
    line = ("table", "build", "--bits", "4", "-n", "5", "--workers", "2", "-o", "table.json")
    process = start(*line, folder=folder, start_new_session=True)
    wait_for_file(process, folder / "table.json.parts/*.json")
    return process


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_signal_to_all_processes_ends_the_building_of_a_table(
    tmp_path: Path, number: signal.Signals
) -> None:
    """A terminal sends Control-C and its closing to the workers, too."""
    process = start_build(tmp_path)
    os.killpg(process.pid, number)
    out, err = process.communicate()
    assert process.returncode == 128 + number
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("camctl: ")
    assert "the same command continues" in err


@pytest.mark.slow
def test_lost_worker_ends_the_building_of_a_table(tmp_path: Path) -> None:
    """The system ends processes where memory lacks."""
    process = start_build(tmp_path)
    worker = next(pid for pid in children(process.pid) if b"spawn_main" in command_line(pid))
    os.kill(int(worker), signal.SIGKILL)
    _, err = process.communicate()
    assert process.returncode == 1
    assert err.startswith("camctl: a worker process was ended after ")
    assert err.endswith("the same command continues, with the rows kept in table.json.parts\n")
    assert err.count("\n") == 1


def children(pid: int) -> list[str]:
    """Return the ids of the child processes."""
    tasks = (Path("/proc") / str(pid) / "task").glob("*/children")
    return [child for task in tasks for child in task.read_text().split()]


def command_line(pid: str) -> bytes:
    return (Path("/proc") / pid / "cmdline").read_bytes()
