"""The files that a virtual still camera makes of an exposure: JPEG, TIFF, DNG.

DNG, and TIFF of mono and RGB sensors, hold the sensor's digital numbers unchanged, so that a reader
can be checked against the sensor.  Structure: TIFF 6.0, EXIF 2.3 (exposure time), Adobe DNG 1.4.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from camctl.errors import UsageError, unknown_name
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.system.picture_operations import required_opencv

MAKE = "camctl"
MODEL = "virtual still camera"

_CFA, _LINEAR_RAW = 32803, 34892  # TIFF photometric interpretations of DNG
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10  # TIFF field types
_D65 = 21  # EXIF light source
# XYZ (D65) to linear sRGB, IEC 61966-2-1, in 1/10000: the colour matrix that DNG requires.
_XYZ_TO_RGB = (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570)
_COLOUR_OF = {"r": 0, "g": 1, "b": 2}


@dataclass(frozen=True, eq=False)
class RawImage:
    """The pixels of one exposure, as read from the sensor.

    Attributes:
        pixels: (rows, columns) or (rows, columns, 3), uint8 or uint16
        layout: pixel layout
        bits, black, white: bit depth and levels of the sensor, DN
        time_s: exposure time that the file states
        iso, f_number, model: what it states beside; None and "": nothing
    """

    pixels: Pixels
    layout: Layout
    bits: int
    black: int
    white: int
    time_s: float
    iso: int | None = None
    f_number: float | None = None
    model: str = ""


def encode(form: str, image: RawImage, *, grey: bool = True, quality: int = 95) -> bytes:
    """Return the bytes of a file.

    Args:
        form: its format: jpeg, tiff or dng
        image: the picture
        grey: one channel for a mono sensor in JPEG and TIFF; False: three equal ones
        quality: of a JPEG, 1 to 100

    Raises:
        UsageError: an unknown format, or DNG with an RGB sensor
    """
    if form not in _ENCODERS:
        raise unknown_name("file format", form, _ENCODERS)
    return _ENCODERS[form](image, grey, quality)


def _jpeg(image: RawImage, grey: bool, quality: int) -> bytes:
    picture = _eight_bits(_developed(image, grey), image.bits)
    data = _cv2_jpeg(picture, quality)
    # The application segment of EXIF follows the start-of-image marker.
    return data[:2] + _exif_segment(image) + data[2:]


def _tiff(image: RawImage, grey: bool, quality: int) -> bytes:
    picture = _developed(image, grey)
    samples = 1 if picture.ndim == 2 else 3
    # MinSampleValue and MaxSampleValue: the black and the white level.
    levels = ((280, image.black), (281, image.white))
    tags = [(tag, _SHORT, samples, (level,) * samples, True) for tag, level in levels]
    return _tiff_bytes(picture, "minisblack" if samples == 1 else "rgb", image, tags)


def _dng(image: RawImage, grey: bool, quality: int) -> bytes:
    if image.layout is Layout.RGB:
        raise UsageError(
            "an RGB sensor has no raw file", hint="use jpeg or tiff, or a Bayer sensor"
        )
    is_mosaic = image.layout.is_mosaic
    model = f"{MAKE} {MODEL}"
    tags: list[tuple[int, int, int, Any, bool]] = [
        (50706, _BYTE, 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, _BYTE, 4, (1, 1, 0, 0), True),  # DNGBackwardVersion
        (50708, _ASCII, len(model) + 1, model, True),  # UniqueCameraModel
        (50713, _SHORT, 2, (1, 1), True),  # BlackLevelRepeatDim
        (50714, _LONG, 1, image.black, True),  # BlackLevel
        (50717, _LONG, 1, image.white, True),  # WhiteLevel
    ]
    if is_mosaic:
        pattern = bytes(_COLOUR_OF[letter] for letter in image.layout.value)
        matrix = tuple(part for value in _XYZ_TO_RGB for part in (value, 10_000))
        tags += [
            (33421, _SHORT, 2, (2, 2), True),  # CFARepeatPatternDim
            (33422, _BYTE, 4, pattern, True),  # CFAPattern
            (50721, _SRATIONAL, 9, matrix, True),  # ColorMatrix1
            (50728, _RATIONAL, 3, (1, 1) * 3, True),  # AsShotNeutral
            (50778, _SHORT, 1, _D65, True),  # CalibrationIlluminant1
        ]
    wide = image.pixels.astype(np.uint16, copy=False)
    if is_mosaic:
        return _tiff_bytes(wide, _CFA, image, tags)
    # tifffile refuses linear raw with one channel: write it as grey, then change the tag.
    grey_file = io.BytesIO(_tiff_bytes(wide, "minisblack", image, tags))
    with tifffile.TiffFile(grey_file, mode="r+") as file:
        page = file.pages.first
        page.tags["PhotometricInterpretation"].overwrite(_LINEAR_RAW)
    return grey_file.getvalue()


_ENCODERS: dict[str, Callable[[RawImage, bool, int], bytes]] = {
    "jpeg": _jpeg,
    "tiff": _tiff,
    "dng": _dng,
}
SUFFIXES = {"jpeg": "JPG", "tiff": "TIF", "dng": "DNG"}


def _developed(image: RawImage, grey: bool) -> NDArray[Any]:
    """Return the picture as grey or, demosaiced, as RGB; with the sensor's bit depth."""
    if image.layout.is_mosaic:
        cv2 = required_opencv("the virtual camera with a mosaic")
        code = getattr(cv2, f"COLOR_Bayer{image.layout.value.upper()}2RGB")
        return np.asarray(cv2.cvtColor(image.pixels, code))
    if image.layout is Layout.MONO and not grey:
        return np.repeat(image.pixels[..., np.newaxis], 3, axis=2)
    return image.pixels


def _eight_bits(picture: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """Return the eight most significant bits of a picture of `bits` bits."""
    return (picture >> max(0, bits - 8)).astype(np.uint8)


def _cv2_jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    cv2 = required_opencv("the virtual camera with JPEG files")
    bgr = picture[..., ::-1] if picture.ndim == 3 else picture
    is_encoded, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert is_encoded  # it fails for empty pictures only
    return bytes(data)


def _rational(value: float) -> tuple[int, int]:
    """Return a value as numerator and denominator of 32 bits each, to about nine digits."""
    fraction = Fraction(value).limit_denominator(10**6 if value > 1e-3 else 10**9)
    return min(fraction.numerator, 2**32 - 1), fraction.denominator


def _exif_tags(image: RawImage) -> list[tuple[int, int, int, Any, bool]]:
    """Return the tags of the exposure, as tifffile's extra tags."""
    tags: list[tuple[int, int, int, Any, bool]] = [
        (33434, _RATIONAL, 1, _rational(image.time_s), True)  # ExposureTime
    ]
    if image.f_number is not None:
        tags.append((33437, _RATIONAL, 1, _rational(image.f_number), True))
    if image.iso is not None:
        tags.append((34855, _SHORT, 1, min(image.iso, 65535), True))
    return tags


def _exif_segment(image: RawImage) -> bytes:
    """Return an APP1 segment: the model if there is one, and the exposure in an EXIF directory."""
    model = image.model.encode("ascii", "replace") + bytes(4)  # at least the size of an offset
    exif_tags, entries = _exif_tags(image), 1 + bool(image.model)
    exif_at = 8 + 2 + 12 * entries + 4
    values_at = exif_at + 2 + 12 * len(exif_tags) + 4
    top, values = struct.pack("<2sHIH", b"II", 42, 8, entries), b""
    if image.model:
        top += struct.pack("<HHII", 272, _ASCII, len(model), values_at)
        values += model + bytes(len(model) % 2)
    top += struct.pack("<HHIII", 0x8769, _LONG, 1, exif_at, 0)
    exif = struct.pack("<H", len(exif_tags))
    for tag, kind, count, value, _ in exif_tags:
        if kind == _SHORT:
            exif += struct.pack("<HHIHH", tag, kind, count, value, 0)
            continue
        exif += struct.pack("<HHII", tag, kind, count, values_at + len(values))
        values += struct.pack("<II", *value)
    body = b"Exif\0\0" + top + exif + bytes(4) + values
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


def _tiff_bytes(
    picture: NDArray[Any],
    photometric: str | int,
    image: RawImage,
    tags: list[tuple[int, int, int, Any, bool]],
) -> bytes:
    out, model = io.BytesIO(), image.model or MODEL
    tifffile.imwrite(
        out,
        picture,
        photometric=photometric,
        metadata=None,
        software=False,
        extratags=[
            (271, _ASCII, len(MAKE) + 1, MAKE, True),
            (272, _ASCII, len(model) + 1, model, True),
            *_exif_tags(image),
            *tags,
        ],
    )
    return out.getvalue()
