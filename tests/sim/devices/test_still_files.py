"""What a virtual still camera writes is what its sensor said, read back by other programs' code."""

import io

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.controls import Layout
from camctl.errors import UsageError
from sim.devices.still_files import Exposed, encode, thumbnail

MOSAICS = [layout for layout in Layout if layout.is_mosaic]


def exposed(layout=Layout.MONO, bits=8, *, shape=(60, 80), black=0, white=None, time_s=1 / 60):
    full = 2**bits - 1
    size = (*shape, 3) if layout is Layout.RGB else shape
    pixels = np.random.default_rng(3).integers(0, full, size, endpoint=True)
    pixels = pixels.astype(np.uint8 if bits <= 8 else np.uint16)
    return Exposed(pixels, layout, bits, black, full if white is None else white, time_s)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("layout", [Layout.MONO, *MOSAICS])
def test_libraw_reads_the_sensors_numbers_from_a_dng(layout, bits):
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed: pip install camctl[raw]")
    shot = exposed(layout, bits, black=7, white=2**bits - 3)
    with rawpy.imread(io.BytesIO(encode("dng", shot))) as raw:
        assert np.array_equal(raw.raw_image, shot.pixels)
        assert raw.raw_image.shape == shot.pixels.shape
        assert set(raw.black_level_per_channel) == {7}
        assert raw.white_level == 2**bits - 3
        if layout.is_mosaic:
            letters = "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.reshape(-1))
            assert letters.lower() == layout.value
        else:
            assert raw.num_colors == 1


def test_a_dng_says_how_long_it_was_exposed():
    with tifffile.TiffFile(io.BytesIO(encode("dng", exposed(time_s=1 / 8000)))) as file:
        assert file.pages.first.tags["ExposureTime"].value == (1, 8000)


def test_no_raw_file_of_an_rgb_sensor():
    with pytest.raises(UsageError, match="raw file of an RGB sensor"):
        encode("dng", exposed(Layout.RGB))


@pytest.mark.parametrize(
    ("layout", "grey", "shape"),
    [
        (Layout.MONO, True, (60, 80)),
        (Layout.MONO, False, (60, 80, 3)),
        (Layout.RGB, True, (60, 80, 3)),
    ],
)
@pytest.mark.parametrize("bits", [8, 12])
def test_a_tiff_is_lossless(layout, grey, shape, bits):
    shot = exposed(layout, bits, black=2, white=200)
    data = encode("tiff", shot, grey=grey)
    picture = tifffile.imread(io.BytesIO(data))
    assert picture.shape == shape
    assert picture.dtype == shot.pixels.dtype
    same = picture if picture.ndim == shot.pixels.ndim else picture[..., 1]
    assert np.array_equal(same, shot.pixels)
    if picture.ndim > shot.pixels.ndim:
        assert np.array_equal(picture[..., 0], picture[..., 2])
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tags = file.pages.first.tags
        assert tags["MaxSampleValue"].value in (200, (200,) * 3)
        assert tags["Compression"].value == 1


def test_a_tiff_of_a_mosaic_is_in_colour_and_keeps_an_even_field():
    shot = exposed(Layout.GRBG)
    red = np.zeros_like(shot.pixels)
    red[0::2, 1::2] = 200  # the red places of GRBG
    picture = tifffile.imread(io.BytesIO(encode("tiff", Exposed(red, Layout.GRBG, 8, 0, 255, 0.1))))
    inside = picture[4:-4, 4:-4]
    assert inside[..., 0].min() == 200
    assert inside[..., 1:].max() == 0


@pytest.mark.parametrize("bits", [8, 12])
def test_a_jpeg_is_near_in_eight_bits(bits):
    ramp = np.tile(np.linspace(0, 2**bits - 1, 80), (60, 1))
    pixels = ramp.astype(np.uint8 if bits == 8 else np.uint16)
    data = encode("jpeg", Exposed(pixels, Layout.MONO, bits, 0, 2**bits - 1, 0.1), quality=100)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (60, 80)
    assert np.abs(picture.astype(int) - (pixels >> (bits - 8)).astype(int)).max() <= 2


def test_colours_of_a_jpeg_are_the_right_way_round():
    pixels = np.zeros((32, 32, 3), np.uint8)
    pixels[..., 0] = 255
    data = encode("jpeg", Exposed(pixels, Layout.RGB, 8, 0, 255, 0.1))
    blue, _, red = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[16, 16]
    assert red > 240
    assert blue < 15


@given(st.floats(1e-6, 100))
@settings(max_examples=50)
def test_a_jpeg_says_how_long_it_was_exposed(time_s):
    data = encode("jpeg", exposed(time_s=time_s, shape=(8, 8)))
    assert data[2:4] == b"\xff\xe1"
    length = int.from_bytes(data[4:6], "big")
    assert data[6:12] == b"Exif\0\0"
    # What follows is a TIFF file without a picture: its EXIF directory has the time.
    tiff = data[12 : 4 + length]
    entry = int.from_bytes(tiff[18:22], "little")
    tag, kind = (int.from_bytes(tiff[entry + i : entry + i + 2], "little") for i in (2, 4))
    assert (tag, kind) == (33434, 5)
    place = int.from_bytes(tiff[entry + 10 : entry + 14], "little")
    above, below = (int.from_bytes(tiff[place + i : place + i + 4], "little") for i in (0, 4))
    assert above / below == pytest.approx(time_s, rel=1e-3)


def test_a_thumbnail_is_small():
    picture = cv2.imdecode(np.frombuffer(thumbnail(exposed(shape=(480, 640))), np.uint8), 1)
    assert picture.shape == (120, 160, 3)


def test_an_unknown_kind_of_file():
    with pytest.raises(UsageError, match="unknown kind of file 'png'"):
        encode("png", exposed())
