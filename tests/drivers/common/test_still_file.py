"""Still cameras' files: right ones are read exactly, damaged ones refused, at once."""

import io
import resource
import struct
import sys
import zlib
from contextlib import suppress

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.controls import Layout
from camctl.errors import CameraProtocolError, UsageError
from drivers.common.still_file import MAX_PIXELS, read_still

RNG = np.random.default_rng(5)
GREY8 = RNG.integers(0, 256, (24, 32), np.uint8)
RGB8 = np.repeat(np.repeat(RNG.integers(0, 256, (3, 4, 3), np.uint8), 8, 0), 8, 1)
GREY16 = RNG.integers(0, 65536, (24, 32), np.uint16)
RGB16 = RNG.integers(0, 65536, (24, 32, 3), np.uint16)
RAW12 = RNG.integers(60, 4096, (24, 32), np.uint16)
PATTERNS = {
    (0, 1, 1, 2): Layout.RGGB,
    (1, 0, 2, 1): Layout.GRBG,
    (1, 2, 0, 1): Layout.GBRG,
    (2, 1, 1, 0): Layout.BGGR,
}


def coded(suffix, image, *options):
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    return cv2.imencode(suffix, bgr, list(options))[1].tobytes()


def tiff(image, **options):
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, image, metadata=None, **options)
    return buffer.getvalue()


def dng(samples, pattern=(0, 1, 1, 2), blacks=(64, 64, 64, 64), white=4000):
    """Return a DNG 1.4 as small as LibRaw takes it; blacks are row by row of the pattern."""
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50708, "s", 0, "Test Camera", True),
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, pattern, True),
        (50713, "H", 2, (2, 2), True),
        (50714, "H", 4, blacks, True),
        (50717, "H", 1, (white,), True),
        (50721, "2i", 9, identity, True),
        (50778, "H", 1, 21, True),
    ]
    return tiff(samples, photometric=32803, extratags=tags)


FILES = {
    "a.jpg": coded(".jpg", RGB8, cv2.IMWRITE_JPEG_QUALITY, 95),
    "p.jpg": coded(".jpg", RGB8, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "g.jpg": coded(".jpg", GREY8),
    "a.png": coded(".png", RGB16),
    "a.tif": tiff(RGB16, photometric="rgb"),
    "z.tif": tiff(GREY16, compression="zlib", rowsperstrip=4),
    "a.dng": dng(RAW12),
}


@pytest.mark.parametrize(
    ("name", "data", "image"),
    [
        ("a.png", FILES["a.png"], RGB16),
        ("g.png", coded(".png", GREY8), GREY8),
        ("a.tif", FILES["a.tif"], RGB16),
        ("g.tif", tiff(GREY16), GREY16),
        ("z.tif", FILES["z.tif"], GREY16),
        ("planes.tif", tiff(RGB8.transpose(2, 0, 1), photometric="rgb", planarconfig=2), RGB8),
        ("big.tif", tiff(GREY8, byteorder=">"), GREY8),
    ],
)
def test_lossless_files_are_read_sample_for_sample(name, data, image):
    still = read_still(data, name)
    assert np.array_equal(still.pixels, image)
    assert still.pixels.dtype == image.dtype
    assert still.layout is (Layout.RGB if image.ndim == 3 else Layout.MONO)
    assert (still.bits, still.black) == (8 * image.dtype.itemsize, 0)
    assert still.white == 2**still.bits - 1
    assert not still.is_linear


@pytest.mark.parametrize("name", ["a.jpg", "p.jpg"])
def test_jpegs_are_read_red_green_blue(name):
    still = read_still(FILES[name], name)
    assert still.layout is Layout.RGB
    assert np.abs(still.pixels.astype(int) - RGB8).mean() < 12
    assert still.pixels[4, 4].argmax() == RGB8[4, 4].argmax()


def test_zeros_after_the_end_of_a_jpeg_do_no_harm():
    still = read_still(FILES["g.jpg"] + bytes(10_000), "g.jpg")
    assert still.layout is Layout.MONO
    assert np.array_equal(still.pixels, read_still(FILES["g.jpg"], "g.jpg").pixels)


@pytest.mark.parametrize(("pattern", "layout"), PATTERNS.items())
def test_raw_is_the_mosaic_as_it_came(pattern, layout):
    still = read_still(dng(RAW12, pattern), "IMG.DNG")
    assert still.layout is layout
    assert np.array_equal(still.pixels, RAW12)
    assert (still.bits, still.black, still.white) == (12, 64, 4000)
    assert still.is_linear
    assert still.notes == ()


def test_different_blacks_are_raised_to_one_and_a_note_says_so():
    samples = np.full((24, 32), 200, np.uint16)
    still = read_still(dng(samples, blacks=(60, 64, 62, 66)), "IMG.DNG")
    assert still.black == 66
    dark = [[still.pixels[r, c] - 66 for c in (0, 1)] for r in (0, 1)]
    assert dark == [[140, 136], [138, 134]]  # light above each colour's own black
    assert "60" in still.notes[0]
    assert "66" in still.notes[0]


def test_raising_a_black_does_not_run_over():
    samples = np.full((24, 32), 4095, np.uint16)
    still = read_still(dng(samples, blacks=(60, 64, 62, 66)), "IMG.DNG")
    assert (still.pixels == 4095).all()


def test_raw_without_rawpy_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(UsageError, match=r"pip install 'camctl\[raw\]'"):
        read_still(FILES["a.dng"], "a.dng")


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_short_is_refused(name):
    data = FILES[name]
    for share in np.linspace(0, 0.97, 40):
        with pytest.raises(CameraProtocolError, match="shoot it again"):
            read_still(data[: int(share * len(data))], name)


@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
@settings(max_examples=60)
def test_a_damaged_file_is_read_or_refused(name, data):
    damaged = bytearray(FILES[name])
    # Headers are where damage leads astray.
    reach = len(damaged) if data.draw(st.booleans()) else min(600, len(damaged))
    for _ in range(data.draw(st.integers(1, 6))):
        damaged[data.draw(st.integers(0, reach - 1))] = data.draw(st.integers(0, 255))
    with suppress(CameraProtocolError, UsageError):
        still = read_still(bytes(damaged), name)
        assert still.pixels.max() < 2**still.bits
        assert 0 <= still.black < still.white < 2**still.bits


@given(data=st.binary(max_size=300), suffix=st.sampled_from([".jpg", ".tif", ".nef", ""]))
@settings(max_examples=150)
def test_rubbish_is_refused(data, suffix):
    with pytest.raises(CameraProtocolError):
        read_still(data, "IMG" + suffix)


def png_header(columns, rows):
    head = struct.pack(">IIBBBBB", columns, rows, 16, 2, 0, 0, 0)

    def part(kind, body):
        check = zlib.crc32(kind + body)
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", check)

    idat = part(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + idat + part(b"IEND", b"")


def jpeg_of_size(columns, rows):
    data = bytearray(FILES["a.jpg"])
    at = data.index(b"\xff\xc0")
    struct.pack_into(">HH", data, at + 5, rows, columns)
    return bytes(data)


def tiff_of_size(columns, rows):
    data = bytearray(FILES["z.tif"])
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tags = file.pages.first.tags
        for code, value in ((256, columns), (257, rows)):
            struct.pack_into("<HII", data, tags[code].offset + 2, 4, 1, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("bomb.png", png_header(60000, 60000)),
        ("bomb.jpg", jpeg_of_size(65000, 65000)),
        ("bomb.tif", tiff_of_size(2**15, 2**15)),
        ("tall.tif", tiff_of_size(1, 2**31)),
    ],
)
def test_sizes_that_the_file_cannot_hold_take_no_memory(name, data):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CameraProtocolError, match=r"pixels in|ends too early"):
        read_still(data, name)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
    assert MAX_PIXELS < 2**30
