"""Files of still cameras: valid ones are read exactly, damaged ones rejected."""

from __future__ import annotations

import io
import resource
import struct
import subprocess
import sys
import zlib
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.errors import CameraProtocolError, UsageError
from camctl.interface.controls import Layout
from camctl.stills.decoding import MAX_PIXELS, read_still
from camctl.stills.separate import read_apart

Image = NDArray[np.uint8] | NDArray[np.uint16]

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


def coded(suffix: str, image: Image, *options: int) -> bytes:
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    return cv2.imencode(suffix, bgr, list(options))[1].tobytes()


def tiff(image: Image, **options: Any) -> bytes:
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, image, metadata=None, **options)
    return buffer.getvalue()


def dng(
    samples: Image,
    pattern: Sequence[int] = (0, 1, 1, 2),
    blacks: Sequence[int] = (64, 64, 64, 64),
    white: int = 4000,
) -> bytes:
    """Return the smallest DNG 1.4 that LibRaw accepts; blacks are row by row of the pattern."""
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


RGBA8 = np.dstack((RGB8, np.full(RGB8.shape[:2], 255, np.uint8)))
RGBA8[:3, :5, 3] = 100

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
        ("lzw.tif", coded(".tif", RGB8), RGB8),
        ("tiles.tif", tiff(RGB8, photometric="rgb", tile=(16, 16), compression="zlib"), RGB8),
        ("planes.tif", tiff(RGB8.transpose(2, 0, 1), photometric="rgb", planarconfig=2), RGB8),
        ("big.tif", tiff(GREY8, byteorder=">"), GREY8),
    ],
)
def test_lossless_files_are_read_sample_for_sample(name: str, data: bytes, image: Image) -> None:
    still = read_still(data, name)
    assert np.array_equal(still.pixels, image)
    assert still.pixels.dtype == image.dtype
    assert still.layout is (Layout.RGB if image.ndim == 3 else Layout.MONO)
    assert (still.bits, still.black) == (8 * image.dtype.itemsize, 0)
    assert still.white == 2**still.bits - 1


@pytest.mark.parametrize("name", ["a.jpg", "p.jpg"])
def test_the_channels_of_a_jpeg_are_red_green_blue(name: str) -> None:
    still = read_still(FILES[name], name)
    assert still.layout is Layout.RGB
    assert np.abs(still.pixels.astype(int) - RGB8).mean() < 12
    assert still.pixels[4, 4].argmax() == RGB8[4, 4].argmax()


def test_a_jpeg_has_the_same_samples_without_a_newer_opencv(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = read_still(FILES["a.jpg"], "a.jpg").pixels
    monkeypatch.delattr(cv2, "IMREAD_COLOR_RGB", raising=False)  # before 4.11
    assert np.array_equal(read_still(FILES["a.jpg"], "a.jpg").pixels, here)


def test_zeros_after_the_end_of_a_jpeg_are_ignored() -> None:
    still = read_still(FILES["g.jpg"] + bytes(10_000), "g.jpg")
    assert still.layout is Layout.MONO
    assert np.array_equal(still.pixels, read_still(FILES["g.jpg"], "g.jpg").pixels)


@pytest.mark.parametrize(("pattern", "layout"), PATTERNS.items())
def test_raw_samples_are_unchanged(pattern: tuple[int, ...], layout: Layout) -> None:
    still = read_still(dng(RAW12, pattern), "IMG.DNG")
    assert still.layout is layout
    assert np.array_equal(still.pixels, RAW12)
    assert (still.bits, still.black, still.white) == (12, 64, 4000)
    assert still.notes == ()


def test_different_black_levels_are_raised_to_one_and_noted() -> None:
    samples = np.full((24, 32), 200, np.uint16)
    still = read_still(dng(samples, blacks=(60, 64, 62, 66)), "IMG.DNG")
    assert still.black == 66
    dark = [[still.pixels[r, c] - 66 for c in (0, 1)] for r in (0, 1)]
    assert dark == [[140, 136], [138, 134]]  # light above each colour's own black
    assert still.notes == (
        "the black levels of the colours differ (60, 64, 66, 62): all samples were raised to black "
        "level 66",
    )


def test_raising_the_black_level_keeps_saturated_samples() -> None:
    samples = np.full((24, 32), 4095, np.uint16)
    still = read_still(dng(samples, blacks=(60, 64, 62, 66)), "IMG.DNG")
    assert (still.pixels == 4095).all()


def test_raw_without_rawpy_is_an_error_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(UsageError, match=r"pip install 'camctl\[raw\]'"):
        read_still(FILES["a.dng"], "a.dng")


def test_a_wrong_checksum_is_named_with_its_chunk() -> None:
    data = bytearray(FILES["a.png"])
    data[data.index(b"IDAT") + 8] ^= 1
    with pytest.raises(CameraProtocolError, match="the checksum of its chunk IDAT is wrong"):
        read_still(bytes(data), "a.png")


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_short_is_rejected(name: str) -> None:
    data = FILES[name]
    for share in np.linspace(0, 0.97, 40):
        with pytest.raises(CameraProtocolError, match="shoot it again"):
            read_still(data[: int(share * len(data))], name)


@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
def test_a_damaged_file_is_read_or_rejected(name: str, data: st.DataObject) -> None:
    damaged = bytearray(FILES[name])
    # Half of the time only the headers are damaged, where damage has the largest effects.
    reach = len(damaged) if data.draw(st.booleans()) else min(600, len(damaged))
    for _ in range(data.draw(st.integers(1, 6))):
        damaged[data.draw(st.integers(0, reach - 1))] = data.draw(st.integers(0, 255))
    with suppress(CameraProtocolError, UsageError):
        still = read_still(bytes(damaged), name)
        assert still.pixels.max() < 2**still.bits
        assert 0 <= still.black < still.white < 2**still.bits


@given(data=st.binary(max_size=300), suffix=st.sampled_from([".jpg", ".tif", ".nef", ""]))
@settings(max_examples=150)
def test_arbitrary_bytes_are_rejected(data: bytes, suffix: str) -> None:
    with pytest.raises((CameraProtocolError, UsageError)):
        read_still(data, "IMG" + suffix)


def png_of_size(columns: int, rows: int) -> bytes:
    head = struct.pack(">IIBBBBB", columns, rows, 16, 2, 0, 0, 0)

    def chunk(kind: bytes, body: bytes) -> bytes:
        check = zlib.crc32(kind + body)
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", check)

    idat = chunk(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + idat + chunk(b"IEND", b"")


def jpeg_of_size(columns: int, rows: int) -> bytes:
    data = bytearray(FILES["a.jpg"])
    at = data.index(b"\xff\xc0")
    struct.pack_into(">HH", data, at + 5, rows, columns)
    return bytes(data)


def tiff_of_size(columns: int, rows: int) -> bytes:
    data = bytearray(FILES["z.tif"])
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tags = file.pages.first.tags
        for code, value in ((256, columns), (257, rows)):
            struct.pack_into("<HII", data, tags[code].offset + 2, 4, 1, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("bomb.png", png_of_size(60000, 60000)),
        ("bomb.jpg", jpeg_of_size(65000, 65000)),
        ("bomb.tif", tiff_of_size(2**15, 2**15)),
        ("tall.tif", tiff_of_size(1, 2**31)),
    ],
)
def test_a_size_that_the_file_cannot_hold_allocates_no_memory(name: str, data: bytes) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CameraProtocolError, match=r"pixels in|ends too early"):
        read_still(data, name)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
    assert MAX_PIXELS < 2**30


def test_listing_cameras_imports_neither_opencv_nor_tifffile() -> None:
    code = (
        "import sys, drivers.ptp.backend, drivers.coolpix.backend\n"
        "print(sorted({'cv2', 'tifffile', 'rawpy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["a.png", "a.tif", "apart.png"])
def test_an_alpha_channel_says_what_is_not_valid(name: str) -> None:
    if name.endswith(".png"):
        data = cv2.imencode(".png", cv2.cvtColor(RGBA8, cv2.COLOR_RGBA2BGRA))[1].tobytes()
    else:
        data = tiff(RGBA8, photometric="rgb", extrasamples=["unassalpha"], compression="zlib")
    still = (read_apart if name.startswith("apart") else read_still)(data, name)
    assert np.array_equal(still.pixels, RGB8)
    assert still.invalid is not None
    assert np.array_equal(still.invalid, RGBA8[..., 3] < 255)


def test_an_opaque_alpha_channel_leaves_all_valid() -> None:
    opaque = np.dstack((RGB8, np.full(RGB8.shape[:2], 255, np.uint8)))
    still = read_still(tiff(opaque, photometric="rgb", extrasamples=["unassalpha"]), "a.tif")
    assert np.array_equal(still.pixels, RGB8)
    assert still.invalid is None


def test_heif_pictures_are_refused_with_what_to_do() -> None:
    with pytest.raises(UsageError) as raised:
        read_still(bytes(3) + b"\x18ftypheic" + bytes(100), "IMG_1.HEIC")
    assert "HEIF" in raised.value.what
    assert "TIFF" in raised.value.hint


@pytest.mark.parametrize(
    "begin",
    [
        bytes(3) + b"\x20ftypisom",
        bytes(3) + b"\x14ftypqt  ",
        b"RIFF" + bytes(4) + b"AVI LIST",
        b"\x1a\x45\xdf\xa3" + bytes(8),
    ],
    ids=["MP4", "QuickTime", "AVI", "Matroska"],
)
def test_a_video_is_called_one_and_what_to_do_is_said(begin: bytes) -> None:
    with pytest.raises(UsageError) as raised:
        read_still(begin + bytes(100), "VID_1.mp4")
    assert "video" in raised.value.what
    assert "photographs of several exposures" in raised.value.hint


@pytest.mark.parametrize("kind", ["WebP", "GIF", "BMP"])
def test_intact_pictures_of_other_formats_are_not_called_damaged(kind: str) -> None:
    data = b"GIF89a" + bytes(100)
    if kind != "GIF":
        data = cv2.imencode(f".{kind.lower()}", RGB8)[1].tobytes()
    with pytest.raises(UsageError) as raised:
        read_still(data, "a.jpg")
    assert kind in raised.value.what
    assert "convert" in raised.value.hint


def test_four_inks_are_named() -> None:
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 20, 8, 16, 16, 4) + bytes(12)
    with pytest.raises(UsageError) as raised:
        read_still(b"\xff\xd8" + frame + b"\xff\xd9", "print.jpg")
    assert "CMYK" in raised.value.what
    assert "RGB" in raised.value.hint


@pytest.mark.parametrize(
    ("samples", "photometric", "kind"),
    [
        (np.zeros((4, 6), np.float32), "minisblack", "a TIFF of 32 bits a sample"),
        (np.zeros((4, 6), np.uint8), "miniswhite", r"a TIFF of .* 0 \(miniswhite\)"),
        (np.zeros((4, 6, 4), np.uint8), "separated", r"a TIFF of .* 5 \(separated\)"),
    ],
)
def test_a_sound_tiff_of_another_kind_is_not_called_damaged(
    samples: NDArray[Any], photometric: str, kind: str
) -> None:
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, samples, photometric=photometric)
    with pytest.raises(UsageError, match=f"a.tif is {kind}, which is not read; convert it"):
        read_still(buffer.getvalue(), "a.tif")
