"""The light of samples as if noise dithered the quantiser and clipped nothing, compiled.

What `LightTables.mean` does (extra `fast`), with float32 in the same order.  This module is
imported only where it is used.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.light import KEPT_TABLES, Floats32, LightTables
from camctl.model.sensor import CLIPPING_SIGMAS
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

#: Samples at a time, and their first index, without a sign: see `camctl.model.compiled_alike`.
_AT_ONCE = np.uint64(512)
_NEAR_ZERO, _ZERO = np.float32(CLIPPING_SIGMAS), np.float32(0)

#: Of a sample: `LightTables.mean` says no more about it; it does; all frames are saturated.
_PLAIN, _SPECIAL, _WHITE = (np.uint8(x) for x in range(3))


class _Tables(NamedTuple):
    """See `LightTables`.

    Attributes:
        first: bin of each sum of samples
        white, lowest: value from which on a sample of each frame is not in a bin below this one
        unused: bin from which on a frame has no weight
        irradiance, weights, deviation: see there
        is_special: whether what is not clipped says more about a bin's light
    """

    first: NDArray[np.uint32]
    white: NDArray[np.uint32]
    lowest: NDArray[np.uint32]
    unused: NDArray[np.uint32]
    irradiance: Floats32
    weights: Floats32
    deviation: Floats32
    is_special: NDArray[np.bool_]


@lru_cache(maxsize=KEPT_TABLES)
def _tables_of(tables: LightTables) -> _Tables:
    weighs = np.pad(tables.weights != 0, ((0, 0), (1, 0)), constant_values=True)
    return _Tables(
        tables.first_bins.astype(np.uint32),
        np.full(len(tables.exposures), tables.white, np.uint32),
        tables.saturating.astype(np.uint32),
        (weighs.shape[1] - 1 - np.argmax(weighs[:, ::-1], axis=1)).astype(np.uint32),
        tables.irradiance,
        tables.weights,
        tables.deviation,
        tables.is_above,
    )


@_compiled
def _mean(
    values: NDArray[np.uint8],
    tables: _Tables,
    work: NDArray[np.uint32],
    light: Floats32,
    deviation: Floats32,
    kinds: NDArray[np.uint8],
) -> None:
    count, top = values.shape[1], np.uint32(len(tables.first) - 1)
    for first in range(np.uint64(0), np.uint64(count), _AT_ONCE):
        here = min(_AT_ONCE, np.uint64(count) - first)
        for j in range(here):
            work[j] = np.uint32(values[0, first + j])
        for at in range(1, len(values)):
            for j in range(here):
                work[j] += np.uint32(values[at, first + j])
        for j in range(here):
            kinds[first + j] = _WHITE if work[j] == top else _PLAIN
        for j in range(here):
            work[j] = tables.first[work[j]]
        for at in range(len(values)):
            white, lowest = tables.white[at], tables.lowest[at]
            for j in range(here):
                is_white = np.uint32(values[at, first + j]) >= white
                work[j] = max(work[j], lowest) if is_white else work[j]
        darkest = np.uint32(0xFFFFFFFF)
        for j in range(here):
            darkest = min(darkest, work[j])
        for j in range(here):
            light[first + j] = _ZERO
        for at in range(len(values)):
            if darkest >= tables.unused[at]:
                continue
            for j in range(here):
                sample = tables.irradiance[at, values[at, first + j]]
                light[first + j] += tables.weights[at, work[j]] * sample
        for j in range(here):
            deviation[first + j] = tables.deviation[work[j]]
            is_special = tables.is_special[work[j]]
            kinds[first + j] = max(kinds[first + j], _SPECIAL if is_special else _PLAIN)
        for j in range(here):
            is_special = deviation[first + j] * _NEAR_ZERO > light[first + j]
            kinds[first + j] = max(kinds[first + j], _SPECIAL if is_special else _PLAIN)


def mean(
    tables: LightTables, values: NDArray[np.uint8]
) -> tuple[Floats32, Floats32, NDArray[np.intp], NDArray[np.intp]]:
    """Return the light of samples of each frame, (n, S), and its standard deviation.

    The last results are the samples that `LightTables.mean` says more about, and those that are
    saturated in each frame: nothing is said of these.
    """
    light, deviation = np.empty((2, values.shape[1]), np.float32)
    kinds = np.empty(values.shape[1], np.uint8)
    work = np.empty(int(_AT_ONCE), np.uint32)
    _mean(values, _tables_of(tables), work, light, deviation, kinds)
    return light, deviation, np.flatnonzero(kinds == _SPECIAL), np.flatnonzero(kinds == _WHITE)
