"""Light that spreads from saturated pixels of the longer of two frames into others: no movement.

Two effects are distinguished from movement, each by what one pair of frames shows:

- Charge flows along the columns (blooming).  Contradicting pixels are then connected to saturated
  ones along the columns far more than along the rows, or none of them lost light.
- Lenses and programs that make JPEG files mix neighbouring pixels.  Those beside saturated ones
  then contradict, and those a little farther away do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import Ranges
from camctl.evidence.light_ratio import MOST_CHANGE
from camctl.evidence.patch_errors import MEAN_RADIUS
from camctl.evidence.ratio_check import MOST
from camctl.evidence.residual import FrameRows, Limits, Pair
from camctl.interface.camera import Pixels
from camctl.system.picture_operations import connected_parts, dilated, sums_along_columns

ACROSS = 2
"""Pixels across the columns that light spreads."""

BESIDE = 16
"""Pixels from a saturated one, along the columns, up to which light flows out of it."""

LOST = 0.05
"""Light only spreads if fewer than this share of the pixels that contradict become darker."""

#: Parts of the map smaller than this share of it are light that spread if less than `LOST` of what
#: contradicts there is away from saturated samples.
_SMALL = 1 / 16
#: Columns and rows that are looked at, at most, and pixels at a distance that make a share of them
#: meaningful.
_MOST_LINES, _RING_SAMPLES = 512, 200
#: Charge flows along columns if so many times as many contradicting pixels are connected to
#: saturated ones along the columns as along the rows, and so many more.
_STREAKS, _LEAST_STREAKS = 2.0, 20
#: Pixels of a column whose mean must be darker in the shorter frame than what saturates the longer
#: one, if charge has flooded them.
_AROUND = 9
#: Or if fewer than `LOST` of those connected are darker in the longer frame than expected.
#: With unknown noise that proves nothing: what became darker may not be found in the pair before.
#: Light spreads if this share of the pixels beside saturated ones contradict; the second share with
#: unknown noise, since errors of JPEG files are larger there.  It ends where the share is less than
#: the third one of the largest.
_SPREADS, _SPREADS_UNKNOWN, _ENDS = 0.02, 0.1, 0.1


@dataclass(frozen=True, eq=False)
class Lines:
    """Some of the columns and some of the rows of a frame.

    Attributes:
        columns: every so many columns
        rows: every so many rows
        every: column and row
    """

    columns: Pixels
    rows: Pixels
    every: tuple[int, int]

    @classmethod
    def of(cls, shape: tuple[int, ...], rows: Callable[[slice], Pixels], step: int) -> Lines:
        """Take them from a frame of that shape; `rows` returns rows, about `step` at a time."""
        down, across = (-(-length // _MOST_LINES) for length in shape[:2])
        step = max(1, step // down) * down
        taken = []
        for top in range(0, shape[0], step):
            part = rows(slice(top, top + step))
            taken.append((part[:, ::across].copy(), part[::down].copy()))
        on_columns, on_rows = (np.concatenate(each) for each in zip(*taken, strict=True))
        return cls(on_columns, on_rows, (across, down))


@dataclass(frozen=True)
class LightSpread:
    """How light of a pair spreads from saturated samples of the longer frame.

    Attributes:
        white: brightness from which samples are saturated
        reach: how far light spreads to all sides, pixels
        streaks: whether charge flows along the columns
    """

    white: int
    reach: int
    streaks: bool

    @property
    def is_any(self) -> bool:
        """Whether light spreads at all."""
        return self.streaks or self.reach > 0

    @classmethod
    def of(
        cls, limits: Limits, pair: Pair, short: Lines, long: Lines, ranges: Ranges | None
    ) -> LightSpread:
        """Measure it on some of the columns and rows."""
        white, every = pair.saturated, short.every
        distance = (1, every[0])
        found, source = _on_lines(limits, white, short.columns, long.columns, ranges, distance)
        if not (found.any() and source.any()):
            return cls(white, 0, False)
        connected = _connected_runs(found, source)
        along = int(np.count_nonzero(connected)) * every[0]
        streaks = along > _LEAST_STREAKS and (
            along > _STREAKS * _beside(limits, white, short, long, ranges) + _LEAST_STREAKS
            # Charge only adds light; things that move take it away elsewhere.
            or (pair.is_known and _lost(limits, short, long, source) < LOST * along)
        )
        if streaks and _has_one_factor(pair, connected, short.columns, long.columns):
            streaks = False
        if streaks:
            found &= ~connected
        least = _SPREADS if pair.is_known else _SPREADS_UNKNOWN
        return cls(white, _reach(found, source, least), streaks)

    def separated(
        self,
        limits: Limits,
        found: NDArray[np.bool_],
        comparable: NDArray[np.bool_],
        short: Pixels,
        long: Pixels,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples contradict, and to which pixels no light spread.

        Args:
            limits: of the shorter frame
            found: samples that contradict
            comparable: samples that the longer frame does not saturate
            short: samples of the shorter frame
            long: samples of the longer one

        Returns:
            in the shape of the samples, and of them or (rows, columns, 1)
        """
        source = _any_colour(~comparable & ~found)
        spread = np.zeros_like(source)
        if self.streaks:
            spread |= _connected_runs(_any_colour(found), source)
            # Single samples of a short exposure have too much noise there, a streak has not.
            light, mean = limits.pair.sensor.light, limits.pair.tables.mean[:, self.white - 1]
            middle = np.interp(mean, light, np.arange(light.size)).astype(np.float32)
            error = middle - limits.low[:, self.white - 1].astype(np.float32)
            saturated = ~comparable
            count, total = (
                sums_along_columns(each, _AROUND)
                for each in (saturated, np.where(saturated, short, 0))
            )
            flooded = saturated & (short < middle)
            flooded &= total < count * middle - np.sqrt(count) * error
            spread |= _any_colour(flooded)
            found |= flooded
        if self.reach:
            box = (2 * self.reach + 1, 2 * min(self.reach, ACROSS) + 1)
            spread |= dilated(source.view(np.uint8), box) > 0
        return found, ~spread if found.ndim == 2 else ~spread[..., np.newaxis]


def only_beside_white(
    cells: NDArray[np.bool_],
    shape: tuple[int, int],
    cell: int,
    pairs: Sequence[Pair],
    frame_rows: FrameRows,
    marks: Callable[[slice, slice], NDArray[np.bool_]],
    sigmas: float,
) -> NDArray[np.bool_]:
    """Return the cells whose connected part has no other marks than light that spread.

    Nearly all of them are then beside samples that the longest frame saturates, and none but by
    noise lost light.

    Args:
        cells: those with what is no noise
        shape: rows and columns of a frame
        cell: side of one, pixels
        pairs: of frames
        frame_rows: returns some rows of a frame by its position
        marks: returns which pixels of some rows and columns contradict
        sigmas: of the limits
    """
    labels, boxes = connected_parts(cells)
    small = [k for k in range(1, len(boxes)) if boxes[k, 2] * boxes[k, 3] < _SMALL * cells.size]
    if not small or not all(pair.is_known for pair in pairs):
        return np.zeros_like(cells)
    parts, (rows, columns) = {}, shape
    for k in small:
        left, top, width, height = (boxes[k, :4] * cell).tolist()
        parts[k] = (
            slice(max(0, top - BESIDE), min(top + height + BESIDE, rows)),
            slice(max(0, left - BESIDE), min(left + width + BESIDE, columns)),
        )
    found = {k: marks(*part) & (labels[_cells_of(part, cell)] == k) for k, part in parts.items()}
    beside, darker, noise = (np.zeros(len(boxes)) for _ in range(3))
    box = (2 * BESIDE + 1, 2 * (ACROSS + MEAN_RADIUS) + 1)
    for pair in pairs:
        limits = pair.limits(sigmas)
        for k, part in parts.items():
            short, long = (
                frame_rows(side.position, part[0])[:, part[1]] for side in (pair.short, pair.long)
            )
            source = _any_colour(long >= pair.saturated).view(np.uint8)
            beside[k] = np.count_nonzero(found[k] & (dilated(source, box) > 0))
            darker[k] += np.count_nonzero(found[k] & _darker(limits, short, long))
            noise[k] += NormalDist().cdf(-sigmas) * short.size
    count = np.zeros(len(boxes))
    for k, each in found.items():
        count[k] = np.count_nonzero(each)
    spreads = (count > 0) & (beside > (1 - LOST) * count) & (darker < LOST * count + noise)
    return np.asarray(cells & spreads[labels])


def _cells_of(part: tuple[slice, slice], cell: int) -> tuple[NDArray[np.intp], ...]:
    """Return the cell of each pixel of a part."""
    return np.ix_(*(np.arange(each.start, each.stop) // cell for each in part))


def _on_lines(
    limits: Limits,
    white: int,
    short: Pixels,
    long: Pixels,
    ranges: Ranges | None,
    every: tuple[int, int],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which pixels contradict in any colour, and which are saturated and do not."""
    found = limits.outside(short, long, ranges, every=every)
    return _any_colour(found), _any_colour((long >= white) & ~found)


def _beside(limits: Limits, white: int, short: Lines, long: Lines, ranges: Ranges | None) -> int:
    """Return how many contradicting pixels are connected to saturated ones along the rows."""
    found = _on_lines(limits, white, short.rows, long.rows, ranges, (short.every[1], 1))
    return int(np.count_nonzero(_connected_runs(*(each.T for each in found)))) * short.every[1]


def _lost(limits: Limits, short: Lines, long: Lines, source: NDArray[np.bool_]) -> int:
    """Return how many pixels connected to a source along the columns are darker than expected."""
    darker = _darker(limits, short.columns, long.columns)
    return int(np.count_nonzero(_connected_runs(darker, source))) * short.every[0]


def _has_one_factor(pair: Pair, marks: NDArray[np.bool_], short: Pixels, long: Pixels) -> bool:
    """Return whether marked pixels of the longer frame are brighter by one factor than expected.

    The first to the ninth tenth of them are, but for `MOST_CHANGE`: their light changed, as under
    lamps that flicker.
    """
    white, light = pair.saturated, pair.sensor.light
    marked = np.broadcast_to(
        marks if marks.ndim == short.ndim else marks[..., np.newaxis], short.shape
    )
    compared = marked & (short < white) & (long < white)
    before, after = (light[each[compared]] for each in (short, long))
    both = (before > 0) & (after > 0)
    # A few samples have one factor by chance, and where most are saturated it is not known.
    if not np.count_nonzero(both) > MOST * np.count_nonzero(marked):
        return False
    low, high = np.quantile(np.log(after[both] / before[both]), (0.1, 0.9))
    return bool(high - low < math.log(MOST_CHANGE))


def _darker(limits: Limits, short: Pixels, long: Pixels) -> NDArray[np.bool_]:
    """Return which pixels are darker in the longer frame than expected, in any colour."""
    brighter = replace(limits, low=np.zeros_like(limits.low))
    return _any_colour(brighter.outside(short, long))


def _connected_runs(found: NDArray[np.bool_], source: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which pixels found are connected to a source along their column."""
    rows = len(found)
    row, column = np.unravel_index(np.flatnonzero(found), found.shape)
    # One column after the other, with a free place after each.
    places = np.sort(column * (rows + 1) + row)
    connected = np.zeros_like(found)
    if not places.size:
        return connected
    column, row = np.divmod(places, rows + 1)
    begins = np.flatnonzero(np.diff(places, prepend=-2) > 1)
    ends = np.append(begins[1:], places.size) - 1
    has_source = np.logical_or.reduceat(source[row, column], begins)
    has_source |= source[np.maximum(row[begins] - 1, 0), column[begins]]
    has_source |= source[np.minimum(row[ends] + 1, rows - 1), column[ends]]
    chosen = np.repeat(has_source, ends - begins + 1)
    connected[row[chosen], column[chosen]] = True
    return connected


def _reach(found: NDArray[np.bool_], source: NDArray[np.bool_], least: float) -> int:
    """Return how far light spreads from saturated pixels, pixels along the columns.

    It does if at least a share of `least` of the pixels beside them contradict.  It is 0 where as
    many contradict far from saturated ones, as with things that moved.
    """
    within, rates = source, []
    distances = [ACROSS]
    while distances[-1] < BESIDE:
        distances.append(2 * distances[-1])
    for distance in distances:
        reached = dilated(source.view(np.uint8), (2 * distance + 1, 1)).view(np.bool_)
        ring = reached & ~within
        size = np.count_nonzero(ring)
        rates.append(np.count_nonzero(found & ring) / size if size >= _RING_SAMPLES else np.nan)
        if len(rates) == 2 and not max(rates) >= least:
            return 0
        within = reached
    for nearer, rate in zip(distances[:-1], rates[1:], strict=True):
        if rate <= _ENDS * max(rates[:2]):
            return nearer
    return 0


def _any_colour(marks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which pixels are marked in any of their colours."""
    # numpy's any over a short last axis is 15 times slower.
    return reduce(np.logical_or, np.moveaxis(marks, 2, 0)) if marks.ndim == 3 else marks
