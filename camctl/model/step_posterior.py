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
#: sum of a wider normal one has an error of 2 exp(-2 (3 pi)^2).  Combinations computed at once:
#: arrays of their nodes stay in a cache (4096 take 1.7 times as long).
_NODES, _CHUNK = 48, 512

#: Lights at which the noise of files is tabulated.
_FILE_LIGHTS = 4096

#: Odd, without a pattern (2^64 over the golden ratio): a combination of samples, as the digits of a
#: number to this base modulo 2^64, is another one's number in 1 of 2^64 cases.
_FACTOR = np.uint64(0x9E3779B97F4A7C15)

#: Combinations whose results are kept: 24 MB.
_MOST_KNOWN = 1 << 20


@dataclass(frozen=True)
class FrameSet:
    """What the tables depend on.

    Attributes:
        response: of the camera; its fingerprint is compared
        black: brightness without light, DN
        exposures: of the frames, relative to the shortest, which has 1
        noise: of each frame
        beside_saturated: whether a file rounds samples together with saturated ones
        most_rounding: standard deviation of what a file rounds of samples at most, levels; None:
            noise or errors of samples beside saturated ones are not known
        fingerprint: of `response`
    """

    response: CameraResponse = field(compare=False, repr=False)
    black: int
    exposures: tuple[float, ...]
    noise: tuple[FrameNoise, ...]
    beside_saturated: bool = False
    most_rounding: float | None = None
    fingerprint: str = ""

    def __post_init__(self) -> None:
        check_noise(self.noise, len(self.exposures), self.response)
        object.__setattr__(self, "fingerprint", self.response.fingerprint)


@dataclass(frozen=True, eq=False)
class _Known:
    """Results for combinations of samples: numbers that stand for them, ascending, and both."""

    keys: NDArray[np.uint64]
    mean: FloatArray
    deviation: FloatArray

    def with_others(self, more: _Known) -> _Known:
        """Return these results and others, none of which is among them."""
        places = np.searchsorted(self.keys, more.keys)
        return _Known(
            np.insert(self.keys, places, more.keys),
            np.insert(self.mean, places, more.mean),
            np.insert(self.deviation, places, more.deviation),
        )


def _places(known: _Known, key: NDArray[np.uint64]) -> NDArray[np.intp]:
    """Return where the results for some combinations are; -1 for those that are not there."""
    if not known.keys.size:
        return np.full(key.size, -1, np.intp)
    place = np.minimum(np.searchsorted(known.keys, key), known.keys.size - 1)
    place[known.keys[place] != key] = -1
    return place


class StepPosterior:
    """The posterior of the light after values of each frame.

    Args:
        frames: exposures and noise
        sensor: the camera
    """

    def __init__(self, frames: FrameSet, sensor: SensorModel) -> None:
        self._frames, self.sensor = frames, sensor
        self._of_files: dict[FrameNoise, FloatArray] = {}
        self._known = _Known(np.empty(0, np.uint64), np.empty(0), np.empty(0))

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """Both ends of the light of each value; infinite at the lowest and the highest one."""
        noise = FrameNoise(np.inf, 0.0, black=self._frames.black)
        thresholds = NoisyFrame.of(self._frames.response, 1.0, noise).thresholds
        return np.append(-np.inf, thresholds), np.append(thresholds, np.inf)

    @cached_property
    def _ranges(self) -> list[tuple[FloatArray, FloatArray]]:
        """Light between which each value of each frame is probable, and any at the end."""
        found = []
        for exposure, noise in zip(self._frames.exposures, self._frames.noise, strict=True):
            ends = []
            for edges, sign in zip(self._edges, (-1.0, 1.0), strict=True):
                spread = self._spread(np.where(np.isfinite(edges), edges, 0.0), noise)
                light = edges + sign * REACH * spread - noise.dark_levels * self.sensor.level
                ends.append(np.append(light / exposure, sign * np.inf))
            found.append((ends[0], ends[1]))
        return found

    def of(
        self, values: Sequence[NDArray[Any]], kept: Sequence[NDArray[np.bool_]]
    ) -> tuple[FloatArray, FloatArray]:
        """Return mean and deviation of the light of samples; NaN where all probabilities are 0.

        Args:
            values: samples of each frame, (S,), black included
            kept: whether each sample counts, likewise
        """
        key = np.zeros(values[0].size, np.uint64)
        for each, used in zip(values, kept, strict=True):
            key = key * _FACTOR + np.where(used, each.astype(np.uint64) + np.uint64(1), 0)
        known = self._known
        place = _places(known, key)
        missing = np.flatnonzero(place < 0)
        if not missing.size:
            return known.mean[place], known.deviation[place]
        keys, first, which = np.unique(key[missing], return_index=True, return_inverse=True)
        first = missing[first]
        rows = np.stack(
            [
                np.where(used[first], each[first].astype(np.intp), -1)
                for each, used in zip(values, kept, strict=True)
            ]
        )
        parts = [
            self._posterior(rows[:, start : start + _CHUNK])
            for start in range(0, first.size, _CHUNK)
        ]
        more = _Known(keys, *map(np.concatenate, zip(*parts, strict=True)))
        if known.keys.size + keys.size <= _MOST_KNOWN:
            self._known = known.with_others(more)  # what threads lose is computed again
        mean, deviation = np.empty((2, key.size))
        there = np.flatnonzero(place >= 0)
        for found, old, new in (
            (mean, known.mean, more.mean),
            (deviation, known.deviation, more.deviation),
        ):
            found[there] = old[place[there]]
            found[missing] = new[which]
        return mean, deviation

    def _posterior(self, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Return mean and deviation of the light after values (n, U); -1: the frame is left out."""
        low, high = np.zeros(rows.shape[1]), np.full(rows.shape[1], np.inf)
        for row, (least, most) in zip(rows, self._ranges, strict=True):
            # The last element, which -1 takes, stands for a frame that is left out.
            np.maximum(low, least[row], out=low)
            np.minimum(high, most[row], out=high)
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
        if noise.file is None:
            return np.sqrt(self.sensor.spread(light, noise) + offset**2)
        if noise not in self._of_files:
            square = self.sensor.spread(self._lights, noise) + offset**2
            self._of_files[noise] = np.sqrt(square)
        return np.interp(light, self._lights, self._of_files[noise])

    @cached_property
    def _lights(self) -> FloatArray:
        """Lights up to twice full scale, beyond which all samples are saturated."""
        return 2 * self.sensor.full * np.square(np.linspace(0, 1, _FILE_LIGHTS))

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
            above -= below
            likelihood[used] *= above
        total = likelihood.sum(axis=1)
        total[total <= 0] = np.nan
        mean = (likelihood * E).sum(axis=1) / total
        variance = (likelihood * (E - mean[:, np.newaxis]) ** 2).sum(axis=1) / total
        return mean, np.sqrt(variance + cell[:, 0] ** 2 / 12)
