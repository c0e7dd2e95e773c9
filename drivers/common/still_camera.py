"""What drivers of still cameras share: options, records in the profile, times in their files."""

from __future__ import annotations

import io
import math
import struct
from typing import Annotated

from pydantic import BeforeValidator, field_validator

from camctl.backends import BackendOptions
from camctl.camera import CameraInfo
from camctl.errors import DataError, StorageError
from camctl.profile import StillRecord, change_profile
from camctl.response.camera import named_response

_EXPOSURE_TIME = 33434
_EXIF_IFD = "ExifTag"
_APP1, _START_OF_SCAN = 0xE1, 0xDA


def _lower_case(value: object) -> object:
    return value.strip().lower() if isinstance(value, str) else value


LowerCase = BeforeValidator(_lower_case)
"""Converts the value of an option to lower case before it is checked."""


class StillOptions(BackendOptions):
    """Options of all still cameras.

    Attributes:
        response: of JPEG and TIFF files: linear, srgb, rec709, power:GAMMA, or power (gamma 2.2)
    """

    response: Annotated[str, LowerCase] = "srgb"

    @field_validator("response")
    @classmethod
    def _is_a_response(cls, word: str) -> str:
        named_response(word, 8, 255)
        return word


def save_record(info: CameraInfo, file_format: str, record: StillRecord) -> str | None:
    """Save what is known of a camera's files in its profile; return a note if that fails."""
    try:
        change_profile(info, lambda profile: profile.stills.update({file_format: record}))
    except (DataError, StorageError) as error:
        return f"the format of its files could not be saved in its profile: {error.what}"
    return None


def exposure_time_s(data: bytes) -> float | None:
    """Return the tag ExposureTime (EXIF 2.3, section 4.6.5), s; None if missing or invalid.

    Args:
        data: a whole JPEG or TIFF file, or any other bytes
    """
    import tifffile

    tags = _exif_of_jpeg(data) if data.startswith(b"\xff\xd8") else data
    if tags is None:
        return None
    try:
        with tifffile.TiffFile(io.BytesIO(tags)) as file:
            page = file.pages.first
            tag = page.tags.get(_EXPOSURE_TIME)
            value = page.tags[_EXIF_IFD].value["ExposureTime"] if tag is None else tag.value
            numerator, denominator = value
            time_s = float(numerator) / float(denominator)
    except Exception:  # a damaged tag can cause any error in tifffile
        return None
    return time_s if math.isfinite(time_s) and time_s > 0 else None


def _exif_of_jpeg(data: bytes) -> bytes | None:
    """Return the EXIF data of application segment 1, which has the structure of a TIFF file."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _START_OF_SCAN:
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return data[at + 10 : at + 2 + length]
        at += 2 + max(length, 2)
    return None
