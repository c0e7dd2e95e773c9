"""The files of a capture's folder: who owns it, what may be touched in it, and how.

Nothing here follows a symbolic link inside the folder, and only names that `report_file` knows are
written, renamed or removed.
"""

from __future__ import annotations

import errno
import hashlib
import io
import math
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from camctl.errors import StorageError
from camctl.interface.camera import Pixels
from camctl.pictures.files import PICTURE_FILES
from camctl.records.report_file import (
    FRAME_FILE,
    FRAMES,
    LEFTOVER,
    LOCK,
    REPORT,
    STAGED_FILE,
)
from camctl.system.files import file_lock, storage_error, sync_folder, write_new
from camctl.system.input_files import open_own_file, read_own_file
from camctl.system.interrupts import uninterrupted

#: Bytes that are read as one file of a frame at most: 250 megapixels in 16 bits.
_LARGEST_FRAME = 500 << 20
#: Bytes that hold the header of such a file, which has 128.
_HEADER = 1024


@dataclass(frozen=True)
class CaptureFolder:
    """A folder and its files by their names in a report, such as ``frames/frame-01.npy``.

    The methods raise OSError where a file cannot be read or written, but for those that say
    `StorageError`.
    """

    directory: Path

    @cached_property
    def frames(self) -> Path:
        """The folder of the frames."""
        return self.directory / FRAMES

    @contextmanager
    def owned(self) -> Iterator[None]:
        """Hold the folder's lock while the block runs; `StorageError` where another one has it."""
        from filelock import Timeout

        lock = file_lock(self.directory / LOCK)
        acquire, release = uninterrupted(lock.acquire), uninterrupted(lock.release)
        try:
            try:
                acquire(timeout=0)
            except Timeout:
                raise StorageError(
                    f"another process is writing {self.directory}",
                    hint="wait until it ends, or choose another folder",
                ) from None
            except (OSError, NotImplementedError) as error:
                reason = error if isinstance(error, OSError) else OSError(str(error))
                raise storage_error(self.directory / LOCK, reason) from error
            yield
        finally:
            release()  # does nothing where it was not acquired

    @contextmanager
    def storage_errors(self) -> Iterator[None]:
        """Raise `StorageError` in place of OSError."""
        try:
            yield
        except OSError as error:
            named = error.filename if isinstance(error.filename, str) else self.directory
            raise storage_error(Path(named), error) from error

    def is_file(self, name: str) -> bool:
        """Return whether there is a file of that name, and not a link or a folder."""
        path = self.directory / name
        return path.is_file() and not path.is_symlink()

    def stage(self, name: str, parts: Iterable[bytes | memoryview]) -> tuple[str, str]:
        """Write a file of a frame under a hidden name; return that name and the checksum.

        Raises:
            StorageError: it could not be written; the hidden file is removed
        """
        staged = staged_name(name)
        path = self.directory / staged
        try:
            path.unlink(missing_ok=True)
            try:
                checksum = write_new(path, parts)
                sync_folder(self.frames)
            except BaseException:
                path.unlink(missing_ok=True)
                raise
        except OSError as error:
            raise storage_error(self.directory / name, error) from error
        return staged, checksum

    def rename(self, source: str, target: str) -> None:
        """Rename a file, never onto another one; `sync` makes this durable."""
        path = self.directory / target
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        (self.directory / source).rename(path)

    def finish_rename(self, name: str, checksum: str | None) -> bool:
        """Give a staged file with that checksum its name; return whether the file is there."""
        if self.is_file(name):
            return True
        staged = staged_name(name)
        if not self.is_file(staged):
            return False
        data = read_own_file(self.directory / staged, _LARGEST_FRAME)
        if hashlib.sha256(data).hexdigest() != checksum:
            return False
        self.rename(staged, name)
        return True

    def remove(self, names: Iterable[str]) -> None:
        """Remove files; an entry that is no file stays."""
        for name in names:
            if self.is_file(name):
                (self.directory / name).unlink()

    def remove_leftovers(self) -> None:
        """Remove the hidden files that a killed process left."""
        for folder, pattern in ((self.directory, LEFTOVER), (self.frames, STAGED_FILE)):
            for entry in folder.iterdir() if folder.exists() else ():
                if pattern.fullmatch(entry.name) and not entry.is_dir():
                    entry.unlink()

    def sync(self) -> None:
        """Make all renames and removals durable."""
        sync_folder(self.frames)
        sync_folder(self.directory)

    def check_claims(self, claimed: set[str]) -> None:
        """Check that `claimed` are plain files or missing, and no other file has such a name.

        Raises:
            StorageError: a file is not claimed, or not a plain file
        """
        self.check_frames_folder()
        in_frames = self.frames.iterdir() if self.frames.exists() else ()
        names = {
            f"{FRAMES}/{entry.name}" for entry in in_frames if FRAME_FILE.fullmatch(entry.name)
        }
        for name in sorted(names | claimed | set(PICTURE_FILES.values())):
            path = self.directory / name
            if not os.path.lexists(path):
                continue
            if name not in claimed:
                raise StorageError(f"{path} is not named in {REPORT}", hint="move it away")
            if not self.is_file(name):
                raise StorageError(f"{path} is not a plain file", hint="move it away")

    def check_frames_folder(self) -> None:
        """Raise `StorageError` where frames/ leads elsewhere."""
        try:
            mode = self.frames.lstat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            return
        if not stat.S_ISDIR(mode):
            raise StorageError(
                f"{self.frames} is a link or a file, not a folder",
                hint="choose another folder, or put a folder in its place",
            )

    def samples(self, name: str, checksum: str | None) -> Pixels:
        """Return the samples in a file of a frame.

        Raises:
            ValueError: the file is damaged, or its checksum is not `checksum` (None: any)
            DataError: it is no file, or too large
        """
        file, length = open_own_file(self.directory / name, _LARGEST_FRAME)
        with file:
            data = np.empty(length, np.uint8)  # unlike a bytearray, it is not filled first
            data = data[: file.readinto(data.data)]
        if checksum is not None and hashlib.sha256(data.data).hexdigest() != checksum:
            raise ValueError("its content has changed since it was shot (wrong checksum)")
        shape, dtype, start = _header(data[:_HEADER].tobytes(), len(data))
        return np.frombuffer(data, dtype, offset=start).reshape(shape)

    def rows(self, name: str, part: slice) -> Pixels:
        """Return some rows of the samples in a file of a frame; raises as `samples`."""
        file, length = open_own_file(self.directory / name, _LARGEST_FRAME)
        with file:
            shape, dtype, start = _header(file.read(_HEADER), length)
            first, last, _ = part.indices(shape[0])
            file.seek(start + first * math.prod(shape[1:]) * dtype.itemsize)
            found = np.empty((max(0, last - first), *shape[1:]), dtype)
            if file.readinto(found.data) != found.nbytes:
                raise ValueError("it has become shorter")
        return found


@lru_cache(maxsize=64)  # pictures are made of hundreds of parts of each frame
def _header(begin: bytes, length: int) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Return shape and type of the array in a file of that length, and where its samples begin."""
    stream = io.BytesIO(begin)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("it is not a .npy file of version 1.0")
    try:
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    except Exception as error:  # numpy raises errors of any type for a damaged header
        raise ValueError("its header is damaged") from error
    if fortran or dtype not in (np.uint8, np.uint16) or len(shape) not in (2, 3):
        raise ValueError(f"it holds {dtype} {shape} instead of a picture in uint8 or uint16")
    size = math.prod(shape) * dtype.itemsize
    if min(shape) < 1 or size != length - stream.tell():
        raise ValueError(f"it has not the size of {dtype} {shape}")
    return shape, dtype, stream.tell()


def staged_name(name: str) -> str:
    """Return the hidden name that a frame's file has until the report names it."""
    return f"{FRAMES}/.{name.removeprefix(f'{FRAMES}/')}.staged"
