"""Libraries that read and write pictures: what they print, and which file names they take.

OpenEXR, libtiff and libjpeg (within OpenCV and LibRaw) print about damaged files by themselves, on
standard error or even on standard output, where it would spoil JSON.  camctl reports these files
with errors of its own.
"""

from __future__ import annotations

import io
import logging
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import BinaryIO, TypeVar

# tifffile logs broken tags; without a handler the text would appear on standard error.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

_STANDARD_ERROR = 2  # its descriptor (POSIX)

T = TypeVar("T")

_lock, _collecting = threading.Lock(), threading.Lock()
_blocks = 0
_restore = ExitStack()


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Drop what the process prints while the block runs, also from C.

    Blocks of several threads may overlap.  The output of other threads is dropped as well: keep the
    block short.
    """
    global _blocks
    with _lock:
        _blocks += 1
        if _blocks == 1:
            _restore.enter_context(redirect_stdout(io.StringIO()))
            _redirect_standard_error(_restore)
    try:
        yield
    finally:
        with _lock:
            _blocks -= 1
            if _blocks == 0:
                _restore.close()


def _redirect_standard_error(restore: ExitStack) -> None:
    """Point standard error at the null device; leave it as it is where that fails."""
    try:
        saved = os.dup(_STANDARD_ERROR)
    except OSError:  # it is closed, or too many files are open
        return
    restore.callback(os.close, saved)
    restore.callback(os.dup2, saved, _STANDARD_ERROR)
    with open(os.devnull, "wb") as nothing:  # noqa: PTH123 - a device
        os.dup2(nothing.fileno(), _STANDARD_ERROR)


def with_messages(call: Callable[[], T]) -> tuple[T, str]:
    """Return what a call returns, and what the process prints on standard error meanwhile.

    Calls of several threads follow each other.  The text is empty where it cannot be collected.
    """
    with quiet_libraries(), _collecting, ExitStack() as restore:
        try:
            file = restore.enter_context(tempfile.TemporaryFile())
            saved = os.dup(_STANDARD_ERROR)
        except OSError:  # as in `_redirect_standard_error`, or the disk is full
            return call(), ""
        restore.callback(os.close, saved)
        restore.callback(os.dup2, saved, _STANDARD_ERROR)
        os.dup2(file.fileno(), _STANDARD_ERROR)
        result = call()
        file.seek(0)
        return result, file.read().decode("utf-8", "replace")


@contextmanager
def exr_source(path: Path) -> Iterator[str | BinaryIO]:
    """Yield what `OpenEXR.File` can read: the path, or a stream where that is not UTF-8.

    Raises OSError where the file cannot be opened; OpenEXR would not give the reason.
    """
    name = str(path)
    with path.open("rb") as stream:
        is_unicode = name == name.encode("utf-8", "replace").decode()
        yield name if is_unicode else stream
