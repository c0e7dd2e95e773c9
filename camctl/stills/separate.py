"""Pictures that others made, decoded in processes that may fail.

A process (`camctl.stills.worker`) is started with the first file, and decodes later ones, too.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CamctlError, CameraProtocolError, DataError, UsageError
from camctl.interface.colour import CameraColour
from camctl.interface.controls import Layout
from camctl.stills.decoding import MAX_PIXELS, Still, read_still
from camctl.stills.maps import Map
from camctl.stills.worker import put

_COMMAND = (sys.executable, "-P", "-m", "camctl.stills.worker")
_ERRORS = {each.__name__: each for each in (CameraProtocolError, DataError, UsageError)}
_Answer = TypeVar("_Answer")
_lock = threading.Lock()


class UnreadableError(Exception):
    """What the library of a format says of a file."""


@dataclass(frozen=True, eq=False)
class _Worker:
    """A process that decodes, and the file through which it gets and gives the bytes."""

    process: subprocess.Popen[bytes]
    shared: IO[bytes]

    @classmethod
    def started(cls) -> _Worker:
        shared = _shared_file()
        try:
            process = subprocess.Popen(
                (*_COMMAND, str(shared.fileno())),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=(shared.fileno(),),
                start_new_session=True,  # Control-C is this process's to handle
            )
        except BaseException:
            shared.close()
            raise
        return cls(process, shared)

    def ask(self, **request: Any) -> dict[str, Any]:
        """Return the answer to a request.

        Raises:
            OSError, ValueError, EOFError: there is no answer
            CameraProtocolError, DataError, UnreadableError, UsageError: the process reports them
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        self.process.stdin.flush()
        return _checked(self.process.stdout.readline())

    def read(self, data: bytes, name: str) -> Still:
        """Return the contents of a file; the errors of `ask`."""
        put(self.shared.fileno(), data)
        return _still(self.ask(name=name, bytes=len(data)), self.shared.fileno())

    def map(self, head: dict[str, Any]) -> Map:
        """Return the samples that an answer speaks of; raises as `_samples`."""
        samples = _samples(head, self.shared.fileno(), "biuf")
        os.ftruncate(self.shared.fileno(), 0)  # maps are large, and few follow
        return samples, tuple(map(str, head["notes"]))

    def end(self) -> None:
        self.process.kill()
        for each in (self.process.stdin, self.process.stdout, self.shared):
            with suppress(OSError):
                if each is not None:
                    each.close()
        self.process.wait()


_free: list[_Worker] = []
"""Processes that wait for a file."""


def read_apart(data: bytes, name: str) -> Still:
    """Return the contents of a JPEG, PNG, TIFF or camera raw file, as `read_still` does.

    Raises:
        CameraProtocolError: it is damaged, or decoding it takes too much memory or time, or crashes
        UsageError: the package that reads this format is not installed
    """
    if os.name != "posix":  # files are not passed to other processes there
        return read_still(data, name)
    try:
        return _apart(lambda worker: worker.read(data, name))
    except UnreadableError as error:
        raise CameraProtocolError(f"{name} cannot be read: {error}", hint="leave it out") from error


def map_apart(read: Callable[..., Map], path: Path, *arguments: str) -> Map:
    """Return what one of `camctl.stills.maps.READERS` reads from a file.

    Raises:
        DataError: it cannot be used
        UnreadableError: what the library says, or what became of the process
        OSError: it cannot be opened
    """
    if os.name != "posix":
        return read(path, *arguments)
    return _found(read, path, *arguments, take=_Worker.map)


def fact_apart(read: Callable[[Path], Any], path: Path) -> Any:
    """Return what such a reader finds that is no map, lists for tuples; raises as `map_apart`."""
    if os.name != "posix":
        return read(path)
    return _found(read, path, take=lambda _worker, head: head["found"])


def _found(
    read: Callable[..., Any],
    path: Path,
    *arguments: str,
    take: Callable[[_Worker, dict[str, Any]], _Answer],
) -> _Answer:
    with path.open("rb"):  # the library would not give the reason
        pass
    request = {"name": str(path.absolute()), "read": read.__name__, "arguments": arguments}
    return _apart(lambda worker: take(worker, worker.ask(**request)))


def _apart(ask: Callable[[_Worker], _Answer]) -> _Answer:
    """Return what a free process answers about a file; `UnreadableError` where it gives none."""
    with _lock:
        worker = _free.pop() if _free else None
    worker = worker or _Worker.started()
    try:
        answer = ask(worker)
    except (OSError, ValueError, EOFError):
        raise UnreadableError(_end(worker)) from None
    except (CamctlError, UnreadableError):
        _set_free(worker)
        raise
    except BaseException:  # an interrupt leaves an answer behind
        worker.end()
        raise
    _set_free(worker)
    return answer


def _set_free(worker: _Worker) -> None:
    with _lock:
        _free.append(worker)


def _shared_file() -> IO[bytes]:
    """Return a file without a name: in memory where the system has such files."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("camctl"), "w+b")
    return tempfile.TemporaryFile()


def _checked(answer: bytes) -> dict[str, Any]:
    """Return what the process answers; raises as `_Worker.ask` does."""
    if not answer.endswith(b"\n"):
        raise EOFError
    head: dict[str, Any] = json.loads(answer)
    if "error" not in head:
        return head
    what, hint = str(head["what"]), str(head["hint"])
    if head["error"] == "UnreadableError":
        raise UnreadableError(what)
    raise _ERRORS.get(str(head["error"]), CameraProtocolError)(what, hint=hint)


def _samples(head: dict[str, Any], shared: int, kinds: str) -> NDArray[Any]:
    """Return samples of some kinds, as answered; a file may have taken the process over.

    Raises:
        ValueError, EOFError: they cannot be
    """
    shape, dtype = tuple(int(side) for side in head["shape"]), np.dtype(str(head["dtype"]))
    size = int(np.prod(shape, dtype=object))
    if dtype.kind not in kinds or min(shape) < 1 or not 0 < size <= 3 * MAX_PIXELS:
        raise ValueError
    return _taken(shared, size, dtype, 0).reshape(shape)


def _still(head: dict[str, Any], shared: int) -> Still:
    """Return the still of an answer; raises as `_samples` does."""
    samples = _samples(head, shared, "u")
    if samples.itemsize > 2:
        raise ValueError
    invalid = None
    if head.get("has_invalid"):
        shape = samples.shape[:2]
        flags = _taken(shared, shape[0] * shape[1], np.dtype(np.uint8), samples.nbytes)
        invalid = flags.reshape(shape) > 0
    return Still(
        samples,
        Layout(head["layout"]),
        int(head["bits"]),
        int(head["black"]),
        int(head["white"]),
        tuple(str(each) for each in head["notes"]),
        _colour(head.get("colour")),
        invalid,
        bool(head.get("few_chroma_samples")),
        tuple(int(each) for each in head.get("brightness_steps", ())),
    )


def _taken(shared: int, size: int, dtype: np.dtype[Any], at: int) -> NDArray[Any]:
    """Return so many samples from a place of a file; raises `EOFError` where it ends before."""
    samples = np.empty(size, dtype)
    view, filled = samples.view(np.uint8).data, 0
    while filled < samples.nbytes:
        count = os.preadv(shared, [view[filled:]], at + filled)
        if not count:
            raise EOFError
        filled += count
    return samples


def _colour(found: Any) -> CameraColour | None:
    """Return the colours in an answer; raises `ValueError` where they are no numbers."""
    if found is None:
        return None
    shapes = {"matrix": (3, 3), "white_balance": (3,), "xyz_to_camera": (3, 3)}
    if not found["xyz_to_camera"]:
        shapes["xyz_to_camera"] = (0,)
    values = {name: np.array(found[name], float) for name in shapes}
    if any(values[name].shape != shape for name, shape in shapes.items()):
        raise ValueError
    rows = {name: tuple(map(tuple, found[name])) for name in ("matrix", "xyz_to_camera")}
    encoding = tuple(map(float, found["encoding"]))
    return CameraColour(
        rows["matrix"], tuple(found["white_balance"]), rows["xyz_to_camera"], encoding
    )


def _end(worker: _Worker) -> str:
    """End a process that gives no answer; return what became of it."""
    with suppress(subprocess.TimeoutExpired):
        worker.process.wait(1.0)
    status = worker.process.poll()
    worker.end()
    if status is None or status >= 0:
        return "its decoder ended without an answer"
    if status == -getattr(signal, "SIGXCPU", 0):
        return "decoding it takes more than a minute"
    return f"its decoder crashed ({signal.Signals(-status).name})"


@atexit.register
def _end_all() -> None:
    while _free:
        _free.pop().end()


def _forget() -> None:
    """Leave the processes to the one that this one is a copy of: both would get the answers."""
    global _lock
    _lock = threading.Lock()
    _free.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
