"""Which objects of a camera are pictures, and of what kind."""

from __future__ import annotations

from pathlib import PurePath

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
