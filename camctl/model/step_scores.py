"""Maximum likelihood of the light of samples, from the exact probabilities of the steps.

Fisher scoring: the light E becomes E + (sum of scores) / information, a few times.  The score of a
sample is d ln p / dE, and its information the mean of the square of that; both are tabulated by
light, and the scores also by frame and value.  Unlike a posterior it costs the same for each
combination of samples.

Where the variance v of the light grows with it, as by photons, dv/dE is added: for a prior that is
flat in E the posterior mean is larger than the maximum by so much.  With photon noise alone it is
one electron.  Information that changes for another reason adds nothing: steps have as much of it
above their light as below, and samples that are saturated say nothing of where the others lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import NORMAL_REACH, NoisyFrame, normal_cdf
from camctl.model.light_bins import LightBins
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import SensorModel
from camctl.model.step_posterior import FrameSet

#: Scores of a table at most: 32 MB.
_LARGEST = 1 << 23

#: Rounds: the error of the first light, of its own standard deviation, is divided by about 10 in
#: each.  A round changes the light by this factor at most.
_ROUNDS, _FACTOR = 3, 2.0

#: Probability below which a score is its limit for improbable samples: `normal_cdf` is exact to
#: 1e-7.
_LEAST = 1e-5

#: Least noise in steps: with less of it scores are 0 within a step.
_LEAST_NOISE = 0.05


class StepScores:
    """Estimates light up to the last of some lights.

    Args:
        frames: exposures and noise
        sensor: the camera
        bins: of light
        size: so many of them, from the first one on

    Attributes:
        size: number of lights
        deviation: (size,) float32, standard deviation at each of them
    """

    def __init__(self, frames: FrameSet, sensor: SensorModel, bins: LightBins, size: int) -> None:
        self._bins, lights = bins, bins.lights[:size]
        self._lights = lights.astype(np.float32)
        information = np.zeros(lights.size)
        # Of a sample that is not saturated, as if the quantiser's error were normal, too.
        self._normal, self._growth = np.empty((2, len(frames.noise), lights.size))
        self._scores = np.empty(
            (len(frames.noise), lights.size, _values(frames, sensor, lights)), "f4"
        )
        for at, (table, exposure, noise) in enumerate(
            zip(self._scores, frames.exposures, frames.noise, strict=True)
        ):
            x = (exposure * lights + noise.dark_levels * sensor.level)[:, np.newaxis]
            offset = noise.dsnu_levels * sensor.level
            # Where measured levels coincide, a step has no width.
            least = (_LEAST_NOISE * np.maximum(sensor.step(x), 1e-6 * sensor.level)) ** 2
            variance = np.maximum(sensor.spread(x, noise) + offset**2, least)
            sigma = np.sqrt(variance)
            normal = exposure**2 / (variance + sensor.step(x) ** 2 / 12)[:, 0]
            self._normal[at] = normal
            self._growth[at] = (normal / exposure) ** 2 * np.gradient(variance[:, 0], lights)
            growth = exposure * sensor.level / noise.electrons_per_level / (2 * variance)
            thresholds = NoisyFrame.of(frames.response, 1.0, noise).thresholds
            z = (thresholds[: table.shape[1]] - x) / sigma
            slope = -exposure / sigma - z * growth
            z, slope = (np.pad(each, ((0, 0), (1, 0))) for each in (z, slope))
            below, density = normal_cdf(z), np.exp(-np.square(z) / 2) / np.sqrt(2 * np.pi) * slope
            below[:, 0] = density[:, 0] = 0.0
            if table.shape[1] > thresholds.size:  # white has no end
                below, density = (np.pad(each, ((0, 0), (0, 1))) for each in (below, density))
                below[:, -1] = 1.0
                z, slope = (np.pad(each, ((0, 0), (0, 1)), mode="edge") for each in (z, slope))
            probability, rise = np.diff(below, axis=1), np.diff(density, axis=1)
            # The end of a step that is nearer to the light.
            is_above = z[:, :-1] + z[:, 1:] > 0
            is_above[:, 0] = False
            end, by = (np.where(is_above, each[:, :-1], each[:, 1:]) for each in (z, slope))
            usual = probability > _LEAST
            safe = np.maximum(probability, _LEAST)
            table[...] = np.where(usual, rise / safe, -end * by)
            information += np.where(usual, rise**2 / safe, 0.0).sum(axis=1)
        self.size, self._white = size, sensor.white
        # Within a sharp step there is none.  A round changes the light by a factor at most.
        information = np.maximum(information, np.square(1e-6 / lights))
        self._inverse = (1 / information).astype(np.float32)
        self.deviation = np.sqrt(self._inverse)

    @staticmethod
    def fits(frames: FrameSet, sensor: SensorModel, lights: FloatArray) -> bool:
        """Return whether the table of these lights is small enough."""
        return len(frames.noise) * lights.size * _values(frames, sensor, lights) <= _LARGEST

    def of(
        self, values: Sequence[NDArray[Any]], bins: NDArray[np.intp]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Return the light of samples, its standard deviation, and whether the rounds met.

        The deviation has no differences of pixels.  Rounds do not meet where samples contradict the
        first light, as beside saturation, or the light is beyond the last one.

        Args:
            values: samples of each frame, (S,), black included
            bins: place of a first light of each among the lights, (S,); it may be beyond the last
        """
        _, size, many = self._scores.shape
        places = [np.minimum(each, many - 1) for each in values]
        bins = np.minimum(bins, size - 1)
        for _ in range(_ROUNDS):
            rows = bins * many
            score = self._scores[0].ravel().take(rows + places[0])
            for table, each in zip(self._scores[1:], places[1:], strict=True):
                score += table.ravel().take(rows + each)
            light = self._lights.take(bins)
            E = light + score * self._inverse.take(bins)
            np.clip(E, light / np.float32(_FACTOR), light * np.float32(_FACTOR), out=E)
            bins = np.minimum(self._bins.of(E), size - 1)
        deviation = self.deviation.take(bins)
        meets = (np.abs(E - light) < deviation) & (bins < size - 1)
        E += self._shift(values, bins)
        return E, deviation, meets

    def _shift(self, values: Sequence[NDArray[Any]], bins: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return dv/dE of the samples that are not saturated."""
        information, growth = np.zeros((2, bins.size))
        for normal, rise, each in zip(self._normal, self._growth, values, strict=True):
            is_measured = each < self._white
            information += normal.take(bins) * is_measured
            growth += rise.take(bins) * is_measured
        return np.asarray(growth / np.square(np.maximum(information, 1e-15)), np.float32)


def _values(frames: FrameSet, sensor: SensorModel, lights: FloatArray) -> int:
    """Return how many values a table needs: one more than is probable at the brightest light."""
    most = 0
    for exposure, noise in zip(frames.exposures, frames.noise, strict=True):
        x = np.array([exposure * lights[-1] + noise.dark_levels * sensor.level])
        reach = float((x + NORMAL_REACH * np.sqrt(sensor.spread(x, noise)))[0])
        most = max(most, int(np.searchsorted(sensor.light, reach)) + 2)
    return min(most, sensor.white + 1)
