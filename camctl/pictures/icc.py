"""The ICC profile of image.tiff: primaries of BT.709, and the desired response as its curve."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from camctl.interface.colour import BT709_PRIMARIES, D65, rgb_to_xyz
from camctl.model.response.desired import DesiredResponse

#: XYZ of the white of profiles, D50 (ICC.1:2022, 6.3.4.3).
_D50 = (0.9642, 1.0, 0.8249)
#: The cone responses of the Bradford transformation (ICC.1:2022, annex E).
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
#: Entries of a curve: the most that old readers take.
_ENTRIES = 4096
_HEADER_BYTES, _TAG_BYTES = 128, 12


def icc_profile(desired: DesiredResponse) -> bytes:
    """Return a profile (ICC.1:2022) of R, G and B in a response to the light of BT.709."""
    to_d50 = _adaptation()
    columns = to_d50 @ rgb_to_xyz(BT709_PRIMARIES, D65)
    u = np.linspace(0, 1, _ENTRIES)
    light = np.clip(desired.inverse(u), 0, 1)
    light[0] = 0.0  # what is darker than the range is black
    codes = np.rint(light * 65535).astype(">u2")
    curve = b"curv" + bytes(4) + struct.pack(">I", _ENTRIES) + codes.tobytes()
    tags = {
        b"desc": _text(f"camctl {desired.name}, BT.709"),
        b"cprt": _text("No copyright, use freely"),
        b"wtpt": _numbers(b"XYZ ", np.array(_D50)),
        b"chad": _numbers(b"sf32", to_d50),
        **{
            name: _numbers(b"XYZ ", columns[:, at])
            for at, name in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))
        },
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve),
    }
    return _assembled(tags)


def _assembled(tags: dict[bytes, bytes]) -> bytes:
    """Return header, table and contents; equal contents are there once."""
    places: dict[bytes, int] = {}
    body, start = b"", _HEADER_BYTES + 4 + _TAG_BYTES * len(tags)
    for content in tags.values():
        if content not in places:
            places[content] = start + len(body)
            body += content + bytes(-len(content) % 4)
    table = struct.pack(">I", len(tags)) + b"".join(
        name + struct.pack(">II", places[content], len(content)) for name, content in tags.items()
    )
    header = struct.pack(
        ">I4sI4s4s4s12s4s4sIII4s12s",
        start + len(body),
        bytes(4),
        0x04300000,  # version 4.3
        *(b"mntr", b"RGB ", b"XYZ "),
        struct.pack(">6H", 2026, 1, 1, 0, 0, 0),
        *(b"acsp", bytes(4)),
        *(0, 0, 0),
        bytes(4),
        bytes(12),
    )
    # Attributes, rendering intent (perceptual), white, creator, identifier and reserve.
    white = struct.pack(">3i", *(round(each * 65536) for each in _D50))
    header = header[:64] + struct.pack(">I", 0) + white
    return header.ljust(_HEADER_BYTES, b"\0") + table + body


def _adaptation() -> NDArray[np.float64]:
    """Return the matrix from XYZ with D65 as white to XYZ with D50."""
    x, y = D65
    cones = [_BRADFORD @ white for white in ((x / y, 1.0, (1 - x - y) / y), _D50)]
    return np.asarray(np.linalg.solve(_BRADFORD, (cones[1] / cones[0])[:, None] * _BRADFORD))


def _numbers(kind: bytes, values: NDArray[np.float64]) -> bytes:
    """Return a tag of numbers of 16 bits before and after the point."""
    fixed = np.rint(np.ravel(values) * 65536).astype(">i4")
    return kind + bytes(4) + fixed.tobytes()


def _text(text: str) -> bytes:
    """Return a tag of a text in English."""
    coded = text.encode("utf-16-be")
    return (
        b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(coded), 28) + coded
    )
