"""Errors of photographs at edges, which are neither noise of the sensor nor movement.

JPEG files are rounded in blocks, and programs mix the colours of neighbouring pixels.  Both grow
with the range of brightness around a sample.  Ranges are those of a block and of the blocks beside
it: together they hold the 16 x 16 pixels in which JPEG files round colours (ITU-T T.81).
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import SIDE
from camctl.interface.camera import Pixels
from camctl.model.colour_rounding import ENCODED
from camctl.model.sensor import JPEG_ERROR
from camctl.system.picture_operations import dilated

#: By how much less the range counts that the blocks beside have: only colours are mixed across
#: them, which are a third of the brightness of a pixel.
_BESIDE = 3

Ranges = NDArray[np.uint8]
"""Range of brightness in and beside each block of a frame, white = 255."""


def edge_levels(ranges: Ranges, white: int) -> NDArray[np.float64]:
    """Return the standard deviation of photographs with these ranges of brightness, in levels."""
    return np.asarray(ranges * (JPEG_ERROR * white / 255), np.float64)


def ranges_at(
    ranges: Ranges,
    places: tuple[NDArray[np.intp], ...],
    first: tuple[int, int],
    every: tuple[int, int] = (1, 1),
) -> Ranges:
    """Return the ranges at rows and columns of a part of the frame, see `Limits.outside`."""
    row, column = (
        (start + step * place) // SIDE
        for start, step, place in zip(first, every, places, strict=False)
    )
    return ranges[row, column]


def local_ranges(frame: Pixels, white: int) -> Ranges:
    """Return the range of brightness in and beside each block of a frame, of any colour.

    Brightness beside it counts by a third.
    """
    most, least = (
        (np.minimum(_blocks(frame, reduce), white) * (255 / white)).astype(np.uint8)
        for reduce in (np.maximum, np.minimum)
    )
    found = []
    for above, below in zip(most, 255 - least, strict=True):
        around = dilated(above, (3, 3)) - (255 - dilated(below, (3, 3)))
        found.append(np.maximum(above - (255 - below), around // _BESIDE))
    return np.asarray(np.maximum.reduce(found))


def mixed_colours(
    clipped: NDArray[np.float64], short: Pixels, places: tuple[NDArray[np.intp], ...]
) -> NDArray[np.float64]:
    """Return the error of samples by the mean colour of cells, of what saturation clips off.

    Decoders interpolate cells linearly.

    Args:
        clipped: off each colour, by the brightness of the shorter frame, (3, levels)
        short: the shorter frame from an even row and column on, (rows, columns, 3)
        places: rows, columns and colours of samples of it
    """
    row, column, colour = places
    own = np.arange(3)[:, np.newaxis] == colour
    weights = own - ENCODED[0][:, np.newaxis]  # of a colour without Y

    def colours(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
        pixels = short[rows, columns]
        each = [clipped[k].take(pixels[:, k], mode="clip") * weights[k] for k in range(3)]
        return np.asarray(np.sum(each, axis=0))

    found = -colours(row, column)
    parts = []
    for place, length in zip((row, column), short.shape, strict=False):
        cell, count = place // 2, -(-length // 2)
        beside = np.clip(cell + 2 * (place % 2) - 1, 0, count - 1)
        parts.append([(3 / 16, cell, length), (1 / 16, beside, length)])
    for (high, down, rows), (wide, across, columns) in product(*parts):
        for y, x in product(range(2), range(2)):
            there = np.minimum(2 * down + y, rows - 1), np.minimum(2 * across + x, columns - 1)
            found += 4 * high * wide * colours(*there)
    return found


def _blocks(frame: Pixels, reduce: np.ufunc) -> Pixels:
    """Return the largest or the least sample of each block, (colours, rows, columns)."""
    rows, columns, colours = (*frame.shape, 1)[:3]
    whole = rows // SIDE * SIDE
    # Many times as fast as `reduceat`.
    parts = [reduce.reduce(frame[:whole].reshape(-1, SIDE, columns * colours), axis=1)]
    if whole < rows:
        rest = frame[whole:].reshape(-1, columns * colours)
        parts.append(reduce.reduce(rest, axis=0, keepdims=True))
    found = np.concatenate(parts)
    last = found[:, -colours:]
    found = np.concatenate((found, *(last,) * (-columns % SIDE)), axis=1)
    of_block = np.ascontiguousarray(found.reshape(-1, SIDE * colours).T)
    return np.asarray(reduce.reduce(of_block.reshape(SIDE, colours, len(found), -1), axis=0))
