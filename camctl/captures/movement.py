"""Where the frames of a capture contradict each other: things that moved, or light that changed.

Frames neighbouring in exposure are compared sample by sample, see `camctl.captures.frame_pairs`.
Change of the whole picture, as by lamps that flicker, is taken out of the comparison first: it is
the ratio of most patches.

What light does that spreads from saturated pixels is left out, see `camctl.captures.light_spread`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.captures.frame_pairs import Limits, Pair
from camctl.captures.light_spread import ACROSS, LightSpread, Lines
from camctl.picture_operations import AREA, connected_parts, dilated
from camctl.threads import in_threads

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
#: The limits are set again where false alarms differ by this share, how often at most, and for
#: how many times as many at most.
_NEAR_RATE, _TRIES, _MOST_RATE = 0.05, 4, 2.0
#: Width of the bands in which they are set again, and pixels of all bands of a frame, about: by
#: chance the share of their false alarms differs by 3 %.
_BAND, _BANDS_PIXELS = 64, 500_000
#: Places that are named at most, the largest first.
_MOST_PLACES = 5
#: Samples that are compared at a time.
_STRIP_SAMPLES = 1 << 19

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
        false_alarms: share that does by noise, predicted from patches that do not move; with
            unknown noise, and where light spreads, measured where the map shows no movement
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


def bands_of(pixels: Pixels) -> Pixels:
    """Return bands of columns of a frame, all over it, of about a million pixels together."""
    rows, columns = pixels.shape[:2]
    step = _BAND * -(-rows * columns // _BANDS_PIXELS)
    return pixels[:, np.arange(columns) % step < _BAND].copy()


def find_movement(
    frame: Callable[[int], Pixels], pairs: Sequence[Pair], bands: Callable[[int], Pixels]
) -> Movement | None:
    """Return where the frames of a capture contradict each other; None with a single frame.

    Three frames are in memory at a time.

    Args:
        frame: returns the samples of a frame by its position, black included
        pairs: frames neighbouring in exposure, from the shortest on
        bands: returns `bands_of` a frame likewise; called where the noise is unknown
    """
    if not pairs:
        return None
    if all(pair.is_known for pair in pairs):
        return _marked(frame, pairs, FALSE_ALARMS)
    return _marked(frame, pairs, _corrected_total(bands, pairs))


def _corrected_total(bands: Callable[[int], Pixels], pairs: Sequence[Pair]) -> float:
    """Return the share of false alarms to set limits for, so that the share in frames is right.

    Unknown noise is larger at contours and beside saturated pixels, of which patches have few.
    """
    most = _MOST_RATE * FALSE_ALARMS
    total, low, high, tries = FALSE_ALARMS, 0.0, math.inf, []
    for _ in range(1 + _TRIES):
        alarms = _marked(bands, pairs, total, in_memory=True).found.false_alarms
        tries.append((abs(alarms / FALSE_ALARMS - 1), total))
        too_few = alarms < FALSE_ALARMS
        if not alarms or min(tries)[0] < _NEAR_RATE or (too_few and total == most):
            break
        low, high = (total, high) if too_few else (low, total)
        total = min(total * FALSE_ALARMS / alarms, most)
        if not low < total < high:
            total = math.sqrt(low * min(high, most))
    return min(tries)[1]


def _marked(
    frame: Callable[[int], Pixels], pairs: Sequence[Pair], total: float, *, in_memory: bool = False
) -> Movement:
    """Return what contradicts by limits that are set for this share of false alarms.

    Frames that are `in_memory` are compared two pairs at a time.
    """

    def load(position: int) -> tuple[Pixels, Lines]:
        pixels = frame(position)
        return pixels, Lines.of(pixels)

    def compare(
        work: tuple[Pair, tuple[Limits, float], tuple[tuple[Pixels, Lines], tuple[Pixels, Lines]]],
    ) -> tuple[NDArray[np.uint8], float, bool, tuple[int, ...]]:
        pair, (limits, rate), ((short, short_lines), (long, long_lines)) = work
        rows, columns = short.shape[:2]
        channels = short.shape[2] if short.ndim == 3 else 1
        spread = LightSpread.of(limits, pair, short_lines, long_lines)
        marks = np.zeros((rows, -(-columns * channels // 8)), np.uint8)
        mark = partial(_mark, marks, limits, spread, short, long)
        areas = _areas(rows, columns, channels, spread)
        compared = sum(map(mark, areas) if in_memory else in_threads(mark, areas))
        return marks, rate * compared / short.size, spread.is_any, short.shape

    positions = [pairs[0].short.position, *(pair.long.position for pair in pairs)]
    # The next frame is read while two are compared.
    frames = map(load, positions) if in_memory else in_threads(load, positions, 1)
    work = zip(pairs, _calibrated(pairs, total), pairwise(frames), strict=True)
    results = in_threads(compare, work) if in_memory else map(compare, work)
    marks, alarms, does_spread, shape = next(results)
    for each, share, spreads, _ in results:
        marks |= each
        alarms += share
        does_spread |= spreads
    is_known = all(pair.is_known for pair in pairs)
    movement, at_rest = _mapped(shape, marks, alarms, is_known=is_known)
    if is_known and not (does_spread and at_rest < alarms):
        return movement
    # Light that spread is in the patches, too, and has been taken out of the picture.
    return replace(movement, found=replace(movement.found, false_alarms=at_rest))


def _areas(
    rows: int, columns: int, channels: int, spread: LightSpread
) -> list[tuple[slice, slice]]:
    """Return the rows and columns of the parts of a frame that are compared at a time."""
    if not spread.is_any:
        step = max(1, _STRIP_SAMPLES // (columns * channels))
        return [(slice(top, top + step), slice(0, columns)) for top in range(0, rows, step)]
    # Charge flows along columns, so that a part has whole ones, and the marks of one whole bytes.
    step = max(8, _STRIP_SAMPLES // (rows * channels) & ~7)
    return [(slice(None), slice(left, left + step)) for left in range(0, columns, step)]


def _mark(
    marks: NDArray[np.uint8],
    limits: Limits,
    spread: LightSpread,
    short: Pixels,
    long: Pixels,
    area: tuple[slice, slice],
) -> int:
    """Add what contradicts in an area to the packed marks; return how many samples can."""
    rows, columns = area
    part = slice(max(0, columns.start - ACROSS), columns.stop + ACROSS)
    inner = slice(columns.start - part.start, columns.stop - part.start)
    found, comparable = (
        each[:, inner] for each in spread.outside(limits, short[rows, part], long[rows, part])
    )
    packed = np.packbits(found.reshape(len(found), -1), axis=1)
    first = columns.start * (found[0, 0].size) // 8
    marks[rows, first : first + packed.shape[1]] |= packed
    return int(np.count_nonzero(comparable))


def _calibrated(pairs: Sequence[Pair], total: float) -> list[tuple[Limits, float]]:
    """Return limits of each pair, and its share of false alarms among the samples compared.

    They are set for a share of `total` of all samples.  Where one pair has fewer, as where its
    longer frame is saturated, the others have more, up to `total` of the samples compared.
    """
    rate, found = total / len(pairs), []
    for _ in range(_TRIES):
        found = list(in_threads(partial(Pair.calibrated, rate=rate), pairs))
        reached = sum(share * pair.compared for (_, share), pair in zip(found, pairs, strict=True))
        if reached > (1 - _NEAR_RATE) * total or rate >= total or not reached:
            break
        rate = min(rate * total / reached, total)
    return found


def _mapped(
    shape: tuple[int, ...],
    marks: NDArray[np.uint8],
    false_alarms: float,
    *,
    is_known: bool,
) -> tuple[Movement, float]:
    """Return a `Movement` with share, map and places, and the share of the marks at rest."""
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
    size = np.outer(_sizes(rows, cell), _sizes(columns, cell)) * channels
    expected = size * FALSE_ALARMS
    moves = counts > expected + _CELL_SIGMAS * np.sqrt(expected) + _LEAST_MARKS
    if is_known:
        moves = _connected(moves, _CONNECTED)
    else:
        moves = _connected(moves & (counts > _DENSE * size), _CONNECTED_UNKNOWN)
    share = float(counts.sum() / size.sum())
    rests = ~_widened(moves)
    at_rest = float(counts[rests].sum() / max(size[rests].sum(), 1))
    places = _places(moves, counts, (rows, columns), cell)
    area = float(moves.mean())
    found = FoundMovement(share, false_alarms, places, area)
    return Movement(shape, marks, found, cell, moves), at_rest


def _widened(moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells that move, and those beside them."""
    return dilated(moves.astype(np.uint8), (3, 3)) > 0


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
