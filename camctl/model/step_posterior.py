"""The posterior mean of the light of samples, from the exact probabilities of the steps.

The prior is flat in light >= 0.  What few combinations of samples occur in many pixels, as where
noise is below half a step of the quantiser, is computed once for each combination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import NoisyFrame, check_noise, normal_cdf
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.sensor import SensorModel

#: Standard deviations of noise that the range of a posterior holds: beyond it, 3e-7 of a normal
#: variable is.
REACH = 5.0

#: Nodes of a posterior, which is computed again where it is narrower than 3 of their distances: the
#: sum of a wider normal one has an error of 2 exp(-2 (3 pi)^2).  Combinations computed at once.
_NODES, _CHUNK = 48, 4096


@dataclass(frozen=True)
class FrameSet:
    """What the tables depend on.

    Attributes:
        response: of the camera; its fingerprint is compared
        black: brightness without light, DN
        exposures: of the frames, relative to the shortest, which has 1
        noise: of each frame
        fingerprint: of `response`
    """

    response: CameraResponse = field(compare=False, repr=False)
    black: int
    exposures: tuple[float, ...]
    noise: tuple[FrameNoise, ...]
    fingerprint: str = ""

    def __post_init__(self) -> None:
        check_noise(self.noise, len(self.exposures))
        object.__setattr__(self, "fingerprint", self.response.fingerprint)


class StepPosterior:
    """The posterior of the light after values of each frame.

    Args:
        frames: exposures and noise
        sensor: the camera
    """

    def __init__(self, frames: FrameSet, sensor: SensorModel) -> None:
        self._frames, self.sensor = frames, sensor

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """Both ends of the light of each value; infinite at the lowest and the highest one."""
        noise = FrameNoise(np.inf, 0.0, black=self._frames.black)
        thresholds = NoisyFrame.of(self._frames.response, 1.0, noise).thresholds
        return np.append(-np.inf, thresholds), np.append(thresholds, np.inf)

    def of(
        self, values: Sequence[NDArray[Any]], kept: Sequence[NDArray[np.bool_]]
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and deviation of the light of samples; NaN where all probabilities are 0.

        Args:
            values: samples of each frame, (S,), black included
            kept: whether each sample counts, likewise
        """
        key, size = np.zeros(values[0].size, np.int64), 1
        count = self.sensor.white + 2
        for each, used in zip(values, kept, strict=True):
            if size > (1 << 62) // count:
                key = np.unique(key, return_inverse=True)[1].astype(np.int64)
                size = int(key.max()) + 1
            key = key * count + np.where(used, each.astype(np.int64) + 1, 0)
            size *= count
        _, place, inverse = np.unique(key, return_index=True, return_inverse=True)
        rows = np.stack(
            [
                np.where(used[place], each[place].astype(np.intp), -1)
                for each, used in zip(values, kept, strict=True)
            ]
        )
        parts = [
            self._posterior(rows[:, first : first + _CHUNK])
            for first in range(0, place.size, _CHUNK)
        ]
        mean, spread = (np.concatenate(each)[inverse] for each in zip(*parts, strict=True))
        return mean, spread

    def _posterior(self, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Return mean and deviation of the light after values (n, U); -1: the frame is left out."""
        lower, upper = self._edges
        low, high = np.zeros(rows.shape[1]), np.full(rows.shape[1], np.inf)
        for row, exposure, noise in zip(
            rows, self._frames.exposures, self._frames.noise, strict=True
        ):
            for edges, sign in ((lower, -1.0), (upper, 1.0)):
                spread = self._spread(np.where(np.isfinite(edges), edges, 0.0), noise)
                found = (edges + sign * REACH * spread)[row] / exposure
                found = found - noise.dark_levels * self.sensor.level / exposure
                if sign < 0:
                    low = np.where(row >= 0, np.maximum(low, found), low)
                else:
                    high = np.where(row >= 0, np.minimum(high, found), high)
        high[~np.isfinite(high) | (high <= low)] = np.nan
        mean, spread = self._moments(rows, low, high)
        cell = (high - low) / _NODES
        narrow = np.flatnonzero(spread < 3 * cell)
        if narrow.size:
            reach = 6 * spread[narrow] + cell[narrow]
            mean[narrow], spread[narrow] = self._moments(
                rows[:, narrow],
                np.maximum(low[narrow], mean[narrow] - reach),
                np.minimum(high[narrow], mean[narrow] + reach),
            )
        prnu = max(each.prnu for each in self._frames.noise)
        return mean, np.hypot(spread, prnu * mean)

    def _spread(self, light: FloatArray, noise: FrameNoise) -> FloatArray:
        """Return the standard deviation of a sample's light, differences of pixels included."""
        offset = noise.dsnu_levels * self.sensor.level
        return np.sqrt(self.sensor.variance(light, noise) + offset**2)

    def _moments(
        self, rows: NDArray[np.intp], low: FloatArray, high: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and deviation of each posterior between two lights; NaN where it is 0."""
        lower, upper = self._edges
        cell = (high - low)[:, np.newaxis] / _NODES
        E = low[:, np.newaxis] + cell * (np.arange(_NODES) + 0.5)
        likelihood = np.isfinite(E).astype(np.float64)
        E = np.where(likelihood > 0, E, 0.0)
        for row, exposure, noise in zip(
            rows, self._frames.exposures, self._frames.noise, strict=True
        ):
            used = np.flatnonzero(row >= 0)
            x = exposure * E[used] + noise.dark_levels * self.sensor.level
            sigma = np.maximum(self._spread(x, noise), 1e-9 * self.sensor.full)
            ends = [edges[row[used]][:, np.newaxis] for edges in (upper, lower)]
            above, below = (normal_cdf((end - x) / sigma) for end in ends)
            likelihood[used] *= above - below
        total = likelihood.sum(axis=1)
        total[total <= 0] = np.nan
        mean = (likelihood * E).sum(axis=1) / total
        variance = (likelihood * (E - mean[:, np.newaxis]) ** 2).sum(axis=1) / total
        return mean, np.sqrt(variance + cell[:, 0] ** 2 / 12)
