"""Residuals of two frames of 8 bits and their means over squares, in one pass (extra `fast`).

This module is imported only where it is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

SIDE = 5
"""Side of a square, samples."""

OUTSIDE = 1 << 10
"""Is added to the residual of two samples that contradict each other; residuals are smaller."""

_AROUND, _BITS, _ZERO, _ONE = (np.uint64(x) for x in (SIDE // 2, 8, 0, 1))
_NONE, _OUTSIDE, _HALF = (np.int16(x) for x in (0, OUTSIDE, OUTSIDE // 2))


class Found(NamedTuple):
    """What is found of an area.

    Attributes:
        outside: which samples contradict each other, in the shape of the area
        places: of means beyond the limit, in the order of the samples
        sums: of residuals, at those places
        number: of the places
    """

    outside: NDArray[np.bool_]
    places: NDArray[np.uint32]
    sums: NDArray[np.int16]
    number: NDArray[np.int64]


class _Work(NamedTuple):
    """Residuals of the last `SIDE` rows, their sums, with zeros beside them, and sums of these."""

    rows: NDArray[np.int16]
    columns: NDArray[np.int16]
    sums: NDArray[np.int16]


@_compiled
def _compare(
    short: NDArray[np.uint8],
    long: NDArray[np.uint8],
    table: NDArray[np.int16],
    limits: NDArray[np.int16],
    work: _Work,
    found: Found,
) -> None:
    """See `compare`; `limits` are those of a sum, and of `SIDE` times its own residual."""
    height, width = np.uint64(short.shape[0]), np.uint64(short.shape[1])
    rows, columns, sums, sides = work.rows, work.columns, work.sums, np.uint64(SIDE)
    colours = np.uint64(len(table))
    two, three, four = _AROUND * colours, np.uint64(3) * colours, np.uint64(4) * colours
    beyond = _ZERO
    for y in range(height + _AROUND):
        row = y % sides
        if y < height:
            for k in range(colours):
                for j in range(width // colours):
                    i = j * colours + k
                    both = np.uint64(short[y, i]) | np.uint64(long[y, i]) << _BITS
                    rows[row, i] = table[k, both]
            for x in range(width):
                is_outside = rows[row, x] > _HALF
                found.outside[y, x] = is_outside
                rows[row, x] -= _OUTSIDE * np.int16(is_outside)
        else:
            for x in range(width):
                rows[row, x] = _NONE
        if y < _AROUND:
            continue
        for x in range(width):
            some = rows[0, x] + rows[1, x] + rows[2, x] + rows[3, x] + rows[4, x]
            columns[x + two] = some
        most = _NONE
        for x in range(width):
            c = columns[x] + columns[x + colours] + columns[x + two]
            sums[x] = c + columns[x + three] + columns[x + four]
        for x in range(width):
            most = max(most, max(sums[x], np.int16(-sums[x])))
        if most <= limits[0]:
            continue
        own_row = (y - _AROUND) % sides
        for x in range(width):
            if sums[x] > limits[0] or sums[x] < -limits[0]:
                own = rows[own_row, x] if sums[x] > _NONE else np.int16(-rows[own_row, x])
                if own > limits[1]:
                    found.places[beyond] = np.uint32((y - _AROUND) * width + x)
                    found.sums[beyond] = sums[x]
                    beyond += _ONE
    found.number[0] = beyond


def compare(
    short: NDArray[np.uint8],
    long: NDArray[np.uint8],
    table: NDArray[np.int16],
    limits: tuple[int, int],
) -> Found:
    """Return what two frames say of an area.

    Args:
        short: samples of a frame, (rows, columns) or (rows, columns, colours); residuals outside of
            it are 0
        long: of another one
        table: of each colour: residual by the sample of the first, plus 256 times that of the
            second
        limits: a sum over a square is beyond it if it is larger than the first, on either side, and
            the residual in its middle larger than the second on the same side
    """
    rows = short.reshape(len(short), -1), long.reshape(len(long), -1)
    width = rows[0].shape[1]
    found = Found(
        np.empty(rows[0].shape, np.bool_),
        np.empty(short.size, np.uint32),
        np.empty(short.size, np.int16),
        np.empty(1, np.int64),
    )
    padded = width + (SIDE - 1) * len(table)
    work = _Work(*(np.zeros(shape, np.int16) for shape in ((SIDE, width), padded, width)))
    both = np.array(limits, np.int16)
    _compare(*rows, table, both, work, found)
    count = int(found.number[0])
    return found._replace(
        outside=found.outside.reshape(short.shape),
        places=found.places[:count],
        sums=found.sums[:count],
    )
