"""What the files of cameras state of their exposure (EXIF 2.32, section 4.6)."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from camctl.interface.orientation import UPRIGHT, Orientation
from camctl.system.library_output import quiet_libraries

# Tags, with their names in the EXIF directory.
_EXPOSURE_TIME, _SHUTTER_SPEED = (33434, "ExposureTime"), (37377, "ShutterSpeedValue")
_F_NUMBER, _APERTURE = (33437, "FNumber"), (37378, "ApertureValue")
_ISO = (34855, "ISOSpeedRatings")  # so tifffile names it, as EXIF 2.2 did
_MAKE, _MODEL = (271, "Make"), (272, "Model")
_SERIAL = (42033, "BodySerialNumber")
_DATE, _OFFSET = (36867, "DateTimeOriginal"), (36881, "OffsetTimeOriginal")
_FLASH = (37385, "Flash")
_FIRED = 1  # its lowest bit
_ORIENTATION = (274, "Orientation")
_CHANGED = (306, "DateTime")  # of the file, where it does not say when the picture was taken
_EXIF_IFD, _INTEROPERABILITY = "ExifTag", "InteroperabilityTag"
_SRGB = 1  # of the tag ColorSpace
_LARGEST_ISO = 65535  # of the tag; it stands for higher ones, too, which one of these states
_SENSITIVITIES = (
    (34866, "RecommendedExposureIndex"),
    (34865, "StandardOutputSensitivity"),
    (34867, "ISOSpeed"),
)

PNG = b"\x89PNG\r\n\x1a\n"
"""The first bytes of a PNG file."""

_JPEG = b"\xff\xd8"
_APP1, _START_OF_SCAN = 0xE1, 0xDA


@dataclass(frozen=True)
class StatedExposure:
    """The exposure that a file states; None or "" where it does not.

    Attributes:
        time_s: exposure time
        gain: sensitivity, 1 for ISO 100
        f_number: of the lens
        make, model, serial: of the camera
        taken_at: when the picture was taken; in the local zone where the file states none
        orientation: of its pixels
        flash_fired: whether it did
    """

    time_s: float | None = None
    gain: float | None = None
    f_number: float | None = None
    make: str = ""
    model: str = ""
    serial: str = ""
    taken_at: datetime | None = None
    orientation: Orientation = UPRIGHT
    flash_fired: bool | None = None


def stated_exposure(data: bytes) -> StatedExposure:
    """Return the exposure in the tags of a file.

    Where the exposure time or the f-number is missing, its logarithm is used (APEX, annex C).

    Args:
        data: a whole JPEG, PNG or TIFF file, or any other bytes
    """
    import tifffile

    if (tags := _tags(data)) is None:
        return StatedExposure()
    try:
        with quiet_libraries(), tifffile.TiffFile(io.BytesIO(tags)) as file:
            top = file.pages.first.tags
            exif = top[_EXIF_IFD].value if _EXIF_IFD in top else {}

            def value(tag: tuple[int, str]) -> Any:
                return top[tag[0]].value if tag[0] in top else exif.get(tag[1])

            make, model, serial, date, offset, changed = map(
                _text, map(value, (_MAKE, _MODEL, _SERIAL, _DATE, _OFFSET, _CHANGED))
            )
            flash = value(_FLASH)
            return StatedExposure(
                time_s=_number(value(_EXPOSURE_TIME)) or _power_of_two(value(_SHUTTER_SPEED), -1),
                gain=_gain(value(_ISO), [_number(value(tag)) for tag in _SENSITIVITIES]),
                f_number=_number(value(_F_NUMBER))
                or _power_of_two(_number(value(_APERTURE)), 1 / 2),
                make=make,
                model=model,
                serial=serial,
                taken_at=_date(date or changed, offset),
                orientation=Orientation.of_tag(value(_ORIENTATION)),
                flash_fired=bool(flash & _FIRED) if isinstance(flash, int) else None,
            )
    except Exception:  # a damaged tag can cause any error in tifffile
        return StatedExposure()


def stated_colour_space(data: bytes) -> str:
    """Return "sRGB", "Adobe RGB" (DCF 2.0, 3.2), or "" where the tags of a file state neither."""
    import tifffile

    if (tags := _tags(data)) is None:
        return ""
    try:
        with quiet_libraries(), tifffile.TiffFile(io.BytesIO(tags)) as file:
            top = file.pages.first.tags
            exif = top[_EXIF_IFD].value if _EXIF_IFD in top else {}
            index = top[_INTEROPERABILITY].value if _INTEROPERABILITY in top else {}
            index = exif.get(_INTEROPERABILITY, index)
            rules = index.get("InteroperabilityIndex", "") if isinstance(index, dict) else ""
            if exif.get("ColorSpace") == _SRGB:
                return "sRGB"
            return "Adobe RGB" if str(rules).startswith("R03") else ""
    except Exception:  # a damaged tag can cause any error in tifffile
        return ""


def _text(value: object) -> str:
    return value.strip("\0 ") if isinstance(value, str) else ""


def _date(date: str, offset: str) -> datetime | None:
    """Return the time that EXIF states as "2026:11:22 08:30:00" and "+01:00"; None: it is none."""
    for text, form in ((date + offset, "%Y:%m:%d %H:%M:%S%z"), (date, "%Y:%m:%d %H:%M:%S")):
        with suppress(ValueError, OverflowError, OSError):  # the last two: years without a zone
            return datetime.strptime(text, form).astimezone()
    return None


def _finite(value: object) -> float | None:
    """Return a finite number: an integer, or a fraction of two; None for others."""
    try:
        if isinstance(value, tuple):
            value = value[0] / value[1]
        number = float(value)  # type: ignore[arg-type]  # other types raise TypeError
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if math.isfinite(number) else None


def _number(value: object) -> float | None:
    """Return a positive finite number; None for others."""
    number = _finite(value)
    return number if number is not None and number > 0 else None


def _power_of_two(value: object, factor: float) -> float | None:
    """Return 2 to the power of a value times a factor; None where it is no logarithm."""
    number = _finite(value)
    return None if number is None or abs(number) > 100 else math.exp2(factor * number)


def _gain(ratings: object, sensitivities: list[float | None]) -> float | None:
    """Return the linear gain of the ISO tag, which may have several values, or of the others."""
    iso = _number(ratings[0] if isinstance(ratings, tuple) and ratings else ratings)
    if iso is None or iso >= _LARGEST_ISO:
        iso = next(filter(None, sensitivities), None)
    return None if iso is None else iso / 100


def _tags(data: bytes) -> bytes | None:
    """Return what of a file has the structure of a TIFF file; None: nothing has."""
    if data.startswith(PNG):
        return next(
            (data[start:end] for kind, start, end in png_chunks(data) if kind == b"eXIf"), None
        )
    if not data.startswith(_JPEG):
        return data
    return next(
        (
            data[start + 6 : end]
            for kind, start, end in jpeg_segments(data)
            if kind == _APP1 and data.startswith(b"Exif\0\0", start)
        ),
        None,
    )


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the marker of each segment before the picture, and where its contents begin and end."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _START_OF_SCAN:
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield data[at + 1], at + 4, at + 2 + max(length, 2)
        at += 2 + max(length, 2)


def png_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield the name of each whole chunk of a PNG file, and where its contents begin and end."""
    at = len(PNG)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            return
        yield kind, at + 8, at + 8 + length
        at += 12 + length
