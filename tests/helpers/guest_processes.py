"""Processes and command lines in the guest, without the cost of another interpreter.

An interpreter that starts in the emulated guest imports numpy, OpenCV and the drivers for ten
seconds and more.  A process that is forked from one that has imported them is there at once.
"""

from __future__ import annotations

import functools
import mmap
import os
import pkgutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn

import cv2
import pytest
import serial
import usb.core
import usb.util

from camctl.cli import main

# After so long a condition will never be true; most are within a second.  An idle wait of this
# length costs the host a few seconds, because the guest's clock jumps.
HANG_S = 600.0
_POLL_S = 0.02
_POPULATE = 0x8000  # MAP_POPULATE of mmap(2), which the module mmap of Python 3.11 does not name


def wait_for(what: str, condition: Callable[[], Any]) -> Any:
    """Return what `condition` returns as soon as that is true."""
    end = time.monotonic() + HANG_S
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(_POLL_S)
    raise AssertionError(f"no {what} after {HANG_S:g} s")


def import_all(packages: Sequence[str]) -> None:
    """Import every module of these packages, and keep in memory all that they need of the host.

    While a guest waits for a file of the host its clock runs ahead (see machine.py): a camera would
    seem silent for many seconds if a module were imported during a test.
    """
    for package in packages:
        root = import_module(package)
        for module in pkgutil.walk_packages(root.__path__, f"{package}."):
            # bluesky is large, and no test here uses it.
            if not module.name.endswith(("__main__", "adapters.bluesky")):
                with suppress(ImportError):  # an optional dependency is not installed
                    import_module(module.name)
    mappings = Path("/proc/self/maps").read_text().splitlines()
    for path in {Path(mapping.split(maxsplit=5)[5]) for mapping in mappings if ".so" in mapping}:
        with path.open("rb") as library:
            # Read as a whole, not page by page when a function is called for the first time.
            mmap.mmap(library.fileno(), 0, flags=mmap.MAP_SHARED | _POPULATE, prot=mmap.PROT_READ)
    for folder in map(Path, sys.path):
        # Read whenever a camera is opened; a change moves a file to the guest's layer of RAM.
        for path in folder.glob("*.dist-info/entry_points.txt"):
            os.utime(path)


class Forked:
    """A process that a `Spawner` has started."""

    def __init__(self, spawner: Spawner, pid: int, folder: Path) -> None:
        self._spawner = spawner
        self.pid = pid
        self._folder = folder

    @property
    def out(self) -> str:
        """What it has written to standard output."""
        return (self._folder / "out").read_text()

    @property
    def err(self) -> str:
        """What it has written to standard error."""
        return (self._folder / "err").read_text()

    @property
    def status(self) -> int | None:
        """Its exit status; None while it runs."""
        return self._spawner.status(self.pid)

    def wait(self) -> int:
        """Wait for its end and return its exit status."""
        wait_for("end of a process", lambda: self.status is not None)
        assert self.status is not None
        return self.status

    def wait_for_line(self, line: str) -> None:
        """Wait until it has written this line."""

        def is_written() -> bool:
            assert self.status is None, self.err
            return line in self.out.splitlines()

        wait_for(f"line '{line}'", is_written)

    def terminate(self) -> None:
        """Ask it to end, and wait until it has."""
        if self.status is None:
            os.kill(self.pid, signal.SIGTERM)
        self.wait()


class Spawner:
    """Forks a process for each `start`, from a process that is itself forked where this is made.

    Make it when everything is imported and no thread runs.  The process in between starts no
    thread, so that a fork of it is safe whatever threads run here by then.
    """

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="forked-"))
        self._count = 0
        self._requests, theirs = Pipe()
        if os.fork() == 0:
            self._requests.close()
            _run_and_exit(functools.partial(_serve, theirs))
        theirs.close()

    def start(self, function: Callable[..., Any], *arguments: Any) -> Forked:
        """Run `function` in a new process; its result is the exit status, None for 0.

        Function and arguments are pickled, so that the function belongs to a module that was
        imported before this spawner was made.
        """
        self._count += 1
        folder = self._folder / str(self._count)
        folder.mkdir()
        for name in ("out", "err"):
            (folder / name).touch()
        self._requests.send((function, arguments, folder))
        return Forked(self, self._requests.recv(), folder)

    def status(self, pid: int) -> int | None:
        """Return the exit status of a process, None while it runs."""
        self._requests.send(pid)
        status: int | None = self._requests.recv()
        return status


def _serve(requests: Connection) -> None:
    """Start jobs and report exit statuses until the other end is closed."""
    ended: dict[int, int] = {}
    while True:
        try:
            request = requests.recv()
        except EOFError:
            return
        if isinstance(request, int):
            if request not in ended:
                pid, status = os.waitpid(request, os.WNOHANG)
                if pid:
                    ended[pid] = os.waitstatus_to_exitcode(status)
            requests.send(ended.get(request))
            continue
        function, arguments, folder = request
        pid = os.fork()
        if pid == 0:
            requests.close()
            _redirect(folder)
            _run_and_exit(functools.partial(function, *arguments))
        requests.send(pid)


def _redirect(folder: Path) -> None:
    """Write standard output and error to files in `folder`."""
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(folder / name, os.O_WRONLY), number)
    sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)


def _run_and_exit(function: Callable[[], Any]) -> NoReturn:
    """End this process with the result of `function`, 0 for None, 1 after an exception."""
    status = 1
    try:
        status = function() or 0
    except SystemExit as exit_:
        status = exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


@contextmanager
def clock_in_step() -> Iterator[None]:
    """Keep the guest busy, so that its clock does not run ahead while it waits for the host."""
    process = spawner().start(_keep_busy)
    try:
        yield
    finally:
        process.terminate()


def _keep_busy() -> None:
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))  # only when nothing else runs
    while True:
        pass


@functools.cache
def spawner() -> Spawner:
    """Return what starts processes; everything that tests may need is imported before."""
    import_all(["camctl"])
    return Spawner()


@dataclass(frozen=True)
class CommandResult:
    """What a command line did.

    Attributes:
        status: exit status
        out, err: standard output and standard error
        seconds: how long it took by the guest's clock
    """

    status: int
    out: str
    err: str
    seconds: float

    @property
    def error(self) -> str:
        """The one line on standard error of a command that failed, without its prefix."""
        assert self.status == 1, self.err
        assert self.err.count("\n") == 1, self.err
        return self.err.removeprefix("camctl: ").rstrip("\n")


def camctl(capfd: pytest.CaptureFixture[str], *words: object) -> CommandResult:
    """Run a command line of camctl in this process."""
    capfd.readouterr()
    began = time.monotonic()
    status = main([str(word) for word in words])
    seconds = time.monotonic() - began
    out, err = capfd.readouterr()
    return CommandResult(status, out, err, seconds)


def camctl_as_nobody(directory: Path, *words: object) -> CommandResult:
    """Run a command line of camctl as an ordinary user without groups, in `directory`."""
    began = time.monotonic()
    process = spawner().start(_main_as_nobody, directory, [str(word) for word in words])
    status = process.wait()
    return CommandResult(status, process.out, process.err, time.monotonic() - began)


def _main_as_nobody(directory: Path, words: list[str]) -> int:
    nobody = 65534
    os.chdir(directory)
    os.environ.update(HOME=str(directory), CAMCTL_PROFILES=str(directory / "profiles"))
    os.setgroups([])
    os.setgid(nobody)
    os.setuid(nobody)
    return main(words)


@contextmanager
def held_by_another_process(hold: Callable[[str], object], address: object) -> Iterator[Forked]:
    """Let another process hold a device while this lasts, by one of the functions below."""
    process = spawner().start(_hold, hold, str(address))
    try:
        process.wait_for_line("held")
        yield process
    finally:
        process.terminate()


def stream_video(node: str) -> object:
    """Stream from a webcam's node."""
    capture = cv2.VideoCapture(node, cv2.CAP_V4L2)
    assert capture.read()[0]
    return capture


def claim_interface(serial_number: str) -> object:
    """Claim the interface of a PTP camera."""
    for device in usb.core.find(find_all=True):
        if device.bDeviceClass != 9 and device.serial_number == serial_number:
            usb.util.claim_interface(device, 0)
            return device
    raise AssertionError(f"no USB device {serial_number}")


def open_exclusively(node: str) -> object:
    """Open a serial port for this process alone."""
    return serial.Serial(node, exclusive=True)


def _hold(hold: Callable[[str], object], address: str) -> None:
    held = hold(address)
    assert held is not None
    print("held", flush=True)
    while True:  # until this process is terminated
        signal.pause()


@contextmanager
def once_a_frame_is_kept(directory: Path, action: Callable[[], Any]) -> Iterator[None]:
    """Run `action` in a thread as soon as a capture has kept its first frame."""
    is_over = threading.Event()

    def watch() -> None:
        while not is_over.is_set():
            if next((directory / "frames").glob("*.npy"), None) is not None:
                action()
                return
            time.sleep(0.002)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
