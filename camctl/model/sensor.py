"""The sensor model: the light of a sample, its noise, and when it is saturated.

It joins a camera's response, its black and white level, its quantiser and the noise of one frame.
Light is irradiance at exposure 1, where full scale, M + 1 levels, is 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, FloatArray

CLIPPED = 0.001
"""Share of the samples of a brightness that noise may saturate, or lift off black, for the
brightness to count as measured: it lowers their mean by 3e-4 of the noise, 1e-3 / 3.4."""

CLIPPING_SIGMAS = NormalDist().inv_cdf(1 - CLIPPED)

#: Standard deviation of the errors of JPEG files as a share of the range of brightness around a
#: sample, and so at most that share of white: at quality 75 with a quarter of the samples of
#: colour, 1 of 5,000 samples of five photographs had an error of 3 times that.
JPEG_ERROR = 0.05

#: Standard deviation of the difference of two JPEG files that a whole block has in common, levels
#: of 255: at quality 75 ITU-T T.81 rounds the means of a block to steps of 1 level of Y and 1.1 of
#: Cb, of which blue has 1.77 times as much: sqrt(2 (1 + (1.77 * 1.1)^2) / 12).
JPEG_BLOCK_ERROR = 0.9

FILE_OFFSET = 2.0
"""Standard deviation of the offset of a photograph, which all of its samples share, levels of 255:
JPEG files whose exposures are halved from one to the next differ by -4 to +2 levels (taipei)."""

RESPONSE_ERROR = 0.005
"""Standard deviation of the relative error of a response: twice the linearity error (EMVA 1288)
that data sheets of machine-vision cameras state, 0.2 to 0.3 %."""

ESTIMATED_RESPONSE_ERROR = 0.03
"""The same of a response estimated from photographs: radiance of the memorial photographs differs
by 0.027 to 0.038 (rms of the natural logarithm) from the map of their authors."""

FEWEST_LEVELS = 8
"""With fewer levels the noise of a few electrons decides which samples are saturated."""

#: Standard deviation of the error of a stated black level, a whole number: 1 / sqrt(12) levels.
BLACK_ERROR_LEVELS = 12**-0.5

#: Square of a step that is not less: levels of a flat response coincide.
_LEAST_SQUARE = 1e-24


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the samples of one frame predict of another one's; each (white + 1,), by their value.

    Attributes:
        mean: light of the other frame's sample
        own: variance of its light that is independent from sample to sample
        shared: variance that neighbouring samples of one brightness have in common
        skewness: of its light
        black_error: standard deviation of what all samples have in common, since the black level is
            a whole number
    """

    mean: FloatArray
    own: FloatArray
    shared: FloatArray
    skewness: FloatArray
    black_error: float


class SensorModel:
    """The light of each value of a sample from 0 to white, and its noise where it is known.

    Args:
        real: the camera's response as levels
        black: brightness without light, DN

    Attributes:
        light: (white + 1,) float64, the middle of each brightness's gap
        gap: (white + 1,) float64, the width of the gap: the step of the quantiser
        black: as given
        white: brightness from which samples are saturated, DN
        full: light at white
        level: light of one level of the noise, which is on the linear scale of M + 1 levels
        is_coarse: whether there are so few levels that noise decides which samples are saturated
        curvature: (white + 1,) float64, the second difference of `light`
        exponent_error: that of the response
        deviation: (white + 1,) that of the logarithm of `light`; 0 where the response is exact
    """

    def __init__(self, real: CameraResponse, black: int) -> None:
        low, high = real.gaps
        self.light: FloatArray = (low + high) / 2
        self.gap: FloatArray = high - low
        if black:
            # Noise around a black level has samples below it: they continue the first whole gap.
            first, step = self.light[1], self.gap[1]
            below = first - step * np.arange(black + 1, 0, -1)
            self.light = np.concatenate((below, self.light[1:]))
            self.gap = np.concatenate((np.full(black + 1, step), self.gap[1:]))
        self.black, self.white = black, black + real.M
        self.exponent_error = real.exponent_error
        self.deviation: FloatArray = np.zeros(self.white + 1)
        if real.deviation is not None:
            self.deviation[black + 1 :] = real.deviation
            self.deviation[: black + 1] = np.inf
        self.full = float(self.light[-1])
        self.level = 1 / (real.M + 1)
        self.is_coarse = real.M < FEWEST_LEVELS
        self.curvature: FloatArray = np.concatenate(
            ([0.0], np.abs(np.diff(self.light, 2)), [0.0] * min(1, self.light.size - 1))
        )

    def variance(self, light: FloatArray, noise: FrameNoise) -> FloatArray:
        """Return the variance of a sample's light by photons and reading, before the quantiser."""
        photons = np.maximum(light, 0.0) * self.level / noise.electrons_per_level
        return np.asarray(photons + (noise.read_noise_levels * self.level) ** 2)

    def spread(self, light: FloatArray, noise: FrameNoise) -> FloatArray:
        """Return that variance with the errors of compression, which follow the response."""
        variance = self.variance(light, noise)
        if noise.file is None and not noise.compression_levels:
            return variance
        # They end at white: the nearer the light, the less is left of them.
        square = np.square(np.interp(light, self.light, self.gap))
        if noise.file is not None:
            square = np.maximum(square, _LEAST_SQUARE)
            variance = noise.file.error(variance / square) * square
        return np.asarray(variance + noise.compression_levels**2 * square)

    def step(self, light: FloatArray) -> FloatArray:
        """Return the step of the quantiser at a light."""
        return np.asarray(np.interp(light, self.light[:-1], self.gap[:-1]))  # white has no end

    def highest(self, noise: FrameNoise | None) -> int:
        """Return the largest brightness that noise saturates in few samples, see `CLIPPED`.

        Samples above it are saturated or nearly so.  What the file of a frame adds to its noise
        counts; without a known noise the errors of JPEG files, which are larger than the noise of
        any frame that is worth a capture.
        """
        if noise is None:
            limit = self.black + (1 - JPEG_ERROR) * (self.white - self.black)
            return min(max(round(limit), 0), self.white - 1)
        reach = self.light + CLIPPING_SIGMAS * np.sqrt(self.spread(self.light, noise))
        inside = np.flatnonzero(reach[:-1] < self.full)
        return int(inside[-1]) if inside.size else 0

    def rounding(self, light: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the rounding error, independent and shared by equal light.

        Noise of s steps leaves exp(-4 (pi s)^2) of it in common (Widrow and Kollar, Quantization
        Noise, 2008).
        """
        step = self.step(light)
        total = step**2 / 12
        noisy = variance / np.maximum(step, 1e-12) ** 2
        common = total * np.exp(-4 * np.square(np.pi) * noisy)
        return total - common, common

    def expected(
        self, ratio: float, short: FrameNoise | None, long: FrameNoise | None
    ) -> FloatArray:
        """Return the light of a shorter frame by the values of a `ratio` times as long one.

        Means of many samples have it; dark current adds to the light of each frame.
        """
        dark = 0.0
        if short is not None and long is not None:
            dark = (short.dark_levels - long.dark_levels / ratio) * self.level
        return np.asarray(self.light / ratio + dark)

    def neighbour(
        self, ratio: float, short: FrameNoise | None, long: FrameNoise | None
    ) -> Prediction:
        """Return what a frame of `ratio` times the exposure predicts of one of exposure 1.

        Both have photon and read noise and are rounded.  A light of which N electrons were counted
        has a gamma distribution of N + 1 (any light being as probable as another one), of variance
        N + 1 and third moment 2 (N + 1).  Dark current adds to the light of each frame, and the
        offset of a pixel is the same in both.  Without a known noise there is rounding alone.
        """
        mean = self.expected(ratio, short, long)
        square = ratio * ratio  # a power of float would raise where this is infinite
        noise = np.zeros(mean.size), np.zeros(mean.size)
        own, third = np.zeros(mean.size), np.zeros(mean.size)
        if short is not None and long is not None:
            unit = self.level
            electron = unit / short.electrons_per_level, unit / long.electrons_per_level
            lit = np.maximum(self.light, 0.0) + electron[1]
            # It may be larger than its sample shows by its standard deviation.
            lit = lit + np.sqrt(self.variance(lit, long))
            noise = self.variance(lit / ratio, short), self.variance(lit, long)
            own += noise[0] + noise[1] / square
            # A count that is too small has too small a variance, too.  The residual over its root
            # has mean 0 with this shift, half an electron where photon noise is all.
            light, first, each = np.unique(self.light, return_index=True, return_inverse=True)
            slope = np.gradient(own[first], light)[each]  # levels of a flat response coincide
            mean = mean + slope * noise[1] / ratio / (2 * np.maximum(own, 1e-300))
            own += ((short.dsnu_levels - long.dsnu_levels / ratio) * unit) ** 2
            third += lit / ratio * electron[0] ** 2 + 2 * lit * electron[1] ** 2 / (square * ratio)
        roundings = self.rounding(mean, noise[0]), self.rounding(self.light, noise[1])
        own += roundings[0][0] + roundings[1][0] / square
        shared = roundings[0][1] + roundings[1][1] / square
        skewness = third / np.maximum(own + shared, 1e-200) ** 1.5
        black_error = BLACK_ERROR_LEVELS * self.level * abs(1 - 1 / ratio)
        return Prediction(mean, own, shared, skewness, black_error)
