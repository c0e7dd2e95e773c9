"""Photographs from the hand: moved by whole pixels or by a homography, and cut to what all show."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from bracketed_photographs import error_between, light, photograph
from numpy.typing import NDArray

from camctl.evidence.alignment import displacement
from camctl.interface.controls import Layout
from camctl.photographs.moves import Move, overlap

from .conftest import Opened

TIMES = (0.004, 0.016, 0.064, 0.25)
SHIFTS = ((0, 0), (9, -6), (-5, 12), (3, 4))
LARGE = light(240, 320)


def by_hand(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
    """Return what of a photograph the camera shows when the hand is at the k-th place."""
    columns, rows = SHIFTS[k]
    return pixels[30 + rows : 210 + rows, 40 + columns : 280 + columns]


def turned(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the same where every second photograph is turned by 0.9 degrees, too."""
    middle = (pixels.shape[1] / 2, pixels.shape[0] / 2)
    matrix = cv2.getRotationMatrix2D(middle, 0.9 * (k % 2), 1.0)
    return by_hand(k, cv2.warpAffine(pixels, matrix, pixels.shape[1::-1], flags=cv2.INTER_CUBIC))


def test_shifted_photographs_are_moved_by_whole_pixels(opened: Opened) -> None:
    found = opened(TIMES, scene=LARGE, change=by_hand)
    assert len(found.camera.photographs) == 4
    (moved,) = [each for each in found.facts if each.code == "aligned"]
    assert (moved.details["count"], moved.details["by"]) == (3, "shift")
    assert moved.remedies == {"align": "none"}
    assert not found.displaced
    frames = [found.camera._load(k) for k in range(4)]
    # What all show begins there in the scene; every sample is as it was.
    part = np.s_[30 + 12 : 210 - 6, 40 + 9 : 280 - 5]
    for frame, time_s in zip(frames, TIMES, strict=True):
        assert np.array_equal(frame, photograph(time_s, LARGE)[part])


def test_photographs_that_lie_alike_are_not_moved(opened: Opened) -> None:
    found = opened(TIMES)
    assert "aligned" not in [each.code for each in found.facts]


@pytest.mark.slow
def test_turned_photographs_need_a_homography(opened: Opened) -> None:
    shifted = opened(TIMES, scene=LARGE, change=turned)
    left = [
        each for each in (*shifted.notes, *shifted.displaced.values()) if each.code == "shifted"
    ]
    assert left
    assert all("degrees" in each.details for each in left)
    assert left[0].remedies == {"align": "full"}
    full = opened(TIMES, scene=LARGE, change=turned, options={"align": "full"})
    assert len(full.camera.photographs) == 4
    assert not full.displaced
    assert not [each for each in full.notes if each.code == "shifted"]
    frames = [full.camera._load(k).astype(float) for k in (1, 2)]
    well = (frames[0] > 30) & (frames[1] < 230)
    ranks = [np.log(np.maximum(each, 1)) for each in frames]
    assert error_between(ranks[1], ranks[0]) < 0.05
    assert well.mean() > 0.1


@pytest.mark.parametrize("layout", [Layout.RGGB, Layout.MONO])
def test_a_shift_keeps_samples_and_colours_of_a_mosaic(layout: Layout) -> None:
    pixels = np.random.default_rng(0).integers(0, 4096, (40, 60)).astype(np.uint16)
    step = 2 if layout.is_mosaic else 1
    move = Move.whole(4.7, -3.2, step)
    assert move.shift == ((4, -4) if layout.is_mosaic else (5, -3))
    moved = move.applied(pixels, layout, 4095)
    rows, columns = overlap([move], pixels.shape)
    across, down = move.shift
    assert np.array_equal(
        moved[rows, columns],
        pixels[
            rows.start + down : rows.stop + down, columns.start + across : columns.stop + across
        ],
    )
    assert (rows.stop - rows.start, columns.stop - columns.start) == (40 + down, 60 - across)


def test_what_a_saturated_sample_is_in_stays_saturated() -> None:
    pixels = np.full((20, 20), 100, np.uint16)
    pixels[10, 10] = 1000
    matrix = np.eye(3)
    matrix[:2, 2] = 0.5
    moved = Move(matrix, False).applied(pixels, Layout.MONO, 1000)
    assert (moved[9:11, 9:11] == 1000).all()
    assert np.count_nonzero(moved == 1000) == 4


def test_steps_of_the_quantiser_in_a_smooth_picture_are_no_displacement() -> None:
    light = np.geomspace(0.003, 1, 64 * 48).reshape(48, 64)
    short, long = (
        (np.minimum(256 * (exposure * light) ** 0.45, 255).astype("u1") / 255).astype("f4")
        for exposure in (0.25, 1.0)
    )
    found = displacement(short, long)
    assert found is None or not found.any()
