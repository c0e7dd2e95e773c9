"""Reading of files that a user or another file names: regular files of a limited size only.

A named pipe or a terminal would be waited for, ``/dev/zero`` never ends, and opening a device may
change it.  They are recognised before anything is read, and a file is never read beyond a limit.
"""

from __future__ import annotations

import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.errors import DataError

if TYPE_CHECKING:
    from pydantic import ValidationError

MOST_TEXT_BYTES = 64 << 20
"""Largest text file (a table, curve, list or JSON file) that is read: a table of 200,000 rows."""

_KINDS = (
    (stat.S_ISDIR, "it is a folder"),
    (stat.S_ISFIFO, "it is a named pipe"),
    (stat.S_ISSOCK, "it is a socket"),
    (stat.S_ISCHR, "it is a device"),
    (stat.S_ISBLK, "it is a device"),
)
_REGULAR = "give a regular file"


def exists(path: str | Path) -> bool:
    """Return whether there is anything at `path`; False, too, where no file can have that name."""
    return os.path.exists(path)  # noqa: PTH110 - `Path.exists` raises for a name that is too long


def open_input(path: str | Path, subject: str, *, hint: str = "") -> BufferedReader:
    """Return a regular file opened for reading; never waits, also where `path` is a named pipe.

    Args:
        path: the file
        subject: what error messages call it, such as "curve"; may be empty
        hint: what to do where the file cannot be opened

    Raises:
        DataError: it is missing, cannot be opened, or is no regular file
    """
    # The first check keeps devices from being opened; the second is for what was opened.
    check_regular(path, subject, hint=hint)
    try:
        # `Path.open` has no opener; the file is returned open.
        file = open(path, "rb", opener=_open_without_waiting)  # noqa: SIM115
        try:
            _check_mode(path, subject, os.fstat(file.fileno()).st_mode)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise unreadable(path, subject, error, hint=hint) from error
    return file


def _open_without_waiting(path: str, flags: int) -> int:
    waiting = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)  # not on Windows
    return os.open(path, flags | waiting)


def check_regular(path: str | Path, subject: str, *, hint: str = "") -> None:
    """Check that `path` is a regular file, for libraries that open a file themselves.

    Raises:
        DataError: it is missing or no regular file
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError) as error:
        raise unreadable(path, subject, error, hint=hint) from error
    _check_mode(path, subject, mode)


def _check_mode(path: str | Path, subject: str, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((text for is_kind, text in _KINDS if is_kind(mode)), "it is no regular file")
        raise DataError(f"cannot read {_named(subject, path)}: {kind}", hint=_REGULAR)


def unreadable(
    path: str | Path, subject: str, error: OSError | ValueError, *, hint: str = ""
) -> DataError:
    """Return the error that says in one line why `path` cannot be read."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return DataError(f"cannot read {_named(subject, path)}: {reason}", hint=hint)


def _named(subject: str, path: str | Path) -> str:
    return f"{subject} {path}" if subject else str(path)


def read_input(
    path: str | Path, subject: str, *, hint: str = "", most_bytes: int = MOST_TEXT_BYTES
) -> bytes:
    """Return the content of a regular file of at most `most_bytes`.

    Raises:
        DataError: as `open_input`, or the file is too large
    """
    with open_input(path, subject, hint=hint) as file:
        try:
            data = file.read(most_bytes + 1)
        except OSError as error:
            raise unreadable(path, subject, error, hint=hint) from error
    if len(data) > most_bytes:
        raise _too_large(path, subject, most_bytes)
    return data


def _too_large(path: str | Path, subject: str, most_bytes: int) -> DataError:
    return DataError(
        f"cannot read {_named(subject, path)}: it is larger than {most_bytes / 2**20:g} MiB",
        hint="check that it is the right file",
    )


def read_input_text(path: str | Path, subject: str, *, hint: str = "") -> str:
    """Return the text of a regular file in UTF-8 of at most `MOST_TEXT_BYTES`.

    Raises:
        DataError: as `read_input`, or the file is no text
    """
    try:
        return read_input(path, subject, hint=hint).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(
            f"cannot read {_named(subject, path)}: it is not a text file", hint=hint
        ) from error


def open_own_file(path: Path, most_bytes: int) -> tuple[BufferedReader, int]:
    """Return a file that camctl wrote itself, opened for reading, and its size.

    Raises:
        DataError: as `open_input`; it is larger than `most_bytes`; `path` is a symbolic link
    """
    if path.is_symlink():
        raise DataError(f"cannot read {path}: it is a symbolic link", hint=_REGULAR)
    file = open_input(path, "")
    size = os.fstat(file.fileno()).st_size
    if size > most_bytes:
        file.close()
        raise _too_large(path, "", most_bytes)
    return file, size


def read_own_file(path: Path, most_bytes: int) -> bytearray:
    """Return the content of a file that camctl wrote itself; raises as `open_own_file`."""
    file, size = open_own_file(path, most_bytes)
    with file:
        data = bytearray(size)
        try:
            del data[file.readinto(data) :]
        except OSError as error:
            raise unreadable(path, "", error) from error
    return data


def first_problem(error: ValidationError, *, skipped: int = 0) -> str:
    """Return where a file does not fit its model, and why: a text of limited length.

    Args:
        error: of the model
        skipped: so many parts of the place are not shown, such as the kind of a union
    """
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"][skipped:])[:200]
    reason = str(first["msg"])[:200].removeprefix("Value error, ")
    return f"{where}: {reason}" if where else reason
