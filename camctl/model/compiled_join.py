"""The light of cells and samples of frames that share errors of colours, compiled (extra `fast`).

One pass does what `camctl.pictures.chroma_light` and `camctl.model.joined_frames` do with numpy, in
their order and with float32; exponentials and probabilities differ by 1e-5 of them at most.  This
module is imported only where it is used.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.model.compiled_alike import (
    AT_ONCE,
    Lanes,
    Tables,
    is_alike,
    join_alike,
    last_frame,
)
from camctl.model.joined_frames import Cells, CellsLight
from camctl.model.light import Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.model.sensor import CLIPPING_SIGMAS, FILE_OFFSET
from camctl.model.step_posterior import REACH
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

Place: TypeAlias = tuple[int, int, int]
"""A cell, a sample of it, and the number of frames that are looked at."""

Sums: TypeAlias = tuple[
    np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, np.float32, int
]
"""Those of `JoinedFrames`, and the frames that count, as bits."""

_ZERO, _ONE, _HALF, _QUARTER = (np.float32(x) for x in (0, 1, 0.5, 0.25))
_BEYOND, _LARGEST_EXPONENT, _INFINITE = (np.float32(x) for x in (1e30, 50, np.inf))
_DROPPED = np.uint32(DROPPED)


def tables_of(tables: LightTables) -> Tables:
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
    return Tables(
        of_values,
        of_values.view(np.complex128)[..., 0],
        np.stack([tables.variances, tables.steps], axis=2, dtype=np.float32),
        tables.clipped,
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
def _bin(tables: Tables, light: np.float32) -> int:
    inside = min(max(light, tables.ends[0]), tables.ends[1])
    return int(np.float32(inside).view(np.uint32) >> _DROPPED) - tables.first


@_compiled
def _bin_of_cell(cells: Cells, tables: Tables, cell: int) -> int:
    light = cells.light
    mean = ((light[0, cell] + light[1, cell]) + light[2, cell]) + light[3, cell]
    of_light: int = _bin(tables, mean * _QUARTER)
    return of_light


@_compiled
def _above_zero(
    tables: Tables, mean: np.float32, weights: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the posterior mean above 0 of light with a sum of weights, and its error's factor."""
    spread = np.sqrt(_ONE / weights)
    if mean >= tables.ends[4] * spread:
        return mean, _ONE
    far = max(float(mean) / spread, -REACH)
    larger = math.exp(-far * far / 2) / math.sqrt(2 * math.pi) / _probability(far)
    narrower = math.sqrt(max(1 - larger * (far + larger), 1e-6))
    return np.float32(mean + spread * larger), np.float32(narrower)


@_compiled
def _look(cells: Cells, tables: Tables, place: Place, shown: Floats32) -> np.float32:
    """Set what frames show of a sample; return how far they are apart where they contradict."""
    cell, k, last = place
    top, reach, offset = tables.ends[2], tables.ends[4], tables.ends[5]
    low, high, lost = _ZERO, _BEYOND, _ZERO
    for each in range(last):
        at = tables.order[each]
        value, error = cells.values[at, k, cell], cells.errors[at, cell]
        sample, square = tables.of_values[at, value, 0], tables.of_values[at, value, 1]
        noise = tables.of_values[at, value, 2]
        saturated = value > top - reach * error
        unseen = saturated or cells.hidden[at, k, cell]
        shown[each, 0] = sample
        shown[each, 1] = np.sqrt(lost) if tables.of_values[at, value, 3] < lost else _ZERO
        shown[each, 2] = _ONE if saturated else _ZERO
        shown[each, 3] = _ONE if unseen else _ZERO
        lost = max(lost, square * cells.of_chroma[at, cell] - noise)
        if not unseen:
            reached = np.sqrt(square * (error * error + offset) + noise) * reach
            low, high = max(low, sample - reached), min(high, sample + reached)
    if low <= high:
        return _ZERO
    brightest, darkest = _ZERO, _BEYOND
    for each in range(last):
        if shown[each, 3] == _ZERO:
            brightest, darkest = max(brightest, shown[each, 0]), min(darkest, shown[each, 0])
    return brightest - darkest


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
def _join(cells: Cells, tables: Tables, place: Place, of_light: int, shown: Floats32) -> Sums:
    """Return the sums of a sample, with the noise of a bin of light."""
    cell, k, last = place
    above = weights = own = shared = more = squares = count = least = _ZERO
    which, reach, top = 0, tables.ends[4], tables.ends[2]
    for each in range(last):
        at = tables.order[each]
        value, levels = cells.values[at, k, cell], cells.errors[at, cell]
        sample, saturated, unseen = shown[each, 0], shown[each, 2] > _ZERO, shown[each, 3] > _ZERO
        noise, error = tables.of_bins[at, of_light, 0], levels * tables.of_bins[at, of_light, 1]
        both, full = noise + error * error, tables.full[at]
        counts = value <= top and not tables.clipped[at, of_light]
        mean = known = spread = _ZERO
        if weights > _ZERO:
            is_bright = above > full * _QUARTER * weights
            if counts and (is_bright or saturated):
                mean = above / weights
                known = np.sqrt(own + shared * shared) / weights
                spread = np.sqrt(known * known + both)
                too_dark = is_bright and sample < mean - reach * spread
                counts = not (too_dark or mean - reach * known > full)
        elif saturated:
            counts = False
        if not (counts or unseen):
            continue
        if unseen or least > _ZERO:
            reached = reach * np.sqrt(both)
            counts = counts and sample + reached >= least
            if unseen:
                least = max(least, sample - reached)
        if not counts:
            continue
        weight = _ONE / both
        if saturated:
            below = np.float32(tables.ends[3] - value) / levels
            weight *= _chance_of_seeing(mean, known, spread, sample, error, below, full)
        which |= 1 << each
        weighted = weight * sample
        above += weighted
        weights += weight
        own += weight * weight * noise
        shared += weight * error
        squares += weighted * sample
        count += weight * both
        if shown[each, 1] > error:
            more += weight * (shown[each, 1] - error)
    return above, weights, own, shared, more, squares, count, which


@_compiled
def _write(
    cells: Cells, found: CellsLight, tables: Tables, place: Place, sums: Sums, apart: np.float32
) -> None:
    """Set what is found of a sample."""
    cell, k, _ = place
    above, weights, own, shared, more, squares, count, _ = sums
    light, deviation = cells.light[k, cell], cells.deviation[k, cell]
    common = cells.common[cell] + apart * _HALF
    if weights > _ZERO:
        light, narrower = _above_zero(tables, above / weights, weights)
        if not np.isnan(deviation):
            deviation = narrower * np.sqrt(own) / weights
        common = max(narrower * (shared + more) / weights, apart * _HALF)
        found.scatter[0, k, cell] = max(squares - above * above / weights, _ZERO)
        found.scatter[1, k, cell] = count - (own + shared * shared) / weights
    elif not np.isnan(deviation):
        at = tables.order[0]
        limit = tables.ends[2] - tables.ends[4] * cells.errors[at, cell]
        if cells.hidden[at, k, cell] or cells.values[at, k, cell] > limit:
            deviation = _INFINITE
    found.light[k, cell], found.deviation[k, cell] = light, deviation
    found.common[k, cell] = common


@_compiled
def _join_evenly(
    cells: Cells, tables: Tables, found: CellsLight, place: Place, shown: Floats32
) -> bool:
    """Do the same where samples may be saturated, with a weight of each."""
    cell, _, last = place
    of_light, which = _bin_of_cell(cells, tables, cell), 0
    for k in range(4):
        if _look(cells, tables, (cell, k, last), shown) > _ZERO:
            return False
        sums = _join(cells, tables, (cell, k, last), of_light, shown)
        if (k > 0 and sums[7] != which) or not sums[1] > _ZERO:
            return False
        which = sums[7]
        _write(cells, found, tables, (cell, k, last), sums, _ZERO)
    return True


@_compiled
def _join_each(
    cells: Cells, tables: Tables, found: CellsLight, place: Place, shown: Floats32
) -> None:
    """Set the light of each sample of a cell by itself."""
    cell, _, last = place
    for k in range(4):
        apart = _look(cells, tables, (cell, k, last), shown)
        of_light = _bin(tables, cells.light[k, cell])
        sums = _join(cells, tables, (cell, k, last), of_light, shown)
        light = cells.light[k, cell]
        if sums[1] > _ZERO:
            light, _ = _above_zero(tables, sums[0] / sums[1], sums[1])
        again = _bin(tables, light)
        if again != of_light:
            sums = _join(cells, tables, (cell, k, last), again, shown)
        _write(cells, found, tables, (cell, k, last), sums, apart)


@_compiled
def _join_cells(
    cells: Cells,
    tables: Tables,
    chosen: NDArray[np.bool_],
    mixed: NDArray[np.bool_],
    found: CellsLight,
    lanes: Lanes,
    shown: Floats32,
) -> None:
    for start in range(0, len(chosen), AT_ONCE):
        count, rest = min(AT_ONCE, len(chosen) - start), 0
        for cell in range(start, start + count):
            rest += chosen[cell]
        if rest == 0:
            continue
        join_alike(cells, tables, chosen, mixed, found, lanes, np.uint64(start), np.uint64(count))
        for j in range(count):
            cell = start + j
            if not chosen[cell] or is_alike(lanes, np.uint64(j)):
                continue
            place = cell, 0, last_frame(lanes, np.uint64(j))
            if mixed[cell] or not _join_evenly(cells, tables, found, place, shown):
                _join_each(cells, tables, found, place, shown)


def join_cells(
    tables: LightTables,
    cells: Cells,
    chosen: NDArray[np.bool_],
    mixed: NDArray[np.bool_],
    found: CellsLight,
) -> None:
    """Set the light of chosen cells, that of `mixed` ones sample by sample."""
    shown = np.empty((len(cells.values), 8), np.float32)
    _join_cells(cells, tables_of(tables), chosen, mixed, found, Lanes.new(), shown)
