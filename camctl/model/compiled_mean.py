"""The light of samples as if noise dithered the quantiser and clipped nothing, compiled.

What `LightTables.mean` does (extra `fast`), with float32 in the same order, but for samples of
which it says more.  Frames that are saturated all over a block, and weigh nothing there, are left
out.  This module is imported only where it is used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.light import Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.model.sensor import CLIPPING_SIGMAS
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

#: Samples at a time, and their first index, without a sign: see `camctl.model.compiled_alike`.
_AT_ONCE = np.uint64(512)
_NULL, _ONCE, _SIGN, _DROPPED = (np.uint32(x) for x in (0, 1, 1 << 31, DROPPED))
_LARGEST = np.uint32(0xFFFFFFFF)
_NEAR_ZERO, _ZERO = np.float32(CLIPPING_SIGMAS), np.float32(0)


class MeanTables(NamedTuple):
    """See `LightTables`.

    Attributes:
        first: bin of each sum of samples
        white, lowest: value from which on a sample of each frame is not in a bin below this one
        unused: bin of each frame from which on it has no weight, and is white
        irradiance, weights: see there
        deviation: below 0 where more is said of the light
        unknown: not a number for bins of light whose deviation is not known, else 0
        unknowns: how many such bins are below each bin
        ends: first and last bin, by the bits of their light
        of_white: light and deviation of what is saturated in each frame; below 0: more is said
    """

    first: NDArray[np.uint32]
    white: NDArray[np.uint32]
    lowest: NDArray[np.uint32]
    unused: NDArray[np.uint32]
    irradiance: Floats32
    weights: Floats32
    deviation: Floats32
    unknown: Floats32
    unknowns: NDArray[np.uint32]
    ends: NDArray[np.uint32]
    of_white: Floats32


def tables_of(
    tables: LightTables, unknown: NDArray[np.bool_], of_white: tuple[float, float] = (-1, -1)
) -> MeanTables:
    """Return tables with which the deviation of light in some bins is not known."""
    bins = tables.light_bins
    weighs = tables.weights != 0
    last = weighs.shape[1] - np.argmax(weighs[:, ::-1], axis=1)
    unused = np.maximum(np.where(weighs.any(axis=1), last, 0), tables.saturating)
    return MeanTables(
        tables.first_bins.astype(np.uint32),
        np.full(len(tables.exposures), tables.white, np.uint32),
        tables.saturating.astype(np.uint32),
        unused.astype(np.uint32),
        tables.irradiance,
        tables.weights,
        np.where(tables.is_above, np.float32(-1), tables.deviation),
        np.where(unknown, np.float32(np.nan), _ZERO),
        np.append(0, np.cumsum(unknown)).astype(np.uint32),
        np.array([bins.first, bins.first + unknown.size - 1], np.uint32),
        np.array(of_white, np.float32),
    )


@_compiled
def _place(
    values: NDArray[Any],
    tables: MeanTables,
    first: np.uint64,
    here: np.uint64,
    work: NDArray[np.uint32],
) -> np.uint32:
    """Set the sums of samples, and their bins; return the darkest one."""
    sums, places, darkest = work[0], work[1], _LARGEST
    for j in range(here):
        sums[j] = np.uint32(values[0, first + j])
    for at in range(1, len(values)):
        for j in range(here):
            sums[j] += np.uint32(values[at, first + j])
    for j in range(here):
        places[j] = tables.first[sums[j]]
    for j in range(here):
        darkest = min(darkest, places[j])
    before = darkest
    for at in range(len(values)):
        if before >= tables.unused[at]:
            continue
        white, lowest = tables.white[at], tables.lowest[at]
        for j in range(here):
            is_white = np.uint32(values[at, first + j]) >= white
            places[j] = max(places[j], lowest) if is_white else places[j]
    darkest = _LARGEST
    for j in range(here):
        darkest = min(darkest, places[j])
    return darkest


@_compiled
def _add_unknown(
    tables: MeanTables,
    first: np.uint64,
    here: np.uint64,
    places: NDArray[np.uint32],
    bits: NDArray[np.uint32],
    deviation: Floats32,
) -> None:
    """Make deviations that are not known no numbers."""
    lowest, highest = tables.ends[0], tables.ends[1]
    dimmest, brightest = _LARGEST, _NULL
    for j in range(here):  # bits of light below 0 are the largest
        dimmest = min(dimmest, bits[first + j])
        brightest = max(brightest, bits[first + j])
    dimmest = _NULL if brightest >= _SIGN else dimmest
    start = min(max(dimmest >> _DROPPED, lowest), highest) - lowest
    stop = min(max(brightest >> _DROPPED, lowest), highest) - lowest
    if tables.unknowns[start] == tables.unknowns[stop + _ONCE]:
        return
    for j in range(here):
        inside = _NULL if bits[first + j] >= _SIGN else bits[first + j] >> _DROPPED
        places[j] = min(max(inside, lowest), highest) - lowest
    for j in range(here):
        deviation[first + j] += tables.unknown[places[j]]


@_compiled
def _mean(
    values: NDArray[Any],
    tables: MeanTables,
    work: NDArray[np.uint32],
    light: Floats32,
    bits: NDArray[np.uint32],
    deviation: Floats32,
    is_other: NDArray[np.bool_],
) -> None:
    count, top = np.uint64(values.shape[1]), np.uint32(len(tables.first) - 1)
    sums, places = work[0], work[1]
    for first in range(np.uint64(0), count, _AT_ONCE):
        here, most = min(_AT_ONCE, count - first), _NULL
        darkest = _place(values, tables, first, here, work)
        for j in range(here):
            light[first + j] = _ZERO
            most = max(most, sums[j])
        for at in range(len(values)):
            if darkest >= tables.unused[at]:
                continue
            for j in range(here):
                sample = tables.irradiance[at, values[at, first + j]]
                light[first + j] += tables.weights[at, places[j]] * sample
        for j in range(here):
            deviation[first + j] = tables.deviation[places[j]]
        for j in range(here):
            near = deviation[first + j] * _NEAR_ZERO > light[first + j]
            is_other[first + j] = near | (deviation[first + j] < _ZERO)
        _add_unknown(tables, first, here, places, bits, deviation)
        if most < top:
            continue
        of_light, of_deviation = tables.of_white[0], tables.of_white[1]
        for j in range(here):
            is_white = sums[j] == top
            light[first + j] = of_light if is_white else light[first + j]
            deviation[first + j] = of_deviation if is_white else deviation[first + j]
            is_other[first + j] = of_light < _ZERO if is_white else is_other[first + j]


def mean(
    values: NDArray[Any], tables: MeanTables, light: Floats32, deviation: Floats32
) -> NDArray[np.bool_]:
    """Set the light of samples of each frame, (n, S), and its deviation.

    Returns:
        the samples of which `LightTables.mean` says more
    """
    is_other, work = np.empty(light.size, np.bool_), np.empty((2, int(_AT_ONCE)), np.uint32)
    _mean(values, tables, work, light, light.view(np.uint32), deviation, is_other)
    return is_other
