"""The format that a still camera's frames have, and whether a file has it and the exposure set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.camera import CameraInfo, Pixels
from camctl.interface.controls import ExposureSetting
from camctl.profiles.profile import StillRecord, load_profile
from camctl.stills.decoding import Still
from camctl.stills.exif import stated_exposure

#: Formats in the order in which "auto" prefers them: the fewest changes to the samples first.
FORMATS = ("raw", "tiff", "jpeg")

_SUFFIXES: dict[str, str] = {
    **dict.fromkeys((".jpg", ".jpeg", ".jpe"), "jpeg"),
    **dict.fromkeys((".tif", ".tiff"), "tiff"),
    **dict.fromkeys(
        (".dng", ".nef", ".nrw", ".cr2", ".cr3", ".crw", ".arw", ".sr2", ".srf", ".raf", ".orf"),
        "raw",
    ),
    **dict.fromkeys(
        (".rw2", ".raw", ".pef", ".srw", ".3fr", ".fff", ".iiq", ".rwl", ".dcr", ".kdc", ".mrw"),
        "raw",
    ),
}
# Cameras measure the black level of each raw file on masked pixels; it varies by a few DN.
_MAX_BLACK_DRIFT_DN = 32
# Labels and true values of one setting differ by up to 10 %, neighbouring settings by 26 %.
_MAX_RATIO = 1.2


def format_of_name(name: str) -> str | None:
    """Return the format, one of `FORMATS`, of a file by its suffix; None where it is no picture."""
    return _SUFFIXES.get(PurePath(name).suffix.lower())


@dataclass(frozen=True)
class KnownFormat:
    """A format of a camera's files, with their size, layout and levels."""

    format: str
    record: StillRecord


def has_size(known: KnownFormat, size: tuple[int, int] | None) -> bool:
    """Return whether files of a format may have the size (rows, columns) that a camera is set to.

    Raw files have the size of the sensor, whatever is set.
    """
    record = known.record
    return size is None or known.format == "raw" or (record.rows, record.columns) == size


def saved_format(info: CameraInfo, format_name: str | None) -> KnownFormat | None:
    """Return a format from the camera's profile, or None; without a name, the preferred one."""
    stills = load_profile(info).stills
    for name in (format_name,) if format_name else FORMATS:
        if name in stills:
            return KnownFormat(name, stills[name])
    return None


class WrongFormatError(CameraError):
    """The camera saves files in another format than the frames."""


class OtherExposureError(CameraProtocolError):
    """A file states another exposure than the one that was set."""


class FormatChangedError(CameraProtocolError):
    """A file differs from the format that the camera's frames have; `record` describes the file."""

    def __init__(self, what: str, record: StillRecord) -> None:
        self.record = record
        super().__init__(
            what, hint="leave size, quality and ISO of the camera as they are, and shoot again"
        )


def matched_pixels(still: Still, known: KnownFormat, name: str) -> tuple[Pixels, dict[str, int]]:
    """Return a file's samples shifted to the black level of `known`, and details of the shift.

    If the black level of a raw file differs by a few DN, all samples are shifted by that whole
    number; saturated samples stay saturated.

    Args:
        still: contents of the file
        known: format that the camera's frames have
        name: of the file, for errors

    Raises:
        FormatChangedError: size, layout, bits or levels differ from `known`
    """
    record, shape = known.record, still.pixels.shape[:2]
    same = (shape, still.layout, still.bits) == (
        (record.rows, record.columns),
        record.layout,
        record.bits,
    )
    drift = still.black - record.black
    white = still.white - drift
    if not same or abs(drift) > _MAX_BLACK_DRIFT_DN or white < record.white - _MAX_BLACK_DRIFT_DN:
        raise FormatChangedError(
            f"{name} has {shape[1]} x {shape[0]} samples ({still.layout}, {still.bits} bits, black "
            f"{still.black}, white {still.white}) instead of {record.columns} x {record.rows} "
            f"({record.layout}, {record.bits} bits, black {record.black}, white {record.white})",
            still.record,
        )
    if not drift and white >= record.white:
        return still.pixels, {**still.details}
    top = 2**record.bits - 1
    shifted = np.clip(still.pixels.astype(np.int32) - drift, 0, top)
    shifted[still.pixels >= still.white] = top
    pixels: Pixels = shifted.astype(np.uint8) if record.bits <= 8 else shifted.astype(np.uint16)
    return pixels, {
        "black_in_file": still.black,
        "white_in_file": still.white,
    }


def checked_exposure(
    name: str, data: bytes, applied: ExposureSetting, *, has_gain: bool
) -> dict[str, float]:
    """Return the ISO speed and the orientation as `Frame.details` has them.

    The speed is the file's, or as it was set; neither is there where it is unknown.

    Raises:
        OtherExposureError: the file states another exposure than the one that was set; a stop of
            the lens is compared as light, and so are the others: by their ratio

    Args:
        name: of the file
        data: its bytes
        applied: what was set
        has_gain: whether the sensitivity was set, too
    """
    stated = stated_exposure(data)
    # What it is, the value in the file, the value that was set, its power in the light, its unit.
    checks = (
        ("an exposure time", stated.time_s, applied.time_s, 1, "{:.6g} s"),
        ("a sensitivity", stated.gain, applied.gain if has_gain else None, 1, "{:.4g} x ISO 100"),
        ("an aperture", stated.f_number, applied.f_number, 2, "f/{:.3g}"),
    )
    for what, found, was_set, power, unit in checks:
        if found is None or was_set is None:
            continue
        if not 1 / _MAX_RATIO < (found / was_set) ** power < _MAX_RATIO:
            raise OtherExposureError(
                f"{name} states {what} of {unit.format(found)}, but {unit.format(was_set)} was set",
                hint="shoot it again, and do not use the camera's own buttons during the capture",
            )
    gain = stated.gain or (applied.gain if has_gain else None)
    details: dict[str, float] = {} if gain is None else {"iso": round(100 * gain, 6)}
    return details | stated.orientation.details
