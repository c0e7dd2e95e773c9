"""Fast scores for sets taken out of one grid of settings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.desired import DesiredResponse, TabulatedDesired
from camctl.exposure.goal import Goal
from camctl.exposure.kernels import CACHE_ELEMENTS, BatchScore
from camctl.exposure.real import FloatArray, RealResponse

MOST_KEPT = 8_000_000


class SubsetScore:
    """Scores (C, n) index sets into an ascending grid of exposures (S,).

    For a desired response in a table u of every level at every ratio is worked out once, so that a
    set costs a sort of n M numbers and no look-up; the score is then the lower bound by the mean
    slope of each gap.  Closed forms go through `BatchScore`.
    """

    def __init__(
        self,
        response: RealResponse,
        desired: DesiredResponse,
        goal: Goal,
        grid: FloatArray,
        n: int,
    ) -> None:
        self.evaluations = 0
        self._grid, self._goal, self._n = grid, goal, n
        self._batch = BatchScore(response, desired, goal, n)
        self._levels, self._desired = response.levels, desired
        self._tabulated = isinstance(desired, TabulatedDesired) and goal.p == 1

    def __call__(self, sets: NDArray[np.intp]) -> FloatArray:
        """Return the objective of each set, (C,) float64."""
        self.evaluations += len(sets)
        chosen = self._grid[sets]
        ratios = chosen / chosen[:, :1]
        if self._tabulated:
            distinct, which = np.unique(np.round(np.log(ratios), 9), return_inverse=True)
            if distinct.size * self._levels.size <= MOST_KEPT:
                return self._by_table(np.exp(distinct), which.reshape(ratios.shape))
        return self._batch(ratios)

    def _by_table(self, ratios: FloatArray, which: NDArray[np.intp]) -> FloatArray:
        G = np.float32(self._goal.levels_wanted)
        heights = self._desired.u(self._levels / ratios[:, np.newaxis]).astype(np.float32) * G
        rows, M = len(which), self._levels.size
        scores = np.empty(rows)
        size = max(1, CACHE_ELEMENTS // (self._n * M))
        for first in range(0, rows, size):
            part = which[first : first + size]
            edges = np.empty((len(part), self._n * M + 2), dtype=np.float32)
            edges[:, 0], edges[:, -1] = 0, G
            edges[:, 1:-1] = heights[part].reshape(len(part), -1)
            edges.sort(axis=1)
            gaps = np.diff(edges, axis=1)
            gaps -= 1
            np.maximum(gaps, 0, out=gaps)
            scores[first : first + size] = gaps.sum(axis=1)
        return scores
