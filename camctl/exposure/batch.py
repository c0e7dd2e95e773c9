"""The objective for batches of candidates, as fast as numpy goes on one core.

Same mathematics as `objective`, in float32 (6e-8 of a level's irradiance) up to 4,096 levels a
frame and in float64 above, gap by gap without branches.  Exact are linear for every p, square root
and logarithm for p = 1 and 2, and powers q < 1 for p = 1.  What remains uses the mean slope of each
gap, a lower bound that is good enough to rank candidates: a search ends with the exact one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.objective import Objective
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse, GammaDesired, LinearDesired, LogDesired

CACHE_ELEMENTS = 100_000
"""Numbers in one working array: a batch's few arrays stay within a core's own cache."""

FINEST_FLOAT32 = 4096

Work = NDArray[Any]


class BatchScore:
    """Scores (B, n) exposures, each row ascending from 1, on one core.

    `exact` means float64 for cameras of few levels too.

    Attributes:
        evaluations: rows scored so far
    """

    def __init__(
        self,
        response: CameraResponse,
        desired: DesiredResponse,
        goal: Objective,
        n: int,
        *,
        exact: bool = False,
    ) -> None:
        self.desired = desired
        self.goal = goal
        self.n = n
        self.evaluations = 0
        small = response.M <= FINEST_FLOAT32 and goal.p <= 2  # higher powers overflow float32
        dtype = np.float32 if small and not exact else np.float64
        self._levels = response.levels.astype(dtype)
        self._size = n * response.M
        self._draws = goal.draws(n)
        self.batch = max(1, min(64, CACHE_ELEMENTS // self._size))
        shape = (self.batch, self._size + 1)
        self._edges: Work = np.zeros((self.batch, self._size + 2), dtype=dtype)
        self._work: tuple[Work, Work, Work] = (
            np.empty(shape, dtype),
            np.empty(shape, dtype),
            np.empty(shape, dtype),
        )
        self._tiny = dtype(1e-30)

    def __call__(self, exposures: FloatArray) -> FloatArray:
        """Return the objective of each row, (B,) float64."""
        total = np.zeros(len(exposures))
        for factor in self._draws:
            total += self._mean_free(exposures * factor)
        total /= len(self._draws)
        if self.goal.noise is not None:
            total += self.goal.noise.cost(exposures)
        self.evaluations += len(exposures)
        return total

    def _mean_free(self, exposures: FloatArray) -> FloatArray:
        parts = [
            self._block(exposures[first : first + self.batch])
            for first in range(0, len(exposures), self.batch)
        ]
        return np.concatenate(parts) if parts else np.empty(0)

    def _block(self, exposures: FloatArray) -> FloatArray:
        rows = len(exposures)
        edges = self._edges[:rows]
        edges[:, 0] = 0
        inverse = (1 / exposures).astype(edges.dtype)
        levels = edges[:, 1:-1].reshape(rows, self.n, -1)
        np.multiply(self._levels, inverse[:, :, np.newaxis], out=levels)
        np.minimum(edges[:, 1:-1], 1, out=edges[:, 1:-1])
        edges[:, -1] = 1
        edges.sort(axis=1)
        e_min = edges.dtype.type(self.desired.e_min)
        at = np.arange(rows)
        above = np.maximum((edges <= e_min).sum(axis=1), 1)
        high = edges[at, above].astype(np.float64)
        width = high - edges[at, above - 1].astype(np.float64)
        np.maximum(edges, e_min, out=edges)
        missing = self._gaps(edges[:, :-1], edges[:, 1:], [work[:rows] for work in self._work])
        missing[at, above - 1] = self._straddling(high, width)
        return np.asarray(missing.sum(axis=1), dtype=np.float64)

    def _straddling(self, high: FloatArray, width: FloatArray) -> FloatArray:
        """Return the share of the gap that holds e_min: full width, counted from e_min only."""
        low = np.full_like(high, self.desired.e_min)
        return self._closed(low, high, width)

    def _closed(self, low: FloatArray, high: FloatArray, width: FloatArray) -> FloatArray:
        """Return the gap's share in float64, by its mean slope where there is no closed form."""
        G, p, desired = self.goal.levels_wanted, self.goal.p, self.desired
        stop = high
        if desired.bend < 0:
            stop = np.clip(desired.where_slope(1 / (G * width)), low, high)
        span = stop - low
        rise = G * desired.rise(low, stop)
        if p == 1:
            return np.asarray(np.maximum(rise - span / width, 0.0))
        if p == 2 and isinstance(desired, LogDesired):
            k = G / np.log(desired.dynamic_range)
            square = k * k * span / (low * stop)
            return np.asarray(np.maximum(square - (2 * rise - span / width) / width, 0.0))
        mean = np.maximum(rise / np.where(span > 0, span, 1.0) - 1 / width, 0.0)
        return np.asarray(mean**p * span)

    def _gaps(self, low: Work, high: Work, work: list[Work]) -> Work:
        desired, p = self.desired, self.goal.p
        if isinstance(desired, LinearDesired):
            return self._linear(low, high, work)
        if isinstance(desired, LogDesired) and p in (1, 2):
            return self._log(low, high, work)
        if isinstance(desired, GammaDesired) and desired.q == 0.5 and p in (1, 2):
            return self._root(low, high, work)
        if isinstance(desired, GammaDesired) and desired.bend < 0 and p == 1:
            return self._power(low, high, desired.q)
        heights = self.goal.levels_wanted * desired.u(np.append(low, high[:, -1:], axis=1))
        excess = np.maximum(np.diff(heights, axis=1) - 1, 0.0)
        if p == 1:
            return excess
        width = np.where(excess > 0, (high - low).astype(np.float64), 1.0)
        return np.asarray((excess / width) ** p * width)

    def _linear(self, low: Work, high: Work, work: list[Work]) -> Work:
        p = self.goal.p
        steepness = low.dtype.type(self.goal.levels_wanted / (1 - self.desired.e_min))
        excess: Work = np.subtract(high, low, out=work[0])
        width: Work = np.maximum(excess, 1 / steepness, out=work[1])  # narrower gaps count 0
        excess *= steepness
        excess -= 1
        np.maximum(excess, 0, out=excess)
        if p == 1:
            return excess
        power: Work = excess**p * width ** low.dtype.type(1 - p)
        return power

    def _log(self, low: Work, high: Work, work: list[Work]) -> Work:
        k = low.dtype.type(self.goal.levels_wanted / np.log(self.desired.dynamic_range))
        ratio = np.subtract(high, low, out=work[0])
        ratio /= low
        np.maximum(ratio, 1e-9, out=ratio)
        stop = np.multiply(ratio, k, out=work[1])  # where g' = h', as a multiple of low
        rise = np.add(ratio, 1, out=work[2])
        np.minimum(stop, rise, out=stop)
        np.maximum(stop, 1, out=stop)
        if self.goal.p == 1:
            np.log(stop, out=rise)
            rise *= k
            stop -= 1
            stop /= ratio
            rise -= stop
            return rise
        span = stop - 1
        height = k * k * span / stop - (2 * k * np.log(stop) - span / ratio) / ratio
        return np.asarray(np.maximum(height, 0) / low)

    def _root(self, low: Work, high: Work, work: list[Work]) -> Work:
        k = low.dtype.type(self.goal.levels_wanted / (1 - self.desired.e_min**0.5))
        width = np.subtract(high, low, out=work[0])
        stop = np.multiply(width, k / 2, out=work[1])
        stop *= stop
        np.minimum(stop, high, out=stop)
        np.maximum(stop, low, out=stop)
        rise: Work = np.sqrt(stop, out=work[2])
        if self.goal.p == 2:
            return self._root_squared(low, stop, width)
        stop -= low
        np.maximum(width, self._tiny, out=width)
        stop /= width
        rise -= np.sqrt(low, out=width)
        rise *= k
        rise -= stop
        return rise

    def _power(self, low: Work, high: Work, q: float) -> Work:
        k = low.dtype.type(self.goal.levels_wanted / (1 - self.desired.e_min**q))
        width = np.maximum(high - low, self._tiny)
        with np.errstate(over="ignore"):  # what overflows lies above `high` anyway
            stop = (width * (k * low.dtype.type(q))) ** low.dtype.type(1 / (1 - q))
        np.minimum(stop, high, out=stop)
        np.maximum(stop, low, out=stop)
        power = low.dtype.type(q)
        missing: Work = k * (stop**power - low**power) - (stop - low) / width
        return missing

    def _root_squared(self, low: Work, stop: Work, width: Work) -> Work:
        k = low.dtype.type(self.goal.levels_wanted / (1 - self.desired.e_min**0.5))
        floor = np.maximum(low, self._tiny)
        width = np.maximum(width, low.dtype.type(1e-12))
        span = stop - low
        rise = k * (np.sqrt(stop) - np.sqrt(low))
        square = k * k / 4 * np.log1p(span / floor)
        return np.asarray(np.maximum(square - (2 * rise - span / width) / width, 0))
