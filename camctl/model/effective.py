"""The effective camera: the response of the sum of several exposures.

The sum of n frames h(E) = sum_j f(e_j E) is again a staircase (Grossberg and Nayar, equation 1).
Its levels are the union of the levels E_k / e_j with multiplicity: where m levels coincide, h rises
by m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse

MAX_EXPOSURES = 64
"""Exposures of one capture at most: two digits number its frames, and a report holds so many."""

MOST_SEARCHED = 16
"""Exposures of a search by missing levels at most: each more makes it longer, a minute for 16 of 16
bits; and of a set whose number the controller chooses."""

COINCIDENCE = 1e-12
"""Levels within this distance, relative to the lower one, count as one.

In units of a frame's own gap at level k that is k * 1e-12 for a linear camera: at most 7e-8 of a
gap up to 16 bits, and at least a thousand times the rounding error of E_k / e_j.
"""

WIDEST_RATIO = 1e12
"""Largest factor between exposures of one capture; light of all of them is kept as float32."""

_BLOCK = 1 << 14
"""Gaps that are looked at together: with several arrays of them a cache of 1 MB is full."""


def check_count(n: int, most: int = MAX_EXPOSURES) -> None:
    """Raise `UsageError` unless n is a number of exposures, 1 to `most`."""
    if not 1 <= n <= most:
        raise UsageError(f"invalid number of exposures {n}: expected 1 to {most}")


def check_ratio(exposures: Sequence[float]) -> None:
    """Raise `UsageError` if positive exposures differ by more than `WIDEST_RATIO`."""
    if max(exposures) > WIDEST_RATIO * min(exposures):
        raise UsageError(f"the exposures differ by more than a factor of {WIDEST_RATIO:g}")


def check_exposures(exposures: Sequence[float]) -> tuple[float, ...]:
    """Return the exposures as floats.

    Raises:
        UsageError: there are none or more than 64, or one is not a positive, finite number
    """
    values = tuple(float(e) for e in exposures)
    check_count(len(values))
    for value in values:
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"invalid exposure {value:g}: expected a positive, finite number")
    if min(values) < 1e-100 or max(values) > 1e100:
        raise UsageError(
            "invalid exposures: expected values from 1e-100 to 1e100",
            hint="give them relative to each other",
        )
    return values


def union_of_levels(levels: FloatArray, exposures: Sequence[float]) -> FloatArray:
    """Return all levels E_k / e_j, (n*M,) ascending, from (M,) ascending levels."""
    union: FloatArray = (levels[np.newaxis, :] / np.array(exposures)[:, np.newaxis]).ravel()
    union.sort(kind="stable")  # merges the n sorted runs in n M log n
    return union


def _group_starts(levels: FloatArray) -> NDArray[np.intp]:
    """Return the index of the first level of each group of coincident levels.

    A group extends to COINCIDENCE above its first level and no further: a chain of close neighbours
    does not become one group.
    """
    apart = np.diff(levels) > COINCIDENCE * levels[:-1]
    starts = np.concatenate([np.zeros(1, np.intp), np.flatnonzero(apart) + 1])
    ends = np.concatenate([starts[1:], [levels.size]]) - 1
    chains = np.flatnonzero(levels[ends] - levels[starts] > COINCIDENCE * levels[starts])
    more: list[int] = []
    for chain in chains.tolist():
        first = int(starts[chain])
        while True:
            end = levels[first] * (1 + COINCIDENCE)
            first = first + int(np.searchsorted(levels[first : ends[chain] + 1], end, "right"))
            if first > ends[chain]:
                break
            more.append(first)
    if not more:
        return starts
    return np.sort(np.concatenate([starts, np.array(more, dtype=np.intp)])).astype(np.intp)


@dataclass(frozen=True, eq=False)
class EffectiveCamera:
    """A real camera whose exposures are summed.

    Attributes:
        response: the response of the real camera
        exposures: relative exposures, in any order; the smallest need not be 1
    """

    response: CameraResponse
    exposures: tuple[float, ...]

    @classmethod
    def of(cls, response: CameraResponse, exposures: Sequence[float]) -> EffectiveCamera:
        """Return the effective camera of these exposures; raises what `check_exposures` raises."""
        return cls(response, check_exposures(exposures))

    @cached_property
    def levels(self) -> FloatArray:
        """All levels with multiplicity, (n*M,) float64 ascending."""
        return union_of_levels(self.response.levels, self.exposures)

    @cached_property
    def distinct(self) -> FloatArray:
        """The levels, coincident ones (within `COINCIDENCE`) once, (K,) float64 ascending."""
        return self.levels[_group_starts(self.levels)]

    @property
    def levels_total(self) -> int:
        """N = n*M, the largest sum."""
        return len(self.exposures) * self.response.M

    @property
    def levels_distinct(self) -> int:
        """Number of different levels, one less than the number of sums that can occur."""
        return int(self.distinct.size)


def effective_levels(camera: EffectiveCamera, desired: DesiredResponse) -> float:
    """Return L = (sum of gap_u^3)^(-1/2): the number of equal steps of u of the same accuracy.

    The gaps lie between neighbours of e_min, the distinct levels inside (e_min, 1) and 1, mapped
    through u.  N equal steps give exactly N: L is the rms quantisation error in u, as a number of
    steps.  Noise is not included; see `camctl.exposure.noise`.
    """
    levels = camera.levels
    first, last = np.searchsorted(levels, desired.e_min, "right"), np.searchsorted(levels, 1.0)
    edges = np.concatenate([[desired.e_min], levels[first:last], [1.0]])
    cubes = 0.0
    for some in blocks(edges):
        gaps = desired.rise(some[:-1], some[1:])
        cubes += float(np.sum(gaps * gaps * gaps))
    return float(cubes**-0.5)


def blocks(edges: FloatArray) -> Iterator[FloatArray]:
    """Yield ascending edges in blocks that begin where the one before ends: each fits a cache."""
    for first in range(0, edges.size - 1, _BLOCK):
        yield edges[first : first + _BLOCK + 1]
