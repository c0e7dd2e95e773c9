"""File formats of a still camera: which objects are pictures, and what a format's files contain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from camctl.camera import CameraInfo, Pixels
from camctl.errors import CameraProtocolError
from camctl.profile import StillRecord, load_profile
from drivers.common.still_file import Still
from drivers.ptp.body import Body
from drivers.ptp.datasets import ObjectInfo

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
# Object formats of ISO 15740, section 6.2 (0x38..), and of makers (0xB1..).
_CODES: dict[int, str] = {
    0x3801: "jpeg",
    0x3808: "jpeg",
    0x380D: "tiff",
    0x380E: "tiff",
    0x3802: "raw",  # TIFF/EP
    0x3811: "raw",  # DNG
    0xB101: "raw",  # Sony ARW, Canon CRW
    0xB103: "raw",  # Canon CR2
    0xB108: "raw",  # Canon CR3
}
# The newest objects have the highest handles on all known cameras; this many are examined.
_NEWEST_HANDLES = 12
# Cameras measure the black level of each raw file on masked pixels; it varies by a few DN.
_MAX_BLACK_DRIFT_DN = 32


def format_of(info: ObjectInfo) -> str | None:
    """Return the format of an object, one of `FORMATS`; None if it is not a picture.

    The suffix of its name decides before its format code, since makers give raw files the code of
    an undefined object, or of TIFF.
    """
    suffix = PurePath(info.name).suffix.lower()
    return _SUFFIXES.get(suffix) or _CODES.get(info.format)


def stem_of(info: ObjectInfo) -> str:
    """Return the part of an object's name that the files of one exposure share."""
    return PurePath(info.name).stem.upper()


@dataclass(frozen=True)
class CardPicture:
    """A picture on the card: its handle, its description, and its format, one of `FORMATS`."""

    handle: int
    info: ObjectInfo
    format: str


def newest_picture(body: Body, format_name: str | None) -> CardPicture | None:
    """Return the newest picture on the card; None if there is none.

    Args:
        body: the camera
        format_name: the format to look for; None: of the files of the newest exposure,
            the format that is first in `FORMATS`
    """
    found: list[CardPicture] = []
    for handle in sorted(body.handles() or (), reverse=True)[:_NEWEST_HANDLES]:
        try:
            info = body.session.object_info(handle)
        except CameraProtocolError:
            continue
        name = format_of(info)
        if name is not None and (format_name is None or name == format_name):
            found.append(CardPicture(handle, info, name))
    if not found:
        return None
    last = max(found, key=lambda picture: (picture.info.captured, picture.handle))
    siblings = [picture for picture in found if stem_of(picture.info) == stem_of(last.info)]
    return min(siblings, key=lambda picture: FORMATS.index(picture.format))


@dataclass(frozen=True)
class KnownFormat:
    """A format of a camera's files, with their size, layout and levels."""

    format: str
    record: StillRecord


def saved_format(info: CameraInfo, format_name: str | None) -> KnownFormat | None:
    """Return a format from the camera's profile, or None; without a name, the preferred one."""
    stills = load_profile(info).stills
    for name in (format_name,) if format_name else FORMATS:
        if name in stills:
            return KnownFormat(name, stills[name])
    return None


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
        FormatChangedError: size, layout, bits or levels differ from those of `known`
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
        return still.pixels, {}
    top = 2**record.bits - 1
    shifted = np.clip(still.pixels.astype(np.int32) - drift, 0, top)
    shifted[still.pixels >= still.white] = top
    pixels: Pixels = shifted.astype(np.uint8) if record.bits <= 8 else shifted.astype(np.uint16)
    return pixels, {
        "black_in_file": still.black,
        "white_in_file": still.white,
    }
