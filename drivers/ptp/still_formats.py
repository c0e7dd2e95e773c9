"""Which objects of a still camera are pictures, of which format, and which are the newest."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePath
from typing import TypeAlias

from camctl.drivers.common.known_format import FORMATS, format_of_name
from camctl.drivers.ptp.body import Body
from camctl.drivers.ptp.datasets import ObjectInfo
from camctl.errors import CameraProtocolError

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


def format_of(info: ObjectInfo) -> str | None:
    """Return the format of an object, one of `FORMATS`; None if it is not a picture.

    The suffix of its name decides before its format code, since makers give raw files the code of
    an undefined object, or of TIFF.
    """
    return format_of_name(info.name) or _CODES.get(info.format)


# Folder and stem.
FileKey: TypeAlias = tuple[int, str]


def key_of(info: ObjectInfo) -> FileKey:
    """Return what the files of one exposure share: their folder, and their name without suffix."""
    return info.parent, PurePath(info.name).stem.upper()


@dataclass(frozen=True)
class CardPicture:
    """A picture on the card: its handle, its description, and its format, one of `FORMATS`."""

    handle: int
    info: ObjectInfo
    format: str


def newest_pictures(body: Body, format_name: str | None) -> list[CardPicture]:
    """Return the newest pictures on the card, the newest first, one of each exposure.

    Args:
        body: the camera
        format_name: the format to look for; None: of the files of an exposure, the format that is
            first in `FORMATS`
    """
    found: dict[FileKey, CardPicture] = {}
    for handle in sorted(body.handles() or (), reverse=True)[:_NEWEST_HANDLES]:
        try:
            info = body.session.object_info(handle)
        except CameraProtocolError:
            continue
        name = format_of(info)
        if name is not None and (format_name is None or name == format_name):
            picture = CardPicture(handle, info, name)
            other = found.setdefault(key_of(info), picture)
            if FORMATS.index(name) < FORMATS.index(other.format):
                found[key_of(info)] = picture
    return sorted(
        found.values(), key=lambda picture: (picture.info.captured, picture.handle), reverse=True
    )


def is_of_model(model_in_file: str, model: str) -> bool:
    """Return whether a file may be of a camera: False if it states another model."""
    words = [re.sub(r"[^a-z0-9]", "", name.lower()) for name in (model_in_file, model)]
    return not all(words) or words[0] in words[1] or words[1] in words[0]
