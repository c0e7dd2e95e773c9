"""Camera raw files that others made, decoded in processes that may fail.

A process (`camctl.stills.raw_worker`) is started with the first file, and decodes later ones, too.
"""

from __future__ import annotations

import atexit
import json
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, Any

import numpy as np

from camctl.errors import CameraProtocolError, UsageError
from camctl.interface.controls import Layout
from camctl.stills.decoding import MAX_PIXELS, Still

_COMMAND = (sys.executable, "-P", "-m", "camctl.stills.raw_worker")
_lock = threading.Lock()
_free: list[subprocess.Popen[bytes]] = []
"""Processes that wait for a file."""


def read_raw_apart(data: bytes, name: str) -> Still:
    """Return the contents of a camera raw file, as `read_still` does.

    Raises:
        CameraProtocolError: it is damaged, or decoding it takes too much memory or time, or crashes
        UsageError: the package that reads raw files is not installed
    """
    with _lock:
        worker = _free.pop() if _free else None
    worker = worker or _started()
    try:
        assert worker.stdin is not None
        assert worker.stdout is not None
        request = {"name": name, "bytes": len(data)}
        worker.stdin.write(json.dumps(request).encode() + b"\n")
        worker.stdin.write(data)
        worker.stdin.flush()
        still = _still(worker.stdout)
    except (OSError, ValueError, EOFError):
        raise _ended(worker, name) from None
    except (CameraProtocolError, UsageError):
        _set_free(worker)
        raise
    except BaseException:  # an interrupt leaves an answer behind
        _end(worker)
        raise
    _set_free(worker)
    return still


def _set_free(worker: subprocess.Popen[bytes]) -> None:
    with _lock:
        _free.append(worker)


def _started() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        _COMMAND,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Control-C is this process's to handle
    )


def _still(answers: IO[bytes]) -> Still:
    """Return what the process answers; its numbers are checked, since a file may have taken over.

    Raises:
        ValueError, EOFError: it is no answer
        CameraProtocolError, UsageError: the process reports them
    """
    line = answers.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    head: dict[str, Any] = json.loads(line)
    if "error" in head:
        kind = UsageError if head["error"] == "UsageError" else CameraProtocolError
        raise kind(str(head["what"]), hint=str(head["hint"]))
    shape, dtype = tuple(int(side) for side in head["shape"]), np.dtype(str(head["dtype"]))
    size = int(np.prod(shape, dtype=object))
    if dtype not in (np.uint8, np.uint16) or not 0 < size <= 3 * MAX_PIXELS:
        raise ValueError
    samples = np.empty(size * dtype.itemsize, np.uint8)
    view, filled = samples.data, 0
    while filled < samples.size:
        count = answers.readinto(view[filled:])  # type: ignore[attr-defined]  # of a buffered reader
        if not count:
            raise EOFError
        filled += count
    return Still(
        samples.view(dtype).reshape(shape),
        Layout(head["layout"]),
        int(head["bits"]),
        int(head["black"]),
        int(head["white"]),
        tuple(str(each) for each in head["notes"]),
    )


def _ended(worker: subprocess.Popen[bytes], name: str) -> CameraProtocolError:
    """End a process that gives no answer; return the error for its file."""
    with suppress(subprocess.TimeoutExpired):
        worker.wait(1.0)
    status = worker.poll()
    _end(worker)
    why = "its decoder ended without an answer"
    if status is not None and status < 0:
        took_long = status == -getattr(signal, "SIGXCPU", 0)
        why = f"its decoder crashed ({signal.Signals(-status).name})"
        why = "decoding it takes more than a minute" if took_long else why
    return CameraProtocolError(f"{name} cannot be read: {why}", hint="leave it out")


@atexit.register
def _end_all() -> None:
    while _free:
        _end(_free.pop())


def _end(worker: subprocess.Popen[bytes]) -> None:
    worker.kill()
    for pipe in (worker.stdin, worker.stdout):
        with suppress(OSError):
            if pipe is not None:
                pipe.close()
    worker.wait()
