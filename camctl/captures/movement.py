"""Where the frames of a capture contradict each other: things that moved, or light that changed.

Frames neighbouring in exposure are compared sample by sample, see `camctl.captures.frame_pairs`.
Change of the whole picture, as by lamps that flicker, is taken out of the comparison first: it is
the ratio of most patches.

Light also spreads from saturated pixels into others that are near: charge flows along the columns
(blooming), and programs that make JPEG files mix the colours of neighbouring pixels.  How far is
measured in each pair: where nearly all pixels beside saturated ones contradict and those farther
away do not, it is no movement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.captures.frame_pairs import Limits, Pair, outside
from camctl.picture_operations import AREA, connected_parts, dilated

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
#: False alarms over `FALSE_ALARMS` from which the limits are set again, and how often at most.
_TOO_MANY, _TRIES = 1.3, 3
#: Places that are named at most, the largest first.
_MOST_PLACES = 5
#: Samples that are compared at a time.
_STRIP_SAMPLES = 1 << 20
#: Distances from saturated pixels at which contradictions are counted, pixels along the columns.
_DISTANCES = (2, 4, 8, 16, 32, 64, 128)
#: Columns that are looked at, at most; pixels at a distance that make a share of them meaningful;
#: and pixels across the columns that light spreads.
_MOST_COLUMNS, _RING_SAMPLES, _ACROSS = 512, 200, 2
#: Light spreads if this share of the pixels beside saturated ones contradict.  It ends where the
#: share is less than `_ENDS` of the largest, at a distance of up to `_NEAR` pixels.
_SPREADS, _ENDS, _NEAR = 0.02, 0.1, 8
#: With the first share of all pixels beside saturated ones it spreads farther, as blooming does,
#: and ends where the share is less than the second one of the largest.  With the third one it
#: spreads even where no pixels are left in which it could end.
_SPREADS_FAR, _ENDS_FAR, _SPREADS_SURELY = 0.25, 0.01, 0.5

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """A rectangle of a picture, in pixels: rows `top` to `bottom` - 1, and columns likewise."""

    top: int
    left: int
    bottom: int
    right: int


@dataclass(frozen=True)
class FoundMovement:
    """How much of a picture contradicts: movement, changed light, light that blooming spilled.

    Attributes:
        share: of the samples that contradict
        false_alarms: share that does by noise, measured where the map shows no movement
        places: the largest places where more contradict than by noise, those with most first
        area: share of the picture in which more contradict than by noise
    """

    share: float
    false_alarms: float
    places: tuple[Place, ...]
    area: float = 0.0


@dataclass(frozen=True, eq=False)
class Movement:
    """Where frames contradict each other.

    Attributes:
        shape: of a frame, (rows, columns) or (rows, columns, 3)
        marks: which samples contradict, packed along each row
        found: how many do, and where
        cell: side of a cell of `cells`, pixels
        cells: map of low resolution, bool: cells in which more samples contradict than by noise
    """

    shape: tuple[int, ...]
    marks: NDArray[np.uint8]
    found: FoundMovement
    cell: int
    cells: NDArray[np.bool_]

    def rows(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return 1 where samples of these rows contradict, else 0, in the shape of a frame."""
        width = self.shape[1] * (self.shape[2] if len(self.shape) == 3 else 1)
        found = np.unpackbits(self.marks[start:stop], axis=1, count=width)
        return found.reshape(-1, *self.shape[1:])


def find_movement(frame: Callable[[int], Pixels], pairs: Sequence[Pair]) -> Movement | None:
    """Return where the frames of a capture contradict each other; None with a single frame.

    Two frames are in memory at a time.

    Args:
        frame: returns the samples of a frame by its position, black included
        pairs: frames neighbouring in exposure, from the shortest on
    """
    if not pairs:
        return None
    alarms = FALSE_ALARMS
    found = _marked(frame, pairs, alarms)
    for _ in range(_TRIES):
        stated = found.found.false_alarms
        if stated <= _TOO_MANY * FALSE_ALARMS or all(pair.is_known for pair in pairs):
            break
        # Unknown noise can be larger outside of the patches, as beside saturated pixels.
        alarms *= (FALSE_ALARMS / stated) ** 2
        found = _marked(frame, pairs, alarms)
    return found


def _marked(frame: Callable[[int], Pixels], pairs: Sequence[Pair], alarms: float) -> Movement:
    """Return what contradicts by limits with these false alarms in the patches at rest."""
    rate = alarms / len(pairs)
    short = frame(pairs[0].short.position)
    shape, rows = short.shape, short.shape[0]
    marks = np.zeros((rows, -(-(short.size // rows) // 8)), np.uint8)
    step = max(1, _STRIP_SAMPLES * rows // short.size)
    for pair in pairs:
        long = frame(pair.long.position)
        limits, white = pair.calibrated(rate), pair.scale.white
        reach = _reach(limits, white, short, long)
        for start in range(0, rows, step):
            stop = min(start + step, rows)
            # Saturated pixels above and below spread light into these rows, too.
            first, last = max(0, start - reach), min(rows, stop + reach)
            found = outside(limits, short[first:last], long[first:last])
            if reach:
                found &= ~_near_saturated(long[first:last], found, white, reach)
            inner = found[start - first : stop - first]
            marks[start:stop] |= np.packbits(inner.reshape(stop - start, -1), axis=1)
        short = long
    is_known = all(pair.is_known for pair in pairs)
    return _mapped(shape, marks, step, is_known=is_known)


def _reach(limits: Limits, white: int, short: Pixels, long: Pixels) -> int:
    """Return how far light spreads from saturated pixels, pixels along the columns.

    It is 0 where as many pixels contradict far from saturated ones, as with things that moved.
    """
    every = -(-short.shape[1] // _MOST_COLUMNS)
    dim, bright = short[:, ::every].copy(), long[:, ::every].copy()
    found = outside(limits, dim, bright)
    if not found.any():
        return 0
    sources = (bright >= white) & ~found
    sources, found = _any_colour(sources), _any_colour(found)
    within, rates = sources, []
    for distance in _DISTANCES:
        reached = dilated(sources.astype(np.uint8), (2 * distance + 1, 1)) > 0
        ring = reached & ~within
        size = np.count_nonzero(ring)
        rates.append(np.count_nonzero(found & ring) / size if size >= _RING_SAMPLES else np.nan)
        within = reached
    most = max(rates[:2])
    if not most >= _SPREADS:
        return 0
    is_far = rates[1] >= _SPREADS_FAR
    for nearer, rate in zip(_DISTANCES[:-1], rates[1:], strict=True):
        if rate <= (_ENDS_FAR if is_far else _ENDS) * most:
            return nearer
        if not is_far and nearer >= _NEAR:
            break
    return _DISTANCES[-2] if rates[1] >= _SPREADS_SURELY else 0


def _any_colour(marks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which pixels are marked in any of their colours."""
    return np.asarray(marks.any(axis=2)) if marks.ndim == 3 else marks


def _near_saturated(
    bright: Pixels, found: NDArray[np.bool_], white: int, reach: int
) -> NDArray[np.bool_]:
    """Return which samples are up to `reach` from saturated ones that do not contradict."""
    source = _any_colour((bright >= white) & ~found)
    box = (2 * reach + 1, 2 * min(reach, _ACROSS) + 1)
    near = dilated(source.astype(np.uint8), box) > 0
    return np.asarray(near if bright.ndim == 2 else near[..., np.newaxis])


def _mapped(
    shape: tuple[int, ...], marks: NDArray[np.uint8], step: int, *, is_known: bool
) -> Movement:
    """Return a `Movement` with share, map and places, from its marks; `step` rows at a time."""
    rows, columns = shape[:2]
    channels = shape[2] if len(shape) == 3 else 1
    cell = max(_LEAST_CELL, -(-max(rows, columns) // MAP_SIDE))
    edges = np.arange(0, columns, cell)
    counts = np.zeros((-(-rows // cell), edges.size))
    for start in range(0, rows, step):
        packed = marks[start : start + step]
        if not packed.any():
            continue
        part = np.unpackbits(packed, axis=1, count=columns * channels)
        flat = np.sum([part[:, k::channels] for k in range(channels)], axis=0, dtype=np.uint8)
        sums = np.add.reduceat(flat, edges, axis=1, dtype=np.int64)
        np.add.at(counts, np.arange(start, start + len(part)) // cell, sums)
    size = np.outer(_sizes(rows, cell), _sizes(columns, cell)) * channels
    expected = size * FALSE_ALARMS
    moves = counts > expected + _CELL_SIGMAS * np.sqrt(expected) + _LEAST_MARKS
    if is_known:
        moves = _connected(moves, _CONNECTED)
    else:
        moves = _connected(moves & (counts > _DENSE * size), _CONNECTED_UNKNOWN)
    share = float(counts.sum() / size.sum())
    false_alarms = float(counts[~moves].sum() / max(size[~moves].sum(), 1))
    places = _places(moves, counts, (rows, columns), cell)
    area = float(moves.mean())
    found = FoundMovement(share, false_alarms, places, area)
    return Movement(shape, marks, found, cell, moves)


def _sizes(length: int, cell: int) -> _Floats:
    """Return how many rows or columns each cell has."""
    return np.diff(np.append(np.arange(0, length, cell), length)).astype(np.float64)


def _connected(moves: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return the cells of which at least so many are connected."""
    labels, boxes = connected_parts(moves)
    return np.asarray(moves & (boxes[labels, AREA] >= least))


def _places(
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
