"""The light of cells whose frames count for all samples or for none, compiled (extra `fast`).

Most cells are such ones.  They are worked on side by side, in loops without branches, of which
processors do 8 to 16 at once: a tenth of the time that they take one by one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.joined_frames import Cells
from camctl.model.light import KEPT_TABLES, Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.model.sensor import CLIPPING_SIGMAS, FILE_OFFSET
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _QUARTER = (np.float32(x) for x in (0, 1, 0.25))
_BEYOND, _INFINITE = (np.float32(x) for x in (1e30, np.inf))
_DROPPED = np.uint32(DROPPED)
_NONE, _ONE_BIT = np.uint8(0), np.uint8(1)

AT_ONCE = 128
"""Cells that are joined at a time."""

# Numbers without a sign: an index that may be negative keeps loops from being done side by side.
_NULL, _ONCE, _TWO, _THREE, _FOUR = (np.uint64(x) for x in (0, 1, 2, 3, 4))
_ROW = np.uint64(AT_ONCE)


def _starts(first: int, stop: int, step: int = 1) -> list[np.uint64]:
    return [np.uint64(AT_ONCE * row) for row in range(first, stop, step)]


#: Rows of `Lanes.rows`, of cells: frames that are looked at; whether the cell is alike; sums of
#: `JoinedFrames`.
_LAST, _IS_ALIKE, _WEIGHTS, _OWN, _SHARED, _COUNT = _starts(0, 6)
#: Of a frame in them: noise and step, weight, most levels that are not saturated, square of errors;
#: sums before it; the sum from which on it may be too bright, which is too bright, and how much
#: less of it is too dark.
_NOISE, _STEP, _WEIGHT, _LIMIT, _SQUARE, _BEFORE, _BRIGHT, _MOST, _LESS = _starts(6, 15)
#: Of samples, four each: sums, and the variance of light that frames lose.
_ABOVE, _SQUARES, _LOST = _starts(15, 27, 4)
#: Of cells: whether another colour hides a sample, and that in a frame that may saturate one, and
#: whether all frames are saturated; the variance of a sample by the light of the cell, where one is
#: hidden.
_IS_HIDDEN, _IS_MIXED, _IS_WHITE, _BOTH = _starts(27, 31)
_ROWS = 31

ALIKE, KEPT, WHITE, BY_SAMPLE, OTHER, MIXED = (np.uint8(x) for x in range(6))
"""Kinds of cells: frames are alike for all samples; not chosen; all frames are saturated; samples
have errors of their own; not joined yet, without and with a sample that another colour hides."""


class Tables(NamedTuple):
    """What is tabulated of frames of a colour, see `LightTables`.

    Attributes:
        of_values: (n, white + 1, 4): light, squares of the step and of the noise, and the variance
            of the light from which on a sample may be saturated
        pairs: the same, (n, white + 1), which are copied at once
        of_bins: by bin of light, (n, B): squares of the noise, below 0 where it clips samples, and
            steps, which are copied at once
        full: light that just saturates each frame, (n,)
        ends: least and largest light of the bins; most levels of a sample that is not saturated,
            and white; deviations that no sample is off by; variance of offsets, levels squared
        first: number of the first bin
        order: of the frames, from the shortest to the longest, (n,)
    """

    of_values: Floats32
    pairs: NDArray[np.complex128]
    of_bins: NDArray[np.complex64]
    full: Floats32
    ends: Floats32
    first: int
    order: NDArray[np.uint64]


@lru_cache(maxsize=KEPT_TABLES)
def tables_of(tables: LightTables) -> Tables:
    """Return the tables of a colour."""
    sensor, bins, top = tables.sensor, tables.light_bins, tables.top
    squares, noises = tables.of_values
    offset = (FILE_OFFSET / 255 * (sensor.white - sensor.black)) ** 2
    levels = (top - np.arange(sensor.white + 1)) / np.float32(CLIPPING_SIGMAS)
    to_saturation = squares * np.square(levels)
    ends = bins.least, bins.brightest, top, sensor.white, CLIPPING_SIGMAS, offset
    of_values = np.stack(
        [tables.irradiance, squares, noises, to_saturation], axis=2, dtype=np.float32
    )
    noise = np.where(tables.clipped, -tables.variances, tables.variances)
    return Tables(
        of_values,
        of_values.view(np.complex128)[..., 0],
        np.stack([noise, tables.steps], axis=2, dtype=np.float32).view(np.complex64)[..., 0],
        (sensor.full / tables.exposures).astype(np.float32),
        np.array(ends, np.float32),
        bins.first,
        np.argsort(tables.exposures, kind="stable").astype(np.uint64),
    )


class Joined(NamedTuple):
    """The light of cells, and its errors.

    Attributes:
        light: of samples, (4, C)
        own, common: standard deviation by what each frame has of its own, and by what frames have
            in common, of cells whose frames are alike, (C,)
        scatter: of the frames, and what noise makes of it, sums of the samples, (2, C)
        kinds: of the cells, (C,)
        places: cells whose samples have errors of their own, ascending, first ones of (C,)
        of_samples: `own` and `common` of these, (2, 4, C)
    """

    light: Floats32
    own: Floats32
    common: Floats32
    scatter: Floats32
    kinds: NDArray[np.uint8]
    places: NDArray[np.intp]
    of_samples: Floats32

    @classmethod
    def of(cls, count: int) -> Joined:
        """Return it for so many cells; nothing of them is known."""
        return cls(
            np.empty((4, count), np.float32),
            np.empty(count, np.float32),
            np.empty(count, np.float32),
            np.empty((2, count), np.float32),
            np.empty(count, np.uint8),
            np.empty(count, np.intp),
            np.empty((2, 4, count), np.float32),
        )


class Lanes(NamedTuple):
    """What is known of some cells, side by side.

    Attributes:
        rows: `AT_ONCE` each
        bins: of light
        noises, of_light: of them in a frame, see `Tables.of_bins`; and the same as numbers
        shown: of a sample, see `Tables.of_values`, and the same, as `Tables.pairs`
    """

    rows: Floats32
    bins: NDArray[np.uint32]
    noises: NDArray[np.complex64]
    of_light: Floats32
    shown: Floats32
    pairs: NDArray[np.complex128]

    @classmethod
    def new(cls) -> Lanes:
        """Return some of no cells."""
        pairs, noises = np.zeros(AT_ONCE, np.complex128), np.zeros(AT_ONCE, np.complex64)
        rows, bins = np.zeros(_ROWS * AT_ONCE, np.float32), np.zeros(AT_ONCE, np.uint32)
        return cls(rows, bins, noises, noises.view(np.float32), pairs.view(np.float32), pairs)


@_compiled
def _begin(cells: Cells, tables: Tables, lanes: Lanes, start: np.uint64, count: np.uint64) -> int:
    """Set which frames of cells are looked at, and which cells are mixed; return their number."""
    rows, light, most = lanes.rows, cells.light, _ONE
    top, reach = tables.ends[2], tables.ends[4]
    for row in (_WEIGHTS, _OWN, _SHARED, _COUNT):
        for j in range(count):
            rows[row + j] = _ZERO
    for j in range(_THREE * _FOUR * _ROW):
        rows[_ABOVE + j] = _ZERO
    for j in range(count):
        rows[_LAST + j], rows[_IS_HIDDEN + j], rows[_IS_MIXED + j] = _ONE, _ZERO, _ZERO
    for each in range(len(tables.order)):
        at = tables.order[each]
        for j in range(count):
            c, values, hidden = start + j, cells.values, cells.hidden
            one, two = (
                min(values[at, 0, c], values[at, 1, c]),
                min(values[at, 2, c], values[at, 3, c]),
            )
            is_seen = min(one, two) <= top
            hides = hidden[at, 0, c] | hidden[at, 1, c] | hidden[at, 2, c] | hidden[at, 3, c]
            brightest = max(
                max(values[at, 0, c], values[at, 1, c]), max(values[at, 2, c], values[at, 3, c])
            )
            hides &= is_seen
            may_be_white = hides & (brightest > top - reach * cells.errors[at, c])
            rows[_LAST + j] = np.float32(each + 1) if is_seen else rows[_LAST + j]
            rows[_IS_HIDDEN + j] = _ONE if hides else rows[_IS_HIDDEN + j]
            rows[_IS_MIXED + j] = _ONE if may_be_white else rows[_IS_MIXED + j]
    at = tables.order[0]
    for j in range(count):
        c, values = start + j, cells.values
        lowest = min(
            min(values[at, 0, c], values[at, 1, c]), min(values[at, 2, c], values[at, 3, c])
        )
        is_white = (lowest > top - reach * cells.errors[at, c]) & (rows[_LAST + j] == _ONE)
        rows[_IS_WHITE + j] = _ONE if is_white else _ZERO
        most = max(most, rows[_LAST + j])
    least, brightest, first = tables.ends[0], tables.ends[1], np.uint32(tables.first)
    for j in range(count):
        c = start + j
        mean = (((light[0, c] + light[1, c]) + light[2, c]) + light[3, c]) * _QUARTER
        inside = np.float32(min(max(mean, least), brightest))
        lanes.bins[j] = (inside.view(np.uint32) >> _DROPPED) - first
    return int(most)


@_compiled
def _weigh(
    cells: Cells, tables: Tables, lanes: Lanes, start: np.uint64, count: np.uint64, each: int
) -> None:
    """Set the weight of a frame, and what shorter ones say of it."""
    rows, at, frame = lanes.rows, tables.order[each], np.float32(each)
    full, top, reach, offset = tables.full[at], tables.ends[2], tables.ends[4], tables.ends[5]
    for j in range(count):
        lanes.noises[j] = tables.of_bins[at, lanes.bins[j]]
    for j in range(count):
        levels, of_light = cells.errors[at, start + j], lanes.of_light[_TWO * j]
        noise = of_light if of_light > _ZERO else _BEYOND
        error = levels * lanes.of_light[_TWO * j + _ONCE]
        both = noise + error * error
        counts = (rows[_LAST + j] > frame) & (noise < _BEYOND)
        weight = _ONE / both if counts else _ZERO
        weights, own, shared = rows[_WEIGHTS + j], rows[_OWN + j], rows[_SHARED + j]
        known = np.sqrt(own + shared * shared) / weights
        spread = np.sqrt(known * known + both)
        rows[_WEIGHT + j], rows[_LIMIT + j] = weight, top - reach * levels
        rows[_SQUARE + j], rows[_BEFORE + j] = levels * levels + offset, weights
        rows[_BOTH + j] = both if rows[_IS_HIDDEN + j] > _ZERO else _BEYOND
        is_used = (weight * weight > _ZERO) & (weights > _ZERO)
        rows[_BRIGHT + j] = full * _QUARTER * weights if is_used else _INFINITE
        rows[_MOST + j], rows[_LESS + j] = (
            (full + reach * known) * weights,
            reach * spread * weights,
        )
        rows[_WEIGHTS + j] = weights + weight
        rows[_OWN + j] = own + weight * weight * noise
        rows[_SHARED + j] = shared + weight * error
        rows[_COUNT + j] += weight * both


@_compiled
def _add(
    cells: Cells,
    tables: Tables,
    lanes: Lanes,
    start: np.uint64,
    count: np.uint64,
    each: int,
    k: np.uint64,
) -> None:
    """Add a sample of cells of a frame, and see whether it is like the others."""
    rows, shown, at, frame = lanes.rows, lanes.shown, tables.order[each], np.float32(each)
    reach = tables.ends[4] * tables.ends[4]
    above_k, squares_k, lost_k = (
        _ABOVE + k * _ROW,
        _SQUARES + k * _ROW,
        _LOST + k * _ROW,
    )
    for j in range(count):
        lanes.pairs[j] = tables.pairs[at, cells.values[at, k, start + j]]
    for j in range(count):
        i = _FOUR * j
        sample, square, noise = shown[i], shown[i + _ONCE], shown[i + _TWO]
        off = sample - max(cells.light[k, start + j], _ZERO)
        above, lost = rows[above_k + j], rows[lost_k + j]
        value = np.float32(cells.values[at, k, start + j])
        differs = (value > rows[_LIMIT + j]) | (shown[i + _THREE] < lost)
        variance = min(square * rows[_SQUARE + j] + noise, rows[_BOTH + j])
        differs |= off * off > reach * variance
        dark = sample * rows[_BEFORE + j] < above - rows[_LESS + j]
        differs |= (above > rows[_BRIGHT + j]) & ((above > rows[_MOST + j]) | dark)
        differs &= rows[_LAST + j] > frame
        rows[_IS_ALIKE + j] = _ZERO if differs else rows[_IS_ALIKE + j]
        rows[lost_k + j] = max(lost, square * cells.of_chroma[at, start + j] - noise)
        weighted = rows[_WEIGHT + j] * sample
        rows[above_k + j] = above + weighted
        rows[squares_k + j] += weighted * sample


@_compiled
def _write(
    cells: Cells,
    found: Joined,
    lanes: Lanes,
    start: np.uint64,
    count: np.uint64,
    reach: np.float32,
) -> None:
    """Set what is found of cells, which holds where they are alike."""
    rows, deviation = lanes.rows, cells.deviation
    for j in range(count):
        weights, shared, c = rows[_WEIGHTS + j], rows[_SHARED + j], start + j
        one, two, three, four = deviation[0, c], deviation[1, c], deviation[2, c], deviation[3, c]
        whole = (one + two) + (three + four)
        is_unknown = (one != one) & (two != two) & (three != three) & (four != four)
        is_one = (weights > _ZERO) & ((whole == whole) | is_unknown)
        total = weights if weights > _ZERO else _ONE
        own = np.sqrt(rows[_OWN + j]) / total
        rows[_NOISE + j], rows[_STEP + j] = whole if is_unknown else own, shared / total
        less = rows[_COUNT + j] - (rows[_OWN + j] + shared * shared) / total
        rows[_LESS + j] = ((less + less) + less) + less
        rows[_MOST + j] = reach * np.sqrt(_ONE / total)
        rows[_BEFORE + j], rows[_SQUARE + j] = total, _ZERO
        rows[_IS_ALIKE + j] = rows[_IS_ALIKE + j] if is_one else _ZERO
    for k in range(_FOUR):
        for j in range(count):
            sums = k * _ROW + j
            above, weights, is_alike = rows[_ABOVE + sums], rows[_BEFORE + j], rows[_IS_ALIKE + j]
            mean = above / weights
            rows[_IS_ALIKE + j] = _ZERO if mean < rows[_MOST + j] else is_alike
            rows[_SQUARE + j] += max(rows[_SQUARES + sums] - above * above / weights, _ZERO)
            found.light[k, start + j] = mean
    for j in range(count):
        c = start + j
        found.own[c], found.common[c] = rows[_NOISE + j], rows[_STEP + j]
        found.scatter[0, c], found.scatter[1, c] = rows[_SQUARE + j], rows[_LESS + j]


@_compiled
def _keep(
    cells: Cells, found: Joined, kinds: NDArray[np.uint8], start: np.uint64, count: np.uint64
) -> None:
    """Leave the light of cells as it is where no frame says more of it."""
    for j in range(count):
        c = start + j
        if kinds[c] == KEPT or kinds[c] == WHITE:
            for k in range(4):
                found.light[k, c] = cells.light[k, c]
            found.scatter[0, c] = found.scatter[1, c] = _ZERO


@_compiled
def join_alike(
    cells: Cells,
    tables: Tables,
    chosen: NDArray[np.bool_],
    found: Joined,
    lanes: Lanes,
    first: np.uint64,
    stop: np.uint64,
) -> None:
    """Set the light of some cells, each frame of which counts for all samples or for none.

    Weights are those of the cell, where no sample may be saturated or made darker, and frames do
    not contradict each other, since the first light is in reach of all of them.
    """
    rows, kinds = lanes.rows, found.kinds
    for start in range(first, stop, _ROW):
        count, some = min(_ROW, stop - start), _ZERO
        frames = _begin(cells, tables, lanes, start, count)
        for j in range(count):
            is_one = chosen[start + j] & (rows[_IS_MIXED + j] + rows[_IS_WHITE + j] == _ZERO)
            rows[_IS_ALIKE + j] = _ONE if is_one else _ZERO
            some += rows[_IS_ALIKE + j]
        if some > _ZERO:
            for each in range(frames):
                _weigh(cells, tables, lanes, start, count, each)
                for k in range(_FOUR):
                    _add(cells, tables, lanes, start, count, each, k)
            _write(cells, found, lanes, start, count, tables.ends[4])
        kept = _NONE
        for j in range(count):
            is_chosen, is_white = chosen[start + j], rows[_IS_WHITE + j] > _ZERO
            rest = MIXED if rows[_IS_MIXED + j] > _ZERO else OTHER
            kind = ALIKE if rows[_IS_ALIKE + j] > _ZERO else rest
            kept |= _NONE if is_chosen & (not is_white) else _ONE_BIT
            kinds[start + j] = (WHITE if is_white else kind) if is_chosen else KEPT
        if kept:
            _keep(cells, found, kinds, start, count)
