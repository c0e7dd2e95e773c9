"""Mosaics: their planes, and colours from them."""

import numpy as np
import pytest

from camctl.captures.demosaic import colour_of, demosaic, planes, spread
from camctl.controls import Layout

MOSAICS = [layout for layout in Layout if layout.is_mosaic]


def mosaic_of(colours, layout, first_row=0):
    mosaic = np.empty(colours.shape[:2], np.float32)
    for row in range(colours.shape[0]):
        for column in range(colours.shape[1]):
            channel = colour_of(layout, first_row + row, column)
            mosaic[row, column] = colours[row, column, channel]
    return mosaic


@pytest.mark.parametrize("layout", MOSAICS)
@pytest.mark.parametrize("first_row", [0, 1, 6])
def test_a_colour_that_is_even_comes_back_everywhere(layout, first_row):
    colours = np.broadcast_to(np.float32([0.25, 0.5, 2.0]), (7, 9, 3))
    assert np.array_equal(
        demosaic(mosaic_of(colours, layout, first_row), layout, first_row), colours
    )


@pytest.mark.parametrize("layout", MOSAICS)
def test_linear_light_is_interpolated_exactly_inside(layout):
    row, column = np.mgrid[0:12, 0:10].astype(np.float32)
    colours = np.stack([row + 2 * column, 3 * row - column, 5 + row], axis=-1)
    got = demosaic(mosaic_of(colours, layout), layout, 0)
    assert np.allclose(got[1:-1, 1:-1], colours[1:-1, 1:-1], rtol=1e-6)


def test_planes_cover_every_sample_once():
    frame = np.arange(24, dtype=np.uint8).reshape(4, 6)
    for layout in (Layout.MONO, *MOSAICS):
        seen = np.concatenate([plane.ravel() for plane in planes(frame, layout)])
        assert sorted(seen) == list(range(24))
    colours = np.arange(24, dtype=np.uint8).reshape(4, 2, 3)
    assert [plane.tolist() for plane in planes(colours, Layout.RGB)][2][0] == [2, 5]


def test_the_letters_name_the_pattern_row_by_row():
    assert [colour_of(Layout.GRBG, r, c) for r in (0, 1) for c in (0, 1)] == [1, 0, 2, 1]


def test_a_mark_spreads_to_all_that_interpolation_touches():
    mask = np.zeros((5, 5), np.uint8)
    mask[2, 2] = 2
    wide = spread(mask)
    assert wide.shape == (5, 5, 3)
    assert np.array_equal(wide[..., 0] == 2, np.pad(np.ones((3, 3), bool), 1))
