"""The light of most samples by compiled code (extra `fast`): of those that need no look-up.

Most samples are in steps that noise dithers, and no frame may be saturated in them: a weighted mean
is their light, which compiled code makes in half the time that combinations of samples take to be
looked up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.model.light import Floats32, LightTables
from camctl.system.compiled_functions import has_compiler

SAMPLES_WORTH_LOADING = 1 << 24
"""Samples of a picture from which on compiled code is loaded: it saves 8 ns a sample, and takes
0.08 s to be loaded (24 megapixels of 8 bits, six frames)."""

#: Samples at a time: calls cost little, and the samples of six frames stay in a cache of 2 MB.
_BLOCK = 1 << 16

Plain: TypeAlias = Callable[
    [Sequence[NDArray[Any]], NDArray[np.unsignedinteger], Floats32, Floats32],
    NDArray[np.intp],
]
"""From samples of each frame up to white, (S,), and their sum: sets irradiance at exposure 1 and
its standard deviation, and returns the samples of which an estimate says more."""


def plain_light(tables: LightTables, deviation: NDArray[np.floating[Any]]) -> Plain | None:
    """Return what makes the light of samples; None without numba, or where all need an estimate.

    Args:
        tables: of the frames
        deviation: for each bin of light, NaN where it is not known
    """
    others = tables.is_exact | np.isnan(deviation)
    if not has_compiler() or others.all():
        return None
    from camctl.model.compiled_mean import mean, tables_of

    of_frames = tables_of(tables, others)

    def plain(
        values: Sequence[NDArray[Any]],
        total: NDArray[np.unsignedinteger],
        light: Floats32,
        deviation: Floats32,
    ) -> NDArray[np.intp]:
        found = []
        for start in range(0, total.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            some = np.array([each[part] for each in values])
            is_other = mean(some, of_frames, light[part], deviation[part])
            is_other |= np.isnan(deviation[part])
            found.append(np.flatnonzero(is_other) + start)
        return np.concatenate(found)

    return plain
