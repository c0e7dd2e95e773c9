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
from camctl.stills.exr import Map, Shape, exr_exposure, exr_shape, read_exr
from camctl.stills.worker import put

_COMMAND = (sys.executable, "-P", "-m", "camctl.stills.worker")
_ERRORS = {each.__name__: each for each in (CameraProtocolError, DataError, UsageError)}
_EXR_TYPES = (np.float16, np.float32, np.uint32)
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

    def read_exr(self, path: Path) -> Map:
        """Return the samples of an OpenEXR file; the errors of `ask`."""
        head = self.ask(name=str(path), exr="map")
        samples = _samples(head, self.shared.fileno(), _EXR_TYPES)
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
    return _apart(name, lambda worker: worker.read(data, name))


def exr_apart(path: Path) -> Map:
    """Return the samples of an OpenEXR file, as `read_exr` does.

    Raises:
        DataError: it cannot be used, or decoding it takes too much time, or crashes
        UnreadableError: what the library says
    """
    if os.name != "posix":
        return read_exr(path)
    return _exr_apart(path, _Worker.read_exr)


def exr_shape_apart(path: Path) -> Shape:
    """Return the shape of an OpenEXR file, as `exr_shape` does; raises as `exr_apart`."""
    if os.name != "posix":
        return exr_shape(path)
    answer = _exr_apart(path, lambda worker, file: worker.ask(name=str(file), exr="shape"))
    return tuple(int(side) for side in answer["shape"])


def exr_exposure_apart(path: Path) -> dict[str, float]:
    """Return the exposure of an OpenEXR file, as `exr_exposure` does; raises as `exr_apart`."""
    if os.name != "posix":
        return exr_exposure(path)
    answer = _exr_apart(path, lambda worker, file: worker.ask(name=str(file), exr="exposure"))
    return {name: float(value) for name, value in answer.items()}


def _exr_apart(path: Path, ask: Callable[[_Worker, Path], _Answer]) -> _Answer:
    with path.open("rb"):  # the library would not give the reason
        pass
    try:
        return _apart(str(path), lambda worker: ask(worker, path.absolute()))
    except CameraProtocolError as error:
        raise DataError(error.what, hint=error.hint) from error


def _apart(name: str, ask: Callable[[_Worker], _Answer]) -> _Answer:
    """Return what a free process answers about a file."""
    with _lock:
        worker = _free.pop() if _free else None
    worker = worker or _Worker.started()
    try:
        answer = ask(worker)
    except (OSError, ValueError, EOFError):
        raise _ended(worker, name) from None
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


def _samples(head: dict[str, Any], shared: int, kinds: tuple[type, ...]) -> NDArray[Any]:
    """Return samples; their numbers are checked, since a file may have taken the process over.

    Raises:
        ValueError, EOFError: they cannot be
    """
    shape, dtype = tuple(int(side) for side in head["shape"]), np.dtype(str(head["dtype"]))
    size = int(np.prod(shape, dtype=object))
    if dtype not in kinds or min(shape) < 1 or not 0 < size <= 3 * MAX_PIXELS:
        raise ValueError
    return _taken(shared, size, dtype, 0).reshape(shape)


def _still(head: dict[str, Any], shared: int) -> Still:
    """Return the still of an answer; raises as `_samples` does."""
    samples = _samples(head, shared, (np.uint8, np.uint16))
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
    return CameraColour(rows["matrix"], tuple(found["white_balance"]), rows["xyz_to_camera"])


def _ended(worker: _Worker, name: str) -> CameraProtocolError:
    """End a process that gives no answer; return the error for its file."""
    with suppress(subprocess.TimeoutExpired):
        worker.process.wait(1.0)
    status = worker.process.poll()
    worker.end()
    why = "its decoder ended without an answer"
    if status is not None and status < 0:
        took_long = status == -getattr(signal, "SIGXCPU", 0)
        why = f"its decoder crashed ({signal.Signals(-status).name})"
        why = "decoding it takes more than a minute" if took_long else why
    return CameraProtocolError(f"{name} cannot be read: {why}", hint="leave it out")


@atexit.register
def _end_all() -> None:
    while _free:
        _free.pop().end()
