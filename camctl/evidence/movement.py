"""Where the frames of a capture contradict each other: things that moved, or light that changed.

Frames neighbouring in exposure are compared by their normalised residual, of each sample and of
the mean of 5 x 5 samples, see `camctl.evidence.residual`.  Change of the whole picture, as by lamps
that flicker, is taken out first: it is the ratio of most patches.

Thresholds are quantiles of the normal distribution.  Samples have marks where noise alone would
mark `FALSE_ALARMS` of them; a place is reported where the mean of 5 x 5 contradicts so much that
noise would report one in `SIGNIFICANCE` of the captures in which nothing moves.

Light that spreads from saturated pixels (blooming) is not movement, see `camctl.evidence.spill`,
but the picture is wrong there: it is marked, and counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import edge_levels, local_ranges, ranges_at
from camctl.evidence.patch_errors import MEAN_RADIUS
from camctl.evidence.ratio_check import SIGNIFICANCE
from camctl.evidence.residual import Limits, Pair
from camctl.evidence.spill import LightSpread, Lines, only_beside_white
from camctl.findings import Finding, Place
from camctl.interface.camera import Pixels
from camctl.system.picture_operations import box_sums, connected_parts, dilated, opencv
from camctl.system.threads import in_threads

FALSE_ALARMS = 0.002
"""Share of the samples of a scene without movement that noise marks, at most: the promise of the
mask.  Half of it is for single samples and half for means, and each is divided by the pairs."""

#: Residuals count up to so many standard deviations in a mean: a single sample (a cosmic ray, a
#: pixel that blinks) is 4 / 5 of one there, and is not significant by itself.
_MOST_SIGMAS = 4.0
#: Steps in which residuals are counted, of a standard deviation: the rounding of two tables adds at
#: most 5 / 32 of one to a mean.
_STEPS = 32
#: Cells of the map of movement along the longer side of a picture, at most, and the least side of
#: one, pixels.
_MAP_SIDE, _LEAST_CELL = 160, 8
#: Places that are named at most, the largest first.
_MOST_PLACES = 5
#: Where fewer samples than this share can be compared it is not known what moved.
_LEAST_COMPARED = 1e-3
#: Share of the blocks below which what moved is in a part of the picture.
_MOST_LOCAL = 0.25
#: Samples that are compared at a time: their residuals in float32 fit a cache of 2 MB.
_STRIP_SAMPLES = 1 << 18

_Levels = NDArray[np.int16]
_Marks = NDArray[np.bool_]
_Packed = NDArray[np.uint8]


@dataclass(frozen=True)
class FoundMovement:
    """How much of a picture contradicts: movement, changed light, light that blooming spilled.

    Attributes:
        share: of the samples that contradict, without those of `spread`
        false_alarms: share that does by noise, at most
        places: the largest places where it is no noise, those with most marks first
        area: share of the picture's blocks of `block` x `block` pixels in which it is no noise;
            larger than `share`, since not each sample of a block contradicts
        block: side of a block of the map, pixels
        spread: share of the samples that contradict because light spread to them from saturated
            ones of a longer exposure: the picture is too bright there.  All have marks, too.  A
            bright thing that moved beside such samples looks the same
        compared: share of the samples that are in range in two frames, of the pair with most
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

    @property
    def findings(self) -> list[Finding]:
        """One finding where it is no noise, else none."""
        if not self.places:
            return []
        low = max(self.share - self.false_alarms, 0.0)
        return [
            Finding(
                code="moved",
                value=self.share,
                low=low,
                high=self.share,
                place=self.places[0],
                details={"area": self.area},
            )
        ]


@dataclass(frozen=True, eq=False)
class Movement:
    """Where frames contradict each other.

    Attributes:
        shape: of a frame, (rows, columns) or (rows, columns, 3)
        marks: which samples contradict, packed along each row: moved ones, and those to which
            light spread
        found: how many do, and where
        cell: side of a cell of `cells`, pixels
        cells: map of low resolution, bool: cells in which it is no noise
        spread_cells: likewise those where light spread from saturated samples
    """

    shape: tuple[int, ...]
    marks: _Packed
    found: FoundMovement
    cell: int
    cells: _Marks
    spread_cells: _Marks

    def rows(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return 1 where samples of these rows contradict, else 0, in the shape of a frame."""
        width = self.shape[1] * (self.shape[2] if len(self.shape) == 3 else 1)
        found = np.unpackbits(self.marks[start:stop], axis=1, count=width)
        return found.reshape(-1, *self.shape[1:])


def find_movement(frame: Callable[[int], Pixels], pairs: Sequence[Pair]) -> Movement | None:
    """Return where the frames of a capture contradict each other; None with a single frame.

    Three frames are in memory at a time.

    Args:
        frame: returns the samples of a frame by its position, black included
        pairs: frames neighbouring in exposure, from the shortest on
    """
    if not pairs:
        return None

    def load(position: int) -> tuple[Pixels, Lines]:
        pixels = frame(position)
        return pixels, Lines.of(pixels)

    positions = [pairs[0].short.position, *(pair.long.position for pair in pairs)]
    frames = in_threads(load, positions, 1)  # the next frame is read while two are compared
    found: _Comparison | None = None
    for pair, (short, long) in zip(pairs, pairwise(frames), strict=True):
        if found is None:
            found = _Comparison(short[0].shape, len(pairs))
        found.add(pair, short, long)
    assert found is not None  # there is a pair
    return found.movement(pairs, frame)


class _Comparison:
    """What the pairs compared so far show.

    Args:
        shape: of a frame
        pairs: how many there are

    Attributes:
        sigmas: quantile from which samples have marks
        significant: quantile from which a mean is no noise
        cell: see `Movement`
        cells: cells with a significant mean
        marks: see `Movement`, without light that spread
        spilled: likewise of light that spread
        compared: the largest share of the samples that a pair compares
    """

    def __init__(self, shape: tuple[int, ...], pairs: int) -> None:
        self.shape = shape
        rows, columns, channels = (*shape, 1)[:3]
        normal = NormalDist()
        self.sigmas = -normal.inv_cdf(FALSE_ALARMS / 4 / pairs)
        self.significant = -normal.inv_cdf(SIGNIFICANCE / 2 / pairs / math.prod(shape))
        self.cell = max(_LEAST_CELL, -(-max(rows, columns) // _MAP_SIDE))
        self.cells: _Marks = np.zeros((-(-rows // self.cell), -(-columns // self.cell)), np.bool_)
        self.marks: _Packed = np.zeros((rows, -(-columns * channels // 8)), np.uint8)
        self.spilled = np.zeros_like(self.marks)
        self.compared = 0.0

    def add(self, pair: Pair, short: tuple[Pixels, Lines], long: tuple[Pixels, Lines]) -> None:
        """Compare two frames."""
        limits = pair.limits(self.sigmas)
        ranges = local_ranges(long[0], pair.sensor.white) if pair.is_processed else None
        spread = LightSpread.of(limits, pair, short[1], long[1], ranges)
        work = _FramePair(self, limits, spread, short[0], long[0], ranges)
        count = sum(in_threads(work.mark, work.areas()))
        self.compared = max(self.compared, count / math.prod(self.shape))

    def movement(self, pairs: Sequence[Pair], frame: Callable[[int], Pixels]) -> Movement:
        """Return it; the frames are read again where parts of them may be light that spread."""
        rows, columns = self.shape[:2]
        counts = _cell_counts(self.marks, self.shape, self.cell)
        spread = only_beside_white(
            self.cells, (rows, columns), self.cell, pairs, frame, self._marks_in, self.sigmas
        )
        moves = self.cells & ~spread
        # What moved reaches into the cells beside it that have more marks than by noise.
        expected = FALSE_ALARMS * self.cell**2 * math.prod(self.shape[2:])
        many = counts > expected + self.significant * math.sqrt(expected)
        moves |= many & ~spread & (dilated(moves.astype(np.uint8), (3, 3)) > 0)
        size = math.prod(self.shape)
        spread_count = counts[spread].sum()
        flooded = np.zeros_like(spread)
        if self.spilled.any():
            more = _cell_counts(self.spilled & ~self.marks, self.shape, self.cell)
            spread_count += more.sum()
            flooded = more > self.cell // 2  # streaks of half its side
        found = FoundMovement(
            share=float(counts[~spread].sum() / size),
            false_alarms=FALSE_ALARMS * self.compared,
            places=_places(moves, counts, (rows, columns), self.cell),
            area=float(moves.mean()),
            block=self.cell,
            spread=float(spread_count / size),
            compared=self.compared,
        )
        marks = self.marks | self.spilled
        return Movement(self.shape, marks, found, self.cell, moves, spread | flooded & ~moves)

    def _marks_in(self, rows: slice, columns: slice) -> _Marks:
        """Return which pixels have marks in any colour."""
        channels = (*self.shape, 1)[2]
        part = np.unpackbits(self.marks[rows], axis=1, count=self.shape[1] * channels)
        pixels = part.reshape(len(part), self.shape[1], channels)[:, columns]
        return np.asarray(pixels.any(axis=2))


class _FramePair:
    """Two frames that are compared, area by area."""

    def __init__(
        self,
        total: _Comparison,
        limits: Limits,
        spread: LightSpread,
        short: Pixels,
        long: Pixels,
        ranges: NDArray[np.uint8] | None,
    ) -> None:
        self._total, self._limits, self._spread = total, limits, spread
        self._short, self._long, self._ranges = short, long, ranges
        self._has_means = limits.pair.is_measured and not limits.pair.sensor.is_coarse
        self._tables = _residual_tables(limits.pair, short.dtype)
        self._nearest = _nearest_outside(limits, *self._tables)

    def areas(self) -> list[tuple[slice, slice]]:
        """Return the rows and columns of the parts that are compared at a time."""
        (rows, columns), cell = self._short.shape[:2], self._total.cell
        channels = self._short.size // (rows * columns)
        if not self._spread.is_any:
            step = max(1, _STRIP_SAMPLES // (columns * channels * cell)) * cell
            return [(slice(top, top + step), slice(0, columns)) for top in range(0, rows, step)]
        # Charge flows along columns, so that a part has whole ones, and the marks of one whole
        # bytes.
        step = max(1, _STRIP_SAMPLES // (rows * channels * 8 * cell)) * 8 * cell
        return [(slice(0, rows), slice(left, left + step)) for left in range(0, columns, step)]

    def mark(self, area: tuple[slice, slice]) -> int:
        """Add what contradicts in an area; return how many samples can be compared."""
        shape = self._short.shape
        outer = tuple(
            slice(max(0, part.start - MEAN_RADIUS), min(part.stop + MEAN_RADIUS, length))
            for part, length in zip(area, shape, strict=False)
        )
        first = outer[0].start, outer[1].start
        inner = tuple(
            slice(part.start - start, min(part.stop, length) - start)
            for part, length, start in zip(area, shape, first, strict=False)
        )
        short, long = self._short[outer], self._long[outer]
        comparable = long < self._limits.pair.saturated
        residuals = self._residuals(short, long, comparable) if self._has_means else None
        found = self._outside(short, long, residuals, first)
        spilled = free = None
        if self._spread.is_any:
            found, free = self._spread.separated(self._limits, found, comparable, short, long)
            spilled, found, comparable = found & ~free, found & free, comparable & free
        if residuals is not None:
            if free is not None:
                residuals *= free
            places, sizes = self._contradicting_means(residuals, long, first)
            found[places] = True
            self._add_cells(area, first, places, sizes > self._total.significant)
        _pack(self._total.marks, found[inner], area)
        if spilled is not None:
            _pack(self._total.spilled, spilled[inner], area)
        return int(np.count_nonzero(comparable[inner]))

    def _outside(
        self, short: Pixels, long: Pixels, residuals: _Levels | None, first: tuple[int, int]
    ) -> _Marks:
        """Return which samples contradict by themselves.

        Those whose residual is as far from 0 as the nearest that may contradict are looked at one
        by one, if they are few.
        """
        limits = self._limits
        if residuals is not None:
            below, above = self._nearest
            near = (residuals <= below) | (residuals >= above)
            places = np.unravel_index(np.flatnonzero(near), near.shape)
            if places[0].size <= near.size // 16:
                near[places] = limits.outside_at(
                    places, short[places], long[places], self._ranges, first
                )
                return near
        return limits.outside(short, long, self._ranges, first)

    def _contradicting_means(
        self, residuals: _Levels, long: Pixels, first: tuple[int, int]
    ) -> tuple[tuple[NDArray[np.intp], ...], NDArray[np.float64]]:
        """Return the places of samples whose mean contradicts, and the size of its residual.

        Args:
            residuals: of the samples of a part, 0 where one does not count
            long: the same part of the longer frame
            first: row and column where the part begins
        """
        side, pair = 2 * MEAN_RADIUS + 1, self._limits.pair
        sums = box_sums(residuals, MEAN_RADIUS)
        limit = int(self._total.sigmas * side * _STEPS)
        # As numbers without a sign those below -limit are large.
        contradict = (sums + np.int16(limit)).view(np.uint16) > 2 * limit
        # Most areas have none; numpy's nonzero is five times as slow as this.
        places = np.unravel_index(np.flatnonzero(contradict), contradict.shape)
        # A sample beside what moved is in its mean, and does not differ by itself: it has to by as
        # much as each sample of the weakest mean that contradicts.
        own = residuals[places].astype(np.int32) * np.sign(sums[places])
        used = own * side > self._total.sigmas * _STEPS
        places = tuple(each[used] for each in places)
        sizes = np.abs(sums[places]) / (side * _STEPS)
        if self._ranges is not None:
            white, tables = pair.sensor.white, pair.tables
            after = places[2], np.minimum(long[places], white)
            around = ranges_at(self._ranges, places, first)
            edges = side * edge_levels(around, white) * pair.sensor.step(tables.mean[after])
            square = tables.square[after]
            sizes *= square / np.hypot(square, edges)
            used = sizes > self._total.sigmas
            places, sizes = tuple(each[used] for each in places), sizes[used]
        return places, sizes

    def _residuals(self, short: Pixels, long: Pixels, comparable: _Marks) -> _Levels:
        """Return the normalised residual of each sample, in `_STEPS` of a standard deviation.

        It is within `_MOST_SIGMAS`, and not above 0 where the longer frame is saturated.
        """
        lights, means = self._tables
        found = _looked_up(lights, short)
        found -= _looked_up(means, long)
        most = np.multiply(comparable, np.int16(_MOST_SIGMAS * _STEPS), dtype=np.int16)
        np.minimum(found, most, out=found)
        # numpy is six times as fast with a row as with a number.
        least = np.full(found.shape[1:], -_MOST_SIGMAS * _STEPS, np.int16)
        return np.maximum(found, least, out=found)

    def _add_cells(
        self,
        area: tuple[slice, slice],
        first: tuple[int, int],
        places: tuple[NDArray[np.intp], ...],
        chosen: _Marks,
    ) -> None:
        """Set the cells of the chosen places that are in an area."""
        rows, columns = (start + each[chosen] for start, each in zip(first, places, strict=False))
        inside = (rows >= area[0].start) & (rows < area[0].stop)
        inside &= (columns >= area[1].start) & (columns < area[1].stop)
        cell = self._total.cell
        self._total.cells[rows[inside] // cell, columns[inside] // cell] = True


def _residual_tables(
    pair: Pair, dtype: np.dtype[np.uint8] | np.dtype[np.uint16]
) -> tuple[_Levels, _Levels]:
    """Return tables by the value of a sample: its light, and the light that it predicts.

    Light is counted in standard deviations of the mean of a square, which makes the variance of
    photon noise one everywhere (Anscombe, 1948), and in `_STEPS` of them.  (colours, values of the
    type): samples above white count as white.
    """
    sensor, white = pair.sensor, pair.sensor.white
    codes = np.minimum(np.arange(np.iinfo(dtype).max + 1), white)
    tables = np.empty((2, len(pair.tables.mean), white + 1))
    for k, (mean, square) in enumerate(zip(pair.tables.mean, pair.tables.square, strict=True)):
        # The response may be flat, and measured errors not quite ascending.
        light, first = np.unique(np.maximum.accumulate(mean[: pair.saturated]), return_index=True)
        density = 1 / np.maximum(square[first], 1e-12 * sensor.full)
        scale = np.append(0.0, np.cumsum(np.diff(light) * (density[1:] + density[:-1]) / 2))
        for number, each in enumerate((sensor.light, mean)):
            inside = np.interp(each, light, scale)
            inside += np.minimum(each - light[0], 0.0) * density[0]
            tables[number, k] = inside + np.maximum(each - light[-1], 0.0) * density[-1]
    # The difference of two fits into 16 bits.
    found = np.rint(np.clip(tables * _STEPS, -16000, 16000)).astype(np.int16)[..., codes]
    return found[0], found[1]


def _nearest_outside(limits: Limits, lights: _Levels, means: _Levels) -> tuple[int, int]:
    """Return the residuals nearest to 0, below and above it, that samples outside limits have."""
    most = int(_MOST_SIGMAS * _STEPS)
    below, above = -most, most
    white = limits.low.shape[1] - 1
    for low, high, light, mean in zip(limits.low, limits.high, lights, means, strict=True):
        predicted = mean[: white + 1].astype(np.int32)
        under, over = low > 0, high < white
        if under.any():
            below = max(below, int((light[low[under] - 1] - predicted[under]).max()))
        if over.any():
            above = min(above, int((light[high[over] + 1] - predicted[over]).min()))
    return below, above


def _looked_up(tables: _Levels, samples: Pixels) -> _Levels:
    """Return the value of each sample in the table of its colour, or in the only one."""
    cv2 = opencv() if samples.dtype == np.uint8 else None
    if len(tables) == 1:
        return tables[0][samples] if cv2 is None else np.asarray(cv2.LUT(samples, tables[0]))
    if cv2 is not None:
        table = np.ascontiguousarray(tables.T).reshape(1, 256, 3)
        return np.asarray(cv2.LUT(samples, table))
    return np.stack([tables[k][samples[..., k]] for k in range(len(tables))], axis=-1)


def _pack(packed: _Packed, marks: _Marks, area: tuple[slice, slice]) -> None:
    """Add marks of an area to the packed ones."""
    bits = np.packbits(marks.reshape(len(marks), -1), axis=1)
    first = area[1].start * marks[0, 0].size // 8
    packed[area[0], first : first + bits.shape[1]] |= bits


def _cell_counts(marks: _Packed, shape: tuple[int, ...], cell: int) -> NDArray[np.float64]:
    """Return the marks in each cell, of all colours."""
    rows, columns, channels = (*shape, 1)[:3]
    edges = np.arange(0, columns, cell)
    counts = np.zeros((-(-rows // cell), edges.size))
    step = max(1, _STRIP_SAMPLES // (columns * channels * cell)) * cell
    for start in range(0, rows, step):
        packed = marks[start : start + step]
        if not packed.any():
            continue
        part = np.unpackbits(packed, axis=1, count=columns * channels)
        sums = np.add.reduceat(part, edges * channels, axis=1, dtype=np.int64)
        cells = np.add.reduceat(sums, np.arange(0, len(part), cell), axis=0)
        counts[start // cell :][: len(cells)] = cells
    return counts


def _places(
    moves: _Marks, counts: NDArray[np.float64], shape: tuple[int, int], cell: int
) -> tuple[Place, ...]:
    """Return the rectangles around connected cells that move, those with most marks first."""
    labels, boxes = connected_parts(moves)
    weights = np.bincount(labels.ravel(), weights=counts.ravel(), minlength=len(boxes))[1:]
    largest = np.argsort(-weights, kind="stable")[:_MOST_PLACES]
    return tuple(
        Place(
            top=top * cell,
            left=left * cell,
            bottom=min((top + height) * cell, shape[0]),
            right=min((left + width) * cell, shape[1]),
        )
        for left, top, width, height in boxes[1:][largest, :4].tolist()
    )
