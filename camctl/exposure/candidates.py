"""The objective of whole batches of candidates of a search.

The objective of a batch is the same integral as in `camctl.exposure.objective`, computed by numpy
gap by gap without branches, in float32 (relative rounding error of a level 6e-8) for cameras of up
to 4,096 levels and in float64 above.  It has closed forms for linear with every p, for the square
root and the logarithm with p = 1 and 2, for other gammas with p = 1, and for tables with every p:
there gaps are divided at the knots.  All other cases use the mean slope of each gap, which gives a
lower bound of the objective that is good enough to rank candidates: a search ends with the exact
objective.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.objective import ExposureProblem
from camctl.model.response.camera import FloatArray
from camctl.model.response.desired import GammaDesired, LinearDesired, LogDesired
from camctl.model.response.tabulated import TabulatedDesired

CACHE_ELEMENTS = 100_000
"""Numbers in one working array: the arrays of a batch then fit into the cache of one core."""

MAX_BATCH = 64
"""Candidates in a batch, at most: the limit for cameras of few levels."""

MAX_FLOAT32_LEVELS = 4096
"""Cameras of more levels are scored in float64: their gaps approach float32's rounding, 6e-8."""

SECONDS_A_LEVEL = {
    "closed": (1.5e-8, 2.2e-8),
    "square": (4e-8, 6e-8),
    "power": (4.5e-8, 8e-8),
    "table": (9e-8, 9e-8),
    "other": (1.1e-7, 1.1e-7),
}
"""Processor time for each level of a set in a batch, in float32 and float64, by what its gaps need:
measured for 8 to 16 bits on one core of 2.5 GHz."""

Work = NDArray[Any]


def _formula(problem: ExposureProblem) -> str:
    """Return what the gaps of a problem need, a key of `SECONDS_A_LEVEL`."""
    desired, p = problem.desired, problem.objective.p
    if isinstance(desired, TabulatedDesired):
        return "table"
    is_root = isinstance(desired, GammaDesired) and desired.gamma == 0.5
    if isinstance(desired, LinearDesired | LogDesired) or is_root:
        return "closed" if p == 1 else "square" if p == 2 else "other"
    is_power = isinstance(desired, GammaDesired) and p == 1 and desired.curvature < 0
    return "power" if is_power else "other"


class BatchScore:
    """Scores (B, n) exposures, each row ascending from 1.

    Args:
        problem: the problem whose objective is computed
        exact: compute in float64 for cameras of few levels, too

    Attributes:
        evaluations: rows scored so far
        seconds: about how long the score of a row takes, s; the same on each machine
    """

    def __init__(self, problem: ExposureProblem, *, exact: bool = False) -> None:
        self.problem = problem
        self.evaluations = 0
        self._desired = problem.desired
        self._p = problem.objective.p
        self._G = problem.levels_wanted
        M = problem.response.M
        small = M <= MAX_FLOAT32_LEVELS and self._p <= 2  # higher powers overflow float32
        self._is_table = isinstance(problem.desired, TabulatedDesired)
        dtype = np.float32 if small and not exact and not self._is_table else np.float64
        self._levels = problem.response.levels.astype(dtype)
        size = problem.n * M
        self._jitter_factors = problem.jitter_factors()
        # All of a table's knots divide the gaps, beside the levels.
        self._batch = max(1, min(MAX_BATCH, CACHE_ELEMENTS // (size + self._desired.knots.size)))
        shape = (self._batch, size + 1)
        self._edges: Work = np.zeros((self._batch, size + 2), dtype=dtype)
        self._work: tuple[Work, Work, Work] = (
            np.empty(shape, dtype),
            np.empty(shape, dtype),
            np.empty(shape, dtype),
        )
        self._tiny = dtype(1e-30)
        each = SECONDS_A_LEVEL[_formula(problem)][0 if dtype == np.float32 else 1]
        self.seconds = each * problem.sorted_levels

    def __call__(self, exposures: FloatArray) -> FloatArray:
        """Return the objective of each row, (B,) float64."""
        total = np.zeros(len(exposures))
        for factor in self._jitter_factors:
            total += self._xi(exposures * factor)
        total /= len(self._jitter_factors)
        if self.problem.objective.noise is not None:
            total += self.problem.objective.noise.cost(exposures)
        self.evaluations += len(exposures)
        return total

    def _xi(self, exposures: FloatArray) -> FloatArray:
        parts = [
            self._block(exposures[first : first + self._batch])
            for first in range(0, len(exposures), self._batch)
        ]
        return np.concatenate(parts) if parts else np.empty(0)

    def _block(self, exposures: FloatArray) -> FloatArray:
        rows = len(exposures)
        edges = self._edges[:rows]
        edges[:, 0] = 0
        inverse = (1 / exposures).astype(edges.dtype)
        levels = edges[:, 1:-1].reshape(rows, self.problem.n, -1)
        np.multiply(self._levels, inverse[:, :, np.newaxis], out=levels)
        np.minimum(edges[:, 1:-1], 1, out=edges[:, 1:-1])
        edges[:, -1] = 1
        edges.sort(axis=1, kind="stable")
        if self._is_table:
            return self._divided(edges)
        e_min = edges.dtype.type(self._desired.e_min)
        row = np.arange(rows)
        # In float32 the e_min of a very narrow range is 1, as is the last edge.
        above = np.clip((edges <= e_min).sum(axis=1), 1, edges.shape[1] - 1)
        high = edges[row, above].astype(np.float64)
        width = high - edges[row, above - 1].astype(np.float64)
        np.maximum(edges, e_min, out=edges)
        missing = self._gaps(edges[:, :-1], edges[:, 1:], [work[:rows] for work in self._work])
        missing[row, above - 1] = self._straddling(high, width)
        return np.asarray(missing.sum(axis=1), dtype=np.float64)

    def _divided(self, edges: Work) -> FloatArray:
        """Return the integrals over ascending edges (B, N), with gaps divided at the knots.

        Between two knots of a table g' is constant, so that each piece has a closed form: from an
        edge to the next knot, from the last knot to an edge, and all between two knots.
        """
        desired, rows = self._desired, len(edges)
        knots = np.concatenate([[desired.e_min], desired.knots, [1.0]])
        slopes = self._G * desired.slope(knots[:-1])
        inverse = 1 / np.maximum(np.diff(edges, axis=1), self._tiny)
        np.maximum(edges, desired.e_min, out=edges)
        low, high = edges[:, :-1], edges[:, 1:]
        first = np.searchsorted(knots[1:-1], low, side="right")
        last = first[:, 1:]
        begun = self._pieces(slopes[first], inverse, np.minimum(knots[first + 1], high) - low)
        length = np.where(last > first[:, :-1], high[:, :-1] - knots[last], 0.0)
        ended = self._pieces(slopes[last], inverse[:, :-1], length)
        counts = np.diff(first, axis=1, append=slopes.size)
        between = np.repeat(inverse.ravel(), counts.ravel()).reshape(rows, slopes.size)
        between[np.arange(rows)[:, np.newaxis], first] = np.inf  # divided by an edge
        return begun + ended + self._pieces(slopes, between, np.diff(knots))

    def _pieces(self, slope: FloatArray, inverse: FloatArray, length: FloatArray) -> FloatArray:
        """Return the integrals over pieces (B, N) of gaps of which 1 / width is given, (B,)."""
        height = slope - inverse
        np.maximum(height, 0.0, out=height)
        if self._p != 1:
            height **= self._p
        height *= length
        return np.asarray(height.sum(axis=1))

    def _straddling(self, high: FloatArray, width: FloatArray) -> FloatArray:
        """Return the integral over the gap that contains e_min: of full width, from e_min on."""
        low = np.full_like(high, self._desired.e_min)
        return self._closed(low, high, width)

    def _closed(self, low: FloatArray, high: FloatArray, width: FloatArray) -> FloatArray:
        """Return the integral over a gap in float64, by its mean slope if it has no closed form."""
        G, p, desired = self._G, self._p, self._desired
        stop = high
        if desired.curvature != 0:
            crossing = np.clip(desired.inverse_slope(1 / (G * width)), low, high)
            low, stop = (low, crossing) if desired.curvature < 0 else (crossing, high)
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
        desired, p = self._desired, self._p
        if isinstance(desired, LinearDesired):
            return self._linear(low, high, work)
        if isinstance(desired, LogDesired) and p in (1, 2):
            return self._log(low, high, work)
        if isinstance(desired, GammaDesired) and desired.gamma == 0.5 and p in (1, 2):
            return self._root(low, high, work)
        if isinstance(desired, GammaDesired) and p == 1:
            if desired.curvature < 0:
                return self._power(low, high, desired.gamma)
            width = np.maximum(high - low, self._tiny)
            return self._closed(low.astype(np.float64), high.astype(np.float64), width)
        heights = self._G * desired.u(np.append(low, high[:, -1:], axis=1))
        excess = np.maximum(np.diff(heights, axis=1) - 1, 0.0)
        if p == 1:
            return excess
        width = np.where(excess > 0, (high - low).astype(np.float64), 1.0)
        return np.asarray((excess / width) ** p * width)

    def _linear(self, low: Work, high: Work, work: list[Work]) -> Work:
        p = self._p
        slope = low.dtype.type(self._G / (1 - self._desired.e_min))
        excess: Work = np.subtract(high, low, out=work[0])
        width: Work = np.maximum(excess, 1 / slope, out=work[1])  # narrower gaps count 0
        excess *= slope
        excess -= 1
        np.maximum(excess, 0, out=excess)
        if p == 1:
            return excess
        power: Work = excess**p * width ** low.dtype.type(1 - p)
        return power

    def _log(self, low: Work, high: Work, work: list[Work]) -> Work:
        k = low.dtype.type(self._G / np.log(self._desired.dynamic_range))
        ratio = np.subtract(high, low, out=work[0])
        ratio /= low
        np.maximum(ratio, 1e-9, out=ratio)
        stop = np.multiply(ratio, k, out=work[1])  # E with g' = h', as a multiple of low
        rise = np.add(ratio, 1, out=work[2])
        np.minimum(stop, rise, out=stop)
        np.maximum(stop, 1, out=stop)
        if self._p == 1:
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
        k = low.dtype.type(self._G / (1 - self._desired.e_min**0.5))
        width = np.subtract(high, low, out=work[0])
        stop = np.multiply(width, k / 2, out=work[1])
        stop *= stop
        np.minimum(stop, high, out=stop)
        np.maximum(stop, low, out=stop)
        rise: Work = np.sqrt(stop, out=work[2])
        if self._p == 2:
            return self._root_squared(low, stop, width)
        stop -= low
        np.maximum(width, self._tiny, out=width)
        stop /= width
        rise -= np.sqrt(low, out=width)
        rise *= k
        rise -= stop
        return rise

    def _power(self, low: Work, high: Work, gamma: float) -> Work:
        k = low.dtype.type(self._G / (1 - self._desired.e_min**gamma))
        width = np.maximum(high - low, self._tiny)
        with np.errstate(over="ignore"):  # values that overflow lie above `high`
            stop = (width * (k * low.dtype.type(gamma))) ** low.dtype.type(1 / (1 - gamma))
        np.minimum(stop, high, out=stop)
        np.maximum(stop, low, out=stop)
        power = low.dtype.type(gamma)
        missing: Work = k * (stop**power - low**power) - (stop - low) / width
        return missing

    def _root_squared(self, low: Work, stop: Work, width: Work) -> Work:
        k = low.dtype.type(self._G / (1 - self._desired.e_min**0.5))
        floor = np.maximum(low, self._tiny)
        width = np.maximum(width, low.dtype.type(1e-12))
        span = stop - low
        rise = k * (np.sqrt(stop) - np.sqrt(low))
        square = k * k / 4 * np.log1p(span / floor)
        return np.asarray(np.maximum(square - (2 * rise - span / width) / width, 0))
