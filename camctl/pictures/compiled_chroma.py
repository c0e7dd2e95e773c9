"""Errors of colours, compiled (extra `fast`): what `camctl.evidence.chroma` does, row by row.

Numbers are the same: float32 in the same order, and sums over cells around each one in float64, as
OpenCV has them.  This module is imported only where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import (
    FOLLOWING,
    GREEN,
    NO_CONTRAST,
    OF_CELLS,
    OF_DETAIL,
    OF_Y,
    OTHER,
)
from camctl.evidence.lost_detail import LEVELS, NOISE_BINS, OCTAVES, LostDetail, cosines
from camctl.evidence.patches import SIDE
from camctl.model.compiled_cells import beside_saturated, in_cells, put, small_errors
from camctl.model.compiled_join import join_cells
from camctl.model.compiled_mean import MeanTables, mean, tables_of
from camctl.model.light import KEPT_TABLES, Floats32, LightTables
from camctl.system.compiled_functions import compiler

__all__ = [
    "beside_saturated",
    "chroma_variance",
    "first_light",
    "in_cells",
    "join_cells",
    "put",
    "small_errors",
    "spreads",
]

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _THREE = (np.float32(x) for x in (0, 1, 3))
_HALF, _QUARTER, _SIXTEENTH = (np.float32(x) for x in (0.5, 0.25, 1 / 16))
_RED, _ONLY_GREEN, _BLUE = OF_Y
_FOLLOWING, _OTHER, _NO_CONTRAST = (np.float32(x) for x in (FOLLOWING, OTHER, NO_CONTRAST))
_TO_RED, _TO_BLUE = (np.float32(x) for x in GREEN)
_OF_RED, _OF_BLUE, _OF_BOTH = (
    np.float32(x) for x in (GREEN[0] ** 2, GREEN[1] ** 2, 2 * GREEN[0] * GREEN[1])
)
_FREE_CELLS, _FREE_DETAIL = (np.float32(16 / np.pi / x) for x in (OF_CELLS, OF_DETAIL))
_NINTH = 1 / 9
_MIDDLE, _BRIGHTEST, _IN_BLOCK = (np.float32(x) for x in (LEVELS / 2, LEVELS - 1, 1 / SIDE**2))
_BINS_OF_LEVEL = np.float32(NOISE_BINS / LEVELS)
#: Quantities whose means over 3 x 3 cells are needed.
_QUANTITIES = 10


@lru_cache(maxsize=KEPT_TABLES)
def _mean_tables(tables: LightTables, unknown: bytes) -> MeanTables:
    of_white = float(tables.sensor.full), np.inf
    return tables_of(tables, np.frombuffer(unknown, np.bool_), of_white)


def first_light(
    tables: LightTables, values: NDArray[Any], unknown: NDArray[np.bool_]
) -> tuple[Floats32, Floats32, NDArray[np.intp]]:
    """Return the light of samples of each frame, (n, S), and its standard deviation.

    The last result is the samples that `LightTables.mean` says more about.

    Args:
        tables: of the frames
        values: of them
        unknown: bins of light in which the deviation is not known
    """
    light, deviation = np.empty((2, values.shape[1]), np.float32)
    of_frames = _mean_tables(tables, unknown.tobytes())
    return light, deviation, np.flatnonzero(mean(values, of_frames, light, deviation))


@_compiled
def _mean(cells: NDArray[Any], at: int, colour: int, row: int, found: Floats32, k: int) -> None:
    """Set the means of a row of cells, exactly."""
    for c in range(found.shape[1]):
        one, two = (
            np.float32(cells[colour, at, 0, row, c]),
            np.float32(cells[colour, at, 1, row, c]),
        )
        three, four = (
            np.float32(cells[colour, at, 2, row, c]),
            np.float32(cells[colour, at, 3, row, c]),
        )
        found[k, c] = ((one + two) + (three + four)) * _QUARTER


@_compiled
def _fill(cells: NDArray[Any], at: int, row: int, found: Floats32, means: Floats32) -> None:
    """Set Y, R - Y, B - Y, products of these, and detail, of a row of cells, (10, columns).

    `means` become those of red, green and blue, and what is between green and the rows beside it.
    """
    last, columns = cells.shape[3] - 1, cells.shape[4]
    for k in range(5):
        beside = max(row - 1, 0) if k == 3 else min(row + 1, last)
        _mean(cells, at, k if k < 3 else 1, row if k < 3 else beside, means, k)
    for c in range(columns):
        red, blue = means[0, c], means[2, c]
        Y = red * _RED + means[1, c] * _ONLY_GREEN + blue * _BLUE
        red -= Y
        blue -= Y
        found[0, c], found[1, c], found[2, c] = Y, red, blue
        found[3, c], found[4, c], found[5, c] = Y * Y, red * Y, blue * Y
        found[6, c], found[7, c], found[8, c] = red * red, blue * blue, red * blue
    for c in range(columns):
        green = _THREE * means[1, c]
        means[3, c] = (green + means[3, c]) * _SIXTEENTH
        means[4, c] = (green + means[4, c]) * _SIXTEENTH
    for c in range(1, columns - 1):
        found[9, c] = _detail(cells, at, row, c, means, c - 1, c + 1)
    for c in (0, columns - 1):
        found[9, c] = _detail(cells, at, row, c, means, max(c - 1, 0), min(c + 1, columns - 1))


@_compiled
def _detail(
    cells: NDArray[Any], at: int, row: int, c: int, means: Floats32, before: int, after: int
) -> np.float32:
    up, down = _THREE * means[3, c], _THREE * means[4, c]
    one = np.float32(cells[1, at, 0, row, c]) - (up + means[3, before])
    two = np.float32(cells[1, at, 1, row, c]) - (up + means[3, after])
    three = np.float32(cells[1, at, 2, row, c]) - (down + means[4, before])
    four = np.float32(cells[1, at, 3, row, c]) - (down + means[4, after])
    found: np.float32 = (one * one + two * two + three * three + four * four) * _QUARTER
    return found


@_compiled
def _mean_around(
    quantities: Floats32, rows: tuple[int, int, int], sums: NDArray[np.float64], means: Floats32
) -> None:
    """Set the means of quantities over three rows and columns."""
    one, two, three = rows
    count, columns = means.shape
    for k in range(count):
        for c in range(columns):
            sums[c] = (
                np.float64(quantities[one, k, c])
                + np.float64(quantities[two, k, c])
                + np.float64(quantities[three, k, c])
            )
        for c in range(1, columns - 1):
            means[k, c] = np.float32((sums[c - 1] + sums[c] + sums[c + 1]) * _NINTH)
        for c in (0, columns - 1):
            whole = sums[max(c - 1, 0)] + sums[c] + sums[min(c + 1, columns - 1)]
            means[k, c] = np.float32(whole * _NINTH)


@_compiled
def _without(variance: np.float32, noise: np.float32, free: np.float32) -> np.float32:
    rest = variance - noise
    found: np.float32 = (rest + np.sqrt(rest * rest + free * (noise * noise))) * _HALF
    return found


@_compiled
def _lost(
    means: Floats32, details: Floats32, shown: Floats32, at: int, row: int, found: Floats32
) -> None:
    """Set what red, green and blue of a row of cells lose; `shown` is what noise shows of them."""
    for c in range(means.shape[1]):
        middle, red, blue = means[0, c], means[1, c], means[2, c]
        contrast, within, detail = means[3, c] - middle * middle, means[9, c], details[c]
        of_red, of_blue, of_Y, of_detail = shown[0, c], shown[1, c], shown[2, c], shown[3, c]
        spread = max(contrast, _ZERO) + _NO_CONTRAST
        real = max(contrast - of_Y, _ZERO) + _NO_CONTRAST
        within = _without(within, of_detail, _FREE_DETAIL)
        detail = max(detail - of_detail, _ZERO)
        share = np.sqrt(min(within / real, _ONE)) * _OTHER
        following = _FOLLOWING * detail
        to_red = (means[4, c] - red * middle) / spread
        to_blue = (means[5, c] - blue * middle) / spread
        rest_red = means[6, c] - red * red - to_red * to_red * spread
        rest_blue = means[7, c] - blue * blue - to_blue * to_blue * spread
        rest_both = means[8, c] - red * blue - to_red * to_blue * spread
        rest_red = _without(rest_red, of_red, _FREE_CELLS)
        rest_blue = _without(rest_blue, of_blue, _FREE_CELLS)
        rest_green = _OF_RED * rest_red + _OF_BLUE * rest_blue + _OF_BOTH * rest_both
        to_green = _TO_RED * to_red + _TO_BLUE * to_blue
        found[0, at, row, c] = to_red * to_red * following + share * max(rest_red, _ZERO)
        found[1, at, row, c] = to_green * to_green * following + share * max(rest_green, _ZERO)
        found[2, at, row, c] = to_blue * to_blue * following + share * max(rest_blue, _ZERO)


@_compiled
def _chroma_variance(
    cells: NDArray[Any],
    at: int,
    noise: Floats32,
    quantities: Floats32,
    rows_of_means: Floats32,
    sums: NDArray[np.float64],
    means: Floats32,
    shown: Floats32,
    found: Floats32,
) -> None:
    rows = cells.shape[3]
    for after in range(rows + 1):
        if after < rows:
            _fill(cells, at, after, quantities[after % 3], rows_of_means[after % 3])
        row = after - 1
        if row < 0:
            continue
        here = row % 3, max(row - 1, 0) % 3, min(row + 1, rows - 1) % 3
        _mean_around(quantities, here, sums, means)
        for k in range(4):
            for c in range(means.shape[1]):
                shown[k, c] = noise[k, np.uint32(rows_of_means[row % 3, 1, c])]
        _lost(means, quantities[row % 3, 9], shown, at, row, found)


def chroma_variance(cells: NDArray[Any], noises: Sequence[Floats32]) -> Floats32:
    """Return the variance of the errors of colours of frames, (3, n, rows, columns).

    Args:
        cells: (3, n, 4, rows, columns)
        noises: what the noise of each shows, as `camctl.evidence.chroma.chroma_variance` has it
    """
    columns = cells.shape[4]
    found = np.empty((3, cells.shape[1], *cells.shape[3:]), np.float32)
    rows, means = (np.empty((3, count, columns), np.float32) for count in (_QUANTITIES, 5))
    sums = np.empty(columns, np.float64)
    around, shown = (np.empty((count, columns), np.float32) for count in (_QUANTITIES, 4))
    for at, noise in enumerate(noises):
        _chroma_variance(cells, at, noise, rows, means, sums, around, shown, found)
    return found


class _Detail(NamedTuple):
    """What is tabulated of what a file loses, see `camctl.evidence.lost_detail`.

    Attributes:
        cosines: of a row of a block, (8, 8)
        half: of the steps of frequencies, (64,)
        lost: by class of block and brightness, (classes * bins,)
        more: likewise, for each frequency that is kept, (64, classes * bins)
        octaves: class of each number of frequencies, up to the last one that is known
    """

    cosines: Floats32
    half: Floats32
    lost: Floats32
    more: Floats32
    octaves: NDArray[np.uint32]


@lru_cache(maxsize=KEPT_TABLES)
def _tables_of(detail: LostDetail) -> _Detail:
    return _Detail(
        cosines().astype(np.float32),
        (detail.steps / 2).astype(np.float32),
        detail.all_lost,
        np.ascontiguousarray(detail.more_by_kept.T),
        np.minimum(OCTAVES, len(detail.variance) - 1).astype(np.uint32),
    )


class _Blocks(NamedTuple):
    """What is known of a row of blocks.

    Attributes:
        Y: brightness, and its frequencies along columns, (2, 8, 8 B)
        columns: these, by column of the block, (8, 8, B)
        kept: whether a frequency is not 0, (64, B)
        place: in the tables, (B,)
        lost: (B,)
        of_cells: the same of each column of cells
    """

    Y: Floats32
    columns: Floats32
    kept: NDArray[np.uint8]
    place: NDArray[np.uint32]
    lost: Floats32
    of_cells: Floats32

    @classmethod
    def of(cls, count: int) -> _Blocks:
        return cls(
            np.empty((2, SIDE, SIDE * count), np.float32),
            np.empty((SIDE, SIDE, count), np.float32),
            np.empty((SIDE * SIDE, count), np.uint8),
            np.empty(count, np.uint32),
            np.empty(count, np.float32),
            np.empty(SIDE // 2 * count, np.float32),
        )


@_compiled
def _read(frame: NDArray[Any], first: int, blocks: _Blocks) -> None:
    """Set the brightness of a row of blocks; what they have beyond the frame is its border."""
    last, columns = frame.shape[1] - 1, frame.shape[2]
    for y in range(SIDE):
        row = min(first + y, last)
        for x in range(columns):
            red, green = np.float32(frame[0, row, x]), np.float32(frame[1, row, x])
            Y = red * _RED + green * _ONLY_GREEN + np.float32(frame[2, row, x]) * _BLUE
            blocks.Y[0, y, x] = Y - _MIDDLE
        for x in range(columns, blocks.Y.shape[2]):
            blocks.Y[0, y, x] = blocks.Y[0, y, columns - 1]


@_compiled
def _transform(detail: _Detail, blocks: _Blocks) -> None:
    """Set which frequencies of blocks are kept."""
    whole, count = blocks.Y.shape[2], len(blocks.lost)
    for u in range(SIDE):
        for x in range(whole):
            found = _ZERO
            for y in range(SIDE):
                found += detail.cosines[u, y] * blocks.Y[0, y, x]
            blocks.Y[1, u, x] = found
        for x in range(SIDE):
            for j in range(count):
                blocks.columns[x, u, j] = blocks.Y[1, u, SIDE * j + x]
    for u in range(SIDE):
        for v in range(SIDE):
            half = detail.half[SIDE * u + v]
            for j in range(count):
                found = _ZERO
                for x in range(SIDE):
                    found += detail.cosines[v, x] * blocks.columns[x, u, j]
                blocks.kept[SIDE * u + v, j] = abs(found) > half


@_compiled
def _lose(detail: _Detail, blocks: _Blocks) -> None:
    """Set what blocks lose."""
    count = len(blocks.lost)
    for j in range(count):
        blocks.place[j], blocks.lost[j] = 0, _ZERO
    for f in range(1, SIDE * SIDE):
        for j in range(count):
            blocks.place[j] += blocks.kept[f, j]
    for y in range(SIDE):
        for j in range(count):
            for x in range(SIDE):
                blocks.lost[j] += blocks.Y[0, y, SIDE * j + x]
    for j in range(count):
        mean = min(max(blocks.lost[j] * _IN_BLOCK + _MIDDLE, _ZERO), _BRIGHTEST)
        of_light = np.uint32(mean * _BINS_OF_LEVEL)
        blocks.place[j] = detail.octaves[blocks.place[j]] * np.uint32(NOISE_BINS) + of_light
        blocks.lost[j] = detail.lost[blocks.place[j]]
    for f in range(SIDE * SIDE):
        for j in range(count):
            blocks.lost[j] += detail.more[f, blocks.place[j]] * np.float32(blocks.kept[f, j])


@_compiled
def _spreads(
    frame: NDArray[Any],
    at: int,
    detail: _Detail,
    blocks: _Blocks,
    of_chroma: Floats32,
    found: Floats32,
) -> None:
    rows, columns, high = of_chroma.shape[2], of_chroma.shape[3], SIDE // 2
    for first in range(0, rows, high):
        _read(frame, 2 * first, blocks)
        _transform(detail, blocks)
        _lose(detail, blocks)
        for j in range(len(blocks.lost)):
            for c in range(high):
                blocks.of_cells[high * j + c] = max(blocks.lost[j], _ZERO)
        for k in range(3):
            for row in range(first, min(first + high, rows)):
                for c in range(columns):
                    found[k, at, row, c] = np.sqrt(of_chroma[k, at, row, c] + blocks.of_cells[c])


def spreads(
    frames: Sequence[NDArray[Any]], details: Sequence[LostDetail], of_chroma: Floats32
) -> Floats32:
    """Return standard deviations of the errors that frames have in common, (3, n, rows, columns).

    Args:
        frames: (rows, columns, 3) of each
        details: what the file of each loses besides
        of_chroma: variance of the errors of colours, (3, n, rows, columns)
    """
    found = np.empty_like(of_chroma)
    blocks = _Blocks.of(-(-frames[0].shape[1] // SIDE))
    for at, (frame, detail) in enumerate(zip(frames, details, strict=True)):
        planes = np.ascontiguousarray(np.moveaxis(frame, 2, 0))
        _spreads(planes, at, _tables_of(detail), blocks, of_chroma, found)
    return found
