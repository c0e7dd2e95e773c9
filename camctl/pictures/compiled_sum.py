"""Sums of clipped samples in one pass over memory, compiled (extra `fast`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.system.compiled_functions import LoadedLater, compiler

SAMPLES_WORTH_LOADING = 1 << 32
"""Samples summed in a process before the functions are loaded: they save 0.2 ns a sample
(tests/bench/bench_summing.py), and loading takes a second."""

_Samples = NDArray[np.unsignedinteger[Any]]


def _add(total: _Samples, samples: _Samples, white: np.unsignedinteger[Any]) -> None:
    for i in range(samples.size):
        total[i] += min(samples[i], white)


def _subtract(total: _Samples, samples: _Samples, white: np.unsignedinteger[Any]) -> None:
    for i in range(samples.size):
        total[i] -= min(samples[i], white)


def _exchange(
    total: _Samples, old: _Samples, new: _Samples, white: np.unsignedinteger[Any]
) -> None:
    for i in range(new.size):
        total[i] += min(new[i], white) - min(old[i], white)


@dataclass(frozen=True)
class CompiledSums:
    """Add `min(samples, white)` to a sum, subtract it, or both; all arrays are contiguous, (S,)."""

    add: Callable[[_Samples, _Samples, np.unsignedinteger[Any]], None]
    subtract: Callable[[_Samples, _Samples, np.unsignedinteger[Any]], None]
    exchange: Callable[[_Samples, _Samples, _Samples, np.unsignedinteger[Any]], None]


@lru_cache(maxsize=1)
def load() -> CompiledSums | None:
    """Return the compiled functions, for all types of samples and sums; None without numba."""
    compiled = compiler()
    if compiled is None:
        return None
    sums = CompiledSums(compiled(_add), compiled(_subtract), compiled(_exchange))
    for sample in (np.uint8, np.uint16):
        for total in (np.uint16, np.uint32):
            one: _Samples = np.zeros(1, sample)
            for work in (sums.add, sums.subtract):
                work(np.zeros(1, total), one, sample(1))
            sums.exchange(np.zeros(1, total), one, one, sample(1))
    return sums


CHOICE = LoadedLater(load, SAMPLES_WORTH_LOADING)
"""Whether the sums of this process are compiled."""
