"""Errors of colours, compiled (extra `fast`): what `camctl.evidence.chroma` does, row by row.

Numbers are the same: float32 in the same order, and sums over cells around each one in float64, as
OpenCV has them.  This module is imported only where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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
from camctl.model.compiled_join import join_cells
from camctl.model.light import Floats32
from camctl.system.compiled_functions import compiler

__all__ = ["chroma_variance", "join_cells"]

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
#: Quantities whose means over 3 x 3 cells are needed.
_QUANTITIES = 10


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
    for colour in range(3):
        _mean(cells, at, colour, row, means, colour)
    _mean(cells, at, 1, max(row - 1, 0), means, 3)
    _mean(cells, at, 1, min(row + 1, last), means, 4)
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
    _fill(cells, at, 0, quantities[0], rows_of_means[0])
    for row in range(rows):
        if row + 1 < rows:
            _fill(cells, at, row + 1, quantities[(row + 1) % 3], rows_of_means[(row + 1) % 3])
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
