"""How the light that samples show differs from the light there is, by noise and the quantiser.

A sample shows the middle of a step.  Where noise is less than a step, steps of several widths are
within the noise, or it is clipped, the error of that light has neither mean 0 nor the variance of
the noise and of an even step together: its moments are sums over the values of a sample, with their
exact probabilities.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import NORMAL_REACH, NoisyFrame, normal_cdf
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.sensor import SensorModel

#: Lights of a table in each step, and at most: 8 bits need fewer.
_OF_STEP, _MOST_LIGHTS = 8, 2048
#: Their phases in the quantiser follow no pattern where steps are finer (the golden ratio).
_PHASE = (np.sqrt(5) - 1) / 2
#: Values of a sample that are distinguished at a light: so many groups of 12 standard deviations
#: are as good as single values, whose light their means are.
_MOST_VALUES = 48
#: Lights that are looked at together: what is made of them stays in a cache.
_TOGETHER = 256


class SampleMoments:
    """Means of the moments of the error of a sample's light, over ranges of light.

    Args:
        response: of the camera
        black: brightness without light, DN

    Attributes:
        size: number of lights in a table
    """

    def __init__(self, response: CameraResponse, black: int) -> None:
        self._sensor = SensorModel(response, black)
        exact = FrameNoise(np.inf, 0.0, black=black)
        self._thresholds = NoisyFrame.of(response, 1.0, exact).thresholds
        steps = np.concatenate(([0.0], response.levels))
        places = np.arange(response.M * _OF_STEP + 1) / _OF_STEP
        if places.size > _MOST_LIGHTS:
            number = np.arange(_MOST_LIGHTS)
            places = (number + number * _PHASE % 1) / _MOST_LIGHTS * response.M
        self.size = places.size
        self._lights = np.interp(places, np.arange(steps.size), steps)
        self._upper = np.append(self._thresholds, np.inf)  # end of each value
        powers = self._powers = np.stack([self._sensor.light, self._sensor.light**2])
        self._rises = np.diff(powers, axis=1, append=powers[:, -1:])  # to the next value
        # Sums over values, of which a group has a mean.
        self._sums = np.cumsum(np.insert(powers, 0, 0.0, axis=1), axis=1)

    def places(self, light: FloatArray) -> FloatArray:
        """Return lights as places in the table, which the ranges begin and end at."""
        return np.interp(light, self._lights, np.arange(self.size, dtype=np.float64))

    def table(self, noise: FrameNoise) -> FloatArray:
        """Return the mean error, its square, and the variance at each light, (3, size)."""
        x = self._lights
        sigma = np.sqrt(self._sensor.variance(x, noise))
        sigma = np.maximum(sigma, 1e-9 * self._sensor.full)
        ends = [
            np.searchsorted(self._thresholds, x + sign * NORMAL_REACH * sigma) for sign in (-1, 1)
        ]
        found = np.empty((3, self.size))
        for start in range(0, self.size, _TOGETHER):
            part = slice(start, start + _TOGETHER)
            lights, deviations, first, last = (each[part] for each in (x, sigma, *ends))
            count = int((last - first).max()) + 1
            if count <= _MOST_VALUES:
                mean, square = self._of_values(lights, deviations, first, count)
            else:
                mean, square = self._of_groups(lights, deviations, first, last)
            error = mean - lights
            found[:, part] = error, error**2, np.maximum(square - mean**2, 0.0)
        return found

    def _of_values(
        self, lights: FloatArray, sigma: FloatArray, first: NDArray[np.intp], count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the mean light that samples show, and its mean square, from so many values."""
        # What is at least the next value adds the step between both (summation by parts).
        places = first + np.arange(count - 1)[:, np.newaxis]
        distance = lights - self._upper.take(places, mode="clip")
        distance /= sigma
        above = normal_cdf(distance)
        mean, square = (
            lowest + np.einsum("vx,vx->x", above, rise.take(places, mode="clip"))
            for lowest, rise in zip(self._powers.take(first, axis=1), self._rises, strict=True)
        )
        return mean, square

    def _of_groups(
        self, lights: FloatArray, sigma: FloatArray, first: NDArray[np.intp], last: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the same from groups of the values from `first` to `last`."""
        width = np.maximum((last - first + 1) / _MOST_VALUES, 1.0)
        # Values from the first edge of a group to before the next one.
        edges = first + np.rint(np.arange(_MOST_VALUES + 1)[:, np.newaxis] * width).astype(np.intp)
        np.minimum(edges, last + 1, out=edges)
        below = normal_cdf((self._upper.take(edges[1:] - 1) - lights) / sigma)
        below[edges[1:] > last] = 1.0
        probability = np.diff(below, axis=0, prepend=0.0)
        number = np.maximum(np.diff(edges, axis=0), 1)
        light, square = (np.diff(row.take(edges), axis=0) / number for row in self._sums)
        # Groups make it larger by the variance within them (Sheppard's correction).
        squares = probability * (2 * light**2 - square)
        return (probability * light).sum(axis=0), squares.sum(axis=0)


def range_means(table: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the means of rows of a table, even between its places, over ranges of places.

    Args:
        table: (rows, places)
        low: place where each range begins, any shape
        high: where it ends, likewise and larger
    """
    sums, slope = np.zeros_like(table), np.zeros_like(table)
    np.cumsum((table[:, 1:] + table[:, :-1]) / 2, axis=1, out=sums[:, 1:])
    np.subtract(table[:, 1:], table[:, :-1], out=slope[:, :-1])

    def up_to(place: FloatArray) -> FloatArray:
        first = place.astype(np.intp)
        rest = place - first
        found = slope.take(first, axis=1)
        found *= rest / 2
        found += table.take(first, axis=1)
        found *= rest
        found += sums.take(first, axis=1)
        return found

    return np.asarray((up_to(high) - up_to(low)) / (high - low))
