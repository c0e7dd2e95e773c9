"""Which objects of a camera are pictures, and of what kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from camctl.camera import CameraInfo, Pixels
from camctl.errors import CameraProtocolError, StorageError
from camctl.profile import StillRecord, change_profile, load_profile
from drivers.common.still_file import Still
from drivers.ptp.body import Body
from drivers.ptp.datasets import ObjectInfo

#: What `format` can be, the most honest first: what `auto` prefers.
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


def format_of(info: ObjectInfo) -> str | None:
    """Return which of `FORMATS` an object is, by its name and else by its code; None: no picture.

    Names come first, since makers give raw files the code of an undefined object, or of TIFF.
    """
    suffix = PurePath(info.name).suffix.lower()
    return _SUFFIXES.get(suffix) or _CODES.get(info.format)


def stem_of(info: ObjectInfo) -> str:
    """Return the name that the files of one exposure share."""
    return PurePath(info.name).stem.upper()


# The newest objects have the highest handles on all cameras seen; so many are asked what they are.
_NEWEST = 12
# Cameras measure the black level of each raw file on shaded pixels; it wanders by a few levels.
_MOST_BLACK_DRIFT = 32


@dataclass(frozen=True)
class KnownFormat:
    """A format of a camera's files, and what is known of it."""

    format: str
    record: StillRecord


def remember(info: CameraInfo, known: KnownFormat) -> str | None:
    """Put what is known into the camera's profile; return a note where that cannot be written."""
    try:
        change_profile(info, lambda profile: profile.stills.update({known.format: known.record}))
    except StorageError as error:
        return f"its profile could not be kept: {error.what}"
    return None


def from_profile(info: CameraInfo, wanted: str | None) -> KnownFormat | None:
    """Return what the profile knows of a format; of the best one where `wanted` is None."""
    stills = load_profile(info).stills
    for name in (wanted,) if wanted else FORMATS:
        if name in stills:
            return KnownFormat(name, stills[name])
    return None


def newest(body: Body, wanted: str | None) -> tuple[int, ObjectInfo, str] | None:
    """Return (handle, info, format) of the newest picture on the card; None where there is none.

    `wanted` is the format looked for; where it is None, the best one of the files that the newest
    exposure left.
    """
    handles = body.handles()
    found: list[tuple[str, int, ObjectInfo, str]] = []
    for handle in sorted(handles or (), reverse=True)[:_NEWEST]:
        try:
            info = body.session.object_info(handle)
        except CameraProtocolError:
            continue
        name = format_of(info)
        if name is not None and (wanted is None or name == wanted):
            found.append((info.captured, handle, info, name))
    if not found:
        return None
    last = max(found, key=lambda item: item[:2])
    family = [item for item in found if stem_of(item[2]) == stem_of(last[2])]
    _, handle, info, name = min(family, key=lambda item: FORMATS.index(item[3]))
    return handle, info, name


def pixels_of(still: Still, known: KnownFormat, name: str) -> tuple[Pixels, dict[str, int]]:
    """Return a file's samples with the black and white level of `known`, and what was changed.

    Where the black level of a raw file differs by a little, all samples are moved by that whole
    number of levels; saturated ones stay saturated.

    Raises:
        CameraProtocolError: it is another kind of file than `known`
    """
    record, rows_columns = known.record, still.pixels.shape[:2]
    same = (rows_columns, still.layout, still.bits) == (
        (record.rows, record.columns),
        record.layout,
        record.bits,
    )
    drift = still.black - record.black
    white = still.white - drift
    if not same or abs(drift) > _MOST_BLACK_DRIFT or white < record.white - _MOST_BLACK_DRIFT:
        raise CameraProtocolError(
            f"{name} has {rows_columns[1]} x {rows_columns[0]} samples ({still.layout}, "
            f"{still.bits} bits, black {still.black}, white {still.white}), "
            f"{record.columns} x {record.rows} ({record.layout}, {record.bits} bits, black "
            f"{record.black}, white {record.white}) were expected",
            hint="leave size, quality and ISO as they are; what is expected is now set right: "
            "shoot again",
        )
    if not drift and white >= record.white:
        return still.pixels, {}
    top = 2**record.bits - 1
    moved = np.clip(still.pixels.astype(np.int32) - drift, 0, top)
    moved[still.pixels >= still.white] = top
    pixels: Pixels = moved.astype(np.uint8) if record.bits <= 8 else moved.astype(np.uint16)
    return pixels, {
        "black_in_file": still.black,
        "white_in_file": still.white,
    }
