"""Files of still cameras, given by their paths: what is in them, and what they state."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from camctl.errors import CameraProtocolError, DataError, UsageError
from camctl.stills.decoding import Still
from camctl.stills.exif import StatedExposure, stated_exposure
from camctl.stills.separate import read_apart
from camctl.system.input_files import read_input

#: Largest file of a camera that is read.
_MOST_BYTES = 1 << 30


def check_times(files: Sequence[Path], times: Sequence[float | Fraction] | None) -> None:
    """Raise `UsageError` unless there is one time for each file, or none at all."""
    if times is not None and len(times) != len(files):
        given = f"{len(times)} exposure times were" if len(times) != 1 else "1 exposure time was"
        raise UsageError(
            f"{given} given for {len(files)} files",
            hint="give one for each file",
            remedies={"times": None},
        )


def read_photograph(path: Path) -> tuple[Still, StatedExposure]:
    """Return the contents of a JPEG, PNG, TIFF or camera raw file, and what it states of itself.

    Raises:
        DataError: it cannot be read
    """
    data = read_input(path, "", most_bytes=_MOST_BYTES)
    try:
        return read_apart(data, str(path)), stated_exposure(data)
    except CameraProtocolError as error:
        raise DataError(
            error.what.removeprefix("the camera's file "),
            hint="copy it from the camera again, or leave it out (JPEG, PNG, TIFF and camera raw "
            "are read)",
        ) from error


def unknown_time(path: Path) -> UsageError:
    """Return the error of a file that does not say its exposure time."""
    return UsageError(
        f"{path} does not say its exposure time",
        hint="give the exposure time of each file",
        remedies={"times": None},
    )
