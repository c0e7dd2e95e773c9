"""Mosaics, their planes and colours, and what each value of a sum stands for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.captures.pictures import (
    DARK,
    GOOD,
    SATURATED,
    Tables,
    colour_of,
    demosaic,
    demosaic_mask,
    encode,
    outside_shares,
    planes,
)
from camctl.controls import Layout
from camctl.exposure.effective import EffectiveCamera
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

MOSAICS = [layout for layout in Layout if layout.is_mosaic]
BLACK = 5
EFFECTIVE = EffectiveCamera.of(linear_response(6), [1.0, 4.0])


def mosaic_of(
    colours: NDArray[np.float32], layout: Layout, first_row: int = 0
) -> NDArray[np.float32]:
    mosaic = np.empty(colours.shape[:2], np.float32)
    for row in range(colours.shape[0]):
        for column in range(colours.shape[1]):
            channel = colour_of(layout, first_row + row, column)
            mosaic[row, column] = colours[row, column, channel]
    return mosaic


@pytest.mark.parametrize("layout", MOSAICS)
@pytest.mark.parametrize("first_row", [0, 1, 6])
def test_demosaic_returns_a_uniform_colour_everywhere(layout: Layout, first_row: int) -> None:
    colours = np.broadcast_to(np.array([0.25, 0.5, 2.0], np.float32), (7, 9, 3))
    assert np.array_equal(
        demosaic(mosaic_of(colours, layout, first_row), layout, first_row), colours
    )


@pytest.mark.parametrize("layout", MOSAICS)
def test_demosaic_is_exact_for_linear_light_inside(layout: Layout) -> None:
    row, column = np.mgrid[0:12, 0:10].astype(np.float32)
    colours = np.stack([row + 2 * column, 3 * row - column, 5 + row], axis=-1)
    found = demosaic(mosaic_of(colours, layout), layout, 0)
    assert np.allclose(found[1:-1, 1:-1], colours[1:-1, 1:-1], rtol=1e-6)


def test_planes_hold_every_sample_once() -> None:
    frame = np.arange(24, dtype=np.uint8).reshape(4, 6)
    for layout in (Layout.MONO, *MOSAICS):
        samples = np.concatenate([plane.ravel() for plane in planes(frame, layout)])
        assert sorted(samples) == list(range(24))
    colours = np.arange(24, dtype=np.uint8).reshape(4, 2, 3)
    assert [plane.tolist() for plane in planes(colours, Layout.RGB)][2][0] == [2, 5]


def test_letters_of_a_layout_name_its_pattern_row_by_row() -> None:
    assert [colour_of(Layout.GRBG, r, c) for r in (0, 1) for c in (0, 1)] == [1, 0, 2, 1]


def test_mask_of_a_mosaic_covers_all_interpolated_pixels() -> None:
    mask = np.zeros((5, 5), np.uint8)
    mask[2, 2] = 2
    wide = demosaic_mask(mask)
    assert wide.shape == (5, 5, 3)
    assert np.array_equal(wide[..., 0] == 2, np.pad(np.ones((3, 3), bool), 1))


def test_tables_are_the_inverse_response_with_black_subtracted_once() -> None:
    desired = desired_response("log", 100.0)
    tables = Tables.of(EFFECTIVE, desired, BLACK, 2.0)
    inverse = EFFECTIVE.irradiance_table()
    top = inverse.size - 1
    assert tables.irradiance.size == top + BLACK + 1
    assert np.array_equal(tables.irradiance[BLACK:], (inverse / 2).astype(np.float32))
    assert np.array_equal(tables.code[BLACK:], encode(desired, inverse))
    assert (tables.mask[: BLACK + 1] == DARK).all()
    assert (tables.mask[BLACK + 1 : -1] == GOOD).all()
    assert tables.mask[-1] == SATURATED
    assert not tables.irradiance[: BLACK + 1].any()


def test_outside_shares_count_saturated_and_dark_samples() -> None:
    tables = Tables.of(EFFECTIVE, desired_response("log", 100.0), BLACK, 2.0)
    total = np.full((10, 10), BLACK + 20, np.uint16)
    total[0], total[1, :5] = BLACK + EFFECTIVE.levels_total, BLACK - 2
    outside = outside_shares(total, tables)
    assert (outside.saturated, outside.dark) == (0.1, 0.05)
