"""The light of samples as a weighted mean, compiled (extra `fast`), in the order of the sum.

What `LightTables.mean` does, with float32 in the same order, but for samples of which it says more.
Frames that are saturated all over a block, and weigh nothing there, are left out.  This module is
imported only where it is used.
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
_NEAR_ZERO, _ZERO = np.float32(CLIPPING_SIGMAS), np.float32(0)


class _Tables(NamedTuple):
    """See `LightTables`.

    Attributes:
        first: bin of each sum of samples
        white, lowest: value from which on a sample of each frame is not in a bin below this one
        unused: bin of each frame from which on it has no weight, and is white
        irradiance, weights: see there
        deviation: below 0 where more is said of the light
        is_other: 1 for bins whose light is another one, else 0
        others: how many such bins are below each bin
        ends: first and last bin, by the bits of their light
    """

    first: NDArray[np.uint32]
    white: NDArray[np.uint32]
    lowest: NDArray[np.uint32]
    unused: NDArray[np.uint32]
    irradiance: Floats32
    weights: Floats32
    deviation: Floats32
    is_other: Floats32
    others: NDArray[np.uint32]
    ends: NDArray[np.uint32]


def tables_of(tables: LightTables, others: NDArray[np.bool_]) -> _Tables:
    """Return tables with which light in bins of `others` is not the weighted mean."""
    bins = tables.light_bins
    weighs = tables.weights != 0
    last = weighs.shape[1] - np.argmax(weighs[:, ::-1], axis=1)
    unused = np.maximum(np.where(weighs.any(axis=1), last, 0), tables.saturating)
    return _Tables(
        tables.first_bins.astype(np.uint32),
        np.full(len(tables.exposures), tables.white, np.uint32),
        tables.saturating.astype(np.uint32),
        unused.astype(np.uint32),
        tables.irradiance,
        tables.weights,
        np.where(tables.is_above, np.float32(-1), tables.deviation),
        others.astype(np.float32),
        np.append(0, np.cumsum(others)).astype(np.uint32),
        np.array([bins.first, bins.first + others.size - 1], np.uint32),
    )


@_compiled
def _mean(
    values: NDArray[np.uint8],
    total: NDArray[np.uint16],
    tables: _Tables,
    work: NDArray[np.uint32],
    light: Floats32,
    bits: NDArray[np.uint32],
    deviation: Floats32,
    is_other: NDArray[np.bool_],
) -> None:
    count, top = np.uint64(values.shape[1]), np.uint32(len(tables.first) - 1)
    lowest_bin, highest_bin = tables.ends[0], tables.ends[1]
    for first in range(np.uint64(0), count, _AT_ONCE):
        here = min(_AT_ONCE, count - first)
        darkest = np.uint32(0xFFFFFFFF)
        for j in range(here):
            work[j] = tables.first[total[first + j]]
            is_other[first + j] = np.uint32(total[first + j]) == top
            light[first + j] = _ZERO
        for j in range(here):
            darkest = min(darkest, work[j])
        for at in range(len(values)):
            if darkest >= tables.unused[at]:
                continue
            white, lowest = tables.white[at], tables.lowest[at]
            for j in range(here):
                value = np.uint32(values[at, first + j])
                light[first + j] += tables.weights[at, work[j]] * tables.irradiance[at, value]
            for j in range(here):
                is_white = np.uint32(values[at, first + j]) >= white
                is_other[first + j] |= is_white & (work[j] < lowest)
        for j in range(here):
            deviation[first + j] = tables.deviation[work[j]]
        for j in range(here):
            near = deviation[first + j] * _NEAR_ZERO > light[first + j]
            is_other[first + j] |= near | (deviation[first + j] < _ZERO)
        dimmest, brightest = np.uint32(0xFFFFFFFF), np.uint32(0)
        for j in range(here):  # bits of light below 0 are the largest
            dimmest = min(dimmest, bits[first + j])
            brightest = max(brightest, bits[first + j])
        dimmest = _NULL if brightest >= _SIGN else dimmest
        start = min(max(dimmest >> _DROPPED, lowest_bin), highest_bin) - lowest_bin
        stop = min(max(brightest >> _DROPPED, lowest_bin), highest_bin) - lowest_bin
        if tables.others[start] == tables.others[stop + _ONCE]:
            continue
        for j in range(here):
            inside = _NULL if bits[first + j] >= _SIGN else bits[first + j] >> _DROPPED
            work[j] = min(max(inside, lowest_bin), highest_bin) - lowest_bin
        for j in range(here):
            is_other[first + j] |= tables.is_other[work[j]] > _ZERO


def mean(
    values: NDArray[Any],
    total: NDArray[np.unsignedinteger],
    tables: _Tables,
    light: Floats32,
    deviation: Floats32,
) -> NDArray[np.intp]:
    """Set the light of samples of each frame, (n, S), and its deviation.

    Args:
        values: of the frames
        total: their sum
        tables: of the frames
        light: set
        deviation: set

    Returns:
        the samples whose light is another one
    """
    is_other, work = np.empty(total.size, np.bool_), np.empty(int(_AT_ONCE), np.uint32)
    _mean(values, total, tables, work, light, light.view(np.uint32), deviation, is_other)
    return np.flatnonzero(is_other)
