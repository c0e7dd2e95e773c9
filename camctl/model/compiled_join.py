"""The light of cells and samples of frames that share errors of colours, compiled (extra `fast`).

One pass does what `camctl.pictures.chroma_light` and `camctl.model.joined_frames` do with numpy, in
their order and with float32; exponentials and probabilities differ by 2e-5 of them at most.  This
module is imported only where it is used.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.compiled_alike import (
    BY_SAMPLE,
    MIXED,
    OTHER,
    Joined,
    Lanes,
    Tables,
    join_alike,
    tables_of,
)
from camctl.model.compiled_normal import exponential, probability
from camctl.model.joined_frames import Cells
from camctl.model.light import Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.model.step_posterior import REACH
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _HALF, _QUARTER = (np.float32(x) for x in (0, 1, 0.5, 0.25))
_BEYOND, _LARGEST_EXPONENT, _INFINITE = (np.float32(x) for x in (1e30, 50, np.inf))
_NONE, _SOME = (np.uint32(x) for x in range(2))
_DROPPED = np.uint32(DROPPED)
# Numbers without a sign, see `camctl.model.compiled_alike`.
_NULL, _ONCE, _TWO, _THREE, _FOUR, _SEVEN = (np.uint64(x) for x in (0, 1, 2, 3, 4, 7))
#: Cells side by side, and their samples: their rows stay in a cache of 48 kB.
_CELLS, _SAMPLES = np.uint64(32), np.uint64(128)
#: Cells at a time: they stay in a cache of 1 MB until those that are not alike are looked at.
_AT_ONCE = np.uint64(6144)


def _starts(first: int, stop: int) -> list[np.uint64]:
    return [_SAMPLES * np.uint64(row) for row in range(first, stop)]


#: Rows of `_Lanes.rows`, of samples: first light; light, and errors' factor near 0; how far frames
#: are apart; whether it is of the frames that the first one of its cell is of; `JoinedFrames`.
_FIRST, _LIGHT, _NARROWER, _APART, _IS_EVEN = _starts(0, 5)
_ABOVE, _WEIGHTS, _OWN, _SHARED, _MORE, _SQUARES, _COUNT, _LEAST = _starts(5, 13)
#: Of frames together: light that they lose, the least and the most that there may be, and the
#: brightest and the darkest one that is seen.
_LOST, _LOW, _HIGH, _BRIGHTEST, _DARKEST = _starts(13, 18)
#: Of one frame: noise, error as light; light that others show, its deviation, that of the
#: difference; whether the sample counts, and its weight.
_NOISE, _ERROR, _MEAN, _KNOWN, _SPREAD, _COUNTS, _WEIGHT = _starts(18, 25)
#: Deviation without errors in common, and what these add; scatter of frames, and what noise makes
#: of it.
_DEVIATION, _COMMON, _SCATTER, _EXPECTED = _starts(25, 29)
#: Of the cells of one frame: variance of colours.
_CHROMA = _starts(29, 30)[0]
#: Of some samples: their difference from what others show, over its deviation, and how far that is
#: above saturation; how far they are below it; deviation of the difference; error as light.
_OFF, _FAR, _BELOW, _WIDE, _NARROW = _starts(30, 35)
_ROWS = 35
#: Rows of `_Lanes.seen`, of each frame: light; its least error; what hides it.  Of the cells: error
#: of colours, levels.
_SAMPLE, _LEAST_ERROR, _HIDING, _LEVELS = _starts(0, 4)
#: What hides a sample: nothing, another colour, or that it may be saturated, or is.
_SEEN, _HIDDEN, _DIM, _WHITE = (np.float32(x) for x in range(4))
_IS_HIDDEN = np.uint8(1)


class _Lanes(NamedTuple):
    """What is known of samples of some cells, side by side: the first ones of these come first.

    Attributes:
        rows: `_SAMPLES` each
        seen: rows of each frame, (n, 4 x `_SAMPLES`)
        values: of each frame, (n, `_SAMPLES`)
        hidden: whether another colour hides samples of a frame
        pairs, shown: of samples in a frame, see `Tables.pairs`; and the same as numbers
        noises, of_light: of samples in a frame, see `Tables.of_bins`; and the same as numbers
        bins: of light
        some: samples of a frame
        cells: which they are
        slots: their places in `Joined.places`
    """

    rows: Floats32
    seen: Floats32
    values: NDArray[np.uint8]
    hidden: NDArray[np.uint8]
    pairs: NDArray[np.complex128]
    shown: Floats32
    noises: NDArray[np.complex64]
    of_light: Floats32
    bins: NDArray[np.uint32]
    some: NDArray[np.uint64]
    cells: NDArray[np.uint64]
    slots: NDArray[np.intp]

    @classmethod
    def new(cls, frames: int, values: np.dtype[Any]) -> _Lanes:
        """Return some of no cells."""
        count = int(_SAMPLES)
        pairs, noises = np.zeros(count, np.complex128), np.zeros(count, np.complex64)
        return cls(
            np.zeros(_ROWS * count, np.float32),
            np.zeros((frames, 4 * count), np.float32),
            np.zeros((frames, count), values),
            np.zeros(count, np.uint8),
            pairs,
            pairs.view(np.float32),
            noises,
            noises.view(np.float32),
            np.zeros(count, np.uint32),
            np.zeros(count, np.uint64),
            np.zeros(int(_CELLS), np.uint64),
            np.zeros(int(_CELLS), np.intp),
        )


@_compiled
def _bin(tables: Tables, light: np.float32) -> np.uint32:
    inside = np.float32(min(max(light, tables.ends[0]), tables.ends[1]))
    of_light: np.uint32 = (inside.view(np.uint32) >> _DROPPED) - np.uint32(tables.first)
    return of_light


@_compiled
def _begin(cells: Cells, tables: Tables, lanes: _Lanes, by_cell: bool) -> int:
    """Set the first light of samples, and its bins; return how many frames are looked at."""
    rows, top, last = lanes.rows, tables.ends[2], len(tables.order)
    for j in range(_CELLS):
        c = lanes.cells[j]
        rows[_COMMON + j] = cells.common[c]
        for k in range(_FOUR):
            rows[_FIRST + k * _CELLS + j] = cells.light[k, c]
            rows[_DEVIATION + k * _CELLS + j] = cells.deviation[k, c]
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
    darkest = top + _ONE
    while last > 0 and darkest > top:
        at, values = tables.order[last - 1], lanes.values[last - 1]
        least = values[0]
        for j in range(_CELLS):
            for k in range(_FOUR):
                values[k * _CELLS + j] = cells.values[at, k, lanes.cells[j]]
        for i in range(_SAMPLES):
            least = min(least, values[i])
        darkest, last = np.float32(least), last - 1
    return last + 1


@_compiled
def _read(cells: Cells, tables: Tables, lanes: _Lanes, each: int, last: int) -> None:
    """Set what a frame has of samples."""
    rows, seen, values, at = lanes.rows, lanes.seen[each], lanes.values[each], tables.order[each]
    for j in range(_CELLS):
        c = lanes.cells[j]
        seen[_LEVELS + j], rows[_CHROMA + j] = cells.errors[at, c], cells.of_chroma[at, c]
        for k in range(_FOUR):
            lanes.hidden[k * _CELLS + j] = cells.hidden[at, k, c]
    if each + 1 < last:
        for j in range(_CELLS):
            c = lanes.cells[j]
            for k in range(_FOUR):
                values[k * _CELLS + j] = cells.values[at, k, c]
    for i in range(_SAMPLES):
        lanes.pairs[i] = tables.pairs[at, values[i]]


@_compiled
def _look(tables: Tables, lanes: _Lanes, each: int) -> bool:
    """Set what a frame shows of samples; return whether it may be that some are saturated."""
    rows, seen, shown, values = lanes.rows, lanes.seen[each], lanes.shown, lanes.values[each]
    top, reach, offset, some = tables.ends[2], tables.ends[4], tables.ends[5], _NONE
    for k in range(_FOUR):
        for j in range(_CELLS):
            i = k * _CELLS + j
            value, error, lost = np.float32(values[i]), seen[_LEVELS + j], rows[_LOST + i]
            sample, square = shown[_FOUR * i], shown[_FOUR * i + _ONCE]
            noise = shown[_FOUR * i + _TWO]
            is_dim = shown[_FOUR * i + _THREE] < lost
            seen[_SAMPLE + i], seen[_LEAST_ERROR + i] = sample, np.sqrt(lost) if is_dim else _ZERO
            hiding = _HIDDEN if lanes.hidden[i] == _IS_HIDDEN else _SEEN
            hiding = _DIM if value > top - reach * error else hiding
            some |= _SOME if (hiding == _DIM) & (value <= top) else _NONE
            seen[_HIDING + i] = _WHITE if value > top else hiding
            rows[_LOST + i] = max(lost, square * rows[_CHROMA + j] - noise)
            reached = np.sqrt(square * (error * error + offset) + noise) * reach
            is_seen = hiding == _SEEN
            least, most = sample - reached, sample + reached
            low, high = rows[_LOW + i], rows[_HIGH + i]
            brightest, darkest = rows[_BRIGHTEST + i], rows[_DARKEST + i]
            rows[_LOW + i] = max(low, least) if is_seen else low
            rows[_HIGH + i] = min(high, most) if is_seen else high
            rows[_BRIGHTEST + i] = max(brightest, sample) if is_seen else brightest
            rows[_DARKEST + i] = min(darkest, sample) if is_seen else darkest
    return bool(some > _NONE)


@_compiled
def _start(tables: Tables, lanes: _Lanes, is_last: bool) -> None:
    """Set the sums of samples to what the first frame shows."""
    rows, seen, at, reach = lanes.rows, lanes.seen[0], tables.order[0], tables.ends[4]
    for lane in range(_SAMPLES):
        lanes.noises[lane] = tables.of_bins[at, lanes.bins[lane]]
    for k in range(_FOUR):
        for j in range(_CELLS):
            i = k * _CELLS + j
            of_light, hiding, sample = (
                lanes.of_light[_TWO * i],
                seen[_HIDING + i],
                seen[_SAMPLE + i],
            )
            noise, error = abs(of_light), seen[_LEVELS + j] * lanes.of_light[_TWO * i + _ONCE]
            both = noise + error * error
            reached = reach * np.sqrt(both)
            counts = (of_light > _ZERO) & (hiding < _DIM)
            counts &= (hiding == _SEEN) | (sample + reached >= _ZERO)
            weight = _ONE / both if counts else _ZERO
            rows[_LEAST + i] = max(sample - reached, _ZERO) if hiding > _SEEN else _ZERO
            rows[_COUNTS + i] = _ONE if counts else _ZERO
            weighted = weight * sample
            rows[_ABOVE + i], rows[_WEIGHTS + i] = weighted, weight
            rows[_OWN + i], rows[_SHARED + i] = weight * weight * noise, weight * error
            if is_last:
                rows[_SQUARES + i], rows[_COUNT + i] = weighted * sample, weight * both
                rows[_MORE + i] = weight * max(seen[_LEAST_ERROR + i] - error, _ZERO)


@_compiled
def _weigh(tables: Tables, lanes: _Lanes, each: int) -> None:
    """Set the weights of samples of a frame, but for the chance that they are seen."""
    rows, seen, at = lanes.rows, lanes.seen[each], tables.order[each]
    reach, full = tables.ends[4], tables.full[at]
    for lane in range(_SAMPLES):
        lanes.noises[lane] = tables.of_bins[at, lanes.bins[lane]]
    for k in range(_FOUR):
        for j in range(_CELLS):
            i = k * _CELLS + j
            of_light = lanes.of_light[_TWO * i]
            noise, error = abs(of_light), seen[_LEVELS + j] * lanes.of_light[_TWO * i + _ONCE]
            hiding, sample, least = seen[_HIDING + i], seen[_SAMPLE + i], rows[_LEAST + i]
            both, weights, shared = noise + error * error, rows[_WEIGHTS + i], rows[_SHARED + i]
            is_known, is_saturated = weights > _ZERO, hiding >= _DIM
            total, above = weights if is_known else _ONE, rows[_ABOVE + i]
            mean = above / total
            known = np.sqrt(rows[_OWN + i] + shared * shared) / total
            spread = np.sqrt(known * known + both)
            is_bright = above > full * _QUARTER * weights
            is_off = is_bright & (sample < mean - reach * spread)
            is_off |= (is_bright | is_saturated) & (mean - reach * known > full)
            is_off = is_off if is_known else is_saturated
            reached = reach * np.sqrt(both)
            is_off |= ((hiding > _SEEN) | (least > _ZERO)) & (sample + reached < least)
            counts = (of_light > _ZERO) & (hiding < _WHITE) & (not is_off)
            rows[_LEAST + i] = max(least, sample - reached) if hiding > _SEEN else least
            rows[_COUNTS + i] = _ONE if counts else _ZERO
            rows[_WEIGHT + i] = _ONE / both if counts else _ZERO
            rows[_NOISE + i], rows[_ERROR + i] = noise, error
            rows[_MEAN + i], rows[_KNOWN + i], rows[_SPREAD + i] = mean, known, spread


@_compiled
def _lessen(tables: Tables, lanes: _Lanes, each: int) -> None:
    """Multiply weights of samples that may be saturated by the chance that they are seen.

    It is the probability that they are not saturated and then made darker by their file, see
    `camctl.model.joined_frames`.
    """
    rows, seen, values, count = lanes.rows, lanes.seen[each], lanes.values[each], _NULL
    full, white = tables.full[tables.order[each]], tables.ends[3]
    for i in range(_SAMPLES):
        lanes.some[count] = i
        count += _ONCE if (rows[_COUNTS + i] > _ZERO) & (seen[_HIDING + i] == _DIM) else _NULL
    for some in range(count):
        i = lanes.some[some]
        rows[_OFF + some] = (seen[_SAMPLE + i] - rows[_MEAN + i]) / rows[_SPREAD + i]
        rows[_FAR + some] = (rows[_MEAN + i] - full) / rows[_KNOWN + i]
        rows[_BELOW + some] = (white - np.float32(values[i])) / seen[_LEVELS + i % _CELLS]
        rows[_WIDE + some], rows[_NARROW + some] = rows[_SPREAD + i], rows[_ERROR + i]
    for some in range(count + _SEVEN & ~_SEVEN):  # whole vectors; nothing reads what is beyond
        off, below, error = rows[_OFF + some], rows[_BELOW + some], rows[_NARROW + some]
        exponent = min((off * off - below * below) * _HALF, _LARGEST_EXPONENT)
        odds = probability(rows[_FAR + some]) * exponential(exponent) * rows[_WIDE + some]
        rows[_OFF + some] = error / (error + odds) if error > _ZERO else _ZERO
    for some in range(count):
        rows[_WEIGHT + lanes.some[some]] *= rows[_OFF + some]


@_compiled
def _add(lanes: _Lanes, each: int, is_last: bool) -> None:
    """Add the samples of a frame."""
    rows, seen = lanes.rows, lanes.seen[each]
    for i in range(_SAMPLES):
        weight, sample, error = rows[_WEIGHT + i], seen[_SAMPLE + i], rows[_ERROR + i]
        noise, weighted = rows[_NOISE + i], weight * sample
        rows[_ABOVE + i] += weighted
        rows[_WEIGHTS + i] += weight
        rows[_OWN + i] += weight * weight * noise
        rows[_SHARED + i] += weight * error
        if is_last:
            rows[_SQUARES + i] += weighted * sample
            rows[_COUNT + i] += weight * (noise + error * error)
            rows[_MORE + i] += weight * max(seen[_LEAST_ERROR + i] - error, _ZERO)


@_compiled
def _compare(lanes: _Lanes) -> None:
    """See whether samples of a cell are of the same frames."""
    rows = lanes.rows
    for k in range(_ONCE, _FOUR):
        for j in range(_CELLS):
            lane = k * _CELLS + j
            is_as_first = rows[_COUNTS + lane] == rows[_COUNTS + j]
            rows[_IS_EVEN + j] = rows[_IS_EVEN + j] if is_as_first else _ZERO


@_compiled
def _join(tables: Tables, lanes: _Lanes, last: int, dim: NDArray[np.bool_], is_last: bool) -> None:
    """Set the sums of samples, with the noise of their bins of light, and their light."""
    rows = lanes.rows
    for j in range(_CELLS):
        rows[_IS_EVEN + j] = _ONE
    for each in range(last):
        if each == 0:
            _start(tables, lanes, is_last)
        else:
            _weigh(tables, lanes, each)
            if dim[each]:
                _lessen(tables, lanes, each)
            _add(lanes, each, is_last)
        _compare(lanes)
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
    beyond = 0.5 * math.erfc(-far / math.sqrt(2))
    larger = math.exp(-far * far / 2) / math.sqrt(2 * math.pi) / beyond
    narrower = math.sqrt(max(1 - larger * (far + larger), 1e-6))
    return np.float32(mean + spread * larger), np.float32(narrower)


@_compiled
def _finish(lanes: _Lanes) -> None:
    """Set the errors of samples, and the scatter of frames."""
    rows, seen = lanes.rows, lanes.seen[0]
    for k in range(_FOUR):
        for j in range(_CELLS):
            i = k * _CELLS + j
            weights, shared, apart = rows[_WEIGHTS + i], rows[_SHARED + i], rows[_APART + i]
            deviation, own, narrower = rows[_DEVIATION + i], rows[_OWN + i], rows[_NARROWER + i]
            is_known, above = deviation == deviation, rows[_ABOVE + i]
            is_found = weights > _ZERO
            total = weights if is_found else _ONE
            is_white = is_known & (seen[_HIDING + i] > _SEEN)
            missing, half = _INFINITE if is_white else deviation, apart * _HALF
            found = narrower * np.sqrt(own) / total if is_known else deviation
            common = max(narrower * (shared + rows[_MORE + i]) / total, half)
            rows[_DEVIATION + i] = found if is_found else missing
            rows[_WEIGHT + i] = common if is_found else rows[_COMMON + j] + half
            scatter = max(rows[_SQUARES + i] - above * above / total, _ZERO)
            expected = rows[_COUNT + i] - (own + shared * shared) / total
            rows[_SCATTER + i] = scatter if is_found else _ZERO
            rows[_EXPECTED + i] = expected if is_found else _ZERO
    for row in (_SCATTER, _EXPECTED):
        for k in range(_ONCE, _FOUR):
            for j in range(_CELLS):
                rows[row + j] += rows[row + k * _CELLS + j]


@_compiled
def _write(lanes: _Lanes, found: Joined, j: np.uint64) -> None:
    """Set what is found of the samples of a cell."""
    rows, c, slot = lanes.rows, lanes.cells[j], lanes.slots[j]
    for k in range(_FOUR):
        i = k * _CELLS + j
        found.light[k, c] = rows[_LIGHT + i]
        found.of_samples[0, k, slot] = rows[_DEVIATION + i]
        found.of_samples[1, k, slot] = rows[_WEIGHT + i]
    found.scatter[0, c], found.scatter[1, c] = rows[_SCATTER + j], rows[_EXPECTED + j]
    found.kinds[c] = BY_SAMPLE


@_compiled
def _is_even(lanes: _Lanes, j: np.uint64) -> bool:
    """Return whether all samples of a cell are of the same frames, which agree."""
    is_even = bool(lanes.rows[_IS_EVEN + j] > _ZERO)
    for k in range(_FOUR):
        i = k * _CELLS + j
        is_even &= lanes.rows[_WEIGHTS + i] > _ZERO and lanes.rows[_APART + i] == _ZERO
    return is_even


@_compiled
def _join_some(
    cells: Cells,
    tables: Tables,
    slots: NDArray[np.intp],
    count: np.uint64,
    by_cell: bool,
    found: Joined,
    lanes: _Lanes,
    dim: NDArray[np.bool_],
) -> None:
    rows = lanes.rows
    for start in range(_NULL, count, _CELLS):
        for j in range(_CELLS):
            place = start + j
            # The last cell again where there are no more.
            lanes.slots[j] = slots[place if place < count else count - _ONCE]
            lanes.cells[j] = found.places[lanes.slots[j]]
        last = _begin(cells, tables, lanes, by_cell)
        for each in range(last):
            _read(cells, tables, lanes, each, last)
            dim[each] = _look(tables, lanes, each)
        for i in range(_SAMPLES):
            is_apart = rows[_LOW + i] > rows[_HIGH + i]
            rows[_APART + i] = rows[_BRIGHTEST + i] - rows[_DARKEST + i] if is_apart else _ZERO
        for again in range(1 if by_cell else 2):
            if again:
                for i in range(_SAMPLES):
                    lanes.bins[i] = _bin(tables, rows[_LIGHT + i])
            _join(tables, lanes, last, dim, by_cell or again == 1)
        _finish(lanes)
        for j in range(_CELLS):
            if by_cell and not _is_even(lanes, j):
                continue
            _write(lanes, found, j)


@_compiled
def _join_cells(
    cells: Cells,
    tables: Tables,
    chosen: NDArray[np.bool_],
    found: Joined,
    side_by_side: Lanes,
    lanes: _Lanes,
    slots: NDArray[np.intp],
    dim: NDArray[np.bool_],
) -> None:
    whole, last = np.uint64(len(chosen)), _NULL
    for start in range(_NULL, whole, _AT_ONCE):
        stop, first = min(start + _AT_ONCE, whole), last
        join_alike(cells, tables, chosen, found, side_by_side, start, stop)
        for c in range(start, stop):
            if found.kinds[c] >= OTHER:
                found.places[last] = c
                last += _ONCE
        for by_cell in (True, False):
            # Samples of mixed cells, and of others that are of several frames, have own weights.
            count = _NULL
            for slot in range(first, last):
                kind = found.kinds[found.places[slot]]
                slots[count] = slot
                count += _ONCE if kind == OTHER or (kind == MIXED and not by_cell) else _NULL
            _join_some(cells, tables, slots, count, by_cell, found, lanes, dim)


def join_cells(tables: LightTables, cells: Cells, chosen: NDArray[np.bool_]) -> Joined:
    """Return the light of cells, that of chosen ones from frames whose errors change weights.

    Cells that are not chosen, or are saturated in all frames, keep the light that they have.
    """
    count = len(cells.values)
    found, lanes = Joined.of(len(chosen)), _Lanes.new(count, cells.values.dtype)
    slots, dim = np.empty(int(_AT_ONCE), np.intp), np.empty(count, np.bool_)
    _join_cells(cells, tables_of(tables), chosen, found, Lanes.new(), lanes, slots, dim)
    return found
