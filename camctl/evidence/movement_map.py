"""The map of movement: in which blocks of a picture more samples contradict than by noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.limits import Limits
from camctl.evidence.pair import Pair
from camctl.evidence.spill import BESIDE, LOST, beside_white
from camctl.interface.camera import Pixels
from camctl.system.picture_operations import AREA, connected_parts, dilated

FALSE_ALARMS = 0.002
"""Share of the samples of a scene without movement that noise alone puts outside."""

MAP_SIDE = 160
"""Cells of the map of movement along the longer side of a picture, at most."""

#: Least side of a cell, pixels: fewer samples cannot show more marks than by noise.
_LEAST_CELL = 8
#: Standard deviations by which a cell of the map must have more marks than false alarms, and
#: by how many more at least.
_CELL_SIGMAS, _LEAST_MARKS = 6.0, 4
#: Cells that must be connected: where few parts of a picture are lit, all noise is in them.
_CONNECTED = 2
#: With unknown noise, contours that are not quite in the same place contradict, too: a cell must
#: have this share of marks, and more of them must be connected.
_DENSE, _CONNECTED_UNKNOWN = 0.15, 4
#: Parts of the map smaller than this share of it are light that spread if more than the second
#: share of what contradicts there is beside saturated samples.
_SMALL, _MOST_BESIDE = 1 / 16, 0.9
#: Places that are named at most, the largest first.
_MOST_PLACES = 5
#: Samples that are counted at a time.
_STRIP_SAMPLES = 1 << 19

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """A rectangle of a picture, in pixels: rows `top` to `bottom` - 1, and columns likewise."""

    top: int
    left: int
    bottom: int
    right: int


def mapped(
    shape: tuple[int, ...],
    marks: NDArray[np.uint8],
    *,
    is_known: bool,
) -> tuple[int, _Floats, NDArray[np.bool_]]:
    """Return the side of a cell, the marks in each, and in which more are than by noise."""
    rows, columns = shape[:2]
    channels = shape[2] if len(shape) == 3 else 1
    cell = max(_LEAST_CELL, -(-max(rows, columns) // MAP_SIDE))
    edges = np.arange(0, columns, cell)
    counts = np.zeros((-(-rows // cell), edges.size))
    step = max(1, _STRIP_SAMPLES // (columns * channels * cell)) * cell
    for start in range(0, rows, step):
        packed = marks[start : start + step]
        if not packed.any():
            continue
        part = np.unpackbits(packed, axis=1, count=columns * channels)
        flat = np.sum([part[:, k::channels] for k in range(channels)], axis=0, dtype=np.uint8)
        sums = np.add.reduceat(flat, edges, axis=1, dtype=np.int64)
        cells = np.add.reduceat(sums, np.arange(0, len(part), cell), axis=0)
        counts[start // cell :][: len(cells)] = cells
    size = np.outer(cell_sizes(rows, cell), cell_sizes(columns, cell)) * channels
    expected = size * FALSE_ALARMS
    moves = counts > expected + _CELL_SIGMAS * np.sqrt(expected) + _LEAST_MARKS
    if is_known:
        moves = _connected(moves, _CONNECTED)
    else:
        moves = _connected(moves & (counts > _DENSE * size), _CONNECTED_UNKNOWN)
    return cell, counts, moves


def light_spread_cells(
    cells: NDArray[np.bool_], cell: int, pairs: Iterable[tuple[Pair, Limits, tuple[Pixels, Pixels]]]
) -> NDArray[np.bool_]:
    """Return the cells whose connected part has no other marks than light that spread."""
    labels, boxes = connected_parts(cells)
    totals, noise = np.zeros((len(boxes), 3)), np.zeros(len(boxes))
    small = [k for k in range(1, len(boxes)) if boxes[k, 2] * boxes[k, 3] < _SMALL * cells.size]
    for pair, limits, (short, long) in pairs if small else ():
        for k in small:
            left, top, width, height = (boxes[k, :4] * cell).tolist()
            part = (
                slice(max(0, top - BESIDE), top + height + BESIDE),
                slice(max(0, left - BESIDE), left + width + BESIDE),
            )
            totals[k] += beside_white(limits, pair.saturated, short[part], long[part])
            noise[k] += FALSE_ALARMS / 2 * short[part].size
    found, beside, darker = totals.T
    spreads = (found > 0) & (beside > _MOST_BESIDE * found) & (darker < LOST * found + noise)
    return np.asarray(cells & spreads[labels])


def widened(moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells that move, and those beside them."""
    return dilated(moves.astype(np.uint8), (3, 3)) > 0


def cell_sizes(length: int, cell: int) -> _Floats:
    """Return how many rows or columns each cell has."""
    return np.diff(np.append(np.arange(0, length, cell), length)).astype(np.float64)


def _connected(moves: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return the cells of which at least so many are connected."""
    labels, boxes = connected_parts(moves)
    return np.asarray(moves & (boxes[labels, AREA] >= least))


def places(
    moves: NDArray[np.bool_], counts: _Floats, shape: tuple[int, int], cell: int
) -> tuple[Place, ...]:
    """Return the rectangles around connected cells that move, those with most marks first."""
    labels, boxes = connected_parts(moves)
    weights = np.bincount(labels.ravel(), weights=counts.ravel(), minlength=len(boxes))[1:]
    largest = np.argsort(-weights, kind="stable")[:_MOST_PLACES]
    return tuple(
        Place(
            top * cell,
            left * cell,
            min((top + height) * cell, shape[0]),
            min((left + width) * cell, shape[1]),
        )
        for left, top, width, height in boxes[1:][largest, :4].tolist()
    )
