"""What the files of cameras state of their exposure."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from camctl.interface.controls import Layout
from camctl.sim.devices.still_files import RawImage, encode
from camctl.stills.exif import StatedExposure, stated_exposure

GREY = np.arange(64, dtype=np.uint8).reshape(8, 8)


def file_of(kind: str, time_s: float) -> bytes:
    return encode(kind, RawImage(GREY, Layout.MONO, 8, 0, 255, time_s))


@pytest.mark.parametrize("kind", ["jpeg", "tiff"])
@pytest.mark.parametrize("time_s", [0.001, 0.016666, 0.3, 8.0])
def test_the_time_is_read_from_the_file(kind: str, time_s: float) -> None:
    assert stated_exposure(file_of(kind, time_s)).time_s == pytest.approx(time_s, rel=1e-6)


def test_a_file_without_the_tag_has_no_time() -> None:
    jpeg = file_of("jpeg", 0.5)
    length = int.from_bytes(jpeg[4:6], "big")
    assert stated_exposure(jpeg[:2] + jpeg[4 + length :]).time_s is None


@given(st.sampled_from(["jpeg", "tiff"]), st.integers(0, 200), st.binary(max_size=40))
def test_a_damaged_file_has_a_positive_time_or_none(kind: str, at: int, noise: bytes) -> None:
    data = file_of(kind, 0.5)
    found = stated_exposure(data[:at] + noise + data[at + len(noise) :]).time_s
    assert found is None or 0 < found < float("inf")


_TIME, _SPEED, _F_NUMBER, _APERTURE, _ISO, _FLASH = 33434, 37377, 33437, 37378, 34855, 37385
_STANDARD_OUTPUT, _RECOMMENDED, _ISO_SPEED = 34865, 34866, 34867
_SHORT, _LONG, _RATIONAL, _SIGNED_RATIONAL = 3, 4, 5, 10


def tagged(container: str, tags: dict[tuple[int, int], Any]) -> bytes:
    """Return a file with tags, which are given by number and type."""
    file = io.BytesIO()
    extra = [
        (number, kind, len(value) if kind == _SHORT else 1, value, True)
        for (number, kind), value in tags.items()
    ]
    tifffile.imwrite(file, GREY, photometric="minisblack", metadata=None, extratags=extra)
    exif = file.getvalue()
    if container == "tiff":
        return exif
    coded = cv2.imencode(f".{container}", GREY)[1].tobytes()
    if container == "jpg":
        body = b"Exif\0\0" + exif
        return coded[:2] + struct.pack(">2sH", b"\xff\xe1", len(body) + 2) + body + coded[2:]
    chunk = b"eXIf" + exif
    head = 33  # the signature and the chunk IHDR
    check = struct.pack(">I", zlib.crc32(chunk))
    return coded[:head] + struct.pack(">I", len(exif)) + chunk + check + coded[head:]


@pytest.mark.parametrize("container", ["jpg", "png", "tiff"])
def test_exposures_are_read_from_each_container(container: str) -> None:
    tags = {(_TIME, _RATIONAL): (1, 60), (_F_NUMBER, _RATIONAL): (28, 10), (_ISO, _SHORT): (400,)}
    found = stated_exposure(tagged(container, tags))
    assert found == StatedExposure(1 / 60, 4.0, 2.8)


@pytest.mark.parametrize(
    ("tags", "time_s", "f_number", "gain"),
    [
        (
            {(_SPEED, _SIGNED_RATIONAL): (6, 1), (_APERTURE, _RATIONAL): (5, 1)},
            1 / 64,
            32**0.5,
            None,
        ),
        ({(_SPEED, _SIGNED_RATIONAL): (-49, 10)}, 2**4.9, None, None),
        ({(_TIME, _RATIONAL): (1, 50), (_SPEED, _SIGNED_RATIONAL): (6, 1)}, 1 / 50, None, None),
        ({(_F_NUMBER, _RATIONAL): (0, 1), (_APERTURE, _RATIONAL): (0, 1)}, None, None, None),
        ({(_SPEED, _SIGNED_RATIONAL): (2**31 - 1, 1)}, None, None, None),
        ({(_ISO, _SHORT): (400, 800)}, None, None, 4.0),
        ({(_RECOMMENDED, _LONG): 3200}, None, None, 32.0),
        ({(_STANDARD_OUTPUT, _LONG): 1600}, None, None, 16.0),
        ({(_ISO_SPEED, _LONG): 800}, None, None, 8.0),
        ({(_ISO, _SHORT): (65535,), (_RECOMMENDED, _LONG): 102400}, None, None, 1024.0),
        ({(_ISO, _SHORT): (65535,)}, None, None, None),
    ],
)
def test_other_tags_replace_missing_ones(
    tags: dict[tuple[int, int], Any],
    time_s: float | None,
    f_number: float | None,
    gain: float | None,
) -> None:
    found = stated_exposure(tagged("jpg", tags))
    for value, expected in zip(
        (found.time_s, found.f_number, found.gain), (time_s, f_number, gain), strict=True
    ):
        assert value == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize(("value", "fired"), [(1, True), (9, True), (16, False), (24, False)])
def test_whether_the_flash_fired(value: int, fired: bool) -> None:
    assert stated_exposure(tagged("jpg", {(_FLASH, _SHORT): (value,)})).flash_fired is fired
