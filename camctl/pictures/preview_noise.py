"""Noise that is filtered out of the preview: what pixels have of their own, and no more.

The channels of a pixel have their details in common, and noise of their own.  The mean of the
logarithms of its channels, each with the inverse of the variance of its noise, is the most exact of
their means, and what the channels differ from it by has independent noise.  So details are compared
with the noise of that mean, and the differences, in which there are few details, with theirs.

A part of the predicted error is no noise of single pixels: of the response, of the exposures, of
the compression of a file, of grain in a scan.  It is the same all over a window, and a filter that
takes it for noise removes details of its size.  A window cannot vary less than by the noise of its
pixels: the noise is no more than what the smoothest windows of this light show.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.pictures.preview_light import NO_LIGHT, Floats, Light, channels_of
from camctl.system.picture_operations import box_means

#: Radii of the windows in which noise is filtered out, pixels, and the share of its variance that
#: the windows before have left.
_WINDOWS = ((1, 1.0), (3, 1 / 6))
BORDER = sum(radius for radius, _ in _WINDOWS)
"""Pixels around that change a pixel without noise."""

LEAST_VARIANCE = np.float32(1e-9)
"""Less than the variance of log2 of the light in any picture."""

#: A logarithm to the base 2 over the natural logarithm of the same number.
_LOG2_E = np.float32(1 / np.log(2))
#: Share of the windows that count as the smoothest, and the variance of 3 x 3 samples of
#: independent noise that so many of them do not exceed, as a share of the noise's: the distribution
#: of chi-squared with 8 degrees of freedom, over 9.
_SMOOTHEST, _OF_NOISE = 0.1, 3.4895 / 9
#: Windows that are looked at: so many rows and columns of them at most; and groups of equal light,
#: of at least so many: a share of 0.1 of them is then known to a tenth.
_MOST_WINDOWS, _GROUPS, _LEAST_GROUP = 256, 16, 1000
#: Shares are looked up in steps of 1 / 8 stop.
_STEPS = 8


@dataclass(frozen=True, eq=False)
class NoiseFilter:
    """Filters the noise out of log2 of light.

    The channels become as many *planes*: the weighted mean, and the difference from it of each
    channel but the one of the largest weight.

    Attributes:
        weights: of the channels in the mean, (channels,)
        darkest: log2 of the mean light of the first column of the following
        of_channels: share of the predicted standard deviation that is the pixels' own, (channels,
            steps)
        of_planes: share of the variance by it that is left in the planes, likewise
    """

    weights: NDArray[np.float32]
    darkest: np.float32
    of_channels: NDArray[np.float32]
    of_planes: NDArray[np.float32]

    @classmethod
    def of(cls, light: Light) -> NoiseFilter:
        """Find the weights of the channels, and what noise the smoothest windows show."""
        channels = light.irradiance.shape[2]
        one = np.ones((channels, 1), np.float32)
        found = cls(one[:, 0] / np.float32(channels), np.float32(0), one, one)
        used = (_windows(light.saturated) == 0) & (_windows(light.unlit) == 0)
        used = used.all(axis=(1, 2))
        count = min(_GROUPS, int(used.sum()) // _LEAST_GROUP)
        if not count:
            return found
        irradiance = np.maximum(_windows(light.irradiance)[used], NO_LIGHT)
        noise = _windows(light.noise)[used]
        usual = np.ones(1) if channels == 1 else np.median(np.square(noise), axis=(0, 1))
        if np.all(usual > 0):
            found = replace(found, weights=np.asarray(1 / usual / np.sum(1 / usual), np.float32))
        mean = np.log2(irradiance @ found.weights)
        groups = np.array_split(np.argsort(mean[:, 4]), count)
        middles = np.array([np.median(mean[group]) for group in groups])
        steps = np.arange(math.ceil((middles[-1] - middles[0]) * _STEPS) + 1) / _STEPS + middles[0]

        def shares(pairs: Iterable[tuple[Floats, Floats]]) -> NDArray[np.float32]:
            """Return those of planes of values and of their predicted variance."""
            rows = []
            for seen, predicted in pairs:
                ratios = seen.var(axis=1) / np.maximum(predicted.mean(axis=1), LEAST_VARIANCE)
                own = [np.quantile(ratios[each], _SMOOTHEST) / _OF_NOISE for each in groups]
                rows.append(np.interp(steps, middles, np.minimum(own, 1)))
            return np.array(rows, np.float32)

        logs = np.log2(irradiance)
        pairs = zip(channels_of(logs), channels_of(np.square(noise * _LOG2_E)), strict=True)
        found = replace(found, darkest=np.float32(middles[0]), of_channels=np.sqrt(shares(pairs)))
        own = found.own_noise(noise, found.places(irradiance))
        return replace(found, of_planes=shares(found._planes(logs, own)))

    def places(self, irradiance: Floats) -> NDArray[np.uint16]:
        """Return the columns of the tables for light."""
        mean = np.maximum(_mean(irradiance, self.weights), NO_LIGHT)
        np.log2(mean, out=mean)
        mean -= self.darkest - np.float32(0.5 / _STEPS)
        mean *= _STEPS
        return np.clip(mean, 0, self.of_channels.shape[1] - 1, out=mean).astype(np.uint16)

    def own_noise(self, noise: Floats, places: NDArray[np.uint16]) -> Floats:
        """Return what pixels have of their own of the predicted noise."""
        found = np.empty_like(noise)
        for channel, own in enumerate(self.of_channels):
            np.multiply(noise[..., channel], own.take(places), out=found[..., channel])
        return found

    def without_noise(self, logs: Floats, noise: Floats, places: NDArray[np.uint16]) -> Floats:
        """Return log2 of light without noise, (rows, columns, channels).

        Args:
            logs: log2 of the light
            noise: standard deviation of the light over it, the pixels' own
            places: of the light
        """
        mean, *differences = (
            _filtered(values, np.multiply(variance, own.take(places), out=variance))
            for (values, variance), own in zip(
                self._planes(logs, noise), self.of_planes, strict=True
            )
        )
        found, rest = np.empty_like(logs), np.zeros_like(mean)
        for channel, difference in zip(self._others, differences, strict=True):
            np.add(mean, difference, out=found[..., channel])
            rest += np.multiply(difference, self.weights[channel], out=difference)
        # The weighted differences of all channels add up to 0.
        last = int(self.weights.argmax())
        np.subtract(mean, rest / self.weights[last], out=found[..., last])
        return found

    @property
    def _others(self) -> list[int]:
        return [each for each in range(self.weights.size) if each != int(self.weights.argmax())]

    def _planes(self, logs: Floats, noise: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield values and variance of the planes; the noise of the channels is independent."""
        mean = _mean(logs, self.weights)
        variances = np.square(noise)
        variances *= _LOG2_E**2
        variance = _mean(variances, np.square(self.weights))
        yield mean, variance.copy()
        for channel in self._others:
            other = variances[..., channel] * (1 - 2 * self.weights[channel])
            other += variance
            # With unequal noise it may be below 0.
            yield logs[..., channel] - mean, np.maximum(other, 0, out=other)


def _mean(values: Floats, weights: NDArray[np.float32]) -> Floats:
    """Return the weighted sum of channels; a product of matrices takes far longer."""
    found = values[..., 0] * weights[0]
    for channel in range(1, weights.size):
        found += values[..., channel] * weights[channel]
    return np.asarray(found)


def _windows(values: NDArray[Any]) -> NDArray[Any]:
    """Return some windows of 3 x 3 samples all over a picture, (windows, 9, channels)."""
    rows, columns = (length // 3 for length in values.shape[:2])
    channels = math.prod(values.shape[2:])
    step = max(1, -(-max(rows, columns) // _MOST_WINDOWS))
    cut = values[: rows * 3, : columns * 3]
    cells = cut.reshape(rows, 3, columns, 3, channels)[::step, :, ::step]
    return cells.swapaxes(1, 2).reshape(cells.shape[0] * cells.shape[2], 9, channels)


def _filtered(values: Floats, variance: Floats) -> Floats:
    """Return log2 of light with noise of this variance filtered out."""
    for radius, left in _WINDOWS:
        mean, seen = moments(values, radius)
        kept = box_means(variance, radius)
        kept *= -np.float32(left)
        kept /= np.maximum(seen, LEAST_VARIANCE, out=seen)
        kept += 1
        values = values - mean
        values *= np.maximum(kept, 0, out=kept)
        values += mean
    return values


def moments(values: Floats, radius: int) -> tuple[Floats, Floats]:
    """Return mean and variance over squares; rounding may leave a variance just below 0."""
    mean, variance = box_means(values, radius), box_means(values * values, radius)
    variance -= mean * mean
    return mean, variance
