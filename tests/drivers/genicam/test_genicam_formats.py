"""Pixel formats: samples that the virtual camera packs are unpacked by the driver."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.drivers.genicam.formats import FORMATS, PixelFormat, choose_format
from camctl.drivers.genicam.port import Received
from camctl.errors import CameraError, UsageError
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.sim.devices.gige.features import formats
from camctl.sim.devices.gige.stream import pack, payload_bytes

SHAPE = (6, 8)
BY_NAME = {each.name: each for each in FORMATS}
PACKED = [
    (layout, bits, name)
    for layout in Layout
    for bits in (8, 10, 12, 14, 16)
    for name, form in formats(layout, bits).items()
    if form.bits == min(bits, 8 if layout is Layout.RGB else bits)
]


def received(data: bytes, padding: int = 0) -> Received:
    return Received(np.frombuffer(data, np.uint8), SHAPE, 0, padding, 1, 0.0, 0.0, True)


@pytest.mark.parametrize(("layout", "bits", "name"), PACKED)
def test_what_the_virtual_camera_packs_is_read_back(layout: Layout, bits: int, name: str) -> None:
    form = formats(layout, bits)[name]
    known = BY_NAME[name]
    assert (known.code, known.bits, known.layout) == (form.code, form.bits, layout)
    shape = (*SHAPE, 3) if layout is Layout.RGB else SHAPE
    random = np.random.Generator(np.random.PCG64(1))
    depth = min(bits, 8) if layout is Layout.RGB else bits
    drawn = random.integers(0, 2**depth, shape)
    pixels: Pixels = drawn.astype(np.uint8) if depth <= 8 else drawn.astype(np.uint16)
    data = pack(pixels, form, depth)
    assert len(data) == payload_bytes(SHAPE, form, 0)
    samples = known.samples(received(data))
    assert samples is not None
    assert samples.dtype == pixels.dtype
    np.testing.assert_array_equal(samples, pixels)
    assert known.samples(received(data[:-1])) is None


def test_published_bytes() -> None:
    """Examples as the PFNC draws them: the first sample is 0x123, the second 0xABC."""
    expected = [0x123, 0xABC]
    for name, data in (
        ("Mono12", b"\x23\x01\xbc\x0a"),
        ("Mono12p", b"\x23\xc1\xab"),
        ("Mono12Packed", b"\x12\xc3\xab"),
    ):
        form = BY_NAME[name]
        one = Received(np.frombuffer(data, np.uint8), (1, 2), form.code, 0, 1, 0.0, 0.0, True)
        samples = form.samples(one)
        assert samples is not None
        assert samples.tolist() == [expected]


def test_line_padding_is_left_out() -> None:
    lines = np.arange(48, dtype=np.uint8).reshape(SHAPE)
    padded = np.hstack([lines, np.full((6, 4), 255, np.uint8)])
    samples = BY_NAME["Mono8"].samples(received(padded.tobytes(), padding=4))
    assert samples is not None
    np.testing.assert_array_equal(samples, lines)


def test_codes_are_unique_and_state_their_storage() -> None:
    assert len({each.code for each in FORMATS}) == len(FORMATS)
    for each in FORMATS:
        colours = 3 if each.layout is Layout.RGB else 1
        # Bits of a pixel are the second byte of its number (PFNC 2.4, section 2).
        assert each.code >> 16 & 0xFF == colours * each.packing.storage_bits(each.bits)


def test_choice() -> None:
    def chosen(offered: list[str], name: str = "auto") -> PixelFormat:
        return choose_format(offered, name, "camera")

    assert chosen(["Mono8", "Mono12", "Mono12p"]).name == "Mono12p"
    assert chosen(["Mono8", "Mono12"], "mono8").name == "Mono8"
    for offered, name in ((["Mono8"], "mono12"), (["Mono8"], "mono99")):
        with pytest.raises(UsageError):
            chosen(offered, name)
    with pytest.raises(CameraError):
        chosen(["Coord3D_ABC32f"])
