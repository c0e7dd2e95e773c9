"""The primaries that JPEG, PNG and TIFF files state: an ICC profile, or EXIF's colour space."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from camctl.interface.colour import BT709, D65, CameraColour, rgb_to_xyz
from camctl.stills.exif import PNG, jpeg_segments, png_chunks, stated_colour_space

#: Chromaticities of red, green and blue (Adobe RGB (1998) Color Image Encoding, 4.3.1).
_ADOBE_RGB = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
#: From XYZ with the white of ICC profiles, D50, to XYZ with D65: the Bradford transformation
#: (ICC.1:2022, annex E, inverted).
_D50_TO_D65 = np.linalg.inv(
    [[1.04788, 0.02292, -0.05022], [0.02959, 0.99048, -0.01707], [-0.00925, 0.01508, 0.75168]]
)
_ICC_SEGMENT, _ICC_HEAD = 0xE2, b"ICC_PROFILE\0"
_TIFF_ICC = 34675
#: Largest profile that is looked at.
_MOST_BYTES = 1 << 22


def stated_colour(data: bytes) -> CameraColour | None:
    """Return the colours of a developed picture: those stated, else sRGB; None: no R, G and B.

    Args:
        data: a whole JPEG, PNG or TIFF file
    """
    profile = _profile(data)
    if profile:
        return _of_profile(profile)
    if stated_colour_space(data) == "Adobe RGB":
        return CameraColour.of_primaries(rgb_to_xyz(_ADOBE_RGB, D65))
    return BT709


def _profile(data: bytes) -> bytes:
    """Return the ICC profile in a file; empty where there is none."""
    if data.startswith(PNG):
        for kind, start, end in png_chunks(data):
            if kind == b"iCCP":
                packed = data[start:end].partition(b"\0")[2][1:]
                try:
                    return zlib.decompressobj().decompress(packed, _MOST_BYTES)
                except zlib.error:
                    return b""
        return b""
    if data[:2] in (b"II", b"MM"):
        return _profile_of_tiff(data)
    parts = [
        data[start + len(_ICC_HEAD) : end]
        for kind, start, end in jpeg_segments(data)
        if kind == _ICC_SEGMENT and data.startswith(_ICC_HEAD, start)
    ]
    return b"".join(part[2:] for part in sorted(parts, key=lambda part: part[:1]))


def _profile_of_tiff(data: bytes) -> bytes:
    import io

    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            tag = file.pages.first.tags.get(_TIFF_ICC)
            return b"" if tag is None else bytes(tag.value)
    except Exception:  # a damaged tag can cause any error in tifffile
        return b""


def _of_profile(profile: bytes) -> CameraColour | None:
    """Return the colours of a profile with three primaries; None for others (ICC.1:2022, 8.3)."""
    if profile[16:20] != b"RGB " or len(profile) < 132:
        return None
    (count,) = struct.unpack_from(">I", profile, 128)
    columns = {}
    for entry in range(min(count, 100)):
        head = profile[132 + 12 * entry : 144 + 12 * entry]
        if len(head) < 12:
            return None
        name, offset, _ = struct.unpack(">4sII", head)
        values = profile[offset + 8 : offset + 20]
        if name in (b"rXYZ", b"gXYZ", b"bXYZ") and len(values) == 12:
            columns[name[:1]] = np.array(struct.unpack(">3i", values)) / 65536
    if len(columns) < 3:
        return None
    d50: NDArray[np.float64] = np.stack([columns[name] for name in (b"r", b"g", b"b")], axis=1)
    try:
        found = CameraColour.of_primaries(_D50_TO_D65 @ d50)
    except np.linalg.LinAlgError:
        return None
    return BT709 if found.is_identity else found
