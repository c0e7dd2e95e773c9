"""Which samples of neighbouring frames contradict each other, area by area.

Each pair is compared by its normalised residual, of each sample and of the mean of 5 x 5 samples,
see `camctl.evidence.residual`.  Thresholds are quantiles of the normal distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from itertools import pairwise
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import Ranges, local_ranges, ranges_at
from camctl.evidence.patch_errors import MEAN_RADIUS
from camctl.evidence.patches import SIDE
from camctl.evidence.ratio_check import SIGNIFICANCE
from camctl.evidence.residual import FrameRows, Limits, Pair
from camctl.evidence.spill import LightSpread, Lines
from camctl.interface.camera import Pixels
from camctl.system.compiled_functions import has_compiler
from camctl.system.picture_operations import box_sums, interleave, looked_up, opencv
from camctl.system.threads import in_threads

if TYPE_CHECKING:
    from camctl.model.compiled_residuals import Found

FALSE_ALARMS = 0.002
"""Share of the samples of a scene without movement that noise marks, at most: the promise of the
mask.  Half of it is for single samples and half for means, and each is divided by the pairs."""

#: Residuals count up to so many standard deviations in a mean: a single sample (a cosmic ray, a
#: pixel that blinks) is 4 / 5 of one there, and is not significant by itself.
_MOST_SIGMAS = 4.0
#: Side of the square of a mean, samples.
_SIDE = 2 * MEAN_RADIUS + 1
#: Steps in which residuals are counted, of a standard deviation: the rounding of two tables adds at
#: most 5 / 32 of one to a mean.
_STEPS = 32
#: Cells of the map of movement along the longer side of a picture, at most; none is smaller than a
#: patch.
_MAP_SIDE = 160
#: Samples of a frame that are read at a time.  With half of them, a tenth of the rows would be read
#: twice, as those around others.
STRIP_SAMPLES = 1 << 20
#: Samples that are compared at a time: their residuals, 2 bytes each, and what is made of them fit
#: a cache of 2 MB, and more areas than larger ones are saturated everywhere.
_AREA_SAMPLES = 1 << 18

SAMPLES_WORTH_LOADING = 1 << 26
"""Samples of all pairs from which on compiled code pays (extra `fast`): it saves 1 to 2 ns a
sample, and takes up to 0.08 s to be loaded."""

Area = tuple[slice, slice]
"""Rows and columns of a part of a frame."""
Mask = NDArray[np.bool_]
Packed = NDArray[np.uint8]
"""Marks of samples as bits, packed along each row."""
#: Pixels from which on a table of all pairs of codes of 8 bits pays: as many as there are pairs.
_ALL_CODES = 1 << 16

_Levels = NDArray[np.int16]
_Places = tuple[NDArray[np.intp], ...]


class Marks:
    """Where samples of the pairs contradict.

    Args:
        shape: of a frame
        pairs: frames neighbouring in exposure, from the shortest on

    Attributes:
        sigmas: quantile from which samples have marks
        significant: quantile from which a mean is no noise
        cell: see `Movement`
        cells: cells with a significant mean
        marks: see `Movement`, without light that spread
        spilled: likewise of light that spread
        compared: the largest share of the samples that a pair compares
        compiled: compares two frames of 8 bits where that pays; None: nothing does
    """

    def __init__(self, shape: tuple[int, ...], pairs: Sequence[Pair]) -> None:
        self.shape = shape
        rows, columns, channels = (*shape, 1)[:3]
        normal = NormalDist()
        self.sigmas = -normal.inv_cdf(FALSE_ALARMS / 4 / len(pairs))
        self.significant = -normal.inv_cdf(SIGNIFICANCE / 2 / len(pairs) / math.prod(shape))
        self.cell = max(SIDE, -(-max(rows, columns) // _MAP_SIDE))
        self.cells: Mask = np.zeros((-(-rows // self.cell), -(-columns // self.cell)), np.bool_)
        self.marks: Packed = np.zeros((rows, -(-columns * channels // 8)), np.uint8)
        self.spilled = np.zeros_like(self.marks)
        self.compared = 0.0
        self.compiled: Callable[..., Found] | None = None
        if math.prod(shape) * len(pairs) >= SAMPLES_WORTH_LOADING and has_compiler():
            from camctl.model.compiled_residuals import compare

            self.compiled = compare
        self._pairs = pairs
        self._step = max(1, STRIP_SAMPLES // (columns * channels * self.cell)) * self.cell

    def compare(self, rows: FrameRows) -> None:
        """Compare the frames: one is in memory at a time, or two between which light spread."""
        pairs, whole = list(self._compared(rows)), slice(0, self.shape[0])
        strips = [each for each in pairs if not each.has_spread]
        counts = dict.fromkeys(pairs, 0)

        def compared(areas: list[Area]) -> list[int]:
            """Return how many samples of areas of the same rows each pair compares."""
            part, found = self.outer(areas[0])[0], []
            position, long = strips[0].short, rows(strips[0].short, part)
            for each in strips:
                short = long if position == each.short else rows(each.short, part)
                position, long = each.long, rows(each.long, part)
                count = 0
                for area in areas:
                    columns = self.outer(area)[1]
                    count += each.mark(area, short[:, columns], long[:, columns])
                found.append(count)
            return found

        for numbers in in_threads(compared, self._strips()) if strips else ():
            for each, count in zip(strips, numbers, strict=True):
                counts[each] += count
        for each in pairs:
            if each.has_spread:
                short, long = rows(each.short, whole), rows(each.long, whole)
                counts[each] = sum(in_threads(partial(each.mark_part, short, long), self._parts()))
        self.compared = max(counts.values()) / math.prod(self.shape)

    def _compared(self, rows: FrameRows) -> Iterator[_FramePair]:
        """Yield what compares each pair; the next frame is read meanwhile."""
        first, is_processed = self._pairs[0], self._pairs[0].is_processed

        def load(position: int) -> tuple[Lines, Ranges | None]:
            if not is_processed or position == first.short.position:  # only of longer frames
                return Lines.of(self.shape, partial(rows, position), 4 * self._step), None
            frame = rows(position, slice(0, self.shape[0]))
            ranges = local_ranges(frame, first.sensor.white)
            return Lines.of(self.shape, frame.__getitem__, len(frame)), ranges

        positions = [first.short.position, *(pair.long.position for pair in self._pairs)]
        frames = in_threads(load, positions, 1)
        for pair, (short, long) in zip(self._pairs, pairwise(frames), strict=True):
            limits = pair.limits(self.sigmas)
            spread = LightSpread.of(limits, pair, short[0], long[0], long[1])
            yield _FramePair(self, limits, spread, long[0].rows.dtype, long[1])

    def _strips(self) -> list[list[Area]]:
        """Return the areas that are compared at a time, as rows and columns, strip by strip.

        The marks of an area have whole bytes.
        """
        (rows, columns, channels), step = (*self.shape, 1)[:3], self._step
        count = max(1, round(step * columns * channels / _AREA_SAMPLES))
        across = -(-columns // (8 * count)) * 8
        lefts = range(0, columns, across)
        return [
            [(slice(top, top + step), slice(left, left + across)) for left in lefts]
            for top in range(0, rows, step)
        ]

    def _parts(self) -> list[Area]:
        """Return likewise those of frames between which light spread.

        Charge flows along columns, so that a part has whole ones, and the marks of one whole bytes.
        """
        rows, columns, channels = (*self.shape, 1)[:3]
        step = max(1, _AREA_SAMPLES // (rows * channels * 8 * self.cell)) * 8 * self.cell
        return [(slice(0, rows), slice(left, left + step)) for left in range(0, columns, step)]

    def outer(self, area: Area) -> Area:
        """Return an area with the samples around it that are in the means of its own."""
        rows, columns = (
            slice(max(0, part.start - MEAN_RADIUS), min(part.stop + MEAN_RADIUS, length))
            for part, length in zip(area, self.shape, strict=False)
        )
        return rows, columns

    def within(self, rows: slice, columns: slice) -> Mask:
        """Return which pixels have marks in any colour."""
        channels = (*self.shape, 1)[2]
        part = np.unpackbits(self.marks[rows], axis=1, count=self.shape[1] * channels)
        pixels = part.reshape(len(part), self.shape[1], channels)[:, columns]
        return np.asarray(pixels.any(axis=2))


class _FramePair:
    """Two frames that are compared, area by area.

    Attributes:
        short, long: positions of the frames
        has_spread: whether light spread between them
    """

    def __init__(
        self,
        total: Marks,
        limits: Limits,
        spread: LightSpread,
        dtype: np.dtype[np.uint8] | np.dtype[np.uint16],
        ranges: Ranges | None,
    ) -> None:
        self._total, self._limits, self._spread, self._ranges = total, limits, spread, ranges
        pair = limits.pair
        self.short, self.long = pair.short.position, pair.long.position
        self.has_spread = spread.is_any
        self._has_means = pair.is_measured and not pair.sensor.is_coarse
        self._tables = _residual_tables(pair, dtype)
        self._nearest = _nearest_outside(limits, *self._tables)
        self._joint: tuple[_Levels, NDArray[np.uint8]] | None = None
        self._compiled = None
        if self._has_means and dtype == np.uint8:
            if not self.has_spread:
                self._compiled = total.compiled
            is_large = math.prod(total.shape[:2]) >= _ALL_CODES
            if self._compiled is None and len(self._tables[0]) == 1 and is_large:
                self._joint = self._of_all_codes()

    def mark_part(self, short: Pixels, long: Pixels, area: Area) -> int:
        """Add what contradicts in an area of whole frames; see `mark`."""
        outer = self._total.outer(area)
        return self.mark(area, short[outer], long[outer])

    def mark(self, area: Area, short: Pixels, long: Pixels) -> int:
        """Add what contradicts in an area; return how many samples can be compared.

        Args:
            area: rows and columns
            short: `Marks.outer` of it in the shorter frame
            long: in the longer one
        """
        if not self.has_spread and self._only_saturates(short, long):
            return 0
        outer = self._total.outer(area)
        first = outer[0].start, outer[1].start
        inner = tuple(
            slice(part.start - start, min(part.stop, length) - start)
            for part, length, start in zip(area, self._total.shape, first, strict=False)
        )
        if self._compiled is not None:
            return self._mark_compiled(area, short, long, first, inner)
        comparable = long < self._limits.pair.saturated
        if not self._limits.pair.is_measured:  # no limits
            return int(np.count_nonzero(comparable[inner]))
        residuals, found = self._seen(short, long, comparable, first)
        spilled = free = None
        if self._spread.is_any:
            found, free = self._spread.separated(self._limits, found, comparable, short, long)
            spilled, found, comparable = found & ~free, found & free, comparable & free
        if residuals is not None:
            if free is not None:
                residuals *= free
            places, sizes = self._contradicting_means(residuals, short, long, first)
            found[places] = True
            self._add_cells(area, first, places, sizes > self._total.significant)
        _pack(self._total.marks, found[inner], area)
        if spilled is not None:
            _pack(self._total.spilled, spilled[inner], area)
        return int(np.count_nonzero(comparable[inner]))

    def _mark_compiled(
        self,
        area: Area,
        short: Pixels,
        long: Pixels,
        first: tuple[int, int],
        inner: tuple[slice, ...],
    ) -> int:
        """Do the same in one pass over the samples."""
        assert self._compiled is not None
        total = self._total
        # An integer is above a limit that is none if it is above the integer below it.
        limits = int(total.sigmas * _SIDE * _STEPS), math.floor(total.sigmas * _STEPS / _SIDE)
        found = self._compiled(short, long, self._table, limits)
        if self._ranges is not None:
            self._limits.leave_out_edges(found.outside, short, long, self._ranges, first)
        places: _Places = np.unravel_index(found.places, short.shape)
        sizes = np.abs(found.sums) / (_SIDE * _STEPS)
        if self._ranges is not None:
            places, sizes = self._beyond_edges(places, sizes, short, long, first)
        found.outside[places] = True
        self._add_cells(area, first, places, sizes > total.significant)
        _pack(total.marks, found.outside[inner], area)
        return int(np.count_nonzero(long[inner] < self._limits.pair.saturated))

    def _only_saturates(self, short: Pixels, long: Pixels) -> bool:
        """Return whether the longer frame is saturated everywhere, and no sample contradicts that.

        None of the shorter frame is darker then than what saturates the longer one: the residuals
        are 0.
        """
        if long.min() < self._limits.pair.saturated:
            return False
        low, (lights, means) = self._limits.low, self._tables
        darkest, white = short.min(), min(self._limits.pair.saturated, low.shape[1] - 1)
        is_as_bright = bool((lights[:, darkest] >= means[:, white]).all())
        return is_as_bright and bool((low[:, white] <= darkest).all())

    def _of_all_codes(self) -> tuple[_Levels, NDArray[np.uint8]]:
        """Return the residual, and whether it contradicts, of each two samples of 8 bits."""
        short = np.arange(256, dtype=np.uint8).repeat(256).reshape(256, 256)
        long, places = short.T, _joined(short, short.T)
        residuals, outside = np.empty(places.size, np.int16), np.empty(places.size, np.bool_)
        residuals[places] = self._residuals(short, long, long < self._limits.pair.saturated)
        outside[places] = self._limits.outside(short, long)
        return residuals, outside.view(np.uint8)

    @cached_property
    def _table(self) -> _Levels:
        """By colour: the residual of each two samples, with `OUTSIDE` added if it contradicts."""
        from camctl.model.compiled_residuals import OUTSIDE

        colours = self._total.shape[2:]
        long = np.arange(256, dtype=np.uint8).repeat(256 * math.prod(colours))
        long = long.reshape(256, 256, *colours)
        short = np.ascontiguousarray(long.swapaxes(0, 1))
        residuals = self._residuals(short, long, long < self._limits.pair.saturated)
        residuals += np.int16(OUTSIDE) * self._limits.outside(short, long)
        return np.ascontiguousarray(residuals.reshape(1 << 16, -1).T)

    def _seen(
        self, short: Pixels, long: Pixels, comparable: Mask, first: tuple[int, int]
    ) -> tuple[_Levels | None, Mask]:
        """Return the residual of each sample, where it is known, and which samples contradict."""
        if self._joint is not None:
            both = _joined(short, long)
            levels, outside = (looked_up(table, both) for table in self._joint)
            return levels, outside.view(np.bool_)
        residuals = self._residuals(short, long, comparable) if self._has_means else None
        return residuals, self._outside(short, long, residuals, first)

    def _outside(
        self, short: Pixels, long: Pixels, residuals: _Levels | None, first: tuple[int, int]
    ) -> Mask:
        """Return which samples contradict by themselves.

        Those whose residual is as far from 0 as the nearest that may contradict are looked at one
        by one, if they are few.
        """
        limits = self._limits
        if residuals is not None:
            below, above = self._nearest
            near = _beyond(residuals, below + 1, above - 1)
            places = np.unravel_index(np.flatnonzero(near), near.shape)
            if places[0].size <= near.size // 16:
                near[places] = limits.outside_at(places, short, long, self._ranges, first)
                return near
        return limits.outside(short, long, self._ranges, first)

    def _contradicting_means(
        self, residuals: _Levels, short: Pixels, long: Pixels, first: tuple[int, int]
    ) -> tuple[_Places, NDArray[np.float64]]:
        """Return the places of samples whose mean contradicts, and the size of its residual.

        Args:
            residuals: of the samples of a part, 0 where one does not count
            short: the same part of the shorter frame
            long: of the longer frame
            first: row and column where the part begins
        """
        sums = box_sums(residuals, MEAN_RADIUS)
        limit = int(self._total.sigmas * _SIDE * _STEPS)
        contradict = _beyond(sums, -limit, limit)
        # Most areas have none; numpy's nonzero is five times as slow as this.
        places = np.unravel_index(np.flatnonzero(contradict), contradict.shape)
        # A sample beside what moved is in its mean, and does not differ by itself: it has to by as
        # much as each sample of the weakest mean that contradicts.
        own = residuals[places].astype(np.int32) * np.sign(sums[places])
        used = own * _SIDE > self._total.sigmas * _STEPS
        places = tuple(each[used] for each in places)
        sizes = np.abs(sums[places]) / (_SIDE * _STEPS)
        if self._ranges is not None:
            return self._beyond_edges(places, sizes, short, long, first)
        return places, sizes

    def _beyond_edges(
        self,
        places: _Places,
        sizes: NDArray[np.float64],
        short: Pixels,
        long: Pixels,
        first: tuple[int, int],
    ) -> tuple[_Places, NDArray[np.float64]]:
        """Return the same of the means that errors of photographs at edges leave."""
        assert self._ranges is not None
        pair = self._limits.pair
        square = pair.tables.square[pair.codes(places, short, long)[1]]
        around = ranges_at(self._ranges, places, first)
        used, sizes = pair.beyond_edges(
            self._total.sigmas, sizes, square, places, short, long, around, samples=_SIDE
        )
        return tuple(each[used] for each in places), sizes

    def _residuals(self, short: Pixels, long: Pixels, comparable: Mask) -> _Levels:
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
        area: Area,
        first: tuple[int, int],
        places: _Places,
        chosen: Mask,
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
        for number, each in enumerate((pair.lights[k], mean)):
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


def _beyond(values: _Levels, least: int, most: int) -> Mask:
    """Return which values are outside of a range; as numbers without a sign those below are large.

    One comparison takes half the time of two.
    """
    return np.asarray((values - np.int16(least)).view(np.uint16) > most - least)


def _joined(short: Pixels, long: Pixels) -> NDArray[np.uint16]:
    """Return the samples of two frames of 8 bits as numbers of 16 bits, in their shape."""
    both = np.empty((short.size, 2), np.uint8)
    interleave([short.ravel(), long.ravel()], both)
    return both.view(np.uint16).reshape(short.shape)


def _looked_up(tables: _Levels, samples: Pixels) -> _Levels:
    """Return the value of each sample in the table of its colour, or in the only one."""
    if len(tables) == 1:
        return looked_up(tables[0], samples)
    if samples.dtype == np.uint8 and (cv2 := opencv()) is not None:
        table = np.ascontiguousarray(tables.T).reshape(1, 256, 3)
        return np.asarray(cv2.LUT(samples, table))
    return np.stack([tables[k][samples[..., k]] for k in range(len(tables))], axis=-1)


def _pack(packed: Packed, marks: Mask, area: Area) -> None:
    """Add marks of an area to the packed ones."""
    bits = np.packbits(marks.reshape(len(marks), -1), axis=1)
    first = area[1].start * marks[0, 0].size // 8
    packed[area[0], first : first + bits.shape[1]] |= bits
