"""The effective camera: what the sum of several exposures can tell.

The sum of n frames h(E) = sum_j f(e_j E) is again a staircase (the paper's equation 1).  Its levels
are the union of the levels E_k / e_j with multiplicity: where m levels coincide, h jumps by m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import UsageError
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse

MAX_EXPOSURES = 16

COINCIDENCE = 1e-12
"""Levels this near, relative to the lower one, count as one.

In units of a frame's own gap at level k that is k * 1e-12 for a linear camera: at most 7e-8 of a
gap up to 16 bits, and at least a thousand times the rounding error of E_k / e_j.
"""


def check_exposures(exposures: Sequence[float]) -> tuple[float, ...]:
    """Return the exposures as floats; raise `UsageError` where they cannot be."""
    values = tuple(float(e) for e in exposures)
    if not values:
        raise UsageError("no exposures", hint="give one or more, for example 1,2,4")
    if len(values) > MAX_EXPOSURES:
        raise UsageError(f"{len(values)} exposures", hint=f"give at most {MAX_EXPOSURES}")
    for value in values:
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"exposure {value:g}", hint="exposures are positive, finite numbers")
    if min(values) < 1e-100 or max(values) > 1e100:
        raise UsageError(
            "exposures beyond 1e-100 .. 1e100", hint="give them relative to each other"
        )
    return values


def union_of_levels(levels: FloatArray, exposures: Sequence[float]) -> FloatArray:
    """Return all levels E_k / e_j, (n*M,) ascending, from (M,) ascending levels."""
    union: FloatArray = (levels[np.newaxis, :] / np.array(exposures)[:, np.newaxis]).ravel()
    union.sort(kind="stable")  # merges the n sorted runs in n M log n
    return union


def _first_of_each(levels: FloatArray) -> NDArray[np.intp]:
    """Return where each group of coincident levels starts.

    A group reaches COINCIDENCE from its first level, and no further: chains of near neighbours do
    not grow into one group.
    """
    apart = np.diff(levels) > COINCIDENCE * levels[:-1]
    starts = np.concatenate([[0], np.flatnonzero(apart) + 1])
    ends = np.concatenate([starts[1:], [levels.size]]) - 1
    chained = np.flatnonzero(levels[ends] - levels[starts] > COINCIDENCE * levels[starts])
    more: list[int] = []
    for chain in chained.tolist():
        first = int(starts[chain])
        while True:
            reach = levels[first] * (1 + COINCIDENCE)
            first = first + int(np.searchsorted(levels[first : ends[chain] + 1], reach, "right"))
            if first > ends[chain]:
                break
            more.append(first)
    return np.sort(np.concatenate([starts, np.array(more, dtype=np.intp)])).astype(np.intp)


@dataclass(frozen=True, eq=False)
class EffectiveCamera:
    """A real camera that sums several exposures.

    Attributes:
        response: the real camera
        exposures: relative exposures, in the order given; need not be normalised
        levels: (n*M,) float64 ascending, all levels with multiplicity
    """

    response: CameraResponse
    exposures: tuple[float, ...]
    levels: FloatArray

    @classmethod
    def of(cls, response: CameraResponse, exposures: Sequence[float]) -> EffectiveCamera:
        """Return the camera; raises `UsageError` for exposures that cannot be."""
        values = check_exposures(exposures)
        return cls(response, values, union_of_levels(response.levels, values))

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        return _first_of_each(self.levels)

    @cached_property
    def distinct(self) -> FloatArray:
        """(K,) float64 ascending: the levels, coincident ones (see `COINCIDENCE`) once."""
        return self.levels[self._starts]

    @cached_property
    def multiplicity(self) -> NDArray[np.int64]:
        """(K,) int64: how many levels coincide at each of `distinct`; they sum to n*M."""
        return np.diff(np.concatenate([self._starts, [self.levels.size]])).astype(np.int64)

    @property
    def levels_total(self) -> int:
        """N = n*M, the largest sum."""
        return int(self.levels.size)

    @property
    def levels_distinct(self) -> int:
        """How many different levels there are: sums that can occur, less one."""
        return int(self.distinct.size)

    def brightness(self, E: ArrayLike) -> NDArray[np.int64]:
        """Return the sum h(E), black removed, for irradiance of any shape."""
        found = np.searchsorted(self.levels, np.asarray(E, dtype=np.float64), side="right")
        return np.asarray(found).astype(np.int64)

    def irradiance_table(self) -> FloatArray:
        """Return (n*M + 1,) float64: the irradiance that each sum 0..n*M means, black removed.

        In between it is the midpoint of the gap that the sum names; sums that coincident levels
        skip get the level of the jump.  Sum 0 is below the first level and gets 0 (no light is
        invented), sum n*M is saturated and gets the last level: callers mask both.
        """
        table = np.empty(self.levels.size + 1)
        table[0] = 0.0
        table[1:-1] = (self.levels[:-1] + self.levels[1:]) / 2
        table[-1] = self.levels[-1]
        return table

    def standard_deviation(
        self,
        E: ArrayLike,
        *,
        electrons_per_level: float | Sequence[float],
        read_noise_levels: float | Sequence[float],
    ) -> FloatArray:
        """Return the predicted standard deviation of the irradiance read off the sum.

        Args:
            E: irradiance, any shape, in the units of `levels`
            electrons_per_level: electrons that make one brightness level of the linear scale (full
                scale, M + 1 levels, is E = 1 at exposure 1): one number, or one for each frame
                where gain differs
            read_noise_levels: read noise in brightness levels (DN), one or one for each frame

        Returns:
            standard deviation, float64 in the shape and unit of `E`; infinite where every frame is
            saturated.

        Each frame that is not saturated at E adds its variance in DN: photon noise (for a linear
        camera s / K at s levels of K electrons), read noise squared and 1/12 of quantisation.  A
        saturated frame is clipped at white before summing and adds neither noise nor slope.  The
        sum of the variances over the square of the slope of h is the variance of the irradiance.
        """
        E = np.asarray(E, dtype=np.float64)
        n = len(self.exposures)
        gains = np.broadcast_to(np.asarray(electrons_per_level, dtype=np.float64), (n,))
        reads = np.broadcast_to(np.asarray(read_noise_levels, dtype=np.float64), (n,))
        variance = np.zeros(E.shape)
        slope = np.zeros(E.shape)
        for e, electrons, read in zip(self.exposures, gains, reads, strict=True):
            x = e * E
            steepness = self.response.slope(x)
            seen = x < self.response.levels[-1]
            photon = steepness**2 * x / (electrons * (self.response.M + 1))
            variance += np.where(seen, photon + read**2 + 1 / 12, 0.0)
            slope += np.where(seen, e * steepness, 0.0)
        known = slope > 0
        return np.where(known, np.sqrt(variance) / np.where(known, slope, 1.0), np.inf)


def effective_levels(camera: EffectiveCamera, desired: DesiredResponse) -> float:
    """Return L = (sum of gap_u^3)^(-1/2): how many equal steps of u would be as accurate.

    The gaps lie between neighbours of e_min, the distinct levels inside (e_min, 1) and 1, mapped
    through u.  N equal steps give exactly N; L is the rms quantisation error in u as a count.
    """
    return levels_as_effective(camera.levels, desired)


def levels_as_effective(levels: FloatArray, desired: DesiredResponse) -> float:
    """Return the effective levels of an ascending list of levels (N,)."""
    inside = levels[(levels > desired.e_min) & (levels < 1)]
    edges = np.concatenate([[desired.e_min], inside, [1.0]])
    gaps = desired.rise(edges[:-1], edges[1:])
    return float(np.sum(gaps**3) ** -0.5)
