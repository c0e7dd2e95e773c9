"""The primaries that JPEG, PNG and TIFF files state: an ICC profile, or EXIF's colour space."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from camctl.interface.colour import BT709, D65, CameraColour, rgb_to_xyz
from camctl.model.response.camera import srgb_to_linear
from camctl.stills.exif import PNG, jpeg_segments, png_chunks, stated_colour_space

#: Chromaticities of red, green and blue (Adobe RGB (1998) Color Image Encoding, 4.3.1).
_ADOBE_RGB = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
#: Exponent of its encoding (4.3.4.2).
_ADOBE_GAMMA = 563 / 256
#: Codes of 8 bits, 0 to 1, and the largest difference of the light of encodings that are the same.
_CODES, _SAME = np.linspace(0, 1, 256), 0.5 / 255
#: Numbers of a parametric curve, by its kind (ICC.1:2022, table 68).
_PARAMETERS = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}
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
        return CameraColour.of_primaries(rgb_to_xyz(_ADOBE_RGB, D65), tuple(_CODES**_ADOBE_GAMMA))
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
    columns: dict[bytes, NDArray[np.float64]] = {}
    encoding: tuple[float, ...] = ()
    for entry in range(min(count, 100)):
        head = profile[132 + 12 * entry : 144 + 12 * entry]
        if len(head) < 12:
            return None
        name, offset, size = struct.unpack(">4sII", head)
        tag = profile[offset : offset + size]
        if name in (b"rXYZ", b"gXYZ", b"bXYZ") and len(tag) >= 20:
            columns[name[:1]] = np.array(struct.unpack(">3i", tag[8:20])) / 65536
        elif name == b"gTRC":  # R, G and B have one in profiles that cameras write
            encoding = _encoding(tag)
    if len(columns) < 3:
        return None
    d50: NDArray[np.float64] = np.stack([columns[name] for name in (b"r", b"g", b"b")], axis=1)
    try:
        found = CameraColour.of_primaries(_D50_TO_D65 @ d50, encoding)
    except np.linalg.LinAlgError:
        return None
    return BT709 if found.is_identity and not encoding else found


def _encoding(tag: bytes) -> tuple[float, ...]:
    """Return the light of codes by a curve (ICC.1:2022, 10.6 and 10.18); none: as sRGB's."""
    numbers = tag[12:]
    if tag[:4] == b"curv" and len(tag) >= 12:
        (count,) = struct.unpack_from(">I", tag, 8)
        values = np.frombuffer(numbers[: len(numbers) // 2 * 2], ">u2")[:count]
        if count < 2:
            light = _CODES ** (float(values[0]) / 256 if values.size else 1.0)
        elif values.size == count:
            light = np.interp(_CODES, np.linspace(0, 1, count), values / 65535)
        else:
            return ()
    elif tag[:4] == b"para" and len(tag) >= 16:
        values = np.frombuffer(numbers[: len(numbers) // 4 * 4], ">i4") / 65536
        light = _parametric(int.from_bytes(tag[8:10], "big"), values.tolist())
    else:
        return ()
    if not np.isfinite(light).all() or (np.diff(light) < 0).any() or light[-1] <= 0:
        return ()
    light = np.clip(light / light[-1], 0, 1)
    is_srgb = np.abs(light - srgb_to_linear(_CODES)).max() < _SAME
    return () if is_srgb else tuple(light.tolist())


def _parametric(kind: int, values: list[float]) -> NDArray[np.float64]:
    """Return the light of codes by a function: (a x + b)^g + e from x = d on, c x + f below."""
    if kind not in _PARAMETERS or len(values) < _PARAMETERS[kind]:
        return np.full(_CODES.size, np.nan)
    g, a, b, c, d, e, f = [*values[: _PARAMETERS[kind]], *(0.0,) * 7][:7]
    if kind == 0:
        a = 1.0
    if kind in (1, 2):
        d, e, f, c = -b / a if a else 0.0, c, c, 0.0
    above = np.maximum(a * _CODES + b, 0) ** np.clip(g, 0, 100) + e
    return np.where(d <= _CODES, above, c * _CODES + f)
