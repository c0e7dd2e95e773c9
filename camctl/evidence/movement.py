"""Where the frames of a capture contradict each other: things that moved, or light that changed.

Frames neighbouring in exposure are compared sample by sample, see `camctl.evidence.pair`.
Change of the whole picture, as by lamps that flicker, is taken out of the comparison first: it is
the ratio of most patches.

What light does that spreads from saturated pixels is no movement, see
`camctl.evidence.spill`, but the picture is wrong there: it is marked, and counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.limits import Limits, Ranges
from camctl.evidence.movement_map import (
    FALSE_ALARMS,
    Place,
    cell_sizes,
    light_spread_cells,
    mapped,
    places,
    widened,
)
from camctl.evidence.pair import Pair
from camctl.evidence.spill import ACROSS, LightSpread, Lines
from camctl.interface.camera import Pixels
from camctl.system.threads import in_threads

NOTABLE_SPREAD = 1e-4
"""Share of light that spread that is named."""

#: The limits are set again until false alarms are between these shares of those aimed at, how often
#: at most, and for how many times as many at most.
_LEAST_ALARMS, _NEAR_ALARMS, _TRIES, _MOST_RATE = 0.75, 1.05, 6, 8.0
#: Those of the pairs may sum to this share of what is set for them.
_NEAR_SUM = 0.95
#: How often at most they are set again where whole frames have more false alarms than the bands, by
#: this factor.
_TRIES_WHOLE, _MOST_ALARMS = 3, 1.25
#: Pixels of all bands of a frame in which they are set again, about: by chance the share of their
#: false alarms differs by 3 %.  A wide frame has narrow bands, so that there are so many of them.
_BANDS_PIXELS, _LEAST_BANDS = 500_000, 8
_NARROWEST, _WIDEST = 16, 64
#: Where fewer samples than this share can be compared it is not known what moved.
_LEAST_COMPARED = 1e-3
#: Share of the blocks below which what moved is in a part of the picture.
_MOST_LOCAL = 0.25
#: Samples that are compared at a time.
_STRIP_SAMPLES = 1 << 19

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FoundMovement:
    """How much of a picture contradicts: movement, changed light, light that blooming spilled.

    Attributes:
        share: of the samples that contradict, without those of `spread`
        false_alarms: share that does by noise, predicted from patches that do not move; with
            unknown noise, fewer than 8 levels, and where light spreads, measured where the map
            shows no movement
        places: the largest places where more contradict than by noise, those with most first
        area: share of the picture's blocks of `block` x `block` pixels in which more contradict
            than by noise; larger than `share`, since not each sample of a block does
        block: side of a block of the map, pixels
        spread: share of the samples that contradict by light that spread to them from saturated
            ones of a longer exposure: the picture is too bright there.  All have marks, too.  A
            bright thing that moved beside such samples looks the same
        compared: share of the samples that two frames have in range, of the two that have most
    """

    share: float
    false_alarms: float
    places: tuple[Place, ...]
    area: float = 0.0
    block: int = 0
    spread: float = 0.0
    compared: float = 1.0

    @property
    def is_seen(self) -> bool:
        """Whether enough samples could be compared to say that nothing moved."""
        return self.compared >= _LEAST_COMPARED

    @property
    def is_local(self) -> bool:
        """Whether things moved in a part of the picture, and most of it is at rest."""
        return bool(self.places) and self.area < _MOST_LOCAL


@dataclass(frozen=True, eq=False)
class Movement:
    """Where frames contradict each other.

    Attributes:
        shape: of a frame, (rows, columns) or (rows, columns, 3)
        marks: which samples contradict, packed along each row: moved ones, and those to which
            light spread
        found: how many do, and where
        cell: side of a cell of `cells`, pixels
        cells: map of low resolution, bool: cells in which more samples contradict than by noise
        spread_cells: likewise those where they do by light that spread from saturated ones
    """

    shape: tuple[int, ...]
    marks: NDArray[np.uint8]
    found: FoundMovement
    cell: int
    cells: NDArray[np.bool_]
    spread_cells: NDArray[np.bool_]

    def rows(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return 1 where samples of these rows contradict, else 0, in the shape of a frame."""
        width = self.shape[1] * (self.shape[2] if len(self.shape) == 3 else 1)
        found = np.unpackbits(self.marks[start:stop], axis=1, count=width)
        return found.reshape(-1, *self.shape[1:])


def bands_of(pixels: Pixels) -> Pixels:
    """Return bands of columns of a frame, all over it, of about half a million pixels together."""
    rows, columns = pixels.shape[:2]
    every = -(-rows * columns // _BANDS_PIXELS)
    width = min(max(columns // (_LEAST_BANDS * every), _NARROWEST), _WIDEST)
    return pixels[:, np.arange(columns) % (width * every) < width].copy()


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
    total, before = _corrected_total(bands, pairs), 0.0
    for _ in range(_TRIES_WHOLE):
        found = _marked(frame, pairs, total)
        alarms = found.found.false_alarms
        if alarms <= _MOST_ALARMS * FALSE_ALARMS or alarms == before:
            break
        total *= FALSE_ALARMS / alarms
        before = alarms
    return found


def _corrected_total(bands: Callable[[int], Pixels], pairs: Sequence[Pair]) -> float:
    """Return the share of false alarms to set limits for, so that the share in frames is right.

    Unknown noise is larger at contours and beside saturated pixels, of which patches have few.
    """
    low, high = 0.0, _MOST_RATE * FALSE_ALARMS
    total, most, before = FALSE_ALARMS, high, -1.0
    for _ in range(_TRIES):
        alarms = _marked(bands, pairs, total, in_memory=True).found.false_alarms
        is_few = alarms < _NEAR_ALARMS * FALSE_ALARMS
        low, high = (total, high) if is_few else (low, total)
        if is_few and (alarms > _LEAST_ALARMS * FALSE_ALARMS or total == most):
            break
        # Limits that are the least ones do not change.
        total = most if alarms in (0, before) else min(total * FALSE_ALARMS / alarms, most)
        before = alarms
        if high < most and not low < total < high:
            total = math.sqrt(low * high) if low else high / 4
    return low


def _marked(
    frame: Callable[[int], Pixels], pairs: Sequence[Pair], total: float, *, in_memory: bool = False
) -> Movement:
    """Return what contradicts by limits that are set for this share of false alarms.

    Frames that are `in_memory` are compared two pairs at a time.
    """
    is_known = all(pair.is_known for pair in pairs)

    def load(position: int) -> tuple[Pixels, Lines]:
        pixels = frame(position)
        return pixels, Lines.of(pixels, pairs[0].scale.white, is_known=is_known)

    def compare(
        work: tuple[Pair, tuple[Limits, float], tuple[tuple[Pixels, Lines], tuple[Pixels, Lines]]],
    ) -> tuple[NDArray[np.uint8], float, float, NDArray[np.uint8] | None, tuple[int, ...]]:
        pair, (limits, rate), ((short, short_lines), (long, long_lines)) = work
        rows, columns = short.shape[:2]
        channels = short.shape[2] if short.ndim == 3 else 1
        spread = LightSpread.of(limits, pair, short_lines, long_lines)
        marks = np.zeros((rows, -(-columns * channels // 8)), np.uint8)
        spilled = np.zeros_like(marks) if spread.is_any else None
        mark = partial(_mark, (marks, spilled), limits, spread, short, long, long_lines.ranges)
        areas = _areas(rows, columns, channels, spread)
        compared = sum(map(mark, areas) if in_memory else in_threads(mark, areas)) / short.size
        return marks, compared, rate * compared, spilled, short.shape

    positions = [pairs[0].short.position, *(pair.long.position for pair in pairs)]
    # The next frame is read while two are compared.
    frames = map(load, positions) if in_memory else in_threads(load, positions, 1)
    calibrated = _calibrated(pairs, total)
    work = zip(pairs, calibrated, pairwise(frames), strict=True)
    results = in_threads(compare, work) if in_memory else map(compare, work)
    marks, compared, alarms, spilled, shape = next(results)
    for each, comparable, share, more, _ in results:
        marks |= each
        compared = max(compared, comparable)
        alarms += share
        if more is not None:
            spilled = more if spilled is None else np.bitwise_or(spilled, more, out=spilled)
    cell, counts, moves = mapped(shape, marks, is_known=is_known)
    spread = np.zeros_like(moves)
    if is_known and moves.any():
        both = pairwise(map(frame, positions))
        limits = (limits for limits, _ in calibrated)
        spread = light_spread_cells(moves, cell, zip(pairs, limits, both, strict=True))
    movement, at_rest = _summed(shape, marks, alarms, cell, counts, moves, spread)
    movement = replace(movement, found=replace(movement.found, compared=compared))
    if spilled is not None:
        movement = _with_spread(movement, spilled, counts, is_known=is_known)
    is_coarse = pairs[0].scale.is_coarse  # its noise is not near a normal distribution
    if is_known and not is_coarse and not (spilled is not None and at_rest < alarms):
        return movement
    # Light that spread is in the patches, too, and is not in `share`.
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
    marks: tuple[NDArray[np.uint8], NDArray[np.uint8] | None],
    limits: Limits,
    spread: LightSpread,
    short: Pixels,
    long: Pixels,
    ranges: Ranges | None,
    area: tuple[slice, slice],
) -> int:
    """Add what contradicts in an area to the packed marks; return how many samples can.

    The second marks are those of light that spread; None where it does not.
    """
    rows, columns = area
    part = slice(max(0, columns.start - ACROSS), columns.stop + ACROSS)
    inner = slice(columns.start - part.start, columns.stop - part.start)
    before, after = short[rows, part], long[rows, part]
    found = limits.outside(before, after, ranges, (rows.start or 0, part.start))
    found, comparable, spilled = spread.separated(limits, found, before, after)
    for packed, each in zip(marks, (found, spilled), strict=True):
        if packed is None or each is None:
            continue
        bits = np.packbits(each[:, inner].reshape(len(each), -1), axis=1)
        first = columns.start * (each[0, 0].size) // 8
        packed[rows, first : first + bits.shape[1]] |= bits
    return int(np.count_nonzero(comparable[:, inner]))


def _calibrated(pairs: Sequence[Pair], total: float) -> list[tuple[Limits, float]]:
    """Return limits of each pair, and its share of false alarms among the samples compared.

    They are set for a share of `total` of all samples.  Where one pair has fewer, as where its
    longer frame is saturated, the others have more, up to `total` of the samples compared.
    """
    rate, found = total / len(pairs), []
    for _ in range(_TRIES):
        found = list(in_threads(partial(Pair.calibrated, rate=rate), pairs))
        reached = sum(share * pair.compared for (_, share), pair in zip(found, pairs, strict=True))
        if reached > _NEAR_SUM * total or rate >= total or not reached:
            break
        rate = min(rate * total / reached, total)
    return found


def _summed(
    shape: tuple[int, ...],
    marks: NDArray[np.uint8],
    false_alarms: float,
    cell: int,
    counts: _Floats,
    cells: NDArray[np.bool_],
    spread: NDArray[np.bool_],
) -> tuple[Movement, float]:
    """Return a `Movement` with shares and places, and the share of the marks at rest."""
    rows, columns = shape[:2]
    size = np.outer(cell_sizes(rows, cell), cell_sizes(columns, cell)) * math.prod(shape[2:])
    spread_share = float(counts[spread].sum() / size.sum())
    share = float(counts[~spread].sum() / size.sum())
    rests = ~widened(cells)
    at_rest = float(counts[rests].sum() / max(size[rests].sum(), 1))
    moves = cells & ~spread
    named = places(moves, counts, (rows, columns), cell)
    found = FoundMovement(
        share,
        false_alarms,
        named,
        float(moves.mean()),
        cell,
        spread_share,
    )
    return Movement(shape, marks, found, cell, moves, spread), at_rest


def _with_spread(
    movement: Movement, spilled: NDArray[np.uint8], counts: _Floats, *, is_known: bool
) -> Movement:
    """Add the marks of light that spread, which are no movement and no place.

    Args:
        movement: found without it
        spilled: packed marks, likewise
        counts: marks of `movement` in each cell
        is_known: whether the noise is
    """
    marks = np.bitwise_or(spilled, movement.marks, out=spilled)
    _, all_counts, cells = mapped(movement.shape, marks, is_known=is_known)
    more = float((all_counts - counts).sum()) / math.prod(movement.shape)
    found = replace(movement.found, spread=movement.found.spread + more)
    return replace(movement, marks=marks, found=found, spread_cells=cells & ~movement.cells)
