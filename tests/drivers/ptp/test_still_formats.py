"""Formats of a still camera's files: which object is a picture, and levels that vary."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from raw_photographs import raw_file

from camctl.drivers.common.known_format import (
    FORMATS,
    FormatChangedError,
    KnownFormat,
    checked_exposure,
    matched_pixels,
)
from camctl.drivers.ptp.datasets import ObjectInfo
from camctl.drivers.ptp.still_formats import format_of
from camctl.interface.controls import ExposureSetting, Layout
from camctl.stills.decoding import Still

SAMPLES = np.array([[64, 70, 1000, 4000], [4095, 66, 65, 200]], np.uint16)
STILL = Still(SAMPLES, Layout.RGGB, 12, black=64, white=4000)
KNOWN = KnownFormat("raw", STILL.record)


@pytest.mark.parametrize(
    ("name", "code", "expected"),
    [
        ("DSC_0001.NEF", 0x3000, "raw"),
        ("IMG_1.CR2", 0x380D, "raw"),
        ("A.DNG", 0x3811, "raw"),
        ("B.TIF", 0x380D, "tiff"),
        ("C.JPG", 0x3801, "jpeg"),
        ("noname", 0x3801, "jpeg"),
        ("MVI_1.MOV", 0x300D, None),
        ("DCIM", 0x3001, None),
    ],
)
def test_the_format_follows_from_name_and_code(name: str, code: int, expected: str | None) -> None:
    info = ObjectInfo(code, 10, 0, 0, 0, name, "")
    assert format_of(info) == expected
    assert expected is None or expected in FORMATS


def test_samples_at_the_known_levels_are_unchanged() -> None:
    pixels, details = matched_pixels(STILL, KNOWN, "A.DNG")
    assert pixels is STILL.pixels
    assert details == {}


def test_another_black_level_is_shifted_to_the_known_one() -> None:
    still = replace(STILL, black=66, white=4002)
    pixels, details = matched_pixels(still, KNOWN, "A.DNG")
    # Samples at or above the file's white level stay saturated.
    assert pixels.tolist() == [[62, 68, 998, 3998], [4095, 64, 63, 198]]
    assert pixels.dtype == np.uint16
    assert details == {"black_in_file": 66, "white_in_file": 4002}


def test_a_lower_white_level_makes_its_samples_saturated() -> None:
    pixels, _ = matched_pixels(replace(STILL, white=3990), KNOWN, "A.DNG")
    assert pixels.tolist() == [[64, 70, 1000, 4095], [4095, 66, 65, 200]]


@pytest.mark.parametrize(
    "still",
    [
        replace(STILL, pixels=SAMPLES[:1]),
        replace(STILL, layout=Layout.BGGR),
        replace(STILL, bits=14),
        replace(STILL, black=97),
        replace(STILL, white=3900),
    ],
    ids=["size", "layout", "bits", "black", "white"],
)
def test_a_file_of_another_format_is_an_error_with_its_record(still: Still) -> None:
    with pytest.raises(FormatChangedError, match=r"A\.DNG has .* instead of 4 x 2 \(") as caught:
        matched_pixels(still, KNOWN, "A.DNG")
    assert caught.value.record == still.record


@pytest.mark.parametrize(("orientation", "turns"), [(1, None), (3, 2), (6, 3), (8, 1), (5, 1)])
def test_the_turn_that_a_file_states_is_a_detail_of_its_frame(
    orientation: int, turns: int | None
) -> None:
    data = raw_file(np.zeros((16, 16), np.uint16), 0.25, orientation=orientation)
    details = checked_exposure("A.DNG", data, ExposureSetting(0.25), has_gain=False)
    assert details.get("quarter_turns") == turns
    assert details.get("mirrored", False) == (orientation == 5)
