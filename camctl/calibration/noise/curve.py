"""The variance of brightness that a camera's noise gives, against its mean.

A sample has the light x in levels of the linear scale, and electrons K x at K electrons per level.
Its variance on that scale is ``x / K + r^2``, with the read noise r in levels (the photon transfer
method of EMVA 1288).  The camera's response turns this into a variance of brightness, computed
here by quadrature over the noise, so that the slope and the curvature of the response and the
clipping at black count; quantisation is added as

    1/12 - 1 / (2 pi^2) * sum over k of exp(-4 pi^2 k^2 s^2) / k^2

for noise of s levels (its characteristic function, averaged over light that is spread evenly within
a level): 1/12 for much noise, and for less than 0.3 levels of noise the rest of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.noise.pairs import PairPatches
from camctl.model.response.camera import CameraResponse, FloatArray

#: Standard deviations of the quadrature, and its nodes, close enough for the corner at black.
_REACH, _NODES = 6.0, 161
#: Brightness levels at which variances are computed, and how many more near black; between them
#: they are interpolated.  A straight response needs fewer.
_GRID, _DARK_GRID = 480, 80
#: Terms of the sum over k.
_TERMS = np.arange(1.0, 65.0)
#: Least mean brightness of a patch that is used, in levels above black, where black is 0.
_LEAST_LEVEL = 2.0
#: Noise beside rounding below which a patch is not used, and from which it counts in full, DN: with
#: less, the variance depends on where in a level the light is.
_HIDDEN = (0.3, 0.5)
#: Standard deviation of ln(irradiance) above which a part of a measured response is not used, and
#: parts of the response whose errors are taken for independent.
_MOST_DEVIATION, _KNOTS = 0.05, 8

LEAST_VARIANCE = 1e-6
"""Least variance that counts, DN squared."""


class NoiseCurve:
    """A camera for which `moments` are computed: its response, and where noise is cut.

    Args:
        response: of the camera, as levels
        black: black level, DN: by so much noise can lower a sample below 0
    """

    def __init__(self, response: CameraResponse, black: int) -> None:
        self.full = response.M + 1.0
        self.response = response
        self._black = black
        levels, counts = np.unique(response.levels * self.full, return_counts=True)
        height = np.cumsum(counts).astype(np.float64)
        if levels.size < 2:
            levels, height = np.append(levels, 2 * levels[-1]), np.append(height, 2 * height[-1])
        slope = np.diff(height[[0, 1, -2, -1]])[[0, 2]] / np.diff(levels[[0, 1, -2, -1]])[[0, 2]]
        # Beyond its ends the response is a straight line, so that noise around black is not cut.
        far = 1e3 * self.full
        self._light = np.concatenate([[levels[0] - far], levels, [levels[-1] + far]])
        self._height = np.concatenate(
            [[height[0] - far * slope[0]], height, [height[-1] + far * slope[1]]]
        )
        edges = np.diff(levels) / np.diff(height)
        self.is_straight = bool(np.ptp(edges) <= 1e-6 * edges.mean())
        dark = np.linspace(0, 1, _DARK_GRID) ** 2 * min(64.0, response.M)
        below = -dark[dark <= black]
        count = _GRID // 16 if self.is_straight else _GRID
        self._grid = np.interp(
            np.unique(np.concatenate([below, dark, np.linspace(0, response.M, count)])) + 0.5,
            self._height,
            self._light,
        )
        self._top = float(response.M)
        self._z = np.linspace(-_REACH, _REACH, _NODES)
        weight = np.exp(-np.square(self._z) / 2)
        self._weight = weight / weight.sum()

    def moments(self, inverse_k: float, read_squared: float) -> tuple[FloatArray, FloatArray]:
        """Return the mean brightness above black, ascending, and the variance there.

        Args:
            inverse_k: one over the electrons of a level
            read_squared: squared read noise, levels squared of the linear scale
        """
        light = self._grid
        # A mean below black is due to noise: there the line is continued, so that errors cancel.
        photon = inverse_k * light
        variance = np.maximum(photon, -max(read_squared, 0.0) / 2) + read_squared
        sigma = np.sqrt(np.maximum(variance, 1e-12))
        # Photons are Poisson: the skew counts where the response is curved (Cornish-Fisher).
        skew = np.clip(photon * inverse_k / sigma**3, 0.0, 1.0)[:, None] / 6
        normal = (self._z + skew * (self._z**2 - 1)) / np.sqrt(1 + 2 * skew**2)
        noisy = light[:, None] + sigma[:, None] * normal
        signal = np.interp(noisy, self._light, self._height) - 0.5
        # Samples up to half a level above the lowest one are rounded to it. Rounding errors above
        # have a mean of a twelfth of the density at that limit (Euler and Maclaurin's formula).
        limit = 0.5 - self._black
        density = (np.abs(signal - limit) < 0.5) @ self._weight / 12
        inside = (signal > limit) & (signal < self._top)
        np.copyto(signal, -self._black, where=signal <= limit)
        np.minimum(signal, self._top, out=signal)
        mean = signal @ self._weight + density
        variance = np.square(signal - mean[:, None]) @ self._weight
        variance += 2 * density * (limit - mean)
        rounding = 1 / 12 - np.exp(
            -4 * math.pi**2 * np.multiply.outer(np.clip(variance, 0, 9), _TERMS**2)
        ) @ (1 / (2 * math.pi**2 * _TERMS**2))
        return np.maximum.accumulate(mean), variance + (inside @ self._weight) * rounding

    def is_known(self, brightness: FloatArray) -> NDArray[np.bool_]:
        """Return where the response is known well enough for the noise to be measured."""
        deviation = self.response.deviation
        if deviation is None:
            return np.ones(brightness.shape, np.bool_)
        level = np.clip(np.round(brightness).astype(int), 1, self.response.M)
        return np.asarray(deviation[level - 1] <= _MOST_DEVIATION)

    def varied(self) -> list[NoiseCurve]:
        """Return the curves with each independent error of the response, one deviation large.

        They are an exponent, and shifts of `_KNOTS` parts of the curve; none if it is exact.
        """
        real = self.response
        if real.deviation is None:
            return []
        level = np.arange(1.0, self.full)
        light = np.maximum(real.levels, real.levels[-1] * 1e-9)
        distance = np.log(light / np.interp(self.full / 2, level, light))
        exponent = real.exponent_error * distance
        deviation = np.minimum(real.deviation, _MOST_DEVIATION)
        rest = np.sqrt(np.maximum(deviation**2 - exponent**2, 0.0))
        knots = np.linspace(math.log(min(2.0, self.full / 4)), math.log(self.full), _KNOTS)
        parts = [np.interp(np.log(level), knots, each) for each in np.eye(_KNOTS)]
        return [
            NoiseCurve(
                CameraResponse(np.maximum.accumulate(real.levels * np.exp(error)), real.name),
                self._black,
            )
            for error in (exponent, *(rest * part for part in parts))
        ]

    def shape(self, inverse_k: float, read_squared: float) -> TransferCurve:
        """Return variance against brightness, and its derivatives by both parameters."""
        at = (inverse_k, read_squared)
        mean, variance = self.moments(*at)
        columns = []
        for place, step in enumerate((0.01 * at[0], max(0.01 * abs(at[1]), at[0]))):
            sides = []
            for turn in (-1, 1):
                moved = self.moments(*(at[k] + turn * step * (k == place) for k in (0, 1)))
                sides.append(np.interp(mean, *moved))
            columns.append((sides[1] - sides[0]) / (2 * step))
        lowest = -float(self._black)
        return TransferCurve(mean, variance, (columns[0], columns[1]), self.is_straight, lowest)


@dataclass(frozen=True, eq=False)
class TransferCurve:
    """Variance of brightness against its mean, for one conversion gain and read noise.

    Attributes:
        mean: brightness above black, DN, ascending
        variance: there, DN squared
        derivatives: of the variance, by the inverse of the conversion gain and by the squared read
            noise
        is_straight: of the response
        lowest: the lowest brightness above black, DN
    """

    mean: FloatArray
    variance: FloatArray
    derivatives: tuple[FloatArray, FloatArray]
    is_straight: bool
    lowest: float

    def bend(self, patches: PairPatches) -> FloatArray:
        """Return what the contrast of each patch adds to its variance, to second order."""
        middle = np.interp(patches.mean, self.mean, self.variance)
        contrast = patches.spread - middle / 2
        reach = np.sqrt(np.maximum(contrast, 0.25))
        sides = [
            np.interp(patches.mean + turn * reach, self.mean, self.variance) for turn in (-1, 1)
        ]
        return np.asarray((sides[0] + sides[1] - 2 * middle) / (2 * reach**2) * contrast)

    def variances(self, patches: PairPatches) -> FloatArray:
        """Return the expected variance of each patch."""
        return np.asarray(np.interp(patches.mean, self.mean, self.variance) + self.bend(patches))

    def share_used(self, patches: PairPatches) -> FloatArray:
        """Return the weight of patches by brightness: 0 where rounding hides the noise."""
        variance = np.interp(patches.mean, self.mean, self.variance)
        low, high = _HIDDEN
        deviation = np.sqrt(np.maximum(variance, 0))
        noise = np.sqrt(np.maximum(variance - 1 / 12, 0))
        share = np.clip((noise - low) / (high - low), 0, 1)
        if self.lowest == 0:
            share *= np.clip(patches.mean - _LEAST_LEVEL - deviation, 0, 1)
        return np.asarray(share)

    def design(self, patches: PairPatches) -> tuple[FloatArray, FloatArray]:
        """Return (patches, 2) derivatives of the variance, and the weight of each patch."""
        columns = [np.interp(patches.mean, self.mean, each) for each in self.derivatives]
        variance = np.maximum(np.interp(patches.mean, self.mean, self.variance), LEAST_VARIANCE)
        weight = self.share_used(patches) * patches.freedom / variance**2
        return np.stack(columns, axis=1), weight
