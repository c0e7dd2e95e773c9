"""Metadata in the picture files: EXR attributes, TIFF tags, PNG chunks.

OpenEXR's Python interface writes attributes only from a header of which it keeps every value
forever, and chromaticities as zeros.  So a file is written with one long comment instead, and its
place in the header is filled with the attributes afterwards.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from email.utils import format_datetime
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

from camctl.interface.colour import BT709_PRIMARIES, D65
from camctl.pictures.details import PictureDetails

_COMMENT = "comments"
#: Bytes for all attributes together.
_ROOM = 2048
#: Bytes of one attribute, at most: ffmpeg 5 takes files with a longer one for damaged.
_LONGEST_VALUE = 255
EXR_PLACEHOLDER = {_COMMENT: b" " * _ROOM}
"""What the header of a new EXR file has for `fill_exr_header`."""

#: Characters of a text at most.
_LONGEST_TEXT = 100
#: Numbers of TIFF tags: maker and model (TIFF 6.0), serial number (DNG).
_MAKE, _MODEL, _SERIAL = 271, 272, 50735
#: The same of shutter time and f-number (TIFF/EP), and of their type, a ratio of two integers.
_EXPOSURE_TIME, _F_NUMBER, _RATIONAL = 33434, 33437, 5
#: The same of the ISO speed, an integer of 16 bits.
_ISO_SPEED, _SHORT, _LARGEST_SHORT = 34855, 3, 65535
#: Numbers of EXIF tags: software, date, the directory of EXIF, date when taken, colour space with
#: its values.
_SOFTWARE, _DATE_TIME, _EXIF_IFD = 305, 306, 34665
_ORIGINAL_DATE, _COLOUR_SPACE, _SRGB, _UNCALIBRATED = 36867, 40961, 1, 65535
#: The same of the orientation.
_ORIENTATION = 274
#: The same of the version.
_EXIF_VERSION = 36864
#: Types of values: text, an integer of 32 bits, bytes without an end mark.
_ASCII, _LONG, _UNDEFINED = 2, 4, 7
#: Largest of these integers: they have 32 bits.
_LARGEST_INTEGER = 10**9
#: Rendering intent of a PNG file in sRGB: perceptual.
_PERCEPTUAL = b"\0"
#: Colour types of PNG files without colours.
_GREY_TYPES = (0, 4)
#: Code points of sRGB (ITU-T H.273): primaries of BT.709, its own curve, R G B, full range.
_SRGB_CODES = bytes((1, 13, 0, 1))
_PNG_HEADER = 8 + 4 + 4 + 13 + 4

Attribute = str | float | tuple[float, ...]


def exr_attributes(details: PictureDetails, channels: str) -> dict[str, Attribute]:
    """Return the standard attributes of radiance.exr by name.

    Chromaticities are stated where the colours have them, and not for the camera's own R, G, B.
    `expTime` is the sum of the shutter times.
    """
    camera = details.camera
    found: dict[str, Attribute] = {
        "cameraMake": camera.make,
        "cameraModel": camera.model,
        "cameraSerialNumber": camera.serial,
        "software": details.software,
        "expTime": details.total_time_s,
        "irradianceUnit": details.unit,
    }
    if details.f_number is not None:
        found["aperture"] = details.f_number
    if details.iso is not None:
        found["isoSpeed"] = details.iso
    if details.gain is not None:
        found["gain"] = details.gain
    if details.taken_at is not None:
        offset = details.taken_at.utcoffset()
        found["capDate"] = f"{details.taken_at:%Y:%m:%d %H:%M:%S}"
        # OpenEXR counts from local time to UTC.
        found["utcOffset"] = -offset.total_seconds() if offset is not None else 0.0
    if len(channels) == 3 and details.colour is not None:
        found["chromaticities"] = tuple(chain(*BT709_PRIMARIES, D65))
    return {
        name: _clean(value) if isinstance(value, str) else value
        for name, value in found.items()
        if value != ""
    }


def fill_exr_header(path: Path, attributes: Mapping[str, Attribute], summary: str) -> None:
    """Write attributes and a comment into an EXR file that was made with `EXR_PLACEHOLDER`."""
    start = _exr_attribute(_COMMENT, "")[:-4] + struct.pack("<i", _ROOM)
    with path.open("r+b") as file:
        # Long names of channels before it would take more; channels of a capture have short names.
        place = file.read(4096).index(start)
        written = b"".join(_exr_attribute(name, value) for name, value in attributes.items())
        file.seek(place)
        file.write(written + _comments(f"irradiance; {summary}", len(start) + _ROOM - len(written)))


def _comments(text: str, size: int) -> bytes:
    """Return a text as attributes of `size` bytes together, each no longer than ffmpeg reads."""
    names, left = [_COMMENT], size
    while (left := left - len(_exr_attribute(names[-1], "")) - _LONGEST_VALUE) > 0:
        names.append(f"{_COMMENT}{len(names) + 1}")
    lengths = [_LONGEST_VALUE] * len(names)
    lengths[-1] += left
    if lengths[-1] < 0:  # less than its name takes: the one before makes room for it
        lengths[-2:] = [lengths[-2] + lengths[-1], 0]
    found, text = b"", text.encode("ascii", "replace").decode()
    for name, length in zip(names, lengths, strict=True):
        found += _exr_attribute(name, text[:length].ljust(length))
        text = text[length:]
    return found


def tiff_tags(details: PictureDetails) -> dict[str, Any]:
    """Return the arguments of tifffile that say what was taken when, how and with what.

    Texts are ASCII, as TIFF asks.
    """
    camera = details.camera
    texts = {_MAKE: camera.make, _MODEL: camera.model, _SERIAL: camera.serial}
    numbers = {_EXPOSURE_TIME: details.total_time_s, _F_NUMBER: details.f_number}
    iso, lies = round(details.iso or 0), details.orientation
    tags: dict[str, Any] = {
        "software": details.software,
        "description": details.summary,
        "metadata": None,  # tifffile's own description is of the array
        "extratags": [
            *((number, _ASCII, 0, _ascii(text), True) for number, text in texts.items() if text),
            *(
                (number, _RATIONAL, 1, _ratio(value), True)
                for number, value in numbers.items()
                if value is not None
            ),
            *([(_ISO_SPEED, _SHORT, 1, iso, True)] if 0 < iso <= _LARGEST_SHORT else []),
            *([] if lies.is_upright else [(_ORIENTATION, _SHORT, 1, lies.tag, True)]),
        ],
    }
    if details.taken_at is not None:
        tags["datetime"] = f"{details.taken_at:%Y:%m:%d %H:%M:%S}"
    return tags


def exif_block(details: PictureDetails) -> bytes:
    """Return EXIF data (2.32) of a JPEG file, from the header of their TIFF structure on."""
    camera = details.camera
    taken = "" if details.taken_at is None else f"{details.taken_at:%Y:%m:%d %H:%M:%S}"
    iso = round(details.iso or 0)
    top: dict[int, bytes | int] = {
        _MAKE: _ascii(camera.make).encode(),
        _MODEL: _ascii(camera.model).encode(),
        _SOFTWARE: _ascii(details.software).encode(),
        _DATE_TIME: taken.encode(),
        _EXIF_IFD: 0,
    }
    below: dict[int, bytes | int | tuple[int, int]] = {
        _EXPOSURE_TIME: _ratio(details.total_time_s),
        _ISO_SPEED: iso if iso <= _LARGEST_SHORT else 0,
        _EXIF_VERSION: b"0232",
        _ORIGINAL_DATE: taken.encode(),
        _COLOUR_SPACE: _SRGB if details.colour is not None else _UNCALIBRATED,
    }
    if details.f_number is not None:
        below[_F_NUMBER] = _ratio(details.f_number)
    kept = {tag: value for tag, value in top.items() if value or tag == _EXIF_IFD}
    start = 8 + len(_directory(kept, 8))
    kept[_EXIF_IFD] = start
    exif = {tag: value for tag, value in below.items() if value}
    return b"MM\0*" + struct.pack(">I", 8) + _directory(kept, 8) + _directory(exif, start)


def _directory(tags: Mapping[int, bytes | int | tuple[int, int]], at: int) -> bytes:
    """Return a directory of TIFF at this place of a file, with what its entries hold after it."""
    entries, rest = b"", b""
    after = at + 2 + 12 * len(tags) + 4
    for tag, value in sorted(tags.items()):
        if isinstance(value, int):
            kind, form = (_LONG, ">I") if tag == _EXIF_IFD else (_SHORT, ">Hxx")
            entries += struct.pack(">HHI", tag, kind, 1) + struct.pack(form, value)
            continue
        if isinstance(value, tuple):
            kind, count, data = _RATIONAL, 1, struct.pack(">II", *value)
        elif tag == _EXIF_VERSION:
            kind, count, data = _UNDEFINED, len(value), value
        else:
            kind, count, data = _ASCII, len(value) + 1, value + b"\0"
        entries += struct.pack(">HHI", tag, kind, count)
        if len(data) <= 4:
            entries += data.ljust(4, b"\0")
        else:
            entries += struct.pack(">I", after + len(rest))
            rest += data + bytes(len(data) % 2)
    return struct.pack(">H", len(tags)) + entries + bytes(4) + rest


def png_with_metadata(png: bytes, details: PictureDetails) -> bytes:
    """Return a PNG file with date, camera and software, and with chunks that say that it is sRGB.

    Pictures with the camera's own colours are not.
    """
    texts = {
        "Software": details.software,
        "Source": details.camera.name,
    }
    if details.taken_at is not None:
        texts["Creation Time"] = format_datetime(details.taken_at)  # as PNG asks, RFC 1123
    chunks = []
    is_grey = png[_PNG_HEADER - 4 - 13 + 9] in _GREY_TYPES
    if details.colour is not None or is_grey:
        chunks = [_chunk(b"cICP", _SRGB_CODES), _chunk(b"sRGB", _PERCEPTUAL)]
    chunks += [_chunk(b"tEXt", f"{key}\0{_ascii(text)}".encode()) for key, text in texts.items()]
    return png[:_PNG_HEADER] + b"".join(chunks) + png[_PNG_HEADER:]


def _exr_attribute(name: str, value: Attribute) -> bytes:
    """Return an attribute as it stands in the header: name, type, size, value."""
    if isinstance(value, str):
        kind, data = "string", value.encode("utf-8", "replace")
    elif isinstance(value, tuple):
        kind, data = "chromaticities", struct.pack(f"<{len(value)}f", *value)
    else:
        kind, data = "float", struct.pack("<f", value)
    return b"%s\0%s\0%s" % (name.encode(), kind.encode(), struct.pack("<i", len(data))) + data


def _ratio(value: float) -> tuple[int, int]:
    """Return a number as numerator and denominator, each of at most 32 bits."""
    value = min(value, float(_LARGEST_INTEGER))
    ratio = Fraction(value).limit_denominator(round(_LARGEST_INTEGER / max(value, 1.0)))
    return ratio.numerator, ratio.denominator


def _clean(text: str) -> str:
    """Return a text that a camera supplied without control characters, and not too long."""
    return "".join(filter(str.isprintable, text))[:_LONGEST_TEXT]


def _ascii(text: str) -> str:
    return _clean(text).encode("ascii", "replace").decode()


def _chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG file."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
