"""Raw formats of libcamera, packed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.drivers.libcamera.formats import RawFormat
from camctl.interface.controls import Layout


@pytest.mark.parametrize(
    ("name", "layout", "bits", "is_packed"),
    [
        ("SRGGB10", Layout.RGGB, 10, False),
        ("SBGGR12_CSI2P", Layout.BGGR, 12, True),
        ("SGRBG16", Layout.GRBG, 16, False),
        ("R12", Layout.MONO, 12, False),
        ("R8_CSI2P", Layout.MONO, 8, False),
    ],
)
def test_names_say_how_samples_are_stored(
    name: str, layout: Layout, bits: int, *, is_packed: bool
) -> None:
    assert RawFormat.parse(name) == RawFormat(name, layout, bits, is_packed)


@pytest.mark.parametrize("name", ["BGGR_PISP_COMP1", "YUV420", "XBGR8888", "SRGGB11", ""])
def test_other_formats_are_not_raw(name: str) -> None:
    assert RawFormat.parse(name) is None


@pytest.mark.parametrize(
    ("name", "shift", "line", "samples"),
    [
        # By the tables of MIPI CSI-2, RAW10 and RAW12: upper bits of each sample, then the lower.
        ("SRGGB10_CSI2P", 0, [0x80, 0x40, 0xFF, 0x00, 0b10_11_01_00], [512, 257, 1023, 2]),
        ("SRGGB12_CSI2P", 0, [0x80, 0x40, 0xA5, 0xFF, 0x00, 0x0F], [2053, 1034, 4095, 0]),
        (
            "SGBRG14_CSI2P",
            0,
            [0x80, 0x40, 0xFF, 0x00, 0b01_000011, 0b1111_0000, 0b000010_11],
            [0x80 << 6 | 3, 0x40 << 6 | 1, 0xFF << 6 | 0x3F, 2],
        ),
        ("SRGGB10", 0, [0x01, 0x02, 0xFF, 0x03], [513, 1023]),
        ("SRGGB16", 4, [0x50, 0x12, 0xF0, 0xFF], [0x125, 4095]),
        ("R8", 0, [7, 255], [7, 255]),
    ],
)
def test_samples_are_read_from_padded_lines(
    name: str, shift: int, line: list[int], samples: list[int]
) -> None:
    found = RawFormat.parse(name)
    assert found is not None
    data = np.array([line + [99] * 5] * 2, np.uint8)
    pixels = found.samples(data, (2, len(samples)), shift)
    assert pixels.tolist() == [samples, samples]
    assert pixels.dtype == (np.uint8 if found.bits == 8 else np.uint16)
    data[:] = 0
    assert pixels.any()  # a copy
