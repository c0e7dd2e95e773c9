"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.errors import StorageError

_REASONS = {
    errno.ENOSPC: ("the disk is full", "free some space"),
    errno.EDQUOT: ("the disk quota is used up", "free some space"),
    errno.EFBIG: ("the file grows beyond the limit set for files", "raise the limit"),
    errno.EACCES: ("no permission to write", "choose another folder with -o"),
    errno.EPERM: ("no permission to write", "choose another folder with -o"),
    errno.EROFS: ("the file system is read-only", "choose another folder with -o"),
    errno.ENOENT: ("no file can be made there", "choose another folder with -o"),
    errno.ENOTDIR: ("a part of the path is a file", "choose another folder with -o"),
    errno.EEXIST: ("a file of that name is in the way", "choose another folder with -o"),
}

#: How numpy and OpenEXR tell of a write that was cut short, without an error number.
_WORDS = {
    "requested and": errno.ENOSPC,
    os.strerror(errno.ENOSPC): errno.ENOSPC,
    os.strerror(errno.EFBIG): errno.EFBIG,
}


def storage_error(path: Path, error: OSError) -> StorageError:
    """Return what went wrong at `path` in one line, with what to do."""
    told = (number for words, number in _WORDS.items() if words in str(error))
    reason = error.errno or next(told, 0)
    unforeseen = (error.strerror or str(error), "see to the disk, or choose another folder")
    what, hint = _REASONS.get(reason, unforeseen)
    return StorageError(f"cannot write {path}: {what}", hint=hint)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a path to write to; what lies there becomes `path`, on disk, when the block is left.

    Where the block fails nothing is left behind, and what was at `path` before stays.

    Raises:
        StorageError: in place of any OSError

    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # others may write it, too
    try:
        try:
            yield part
            with part.open("rb") as written:
                os.fsync(written.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise storage_error(path, error) from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` whole."""
    with whole(path) as part:
        part.write_bytes(data)


def write_array(path: Path, array: NDArray[np.generic]) -> None:
    """Write an array as .npy, whole.

    numpy's own `save` reports a full disk without saying so; plain writes keep the reason.
    """
    array = np.ascontiguousarray(array)
    with whole(path) as part, part.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(array.data)
