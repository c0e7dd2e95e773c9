"""Least-squares fit of exposure ratios to the light of patches: see `camctl.evidence.ratios`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from camctl.model.quantiles import NORMAL_MAD, median
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import BLACK_ERROR_LEVELS

BLOCKS = 16
"""The frame is divided into this number of blocks for the confidence intervals."""

#: Tukey's constant, in standard deviations, and the number of reweighting steps.
_TUKEY, _STEPS = 4.685, 20


class RatioFit:
    """Weighted least squares for x and b; each patch's irradiance is eliminated.

    Args:
        logs: logarithm of light, (patches, frames)
        weights: 1 / variance, 0 where a patch does not count
        slopes: derivative of `logs` by the error of the black level in levels
        reference: frame whose x is 0

    Attributes:
        used: where a patch counts that several frames show
        scatter: of the patches over their predicted errors, at least 1; set by `robust`
    """

    def __init__(
        self, logs: FloatArray, weights: FloatArray, slopes: FloatArray, reference: int
    ) -> None:
        several = np.count_nonzero(weights, axis=1) > 1
        self._logs, self._slopes = logs, slopes
        self._weights = weights * several[:, None]
        self.used = self._weights > 0
        # The exposures of the other frames, and the error of the black level.
        self._unknown = [k for k in range(logs.shape[1] + 1) if k != reference]
        self._both = np.stack((slopes, logs), axis=2)
        # Contiguous patches form a block, since they follow each other row by row.
        ends = [-(-block * len(logs) // BLOCKS) for block in range(BLOCKS + 1)]
        self._blocks = [slice(*each) for each in pairwise(ends)]

    def robust(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and the final weights, from a first estimate of x."""
        x, black = start, 0.0
        for _ in range(_STEPS):
            residual = self._residuals(x, black, self._weights)
            size = np.abs(residual) * np.sqrt(self._weights)
            self.scatter = max(1.0, median(size[self._weights > 0]) / NORMAL_MAD)
            keep = np.square(np.clip(1 - np.square(size / (_TUKEY * self.scatter)), 0, None))
            weights = self._weights * keep
            before = x
            x, black = self._solve(self._sums(weights).sum(axis=0))
            if np.max(np.abs(x - before)) < 1e-9:
                break
        return x, weights

    def standard_errors(self, weights: FloatArray) -> FloatArray:
        """Return standard errors of x: the model's, or the jackknife's where it is larger."""
        sums = self._sums(weights)
        total = sums.sum(axis=0)
        model = np.zeros(len(total))
        model[self._unknown] = np.sqrt(np.diag(np.linalg.inv(self._normal(total))))
        left_out = np.array([self._solve(total - block)[0] for block in sums])
        jackknife = np.sqrt(len(sums) - 1) * left_out.std(axis=0)
        return np.asarray(np.maximum(model[:-1], jackknife))

    def _residuals(self, x: FloatArray, black: float, weights: FloatArray) -> FloatArray:
        values = self._logs - x - black * self._slopes
        total = weights.sum(axis=1, keepdims=True)
        mean = (weights * values).sum(axis=1, keepdims=True) / np.maximum(total, 1e-300)
        return np.asarray(values - mean)

    def _sums(self, weights: FloatArray) -> FloatArray:
        """Return the normal equations of each block, (blocks, n + 1, n + 2), for n frames and b."""
        count = weights.shape[1]
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        weighted = weights[:, :, None] * self._both
        columns = np.concatenate((weights, weighted.sum(axis=1)), axis=1)
        shares = columns / total
        result = np.zeros((BLOCKS, count + 1, count + 2))
        for here, part in zip(self._blocks, result, strict=True):
            part[:count, :count] = np.diag(weights[here].sum(axis=0))
            part[:count, count:] = weighted[here].sum(axis=0)
            part[count, :count] = part[:count, count]
            part[count, count:] = np.tensordot(self._slopes[here], weighted[here])
            part -= columns[here, :-1].T @ shares[here]
        return result

    def _normal(self, sums: FloatArray) -> FloatArray:
        normal = sums[np.ix_(self._unknown, self._unknown)] / self.scatter**2
        normal[-1, -1] += 1 / BLACK_ERROR_LEVELS**2
        return np.asarray(normal)

    def _solve(self, sums: FloatArray) -> tuple[FloatArray, float]:
        x = np.zeros(len(sums))
        equations, values = self._normal(sums), sums[self._unknown, -1] / self.scatter**2
        x[self._unknown] = np.linalg.solve(equations, values)
        return x[:-1], float(x[-1])
