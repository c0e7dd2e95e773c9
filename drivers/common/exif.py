"""The exposure time that a camera wrote into its file: JPEG with EXIF, and TIFF."""

from __future__ import annotations

import io
import math
import struct

import tifffile

_EXPOSURE_TIME = 33434
_EXIF_IFD = "ExifTag"
_APP1, _START_OF_SCAN = 0xE1, 0xDA


def exposure_time_s(data: bytes) -> float | None:
    """Return the tag ExposureTime (EXIF 2.3, 4.6.5), s; None where there is none that makes sense.

    Args:
        data: a whole JPEG or TIFF file, or anything else
    """
    tags = _tiff_of_jpeg(data) if data.startswith(b"\xff\xd8") else data
    if tags is None:
        return None
    try:
        with tifffile.TiffFile(io.BytesIO(tags)) as file:
            page = file.pages.first
            tag = page.tags.get(_EXPOSURE_TIME)
            value = page.tags[_EXIF_IFD].value["ExposureTime"] if tag is None else tag.value
            numerator, denominator = value
            time_s = float(numerator) / float(denominator)
    except Exception:  # whatever a made-up tag leads tifffile to: the file does not say
        return None
    return time_s if math.isfinite(time_s) and time_s > 0 else None


def _tiff_of_jpeg(data: bytes) -> bytes | None:
    """Return what follows "Exif" in the application segment 1, which is built like a TIFF file."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _START_OF_SCAN:
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return data[at + 10 : at + 2 + length]
        at += 2 + max(length, 2)
    return None
