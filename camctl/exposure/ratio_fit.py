"""Least-squares fit of exposure ratios to the light of patches: see `camctl.exposure.ratios`."""

from __future__ import annotations

import numpy as np

from camctl.response.camera import FloatArray

BLOCKS = 16
"""The frame is divided into this number of blocks for the confidence intervals."""

#: Standard deviation of the black level's error, levels.
_BLACK_LEVELS = 0.25
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
        self._free = [k for k in range(logs.shape[1]) if k != reference]
        # Contiguous patches form a block, since they follow each other row by row.
        self._block = np.arange(len(logs)) * BLOCKS // len(logs)

    def robust(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and the final weights, from a first estimate of x."""
        x, black = start, 0.0
        for _ in range(_STEPS):
            residual = self._residuals(x, black, self._weights)
            size = np.abs(residual) * np.sqrt(self._weights)
            self.scatter = max(1.0, 1.4826 * float(np.median(size[self._weights > 0])))
            keep = np.square(np.clip(1 - np.square(size / (_TUKEY * self.scatter)), 0, None))
            weights = self._weights * keep
            before = x
            x, black = self._solve(self._sums(weights).sum(axis=0))
            if np.max(np.abs(x - before)) < 1e-9:
                break
        return x, weights

    def standard_errors(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return standard errors of x: the model's, or the jackknife's where it is larger."""
        sums = self._sums(weights)
        total = sums.sum(axis=0)
        normal = self._normal(total)
        model = np.sqrt(np.diag(np.linalg.inv(normal)))[:-1]
        left_out = np.array([self._solve(total - block)[0] for block in sums])[:, self._free]
        centre = left_out.mean(axis=0)
        jackknife = np.sqrt((len(sums) - 1) / len(sums) * np.square(left_out - centre).sum(axis=0))
        errors = np.zeros_like(x)
        errors[self._free] = np.maximum(model, jackknife)
        return errors

    def _residuals(self, x: FloatArray, black: float, weights: FloatArray) -> FloatArray:
        values = self._logs - x - black * self._slopes
        total = weights.sum(axis=1, keepdims=True)
        mean = (weights * values).sum(axis=1, keepdims=True) / np.maximum(total, 1e-300)
        return np.asarray(values - mean)

    def _sums(self, weights: FloatArray) -> FloatArray:
        """Return the normal equations of each block, (blocks, n + 1, n + 2), for n frames and b."""
        count = weights.shape[1]
        total = np.maximum(weights.sum(axis=1), 1e-300)
        columns = np.concatenate(
            (
                weights,
                (weights * self._slopes).sum(axis=1, keepdims=True),
                (weights * self._logs).sum(axis=1, keepdims=True),
            ),
            axis=1,
        )
        result = np.zeros((BLOCKS, count + 1, count + 2))
        for block in range(BLOCKS):
            here = self._block == block
            W, S, Y = weights[here], self._slopes[here], self._logs[here]
            part = result[block]
            part[np.arange(count), np.arange(count)] = W.sum(axis=0)
            part[:count, count] = part[count, :count] = (W * S).sum(axis=0)
            part[:count, count + 1] = (W * Y).sum(axis=0)
            part[count, count] = (W * S * S).sum()
            part[count, count + 1] = (W * S * Y).sum()
            C = columns[here]
            part -= C[:, : count + 1].T @ (C / total[here, None])
        return result

    def _normal(self, sums: FloatArray) -> FloatArray:
        keep = [*self._free, sums.shape[0] - 1]
        normal = sums[np.ix_(keep, keep)] / self.scatter**2
        normal[-1, -1] += 1 / _BLACK_LEVELS**2
        return np.asarray(normal)

    def _solve(self, sums: FloatArray) -> tuple[FloatArray, float]:
        keep = [*self._free, sums.shape[0] - 1]
        solved = np.linalg.solve(self._normal(sums), sums[keep, -1] / self.scatter**2)
        x = np.zeros(sums.shape[0] - 1)
        x[self._free] = solved[:-1]
        return x, float(solved[-1])
