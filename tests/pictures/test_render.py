"""Mosaics, their planes and colours, and what each value of a sum stands for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from picture_parts import rendered

from camctl.interface.controls import Layout
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.pictures.mosaic import colour_of, demosaic, demosaic_deviation, demosaic_mask
from camctl.pictures.render import (
    CONTRADICTING,
    DARK,
    FULL_CODE,
    GOOD,
    SATURATED,
    Tables,
)

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
    found = demosaic(mosaic_of(colours, layout, first_row), layout, first_row)
    assert np.array_equal(np.stack(found, axis=-1), colours)


@pytest.mark.parametrize("layout", MOSAICS)
def test_demosaic_is_exact_for_linear_light_inside(layout: Layout) -> None:
    row, column = np.mgrid[0:12, 0:10].astype(np.float32)
    colours = np.stack([row + 2 * column, 3 * row - column, 5 + row], axis=-1)
    found = np.stack(demosaic(mosaic_of(colours, layout), layout, 0), axis=-1)
    assert np.allclose(found[1:-1, 1:-1], colours[1:-1, 1:-1], rtol=1e-6)


@pytest.mark.parametrize("layout", MOSAICS)
def test_demosaic_keeps_17_bits_of_the_fraction(layout: Layout) -> None:
    """A pixel's own sample is not interpolated: only the rounding is left."""
    mosaic = np.geomspace(1e-6, 1e6, 400, dtype=np.float32).reshape(20, 20)
    found = np.stack(demosaic(mosaic, layout, 0), axis=-1)
    own = mosaic_of(found, layout).astype(np.float64)
    error = np.abs(own / mosaic - 1).max()
    assert 2**-20 < error <= 2**-18


def test_planes_hold_every_sample_once() -> None:
    frame = np.arange(24, dtype=np.uint8).reshape(4, 6)
    for layout in (Layout.MONO, *MOSAICS):
        samples = np.concatenate([plane.ravel() for plane in layout.planes(frame)])
        assert sorted(samples) == list(range(24))
    colours = np.arange(24, dtype=np.uint8).reshape(4, 2, 3)
    assert [plane.tolist() for plane in Layout.RGB.planes(colours)][2][0] == [2, 5]


def test_letters_of_a_layout_name_its_pattern_row_by_row() -> None:
    assert [colour_of(Layout.GRBG, r, c) for r in (0, 1) for c in (0, 1)] == [1, 0, 2, 1]


def test_mask_of_a_mosaic_covers_all_interpolated_pixels() -> None:
    mask = np.zeros((5, 5), np.uint8)
    mask[2, 2] = 2
    wide = demosaic_mask(mask)
    assert np.array_equal(wide == 2, np.pad(np.ones((3, 3), bool), 1))


@pytest.mark.parametrize("place", [(4, 4), (4, 5), (5, 4), (5, 5)])
def test_mask_of_a_mosaic_marks_the_pixels_whose_value_depends_on_a_sample(
    place: tuple[int, int],
) -> None:
    """Users of a mask leave out pixels: each that a bad sample changed must be marked."""
    light = np.random.default_rng(0).uniform(0.2, 0.5, (10, 10)).astype(np.float32)
    changed = light.copy()
    changed[place] = 0.9
    mask = np.zeros((10, 10), np.uint8)
    mask[place] = CONTRADICTING
    both = demosaic(light, Layout.RGGB, 0), demosaic(changed, Layout.RGGB, 0)
    depends = np.any(np.stack(both[0]) != np.stack(both[1]), axis=0)
    marked = demosaic_mask(mask) == CONTRADICTING
    # A green sample does not reach the corners of its 3 x 3 pixels: at most 4 of 9 are too many.
    assert not (depends & ~marked).any()
    assert 5 <= depends.sum() <= marked.sum() == 9


def test_tables_are_the_inverse_response_with_black_subtracted_once() -> None:
    desired = desired_response("log", 100.0)
    noise = [FrameNoise(math.inf, 0.0, black=2), FrameNoise(math.inf, 0.0, black=3)]
    posterior = Posterior(EFFECTIVE, desired, noise)
    tables, E = Tables.of(posterior), posterior.inverse.E
    edges = np.concatenate([[0.0], EFFECTIVE.levels])
    assert tables.code.size == EFFECTIVE.levels_total + BLACK + 1
    assert tables.full == edges[-1]
    assert tables.unlit == BLACK
    inside = np.flatnonzero(edges[:-1] >= desired.e_min)
    middle = (desired.u(edges[inside[:-1]]) + desired.u(edges[inside[:-1] + 1])) / 2
    occurs = np.diff(edges)[inside[:-1]] > 0
    code = tables.code[BLACK + inside[:-1]]
    assert np.array_equal(code[occurs], np.rint(middle * FULL_CODE)[occurs])
    assert (tables.mask[: BLACK + 1] == DARK).all()
    is_dark = E[BLACK + 1 : -1] < desired.e_min
    assert 0 < np.count_nonzero(is_dark) < is_dark.size
    assert np.array_equal(tables.mask[BLACK + 1 : -1], np.where(is_dark, DARK, GOOD))
    assert tables.mask[-1] == SATURATED


def test_deviation_of_a_mosaic_counts_independent_errors() -> None:
    """A pixel's own colour has its own error; a mean of k equal errors has it over sqrt(k)."""
    found = demosaic_deviation(np.full((6, 6), 3.0, np.float32), Layout.RGGB, 0)
    colours = [each[2, 2] for each in found]
    np.testing.assert_allclose(colours, [3.0, 3.0 / 2, 3.0 / 2], rtol=1e-6)
    mosaic = np.ones((6, 6), np.float32)
    mosaic[2, 2] = np.inf
    red, _, _ = demosaic_deviation(mosaic, Layout.RGGB, 0)
    around = np.pad(np.ones((3, 3), bool), ((1, 2), (1, 2)))
    assert np.array_equal(np.isinf(red), around)
    mosaic[2, 2] = np.nan
    for each in demosaic_deviation(mosaic, Layout.RGGB, 0):
        assert np.array_equal(np.isnan(each), around)


@pytest.mark.parametrize(("count", "rows"), [(6, 64), (64, 16)])
def test_strips_of_many_frames_have_fewer_rows(count: int, rows: int) -> None:
    """Rows of 64 frames of 3000 columns would be 12 million samples, and are 3 million."""
    total, rendering = rendered(Layout.MONO, shape=(80, 3000))
    assert replace(rendering, count=count).strip_rows(total) == rows
