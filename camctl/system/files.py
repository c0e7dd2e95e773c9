"""Atomic, durable writes: a file is complete or does not exist.  Locks between processes.

What a function here has written is on disk when it returns: a power failure does not undo it.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import stat
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from camctl.errors import StorageError
from camctl.system.system_errors import advice

if TYPE_CHECKING:
    from filelock import BaseFileLock

_OTHER_FOLDER = "choose another folder"

#: Error numbers of the system, in words: what `advice` says helps, and another folder.
_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file grows beyond the limit set for files",
    errno.ENAMETOOLONG: "its name is too long",
    errno.EMFILE: "too many files are open",
}
_OF_THE_FOLDER = {
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EROFS: "the file system is read-only",
    errno.ENOENT: "no file can be made there",
    errno.ENOTDIR: "a part of the path is a file",
    errno.EEXIST: "a file of that name already exists",
}

#: Message of numpy for an incomplete write, which it raises without an error number.
_INCOMPLETE = "requested and"
_UNKNOWN_LIMIT = (
    "only a part of it could be written",
    "free some space, or raise the limit of file sizes",
)

#: Messages of OpenEXR for an incomplete write, which it raises without an error number.
_MESSAGES = {
    os.strerror(errno.ENOSPC): errno.ENOSPC,
    os.strerror(errno.EFBIG): errno.EFBIG,
}


def storage_error(path: Path, error: OSError) -> StorageError:
    """Return the error that says in one line why `path` cannot be written, and what to do."""
    by_message = (number for message, number in _MESSAGES.items() if message in str(error))
    number = error.errno or next(by_message, 0)
    if number in _OF_THE_FOLDER:
        what, hint = _OF_THE_FOLDER[number], _OTHER_FOLDER
    elif number in _REASONS:
        what, hint = _REASONS[number], advice(number) or _OTHER_FOLDER
    elif _INCOMPLETE in str(error):
        what, hint = _UNKNOWN_LIMIT
    else:
        what, hint = error.strerror or str(error), "check the disk, or choose another folder"
    remedies = {"directory": None} if "choose" in hint else {}
    return StorageError(f"cannot write {path}: {what}", hint=hint, remedies=remedies)


def check_space(what: str, needed: int, free: int) -> None:
    """Raise `StorageError` where `what` needs more bytes than are free."""
    if needed > free:
        raise StorageError(
            f"{what} needs {needed / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free",
            hint="free some space",
        )


def check_new(path: Path, *, overwrite: bool) -> None:
    """Check that a file may be written at `path`: nothing is there, or a file to be replaced.

    Raises:
        StorageError: a file is there and is not to be replaced, or as `check_replaceable`
    """
    check_replaceable(path)
    if path.exists() and not overwrite:
        raise StorageError(
            f"{path} exists",
            hint="choose another file, or have it replaced",
            remedies={"overwrite": None},
        )


def check_replaceable(path: Path) -> None:
    """Check that a file may be written at `path`: nothing is there, or a file.

    Raises:
        StorageError: it is a folder, a pipe or a device, which root could replace; or no file can
            have that name
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise storage_error(path, error) from error
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
        what = "it is a folder" if stat.S_ISDIR(mode) else "it is no regular file"
        raise StorageError(
            f"cannot write {path}: {what}", hint="choose another file", remedies={"directory": None}
        )


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to; at the end of the block that file becomes `path`, on disk.

    Where the block fails no new file is left, and an earlier `path` stays as it was.

    Raises:
        StorageError: in place of any OSError; `path` is a folder or a device, which a file must
            not replace
    """
    check_replaceable(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # other processes may write it, too
    try:
        try:
            yield part
            with part.open("r+b") as written:
                os.fsync(written.fileno())
            part.replace(path)
            sync_folder(path.parent)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise storage_error(path, error) from error


_PART = re.compile(r"\.(?P<name>.+)\.(?P<process>\d{1,10})\.part", re.ASCII | re.DOTALL)
"""A file that a killed process leaves of an `atomic_file`."""


def leftovers(names: Iterable[str]) -> re.Pattern[str]:
    """Return the pattern of the files that a killed process leaves of `atomic_file`s so named.

    Its group is the process.

    >>> leftovers(["a.tiff", "b.png"]).fullmatch(".b.png.412.part")[1]
    '412'
    """
    return re.compile(rf"\.(?:{'|'.join(map(re.escape, names))})\.(\d{{1,10}})\.part", re.ASCII)


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes have left of `atomic_file(path)`, where that can be removed."""
    with suppress(OSError):
        for entry in path.parent.iterdir():
            found = _PART.fullmatch(entry.name)
            if found is None or found["name"] != path.name:
                continue
            if not _is_another_process(int(found["process"])):
                entry.unlink()


def _is_another_process(number: int) -> bool:
    if number == os.getpid() or os.name != "posix":  # elsewhere no file in use can be removed
        return False
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path`, atomically; what a kill has left of an earlier write is removed.

    Raises:
        StorageError: it cannot be written
    """
    remove_leftovers(path)
    with atomic_file(path) as part:
        part.write_bytes(data)


def write_array(path: Path, array: NDArray[np.generic]) -> None:
    """Write an array as .npy, atomically.  Raises `StorageError`."""
    with atomic_file(path) as part, part.open("wb") as file:
        file.writelines(npy_parts(array))


def npy_parts(array: NDArray[np.generic]) -> tuple[bytes, memoryview]:
    """Return the header and the data of the .npy file of an array.

    numpy's own `save` does not give the reason when the disk is full; plain writes do.
    """
    array = np.ascontiguousarray(array)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, np.lib.format.header_data_from_array_1_0(array))
    return header.getvalue(), array.reshape(-1).view(np.uint8).data


def write_new(path: Path, parts: Iterable[bytes | memoryview]) -> str:
    """Write a file that must not exist; return the SHA-256 of its content, in hexadecimal.

    The file's content is on disk at the end; its name is so after `sync_folder`.  Raises OSError.
    """
    checksum = hashlib.sha256()
    with path.open("xb", buffering=0) as file:
        for part in parts:
            checksum.update(part)
            rest = memoryview(part)
            while rest:
                rest = rest[file.write(rest) :]
        os.fsync(file.fileno())
    return checksum.hexdigest()


def make_folder(path: Path) -> list[Path]:
    """Make a folder and its missing parents, durably; return those that were made, deepest first.

    Raises OSError.
    """
    missing: list[Path] = []
    for each in (path, *path.parents):
        if each.exists():
            break
        missing.append(each)
    for each in reversed(missing):
        each.mkdir(exist_ok=True)
        sync_folder(each.parent)
    return missing


def sync_folder(path: Path) -> None:
    """Bring the names in a folder to the disk: after a new file, a rename or a removal.

    Only POSIX systems can do this, and not for every file system or for a folder without
    permission to read; there the system's own order of writes must do.
    """
    if os.name != "posix":
        return
    with suppress(PermissionError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
                raise
        finally:
            os.close(descriptor)


def file_lock(path: Path) -> BaseFileLock:
    """Return a lock that one process or thread has at a time; `path` is an empty file for it."""
    with warnings.catch_warnings():
        # filelock prints a line where the system has no file locks and it uses marker files.
        warnings.simplefilter("ignore")
        from filelock import FileLock
    return FileLock(path)
