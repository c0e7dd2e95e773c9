"""The files of a virtual still camera, read back by independent libraries."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.sim.devices.still_files import RawImage, encode

MOSAICS = [layout for layout in Layout if layout.is_mosaic]


def raw_image(
    layout: Layout = Layout.MONO,
    bits: int = 8,
    *,
    shape: tuple[int, int] = (60, 80),
    black: int = 0,
    white: int | None = None,
    time_s: float = 1 / 60,
) -> RawImage:
    """Return an image of random pixels."""
    full = 2**bits - 1
    size = (*shape, 3) if layout is Layout.RGB else shape
    pixels = np.random.default_rng(3).integers(0, full, size, endpoint=True)
    return RawImage(
        narrowed(pixels, bits), layout, bits, black, full if white is None else white, time_s
    )


def narrowed(pixels: NDArray[Any], bits: int) -> Pixels:
    """Return pixels in the type that holds `bits` bits."""
    return pixels.astype(np.uint8) if bits <= 8 else pixels.astype(np.uint16)


def decode_jpeg(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert picture is not None
    return picture


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("layout", [Layout.MONO, *MOSAICS])
def test_libraw_reads_pixels_levels_and_layout_of_a_dng(layout: Layout, bits: int) -> None:
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed: pip install camctl[raw]")
    image = raw_image(layout, bits, black=7, white=2**bits - 3)
    with rawpy.imread(io.BytesIO(encode("dng", image))) as raw:
        assert np.array_equal(raw.raw_image, image.pixels)
        assert raw.raw_image.shape == image.pixels.shape
        assert set(raw.black_level_per_channel) == {7}
        assert raw.white_level == 2**bits - 3
        if layout.is_mosaic:
            letters = "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.reshape(-1))
            assert letters.lower() == layout.value
        else:
            assert raw.num_colors == 1


def test_a_dng_states_its_exposure_time() -> None:
    with tifffile.TiffFile(io.BytesIO(encode("dng", raw_image(time_s=1 / 8000)))) as file:
        assert file.pages.first.tags["ExposureTime"].value == (1, 8000)


def test_a_dng_of_an_rgb_sensor_is_refused() -> None:
    with pytest.raises(UsageError, match="an RGB sensor has no raw file; use jpeg or tiff"):
        encode("dng", raw_image(Layout.RGB))


@pytest.mark.parametrize(
    ("layout", "grey", "shape"),
    [
        (Layout.MONO, True, (60, 80)),
        (Layout.MONO, False, (60, 80, 3)),
        (Layout.RGB, True, (60, 80, 3)),
    ],
)
@pytest.mark.parametrize("bits", [8, 12])
def test_a_tiff_is_lossless(layout: Layout, grey: bool, shape: tuple[int, ...], bits: int) -> None:
    image = raw_image(layout, bits, black=2, white=200)
    data = encode("tiff", image, grey=grey)
    picture = tifffile.imread(io.BytesIO(data))
    assert picture.shape == shape
    assert picture.dtype == image.pixels.dtype
    if picture.ndim == image.pixels.ndim:
        assert np.array_equal(picture, image.pixels)
    else:
        assert all(np.array_equal(picture[..., channel], image.pixels) for channel in range(3))
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tags = file.pages.first.tags
        samples = picture.ndim
        assert tags["MaxSampleValue"].value == (200 if samples == 2 else (200,) * 3)
        assert tags["MinSampleValue"].value == (2 if samples == 2 else (2,) * 3)
        assert tags["Compression"].value == 1


def test_a_tiff_of_a_mosaic_is_demosaiced() -> None:
    red = np.zeros((60, 80), np.uint8)
    red[0::2, 1::2] = 200  # the red pixels of GRBG
    image = RawImage(red, Layout.GRBG, 8, 0, 255, 0.1)
    picture = tifffile.imread(io.BytesIO(encode("tiff", image)))
    inside = picture[4:-4, 4:-4]
    assert inside[..., 0].min() == 200
    assert inside[..., 1:].max() == 0


@pytest.mark.parametrize("bits", [8, 12])
def test_a_jpeg_holds_the_upper_eight_bits(bits: int) -> None:
    ramp = np.tile(np.linspace(0, 2**bits - 1, 80), (60, 1))
    pixels = narrowed(ramp, bits)
    image = RawImage(pixels, Layout.MONO, bits, 0, 2**bits - 1, 0.1)
    picture = decode_jpeg(encode("jpeg", image, quality=100))
    assert picture.shape == (60, 80)
    assert np.abs(picture.astype(int) - (pixels >> (bits - 8)).astype(int)).max() <= 2


def test_the_channels_of_a_jpeg_are_in_order() -> None:
    pixels = np.zeros((32, 32, 3), np.uint8)
    pixels[..., 0] = 255
    data = encode("jpeg", RawImage(pixels, Layout.RGB, 8, 0, 255, 0.1))
    blue, _, red = decode_jpeg(data, cv2.IMREAD_COLOR)[16, 16]
    assert red > 240
    assert blue < 15


def test_an_unknown_file_format_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown file format 'png'"):
        encode("png", raw_image())
