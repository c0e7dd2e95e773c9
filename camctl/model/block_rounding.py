"""What a file that rounds the frequencies of blocks makes of noise, as JPEG does (ITU-T T.81).

Noise of variance v has that variance in each frequency of a block of 8 x 8 pixels.  Where the scene
is smooth, all frequencies but the mean are noise, and are rounded to multiples of their steps: of
much less than half a step nothing is left, of about half a step more than there was, and of more
than a step v + step^2 / 12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from camctl.model.distribution import normal_cdf
from camctl.model.response.camera import FloatArray

#: Encoders compute frequencies in multiples of 1/8, and round halves away from 0 (libjpeg): all
#: others are rounded as if they were larger by half of that.
_LARGER = 1 / 16
#: Noise in steps from which on nothing depends on where the multiples are: 1e-8 of a step does.
_WIDE = 1.5
#: Least and largest noise of the tables of a file, levels, and nodes.
_LEAST_LEVELS, _MOST_LEVELS, _OF_FILE = 0.01, 256.0, 257
#: Noise of samples in a table, levels, beyond which files add as much, and nodes of a level.
_MOST_NOISE, _OF_LEVEL = 32, 32


@dataclass(frozen=True)
class BlockRounding:
    """The rounding of a file.

    Attributes:
        steps: of the frequencies of a block, levels, the mean first
        contrast: share of the frequencies that contrast of the scene makes any part of a step, so
            that their errors by rounding are even
        colours: of the file
    """

    steps: tuple[float, ...]
    contrast: float = 0.0
    colours: ClassVar[int] = 1

    def within(self, variance: FloatArray) -> FloatArray:
        """Return the variance within blocks of a smooth scene, levels squared.

        Args:
            variance: of the noise, levels squared
        """
        return self._of(variance, self._tables[0])

    def scatter(self, variance: FloatArray) -> FloatArray:
        """Return the standard deviation of that over blocks, over the root of 2 / 63.

        Of 63 normal variables it is their variance.
        """
        return self._of(variance, self._tables[1])

    def error(self, variance: FloatArray) -> FloatArray:
        """Return the variance of the error of a sample in a file, levels squared.

        It is that before the sample is rounded to a level when the file is read.

        Args:
            variance: of the noise before the file was made, levels squared
        """
        place = np.minimum(np.sqrt(variance) * _OF_LEVEL, self._errors.size - 1.001)
        first = place.astype(np.intp)
        place -= first
        found = self._errors.take(first + 1) - (below := self._errors.take(first))
        found *= place
        found += below
        found += np.maximum(variance - _MOST_NOISE**2, 0.0)
        return np.asarray(found)

    @cached_property
    def _errors(self) -> FloatArray:
        """What `error` returns, at equal distances of the noise."""
        variance = np.square(np.arange(_MOST_NOISE * _OF_LEVEL + 2) / _OF_LEVEL)
        # Samples are rounded before they are kept, too, and noise dithers a part of that.
        undithered = np.exp(-4 * np.square(np.pi) * variance) / 12
        variance += 1 / 12 - undithered
        even = self.contrast * self.by_contrast(variance)
        smooth = (1 - self.contrast) * self._of(variance, self._tables[2])
        return np.asarray(smooth + even + undithered)

    def by_contrast(self, variance: FloatArray) -> FloatArray:
        """Return the variance within blocks where all frequencies show contrast."""
        return np.asarray(variance + float(np.square(self.steps).mean()) / 12)

    def _of(self, variance: FloatArray, table: FloatArray) -> FloatArray:
        noise = np.sqrt(variance)
        place = np.log(np.maximum(noise, _LEAST_LEVELS) / _LEAST_LEVELS)
        place *= (_OF_FILE - 1) / np.log(_MOST_LEVELS / _LEAST_LEVELS)
        ratio = np.interp(place, np.arange(_OF_FILE), table)
        return np.asarray(variance * ratio)

    @cached_property
    def _tables(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What the methods return over the variance of the noise."""
        variance = nodes_of()
        steps, each = np.unique(self.steps, return_inverse=True)
        noise = np.sqrt(variance)
        mean, spread = np.stack([rounded_moments(noise, step) for step in steps], axis=1)[:, each]
        within = mean[1:].mean(axis=0)
        scatter = np.sqrt(spread[1:].mean(axis=0) / 2)
        # The mean of a block is any multiple and a part of a step.
        error = (mean[1:].sum(axis=0) + variance + self.steps[0] ** 2 / 12) / len(self.steps)
        # Decoders round pixels again, which noise dithers.
        dither = -np.expm1(-4 * np.square(np.pi) * within) / 12
        return (within + dither) / variance, (scatter + dither) / variance, error / variance


def nodes_of() -> FloatArray:
    """Return the variances of the noise of tables."""
    return np.square(np.geomspace(_LEAST_LEVELS, _MOST_LEVELS, _OF_FILE))


def rounded_moments(noise: FloatArray, step: float) -> FloatArray:
    """Return mean and variance of the square of rounded normal variables of mean 0, (2, nodes).

    Args:
        noise: standard deviation of the variables, ascending
        step: what they are rounded to multiples of
    """
    multiple = np.arange(1, 8 * _WIDE)[:, np.newaxis]
    narrow = np.searchsorted(noise, _WIDE * step)
    thresholds = (multiple - 0.5) * step - _LARGER
    beyond = 2 * normal_cdf(-thresholds / noise[:narrow])
    mean = ((2 * multiple - 1) * beyond).sum(axis=0) * step**2
    fourth = ((multiple**4 - (multiple - 1) ** 4) * beyond).sum(axis=0) * step**4
    wide = noise[narrow:]
    added = 2 * _LARGER * math.sqrt(2 / math.pi) * wide + _LARGER**2 + step**2 / 12
    return np.stack(
        [
            np.concatenate([mean, wide**2 + added]),
            np.concatenate([fourth - mean**2, 2 * np.square(wide**2 + added)]),
        ]
    )


def rounded_gain(noise: FloatArray, step: float) -> FloatArray:
    """Return which share of a small normal variable, added to a rounded one, is kept in the mean.

    It is also the covariance of the rounded variable and another one, over that before (Bussgang).

    Args:
        noise: standard deviation of the variables, ascending
        step: what they are rounded to multiples of
    """
    multiple = np.arange(1, 8 * _WIDE)[:, np.newaxis]
    narrow, wide = np.split(noise, [np.searchsorted(noise, _WIDE * step)])
    thresholds = (multiple - 0.5) * step - _LARGER
    density = np.exp(-np.square(thresholds / narrow) / 2).sum(axis=0) / narrow
    root = math.sqrt(2 / math.pi)
    return np.concatenate([root * step * density, 1 + root * _LARGER / wide])
