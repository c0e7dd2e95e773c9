"""The light of cells and samples of frames that share errors of colours, compiled (extra `fast`).

One pass does what `camctl.pictures.chroma_light` and `camctl.model.joined_frames` do with numpy, in
their order and with float32; exponentials and probabilities differ by 1e-5 of them at most.  This
module is imported only where it is used.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.compiled_alike import BY_SAMPLE, OTHER, Joined, Tables, join_alike
from camctl.model.joined_frames import Cells
from camctl.model.light import KEPT_TABLES, Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.model.sensor import CLIPPING_SIGMAS, FILE_OFFSET
from camctl.model.step_posterior import REACH
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _HALF, _QUARTER = (np.float32(x) for x in (0, 1, 0.5, 0.25))
_BEYOND, _LARGEST_EXPONENT, _INFINITE = (np.float32(x) for x in (1e30, 50, np.inf))
_NONE, _SOME = (np.uint32(x) for x in range(2))
_DROPPED, _SATURATED = np.uint32(DROPPED), np.float32(2)
# Numbers without a sign, see `camctl.model.compiled_alike`.
_NULL, _ONCE, _TWO, _THREE, _FOUR = (np.uint64(x) for x in range(5))
#: Cells at a time, and their samples.
_CELLS, _SAMPLES = np.uint64(64), np.uint64(256)


def _starts(first: int, stop: int) -> list[np.uint64]:
    return [_SAMPLES * np.uint64(row) for row in range(first, stop)]


#: Rows of `_Lanes.rows`, of samples: first light; light, and errors' factor near 0; how far frames
#: are apart; whether it is of the frames that the first one of its cell is of; `JoinedFrames`.
_FIRST, _LIGHT, _NARROWER, _APART, _IS_EVEN = _starts(0, 5)
_ABOVE, _WEIGHTS, _OWN, _SHARED, _MORE, _SQUARES, _COUNT, _LEAST = _starts(5, 13)
#: Of frames together: light that they lose, the least and the most that there may be, and the
#: brightest and the darkest one that is seen.
_LOST, _LOW, _HIGH, _BRIGHTEST, _DARKEST = _starts(13, 18)
#: Of one frame: variance of colours; noise, error as light, both; light that others show, its
#: deviation, that of the difference; whether the sample counts, and its weight.
_CHROMA, _NOISE, _ERROR, _BOTH, _MEAN, _KNOWN, _SPREAD, _COUNTS, _WEIGHT = _starts(18, 27)
_ROWS = 27
#: Rows of `_Lanes.seen`, of each frame: value; error of its colours, levels; the least error of its
#: light; 1 where another colour hides the sample, 2 where it may be saturated.
_VALUE, _LEVELS, _LEAST_ERROR, _HIDING = _starts(0, 4)


class _Lanes(NamedTuple):
    """What is known of samples of some cells, side by side: the first ones of these come first.

    Attributes:
        rows: `_SAMPLES` each
        seen: rows of each frame, (n, 4 x `_SAMPLES`)
        shown: of a sample in each frame, see `Tables.of_values`, (n, 4 x `_SAMPLES`)
        pairs: the same, as `Tables.pairs`
        noises, of_light: of samples in a frame, see `Tables.of_bins`; and the same as numbers
        levels: of a frame
        bins: of light
        cells: which they are
        slots: their places in `Joined.places`
    """

    rows: Floats32
    seen: Floats32
    shown: Floats32
    pairs: NDArray[np.complex128]
    noises: NDArray[np.complex64]
    of_light: Floats32
    levels: NDArray[np.uint32]
    bins: NDArray[np.uint32]
    cells: NDArray[np.uint64]
    slots: NDArray[np.intp]

    @classmethod
    def new(cls, frames: int) -> _Lanes:
        """Return some of no cells."""
        count = int(_SAMPLES)
        pairs, noises = np.zeros((frames, count), np.complex128), np.zeros(count, np.complex64)
        return cls(
            np.zeros(_ROWS * count, np.float32),
            np.zeros((frames, 4 * count), np.float32),
            pairs.view(np.float32),
            pairs,
            noises,
            noises.view(np.float32),
            np.zeros(count, np.uint32),
            np.zeros(count, np.uint32),
            np.zeros(int(_CELLS), np.uint64),
            np.zeros(int(_CELLS), np.intp),
        )


@lru_cache(maxsize=KEPT_TABLES)
def _tables_of(tables: LightTables) -> Tables:
    """Return those of a colour."""
    sensor, bins, top = tables.sensor, tables.light_bins, tables.sensor.highest(None)
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


@_compiled
def _probability(x: float) -> float:
    """Return the normal distribution function."""
    return 0.5 * math.erfc(-x / math.sqrt(2))


@_compiled
def _bin(tables: Tables, light: np.float32) -> np.uint32:
    inside = np.float32(min(max(light, tables.ends[0]), tables.ends[1]))
    of_light: np.uint32 = (inside.view(np.uint32) >> _DROPPED) - np.uint32(tables.first)
    return of_light


@_compiled
def _begin(cells: Cells, tables: Tables, lanes: _Lanes, by_cell: bool) -> int:
    """Set the first light of samples, and its bins; return how many frames are looked at."""
    rows, top, last = lanes.rows, tables.ends[2], 1
    for k in range(_FOUR):
        for j in range(_CELLS):
            rows[_FIRST + k * _CELLS + j] = cells.light[k, lanes.cells[j]]
    for i in range(_SAMPLES):
        rows[_LOST + i] = rows[_LOW + i] = rows[_BRIGHTEST + i] = _ZERO
        rows[_HIGH + i] = rows[_DARKEST + i] = _BEYOND
        lanes.bins[i] = _bin(tables, rows[_FIRST + i])
    if by_cell:
        for j in range(_CELLS):
            lane = _FIRST + j
            both = rows[lane] + rows[lane + _CELLS]
            mean = (both + rows[lane + _TWO * _CELLS]) + rows[lane + _THREE * _CELLS]
            for k in range(_FOUR):
                lanes.bins[k * _CELLS + j] = _bin(tables, mean * _QUARTER)
    for each in range(1, len(tables.order)):
        at = tables.order[each]
        for j in range(_CELLS):
            for k in range(_FOUR):
                last = each + 1 if cells.values[at, k, lanes.cells[j]] <= top else last
    return last


@_compiled
def _look(cells: Cells, tables: Tables, lanes: _Lanes, each: int) -> bool:
    """Set what a frame shows of samples; return whether it may be that some are saturated."""
    rows, seen, shown, at = lanes.rows, lanes.seen[each], lanes.shown[each], tables.order[each]
    top, reach, offset, some = tables.ends[2], tables.ends[4], tables.ends[5], _NONE
    for k in range(_FOUR):
        for j in range(_CELLS):
            lane, c = k * _CELLS + j, lanes.cells[j]
            lanes.levels[lane] = cells.values[at, k, c]
            seen[_HIDING + lane] = _ONE if cells.hidden[at, k, c] else _ZERO
            seen[_LEVELS + lane], rows[_CHROMA + lane] = cells.errors[at, c], cells.of_chroma[at, c]
    for i in range(_SAMPLES):
        lanes.pairs[each, i] = tables.pairs[at, lanes.levels[i]]
    for i in range(_SAMPLES):
        value, error, lost = np.float32(lanes.levels[i]), seen[_LEVELS + i], rows[_LOST + i]
        sample, square, noise = shown[_FOUR * i], shown[_FOUR * i + _ONCE], shown[_FOUR * i + _TWO]
        is_dim = shown[_FOUR * i + _THREE] < lost
        seen[_VALUE + i], seen[_LEAST_ERROR + i] = value, np.sqrt(lost) if is_dim else _ZERO
        hiding = _SATURATED if value > top - reach * error else seen[_HIDING + i]
        some |= _SOME if (hiding == _SATURATED) & (value <= top) else _NONE
        seen[_HIDING + i] = hiding
        rows[_LOST + i] = max(lost, square * rows[_CHROMA + i] - noise)
        reached = np.sqrt(square * (error * error + offset) + noise) * reach
        is_seen = hiding == _ZERO
        least, most = sample - reached, sample + reached
        low, high = rows[_LOW + i], rows[_HIGH + i]
        brightest, darkest = rows[_BRIGHTEST + i], rows[_DARKEST + i]
        rows[_LOW + i] = max(low, least) if is_seen else low
        rows[_HIGH + i] = min(high, most) if is_seen else high
        rows[_BRIGHTEST + i] = max(brightest, sample) if is_seen else brightest
        rows[_DARKEST + i] = min(darkest, sample) if is_seen else darkest
    return bool(some > _NONE)


@_compiled
def _chance_of_seeing(
    mean: np.float32,
    known: np.float32,
    spread: np.float32,
    sample: np.float32,
    error: np.float32,
    levels: np.float32,
    full: np.float32,
) -> np.float32:
    """Return the probability that a sample is not saturated and then made darker by its file.

    `levels` is how far it is below saturation over the errors of colours; see `joined_frames`.
    """
    off = (sample - mean) / spread
    exponent = min((off * off - levels * levels) * _HALF, _LARGEST_EXPONENT)
    saturated = _probability((mean - full) / known) * math.exp(exponent) * spread
    return np.float32(error / (error + saturated)) if error > _ZERO else _ZERO


@_compiled
def _weigh(tables: Tables, lanes: _Lanes, each: int) -> None:
    """Set the weights of samples of a frame, but for the chance that they are seen."""
    rows, seen, shown, at = lanes.rows, lanes.seen[each], lanes.shown[each], tables.order[each]
    reach, top, full = tables.ends[4], tables.ends[2], tables.full[at]
    for i in range(_SAMPLES):
        lanes.noises[i] = tables.of_bins[at, lanes.bins[i]]
    for i in range(_SAMPLES):
        of_light = lanes.of_light[_TWO * i]
        noise, error = abs(of_light), seen[_LEVELS + i] * lanes.of_light[_TWO * i + _ONCE]
        hiding, sample, least = seen[_HIDING + i], shown[_FOUR * i], rows[_LEAST + i]
        both, weights, shared = noise + error * error, rows[_WEIGHTS + i], rows[_SHARED + i]
        is_known, is_saturated = weights > _ZERO, hiding == _SATURATED
        total, above = weights if is_known else _ONE, rows[_ABOVE + i]
        mean = above / total
        known = np.sqrt(rows[_OWN + i] + shared * shared) / total
        spread = np.sqrt(known * known + both)
        is_bright = above > full * _QUARTER * weights
        is_off = is_bright & (sample < mean - reach * spread)
        is_off |= (is_bright | is_saturated) & (mean - reach * known > full)
        is_off = is_off if is_known else is_saturated
        reached = reach * np.sqrt(both)
        is_off |= ((hiding > _ZERO) | (least > _ZERO)) & (sample + reached < least)
        counts = (of_light > _ZERO) & (seen[_VALUE + i] <= top) & (not is_off)
        rows[_LEAST + i] = max(least, sample - reached) if hiding > _ZERO else least
        rows[_COUNTS + i] = _ONE if counts else _ZERO
        rows[_WEIGHT + i] = _ONE / both if counts else _ZERO
        rows[_NOISE + i], rows[_ERROR + i], rows[_BOTH + i] = noise, error, both
        rows[_MEAN + i], rows[_KNOWN + i], rows[_SPREAD + i] = mean, known, spread


@_compiled
def _lessen(tables: Tables, lanes: _Lanes, each: int) -> None:
    """Multiply weights of samples that may be saturated by the chance that they are seen."""
    rows, seen, shown, white = lanes.rows, lanes.seen[each], lanes.shown[each], tables.ends[3]
    full = tables.full[tables.order[each]]
    for i in range(_SAMPLES):
        if rows[_COUNTS + i] > _ZERO and seen[_HIDING + i] == _SATURATED:
            mean, known, spread = rows[_MEAN + i], rows[_KNOWN + i], rows[_SPREAD + i]
            below = (white - seen[_VALUE + i]) / seen[_LEVELS + i]
            sample, error = shown[_FOUR * i], rows[_ERROR + i]
            rows[_WEIGHT + i] *= _chance_of_seeing(mean, known, spread, sample, error, below, full)


@_compiled
def _add(lanes: _Lanes, each: int) -> None:
    """Add the samples of a frame."""
    rows, seen, shown = lanes.rows, lanes.seen[each], lanes.shown[each]
    for i in range(_SAMPLES):
        weight, sample, error = rows[_WEIGHT + i], shown[_FOUR * i], rows[_ERROR + i]
        weighted, more = weight * sample, seen[_LEAST_ERROR + i] - error
        rows[_ABOVE + i] += weighted
        rows[_WEIGHTS + i] += weight
        rows[_OWN + i] += weight * weight * rows[_NOISE + i]
        rows[_SHARED + i] += weight * error
        rows[_SQUARES + i] += weighted * sample
        rows[_COUNT + i] += weight * rows[_BOTH + i]
        rows[_MORE + i] += weight * max(more, _ZERO)
    for k in range(_ONCE, _FOUR):
        for j in range(_CELLS):
            lane = k * _CELLS + j
            is_as_first = rows[_COUNTS + lane] == rows[_COUNTS + j]
            rows[_IS_EVEN + lane] = rows[_IS_EVEN + lane] if is_as_first else _ZERO


@_compiled
def _join(tables: Tables, lanes: _Lanes, last: int, dim: NDArray[np.bool_]) -> None:
    """Set the sums of samples, with the noise of their bins of light, and their light."""
    rows = lanes.rows
    for row in (_ABOVE, _WEIGHTS, _OWN, _SHARED, _MORE, _SQUARES, _COUNT, _LEAST):
        for i in range(_SAMPLES):
            rows[row + i] = _ZERO
    for i in range(_SAMPLES):
        rows[_IS_EVEN + i] = _ONE
    for each in range(last):
        _weigh(tables, lanes, each)
        if dim[each]:
            _lessen(tables, lanes, each)
        _add(lanes, each)
    reach = tables.ends[4]
    for i in range(_SAMPLES):
        weights = rows[_WEIGHTS + i]
        total = weights if weights > _ZERO else _ONE
        light, spread = rows[_ABOVE + i] / total, np.sqrt(_ONE / total)
        rows[_SPREAD + i] = spread if (weights > _ZERO) & (light < reach * spread) else _ZERO
        rows[_LIGHT + i] = light if weights > _ZERO else rows[_FIRST + i]
        rows[_NARROWER + i] = _ONE
    for i in range(_SAMPLES):
        if rows[_SPREAD + i] > _ZERO:
            light, narrower = _above_zero(rows[_LIGHT + i], rows[_SPREAD + i])
            rows[_LIGHT + i], rows[_NARROWER + i] = light, narrower


@_compiled
def _above_zero(mean: np.float32, spread: np.float32) -> tuple[np.float32, np.float32]:
    """Return the posterior mean above 0 of light, and its error's factor."""
    far: float = max(float(mean) / float(spread), -REACH)
    larger = math.exp(-far * far / 2) / math.sqrt(2 * math.pi) / _probability(far)
    narrower = math.sqrt(max(1 - larger * (far + larger), 1e-6))
    return np.float32(mean + spread * larger), np.float32(narrower)


@_compiled
def _write(cells: Cells, tables: Tables, lanes: _Lanes, found: Joined, j: np.uint64) -> None:
    """Set what is found of the samples of a cell."""
    rows, c, at, measured, all_expected = lanes.rows, lanes.cells[j], tables.order[0], _ZERO, _ZERO
    limit = tables.ends[2] - tables.ends[4] * cells.errors[at, c]
    for k in range(_FOUR):
        i = k * _CELLS + j
        weights, shared, apart = rows[_WEIGHTS + i], rows[_SHARED + i], rows[_APART + i]
        deviation, common = cells.deviation[k, c], cells.common[c] + apart * _HALF
        is_known, scatter, expected = deviation == deviation, _ZERO, _ZERO
        if weights > _ZERO:
            own, above, narrower = rows[_OWN + i], rows[_ABOVE + i], rows[_NARROWER + i]
            deviation = narrower * np.sqrt(own) / weights if is_known else deviation
            common = max(narrower * (shared + rows[_MORE + i]) / weights, apart * _HALF)
            scatter = max(rows[_SQUARES + i] - above * above / weights, _ZERO)
            expected = rows[_COUNT + i] - (own + shared * shared) / weights
        elif is_known and (cells.hidden[at, k, c] or cells.values[at, k, c] > limit):
            deviation = _INFINITE
        found.light[k, c] = rows[_LIGHT + i]
        found.of_samples[0, k, lanes.slots[j]], found.of_samples[1, k, lanes.slots[j]] = (
            deviation,
            common,
        )
        measured += scatter
        all_expected += expected
    found.scatter[0, c], found.scatter[1, c], found.kinds[c] = measured, all_expected, BY_SAMPLE


@_compiled
def _is_even(lanes: _Lanes, j: np.uint64) -> bool:
    """Return whether all samples of a cell are of the same frames, which agree."""
    is_even = True
    for k in range(_FOUR):
        i = k * _CELLS + j
        is_even &= lanes.rows[_IS_EVEN + i] > _ZERO and lanes.rows[_WEIGHTS + i] > _ZERO
        is_even &= lanes.rows[_APART + i] == _ZERO
    return is_even


@_compiled
def _join_some(
    cells: Cells,
    tables: Tables,
    slots: NDArray[np.intp],
    by_cell: bool,
    found: Joined,
    lanes: _Lanes,
    dim: NDArray[np.bool_],
) -> None:
    rows, count = lanes.rows, np.uint64(len(slots))
    for start in range(_NULL, count, _CELLS):
        for j in range(_CELLS):
            place = start + j
            # The last cell again where there are no more.
            lanes.slots[j] = slots[place if place < count else count - _ONCE]
            lanes.cells[j] = found.places[lanes.slots[j]]
        last = _begin(cells, tables, lanes, by_cell)
        for each in range(last):
            dim[each] = _look(cells, tables, lanes, each)
        for i in range(_SAMPLES):
            is_apart = rows[_LOW + i] > rows[_HIGH + i]
            rows[_APART + i] = rows[_BRIGHTEST + i] - rows[_DARKEST + i] if is_apart else _ZERO
        for again in range(1 if by_cell else 2):
            if again:
                for i in range(_SAMPLES):
                    lanes.bins[i] = _bin(tables, rows[_LIGHT + i])
            _join(tables, lanes, last, dim)
        for j in range(_CELLS):
            if by_cell and not _is_even(lanes, j):
                continue
            _write(cells, tables, lanes, found, j)


def join_cells(tables: LightTables, cells: Cells, chosen: NDArray[np.bool_]) -> Joined:
    """Return the light of cells, that of chosen ones from frames whose errors change weights."""
    of_colour, count = _tables_of(tables), len(cells.values)
    found = join_alike(cells, of_colour, chosen).by_sample()
    lanes, dim = _Lanes.new(count), np.empty(count, np.bool_)
    for by_cell in (True, False):
        # Samples of mixed cells, and of others that are of several frames, have their own weights.
        kinds = found.kinds.take(found.places)
        slots = np.flatnonzero(kinds == OTHER if by_cell else kinds != BY_SAMPLE)
        _join_some(cells, of_colour, slots, by_cell, found, lanes, dim)
    return found
