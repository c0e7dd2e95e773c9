"""Pixel formats in the numbers of the "GenICam Pixel Format Naming Convention" (PFNC) 2.4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.drivers.genicam.port import Received
from camctl.errors import CameraError, UsageError, unknown_name
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout

Bytes: TypeAlias = NDArray[np.uint8]
Unpack: TypeAlias = Callable[[Bytes, int, int], Pixels]


def _bytes(data: Bytes, _: int, count: int) -> Pixels:
    return data[:count].copy()


def _words(data: Bytes, _: int, count: int) -> Pixels:
    return data[: 2 * count].view("<u2").astype(np.uint16)


def _bit_stream(data: Bytes, bits: int, count: int) -> Pixels:
    """Unpack samples that follow each other without a gap, lowest bits first."""
    whole = 8 // int(np.gcd(bits, 8))  # samples in the least whole number of bytes
    size = whole * bits // 8
    groups = np.zeros((-(-count // whole), size), np.uint64)
    used = min(groups.size, data.size)
    groups.reshape(-1)[:used] = data[:used]
    number = np.zeros(len(groups), np.uint64)
    for place in range(size):
        number |= groups[:, place] << np.uint64(8 * place)
    shifts = np.arange(whole, dtype=np.uint64) * np.uint64(bits)
    samples = number[:, None] >> shifts & np.uint64(2**bits - 1)
    return samples.astype(np.uint16).reshape(-1)[:count]


def _two_in_three(data: Bytes, bits: int, count: int) -> Pixels:
    """Unpack the upper 8 bits of two samples, with the lower bits of both in a byte between."""
    groups = data[: 3 * -(-count // 2)].reshape(-1, 3).astype(np.uint16)
    low, mask = bits - 8, 2 ** (bits - 8) - 1
    first = groups[:, 0] << low | groups[:, 1] & mask
    second = groups[:, 2] << low | groups[:, 1] >> 4 & mask
    return np.stack((first, second), axis=1).reshape(-1)[:count].astype(np.uint16)


@dataclass(frozen=True)
class Packing:
    """How the samples of a frame are stored: bits of storage for each, and how to unpack them."""

    storage_bits: Callable[[int], int]
    unpack: Unpack


BYTES = Packing(lambda bits: 8, _bytes)
WORDS = Packing(lambda bits: 16, _words)
BIT_STREAM = Packing(lambda bits: bits, _bit_stream)
TWO_IN_THREE = Packing(lambda bits: 12, _two_in_three)


@dataclass(frozen=True)
class PixelFormat:
    """A pixel format.

    Attributes:
        name: entry of the feature PixelFormat
        code: its number
        bits: of a sample
        packing: of its samples
        layout: pixel layout
        is_reversed: blue comes first
    """

    name: str
    code: int
    bits: int
    packing: Packing
    layout: Layout = Layout.MONO
    is_reversed: bool = False

    def samples(self, frame: Received) -> Pixels | None:
        """Return the samples, (rows, columns), of RGB with 3 more; None where bytes are missing."""
        rows, columns = frame.shape
        colours = 3 if self.layout is Layout.RGB else 1
        count = rows * columns * colours
        data = frame.data
        if frame.line_padding:
            line = -(-columns * colours * self.packing.storage_bits(self.bits) // 8)
            whole = line + frame.line_padding
            if data.size < rows * whole:
                return None
            data = np.ascontiguousarray(data[: rows * whole].reshape(rows, whole)[:, :line])
            data = data.reshape(-1)
        if data.size * 8 < count * self.packing.storage_bits(self.bits):
            return None
        samples = self.packing.unpack(data, self.bits, count)
        if colours == 1:
            return samples.reshape(rows, columns)
        coloured: Pixels = samples.reshape(rows, columns, 3)
        return coloured[..., ::-1].copy() if self.is_reversed else coloured


_PATTERNS = {"GR": Layout.GRBG, "RG": Layout.RGGB, "GB": Layout.GBRG, "BG": Layout.BGGR}
#: Suffix of the name, bits, packing, and the numbers for each of `_PATTERNS`.
_BAYER = (
    ("16", 16, WORDS, (0x0110002E, 0x0110002F, 0x01100030, 0x01100031)),
    ("14", 14, WORDS, (0x01100109, 0x0110010A, 0x0110010B, 0x0110010C)),
    ("12", 12, WORDS, (0x01100010, 0x01100011, 0x01100012, 0x01100013)),
    ("12p", 12, BIT_STREAM, (0x010C0057, 0x010C0059, 0x010C0055, 0x010C0053)),
    ("12Packed", 12, TWO_IN_THREE, (0x010C002A, 0x010C002B, 0x010C002C, 0x010C002D)),
    ("10", 10, WORDS, (0x0110000C, 0x0110000D, 0x0110000E, 0x0110000F)),
    ("10p", 10, BIT_STREAM, (0x010A0056, 0x010A0058, 0x010A0054, 0x010A0052)),
    ("10Packed", 10, TWO_IN_THREE, (0x010C0026, 0x010C0027, 0x010C0028, 0x010C0029)),
    ("8", 8, BYTES, (0x01080008, 0x01080009, 0x0108000A, 0x0108000B)),
)

#: In the order in which they are chosen: the most bits first, then the fewest bytes.
FORMATS: tuple[PixelFormat, ...] = (
    PixelFormat("Mono16", 0x01100007, 16, WORDS),
    PixelFormat("Mono14p", 0x010E0104, 14, BIT_STREAM),
    PixelFormat("Mono14", 0x01100025, 14, WORDS),
    PixelFormat("Mono12p", 0x010C0047, 12, BIT_STREAM),
    PixelFormat("Mono12Packed", 0x010C0006, 12, TWO_IN_THREE),
    PixelFormat("Mono12", 0x01100005, 12, WORDS),
    PixelFormat("Mono10p", 0x010A0046, 10, BIT_STREAM),
    PixelFormat("Mono10Packed", 0x010C0004, 10, TWO_IN_THREE),
    PixelFormat("Mono10", 0x01100003, 10, WORDS),
    *(
        PixelFormat(f"Bayer{letters}{suffix}", code, bits, packing, layout)
        for suffix, bits, packing, codes in _BAYER
        for (letters, layout), code in zip(_PATTERNS.items(), codes, strict=True)
    ),
    PixelFormat("RGB16", 0x02300033, 16, WORDS, Layout.RGB),
    PixelFormat("RGB12", 0x0230001A, 12, WORDS, Layout.RGB),
    PixelFormat("BGR12", 0x0230001B, 12, WORDS, Layout.RGB, is_reversed=True),
    PixelFormat("RGB10", 0x02300018, 10, WORDS, Layout.RGB),
    PixelFormat("BGR10", 0x02300019, 10, WORDS, Layout.RGB, is_reversed=True),
    PixelFormat("Mono8", 0x01080001, 8, BYTES),
    PixelFormat("RGB8", 0x02180014, 8, BYTES, Layout.RGB),
    PixelFormat("BGR8", 0x02180015, 8, BYTES, Layout.RGB, is_reversed=True),
)


def choose_format(offered: Sequence[str], name: str, device: str) -> PixelFormat:
    """Return the requested pixel format if it is offered, or the one with the most bits.

    `name` is a name of `FORMATS` in any case, or "auto".

    Raises:
        UsageError: no such format, or the camera does not offer it
        CameraError: the camera offers none that the driver can read
    """
    known = {each.name.lower() for each in FORMATS} | {"auto"}
    if name not in known:
        raise unknown_name("pixel format", name, sorted(known))
    usable = [each for each in FORMATS if each.name in offered]
    if not usable:
        raise CameraError(
            f"{device} offers no pixel format that camctl can read, only {', '.join(offered)}",
            hint="use a camera that offers Mono8, a Bayer format or RGB8",
        )
    for each in usable:
        if name in ("auto", each.name.lower()):
            return each
    raise UsageError(
        f"{device} does not offer the pixel format {name}",
        hint=f"it offers {', '.join(each.name.lower() for each in usable)}",
    )
