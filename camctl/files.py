"""Atomic writes: a file is complete or does not exist.  Locks between processes."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.errors import StorageError

_OTHER_FOLDER = "choose another folder with -o"

#: Error numbers of the system, in words, with what to do.
_REASONS = {
    errno.ENOSPC: ("the disk is full", "free some space"),
    errno.EDQUOT: ("the disk quota is used up", "free some space"),
    errno.EFBIG: ("the file grows beyond the limit set for files", "raise the limit"),
    errno.EACCES: ("no permission to write", _OTHER_FOLDER),
    errno.EPERM: ("no permission to write", _OTHER_FOLDER),
    errno.EROFS: ("the file system is read-only", _OTHER_FOLDER),
    errno.ENOENT: ("no file can be made there", _OTHER_FOLDER),
    errno.ENOTDIR: ("a part of the path is a file", _OTHER_FOLDER),
    errno.EEXIST: ("a file of that name already exists", _OTHER_FOLDER),
}

#: Messages of numpy and OpenEXR for an incomplete write, which they raise without an error number.
_MESSAGES = {
    "requested and": errno.ENOSPC,
    os.strerror(errno.ENOSPC): errno.ENOSPC,
    os.strerror(errno.EFBIG): errno.EFBIG,
}


def storage_error(path: Path, error: OSError) -> StorageError:
    """Return the error that says in one line why `path` cannot be written, and what to do."""
    by_message = (number for message, number in _MESSAGES.items() if message in str(error))
    number = error.errno or next(by_message, 0)
    other = (error.strerror or str(error), "check the disk, or choose another folder")
    what, hint = _REASONS.get(number, other)
    return StorageError(f"cannot write {path}: {what}", hint=hint)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to; at the end of the block that file becomes `path`, on disk.

    Where the block fails no new file is left, and an earlier `path` stays as it was.

    Raises:
        StorageError: in place of any OSError
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # other processes may write it, too
    try:
        try:
            yield part
            with part.open("r+b") as written:
                os.fsync(written.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise storage_error(path, error) from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path`, atomically.  Raises `StorageError`."""
    with atomic_file(path) as part:
        part.write_bytes(data)


def write_array(path: Path, array: NDArray[np.generic]) -> None:
    """Write an array as .npy, atomically.  Raises `StorageError`.

    numpy's own `save` does not give the reason when the disk is full; plain writes do.
    """
    array = np.ascontiguousarray(array)
    with atomic_file(path) as part, part.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(array.data)


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Hold a lock that one process or thread has at a time; wait for it.

    `path` is an empty file made for this.  A Python without file locks, such as one in a browser,
    runs a single process, and the lock is not taken there.
    """
    with path.open("wb") as file:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
        else:
            try:
                import fcntl
            except ImportError:
                pass
            else:
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
