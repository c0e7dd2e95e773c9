"""The files that a still camera makes of an exposure: JPEG, TIFF, DNG.

Lossless files hold the sensor's own numbers, so that whoever reads one can be checked against the
sensor.  Structure: TIFF 6.0, EXIF 2.3 (exposure time), Adobe DNG 1.4.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.controls import Layout
from camctl.errors import UsageError, unknown_name

MAKE = "camctl"
MODEL = "virtual still camera"

_CFA = 32803  # TIFF photometric interpretations of DNG
_LINEAR_RAW = 34892
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10  # TIFF field types
_D65 = 21  # EXIF light source
# XYZ (D65) to linear sRGB, IEC 61966-2-1, in 1/10000: what a DNG needs to be valid.
_XYZ_TO_RGB = (32406, -15372, -4986, -9689, 18758, 415, 557, -2040, 10570)
_COLOUR_OF = {"r": 0, "g": 1, "b": 2}
_DEMOSAIC = {
    Layout.RGGB: cv2.COLOR_BayerRGGB2RGB,
    Layout.GRBG: cv2.COLOR_BayerGRBG2RGB,
    Layout.GBRG: cv2.COLOR_BayerGBRG2RGB,
    Layout.BGGR: cv2.COLOR_BayerBGGR2RGB,
}


@dataclass(frozen=True, eq=False)
class Exposed:
    """One exposure, as the electronics behind the sensor have it.

    Attributes:
        pixels: (rows, columns) or (rows, columns, 3), uint8 or uint16
        layout: how colour lies in them
        bits, black, white: of the sensor
        time_s: exposure time that goes into the file
    """

    pixels: Pixels
    layout: Layout
    bits: int
    black: int
    white: int
    time_s: float


def encode(kind: str, exposed: Exposed, *, grey: bool = True, quality: int = 95) -> bytes:
    """Return the bytes of a file of `kind`: jpeg, tiff or dng.

    Args:
        kind: a name in `SUFFIXES`
        exposed: what to put into it
        grey: one channel for a mono sensor in JPEG and TIFF; False: three equal ones
        quality: of a JPEG, 1 to 100

    Raises:
        UsageError: an unknown kind, or a raw file of a sensor that has all colours in each pixel
    """
    if kind not in _ENCODERS:
        raise unknown_name("kind of file", kind, _ENCODERS)
    return _ENCODERS[kind](exposed, grey, quality)


def thumbnail(exposed: Exposed, *, rows: int = 120) -> bytes:
    """Return a small JPEG, at most `rows` high."""
    picture = _eight_bits(_picture(exposed, grey=False), exposed.bits)
    scale = min(1.0, rows / picture.shape[0])
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return _cv2_jpeg(small.astype(np.uint8, copy=False), 80)


def _jpeg(exposed: Exposed, grey: bool, quality: int) -> bytes:
    picture = _eight_bits(_picture(exposed, grey), exposed.bits)
    data = _cv2_jpeg(picture, quality)
    # The application segment of EXIF follows the start-of-image marker.
    return data[:2] + _exif_segment(exposed.time_s) + data[2:]


def _tiff(exposed: Exposed, grey: bool, quality: int) -> bytes:
    picture = _picture(exposed, grey)
    samples = 1 if picture.ndim == 2 else 3
    # MinSampleValue and MaxSampleValue: where black and white are.
    levels = ((280, exposed.black), (281, exposed.white))
    tags = [(tag, _SHORT, samples, (level,) * samples, True) for tag, level in levels]
    return _written(picture, "minisblack" if samples == 1 else "rgb", exposed, tags)


def _dng(exposed: Exposed, grey: bool, quality: int) -> bytes:
    if exposed.layout is Layout.RGB:
        raise UsageError("a raw file of an RGB sensor", hint="use jpeg or tiff, or a Bayer sensor")
    is_mosaic = exposed.layout.is_mosaic
    model = f"{MAKE} {MODEL}"
    tags: list[tuple[int, int, int, Any, bool]] = [
        (50706, _BYTE, 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, _BYTE, 4, (1, 1, 0, 0), True),  # DNGBackwardVersion
        (50708, _ASCII, len(model) + 1, model, True),  # UniqueCameraModel
        (50713, _SHORT, 2, (1, 1), True),  # BlackLevelRepeatDim
        (50714, _LONG, 1, exposed.black, True),  # BlackLevel
        (50717, _LONG, 1, exposed.white, True),  # WhiteLevel
    ]
    if is_mosaic:
        pattern = bytes(_COLOUR_OF[letter] for letter in exposed.layout.value)
        matrix = tuple(part for value in _XYZ_TO_RGB for part in (value, 10_000))
        tags += [
            (33421, _SHORT, 2, (2, 2), True),  # CFARepeatPatternDim
            (33422, _BYTE, 4, pattern, True),  # CFAPattern
            (50721, _SRATIONAL, 9, matrix, True),  # ColorMatrix1
            (50728, _RATIONAL, 3, (1, 1) * 3, True),  # AsShotNeutral
            (50778, _SHORT, 1, _D65, True),  # CalibrationIlluminant1
        ]
    wide = exposed.pixels.astype(np.uint16, copy=False)
    if is_mosaic:
        return _written(wide, _CFA, exposed, tags)
    # tifffile writes linear raw with three channels only.
    grey_file = io.BytesIO(_written(wide, "minisblack", exposed, tags))
    with tifffile.TiffFile(grey_file, mode="r+") as file:
        page = file.pages.first
        page.tags["PhotometricInterpretation"].overwrite(_LINEAR_RAW)
    return grey_file.getvalue()


_ENCODERS: dict[str, Callable[[Exposed, bool, int], bytes]] = {
    "jpeg": _jpeg,
    "tiff": _tiff,
    "dng": _dng,
}
SUFFIXES = {"jpeg": "JPG", "tiff": "TIF", "dng": "DNG"}


def _picture(exposed: Exposed, grey: bool) -> NDArray[Any]:
    """Return what a camera makes of the sensor's numbers: grey, or RGB with as many bits."""
    if exposed.layout in _DEMOSAIC:
        return np.asarray(cv2.cvtColor(exposed.pixels, _DEMOSAIC[exposed.layout]))
    if exposed.layout is Layout.MONO and not grey:
        return np.repeat(exposed.pixels[..., np.newaxis], 3, axis=2)
    return exposed.pixels


def _eight_bits(picture: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """Return a picture of `bits` bits with its lowest ones cut off."""
    return (picture >> max(0, bits - 8)).astype(np.uint8)


def _cv2_jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    wanted = [cv2.IMWRITE_JPEG_QUALITY, quality]
    done, data = cv2.imencode(".jpg", picture[..., ::-1] if picture.ndim == 3 else picture, wanted)
    assert done  # it fails for empty pictures alone
    return bytes(data)


def _rational(time_s: float) -> tuple[int, int]:
    """Return numerator and denominator of a time, to about nine digits."""
    fraction = Fraction(time_s).limit_denominator(10**6 if time_s > 1e-3 else 10**9)
    return min(fraction.numerator, 2**32 - 1), fraction.denominator


def _exif_segment(time_s: float) -> bytes:
    """Return an APP1 segment of one IFD, whose EXIF IFD has nothing but the exposure time."""
    top = struct.pack("<2sHIHHHIII", b"II", 42, 8, 1, 0x8769, _LONG, 1, 26, 0)
    exif = struct.pack("<HHHIII", 1, 33434, _RATIONAL, 1, 44, 0) + struct.pack(
        "<II", *_rational(time_s)
    )
    body = b"Exif\0\0" + top + exif
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


def _written(
    picture: NDArray[Any],
    photometric: str | int,
    exposed: Exposed,
    tags: list[tuple[int, int, int, Any, bool]],
) -> bytes:
    out = io.BytesIO()
    tifffile.imwrite(
        out,
        picture,
        photometric=photometric,
        metadata=None,
        software=False,
        extratags=[
            (271, _ASCII, len(MAKE) + 1, MAKE, True),
            (272, _ASCII, len(MODEL) + 1, MODEL, True),
            (33434, _RATIONAL, 1, _rational(exposed.time_s), True),  # ExposureTime
            *tags,
        ],
    )
    return out.getvalue()
