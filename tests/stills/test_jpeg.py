"""Damaged JPEG files are refused with the place, and files as cameras write them are not."""

from __future__ import annotations

import os
import re
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.errors import CameraProtocolError
from camctl.evidence.lost_detail import _EXAMPLE
from camctl.stills.decoding import read_still
from camctl.stills.jpeg import JpegStructure
from camctl.stills.separate import read_apart
from camctl.system.library_output import with_messages

ROWS, COLUMNS = 160, 208


def picture() -> NDArray[np.uint8]:
    rng = np.random.default_rng(8)
    coarse = rng.integers(0, 256, (10, 13, 3)).astype(np.uint8)
    smooth = cv2.resize(coarse, (COLUMNS, ROWS), interpolation=cv2.INTER_LINEAR)
    noisy = smooth + rng.normal(0, 4, smooth.shape)
    return np.asarray(np.clip(noisy, 0, 255), np.uint8)


PICTURE = picture()
PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTARTS = (cv2.IMWRITE_JPEG_RST_INTERVAL, 5)


def coded(*options: int, quality: int = 92) -> bytes:
    """Return a JPEG, 4:2:0, of the picture."""
    options = (cv2.IMWRITE_JPEG_QUALITY, quality, *options)
    return cv2.imencode(".jpg", PICTURE, list(options))[1].tobytes()


def cut(data: bytes, at: int) -> bytes:
    return data[:at]


def cut_with_an_end(data: bytes, at: int) -> bytes:
    return data[:at] + b"\xff\xd9"


def without_some(data: bytes, at: int) -> bytes:
    return data[:at] + data[at + 300 :]


def ending_in_zeros(data: bytes, at: int) -> bytes:
    return data[:at] + bytes(len(data) - at - 2) + data[-2:]


@pytest.mark.parametrize("options", [(), RESTARTS, PROGRESSIVE])
@pytest.mark.parametrize("share", [0.3, 0.6])
@pytest.mark.parametrize("damage", [cut, cut_with_an_end, without_some, ending_in_zeros])
def test_damaged_data_are_refused(
    damage: Callable[[bytes, int], bytes], share: float, options: tuple[int, ...]
) -> None:
    data = coded(*options)
    with pytest.raises(CameraProtocolError, match=r"a\.jpg cannot be read: it") as error:
        read_still(damage(data, int(share * len(data))), "a.jpg")
    if options == PROGRESSIVE or damage is ending_in_zeros:
        return
    # The place is where the first row of units with other pixels is, or below it.
    (row,) = map(int, re.findall(r"row (\d+) of 160", str(error.value)))
    assert row >= ROWS * (share - 0.15)
    if damage in (cut, cut_with_an_end) or options == RESTARTS:
        assert row <= ROWS * (share + 0.15) + 16


@pytest.mark.parametrize("quality", [10, 50, 95, 100])
@pytest.mark.parametrize("options", [(), RESTARTS, PROGRESSIVE, (cv2.IMWRITE_JPEG_OPTIMIZE, 1)])
def test_files_as_cameras_write_them_are_read(options: tuple[int, ...], quality: int) -> None:
    data = coded(*options, quality=quality)
    end, header = data[-2:], data[:2]
    segment = b"\xff\xe1" + (len(data) + 2).to_bytes(2) + data if len(data) < 60_000 else b""
    for variant in (
        data,
        data + data,  # a second picture
        data + bytes(4096),
        data + b"\xff\xe1 something else",
        header + segment + data[2:],  # a thumbnail
        header + b"\xff\xff" + data[2:],
        data[:-2] + bytes(500) + end,  # filled up
        data[:-2] + b"\xff" * 9 + end,
        data[:20] + bytes(2) + data[20:],  # bytes between segments
    ):
        still = read_still(variant, "a.jpg")
        assert still.notes == ()
        assert still.pixels.shape == (ROWS, COLUMNS, 3)


@pytest.mark.parametrize("kind", ["420", "422", "440", "411", "444"])
def test_files_state_whether_they_have_few_samples_of_colours(kind: str) -> None:
    factor = getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{kind}")
    data = coded(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor)
    for read in (read_still, read_apart):
        assert read(data, "a.jpg").few_chroma_samples is (kind != "444")
    grey = cv2.imencode(".jpg", PICTURE[..., 1])[1].tobytes()
    assert not read_still(grey, "a.jpg").few_chroma_samples


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_files_state_the_steps_of_brightness(options: tuple[int, ...]) -> None:
    structure = JpegStructure.of(coded(*options, quality=50))
    example = np.ravel(_EXAMPLE)  # quality 50 is the table of the standard itself
    assert structure.brightness_steps == tuple(example.tolist())
    coarser = JpegStructure.of(coded(*options, quality=25))
    assert coarser.brightness_steps == tuple((2 * example).clip(1, 255).tolist())
    assert JpegStructure().brightness_steps == ()


def test_zeros_in_place_of_data_are_refused_with_their_row() -> None:
    data = coded()
    at = len(data) // 2
    zeroed = data[:at] + bytes(512) + data[at + 512 :]
    with pytest.raises(CameraProtocolError, match=r"from row (64|80|96) of 160 on are damaged"):
        read_still(zeroed, "a.jpg")
    # Optimal tables may code what is white everywhere as zeros.
    white = np.full((1024, 1024, 3), 255, np.uint8)
    flat = cv2.imencode(".jpg", white, [cv2.IMWRITE_JPEG_OPTIMIZE, 1])[1].tobytes()
    assert bytes(100) in flat
    assert (read_still(flat, "a.jpg").pixels == 255).all()


def test_bytes_after_the_last_row_are_noted() -> None:
    data = coded()
    still = read_still(data[:-2] + bytes(range(1, 200)) + data[-2:], "a.jpg")
    (note,) = still.notes
    assert "bytes remain after the last row: the file is damaged, or the camera" in note


def test_what_a_library_prints_is_collected() -> None:
    assert with_messages(lambda: os.write(2, b"a line")) == (6, "a line")
    assert with_messages(lambda: 1) == (1, "")


def test_a_file_without_picture_data_is_refused() -> None:
    headless = coded().replace(b"\xff\xda", b"\xff\xe1", 1)
    with pytest.raises(CameraProtocolError, match=r"p\.jpg cannot be read: "):
        read_still(headless, "p.jpg")
