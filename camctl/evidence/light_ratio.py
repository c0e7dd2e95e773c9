"""Checks on the pixels that each frame had the exposure that the camera reported.

Neighbouring frames are compared in patches of the picture, and the samples of each patch vote for
its ratio of light.  Moving objects and blooming change some patches only; a wrong exposure changes
all of them alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.ratio_check import LAMP_DEPTH, LEAST_COMPARED, RatioCheck
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel

#: Relative difference of light that may have other causes than a wrong exposure.
TOLERANCE = 0.015
MOST_CHANGE = 1.1
"""Factor by which lamps may change a ratio before the picture is not trustworthy, either."""
#: Slowest usual flicker, Hz: twice the frequency of the mains.
_FLICKER_HZ = 100.0
#: Tolerance of a comparison that was not made, and the largest contribution of scatter to one.
LARGEST_TOLERANCE = 0.5
#: Fewer samples give no ratio; where fewer than the second number vote, dimmer ones do, too.
_LEAST_SAMPLES, _FEW_SAMPLES = 32, 128
#: Samples above this share of full scale are not compared: noise saturates some of them.
_HIGHEST = 0.9
#: Share of the light beyond saturation that flows to other samples (blooming), at most.
_SPILLED = 0.05
#: Share of the samples of a bright patch that must be compared: without a tenth of them, the mean
#: of the others lies 0.2 standard deviations of their noise too low; without 2 %, 0.05.
_WHOLE = 0.98
#: A saturated sample contradicts if its expected light is below this share of full scale.
_CERTAIN = 0.7
#: Error of a patch besides rounding (black level, non-linearity, light of other frames): in levels
#: at least, and as a share of full scale where there are many levels.
_OFFSET_LEVELS, _OFFSET_SHARE = 0.5, 1 / 4000
#: Standard errors of the median that are allowed, about.
_SIGMAS = 3.0
#: Only patches vote that reach this number of levels in the shorter exposure, of 1,000 levels at
#: most: the first number for which enough samples vote, since the brightest are measured best.
_LEAST_LEVELS, _LEVELS = (32, 16, 8, 4, 1), 1000

_Floats = NDArray[np.float64]


class NeighbourCheck:
    """Compares neighbouring frames of a capture on patches of their pixels.

    Args:
        real: the camera's response as levels
        black: brightness without light, DN
        layout: pixel layout of a frame

    Attributes:
        scale: irradiance of each brightness
    """

    def __init__(self, real: CameraResponse, black: int, layout: Layout = Layout.MONO) -> None:
        self.scale = SensorModel(real, black)
        self._layout = layout
        self._dark = self.scale.full / min(real.M, _LEVELS)
        self._offset = max(_OFFSET_LEVELS * self.scale.level, _OFFSET_SHARE * self.scale.full)
        self._samples: dict[int, Patches] = {}

    def add(self, position: int, pixels: Pixels) -> None:
        """Keep a sample of the frame at `position` of the sequence."""
        self._samples[position] = self.sample(pixels)

    def remove(self, position: int) -> None:
        """Forget the frame at `position`: it will be shot again."""
        del self._samples[position]

    def has(self, position: int) -> bool:
        """Return whether the frame at `position` and the one before it were added."""
        return position in self._samples and position - 1 in self._samples

    def check(
        self,
        position: int,
        expected: float,
        times_s: tuple[float, float],
        mains_hz: float | None,
        most: float = MOST_CHANGE,
    ) -> RatioCheck:
        """Compare the frame at `position` with the one before it.

        Args:
            position: of the later frame
            expected: ratio of the exposures, later over earlier
            times_s: their shutter times, s
            mains_hz: frequency of the mains that feeds the lamps; None: unknown
            most: factor by which lamps may change the ratio at most
        """
        return self.compare(
            self._samples[position - 1],
            self._samples[position],
            expected,
            lamp_factor(times_s, mains_hz),
            most,
        )

    def sample(self, pixels: Pixels) -> Patches:
        """Return the patches of a frame."""
        return sample_patches(self._layout.planes(pixels), self.scale.white)

    def samples(self, count: int) -> list[Patches]:
        """Return the patches of the frames 0 to `count` - 1."""
        return [self._samples[position] for position in range(count)]

    def compare(
        self,
        before: Patches,
        after: Patches,
        expected: float,
        lamps: float = 1.0,
        most: float = math.inf,
    ) -> RatioCheck:
        """Compare two samples on what is unsaturated in both, and not dark.

        Args:
            before: brightness in the patches of one frame
            after: brightness in the patches of the next frame
            expected: ratio of their exposures, after over before
            lamps: factor by which lamps may change it; see `lamp_factor`
            most: factor by which they may before the picture is not trustworthy
        """
        light, then = self.scale.light[before], self.scale.light[after]
        usable = np.maximum(light, then) <= _HIGHEST * self.scale.full
        count = np.count_nonzero(usable, axis=1).astype(np.float64)
        first, second = _means(light, usable), _means(then, usable)
        # Where noise pushes some samples of a bright patch over the limit, the rest are too dark.
        is_cut = (count < _WHOLE * usable.shape[1]) & (
            np.maximum(first, second) > self.scale.full / 2
        )
        count[is_cut] = 0.0
        too_bright = self._wrongly_saturated(light, then, expected)
        too_dark = self._wrongly_saturated(then, light, 1 / expected)
        if self.scale.is_coarse:
            count[:] = too_bright = too_dark = 0.0
        # The geometric mean of both frames: neither alone decides which patches vote.
        darkest = self._dark / 2
        both = np.maximum(first, darkest) * np.maximum(second / expected, darkest)
        reached = np.sqrt(both) * min(1.0, expected) / self._dark
        steps = [reached >= least for least in _LEAST_LEVELS]
        sizes = [float(count[step].sum()) + too_bright + too_dark for step in steps]
        limits = (LEAST_COMPARED * usable.size, _FEW_SAMPLES, _LEAST_SAMPLES)
        found = [k for limit in limits for k, size in enumerate(sizes) if size >= limit]
        if not found:
            return RatioCheck(
                expected=expected,
                measured=None,
                tolerance=LARGEST_TOLERANCE,
                agrees=True,
                moved=0.0,
            )
        use, compared = steps[found[0]], sizes[found[0]] / usable.size
        is_certain = compared >= LEAST_COMPARED
        least = self.scale.level / 100  # black in one frame is a very large or small ratio
        ratios = np.maximum(second[use], least) / np.maximum(first[use], least)
        tolerance = self._tolerance(
            first[use], second[use] / expected, expected, _spread(ratios, count[use]) * is_certain
        )
        votes, weights = np.append(ratios, (math.inf, 0.0)), np.append(count[use], (0.0, 0.0))
        # Blooming and smear saturate parts of a picture whose other parts have the right light.
        enough = weights.sum() >= _FEW_SAMPLES
        if not (enough and _share_outside(votes, weights, expected, 1 + tolerance) <= 0.5):
            weights[-2:] = too_bright, too_dark
        measured = _quantile(votes, weights, 0.5)
        share = _share_outside(votes, weights, expected, 1 + tolerance)
        beyond_lamps = _share_outside(votes, weights, expected, (1 + tolerance) * min(lamps, most))
        return RatioCheck(
            expected=expected,
            measured=measured if 0 < measured < math.inf else None,
            tolerance=tolerance,
            agrees=share <= 0.5,
            moved=self._moved(light[use], then[use], usable[use], measured),
            compared=compared,
            contradicting=share,
            contradicts=is_certain and beyond_lamps > 0.5,
        )

    def _wrongly_saturated(self, dim: _Floats, bright: _Floats, ratio: float) -> float:
        """Return how many samples are saturated in `bright`, though `dim` x `ratio` is not.

        None is where light that flows out of others, saturated rightly, is enough for it.
        """
        full = self.scale.full
        is_white = bright >= full
        only = (dim <= _HIGHEST * full) & is_white
        expected = ratio * (_means(dim, only) + 2 * self._offset)
        wrong = expected <= _CERTAIN * full
        number = np.count_nonzero(only[wrong])
        needed = float(np.sum((full - expected) * np.count_nonzero(only, axis=1), where=wrong))
        right = is_white & ~wrong[:, np.newaxis]
        beyond = float(np.sum(np.maximum(ratio * dim - full, 0.0), where=right))
        return float(number) if needed > _SPILLED * beyond else 0.0

    def _tolerance(self, first: _Floats, second: _Floats, expected: float, spread: float) -> float:
        """Return the relative error that the median of the patches' ratios may have.

        Where few samples vote, `spread` is 0: what scatters is a reason for a warning.
        """
        if not first.size:
            return TOLERANCE
        light = max(float(np.median(np.maximum(first, second))), self._dark)
        # Rounding errors average out over patches of different brightness, and so does noise.
        different = np.unique(np.rint(first / self.scale.level)).size
        error = self._offset + self.scale.level / 2 / math.sqrt(different)
        scatter = min(_SIGMAS * spread / math.sqrt(different), LARGEST_TOLERANCE)
        return TOLERANCE + error / light * (1 + 1 / expected) + scatter

    def _moved(
        self, light: _Floats, then: _Floats, usable: NDArray[np.bool_], ratio: float
    ) -> float:
        """Return the share of the samples in patches whose ratio differs from most."""
        count = np.count_nonzero(usable, axis=1)
        if not count.any() or not 0 < ratio < math.inf:
            return 0.0
        change = then - ratio * light
        mean = _means(change, usable)
        variance = _means(np.square(change - mean[:, None]), usable)
        allowed = (
            TOLERANCE * _means(then, usable)
            + (self._offset + self.scale.level / 2) * (1 + ratio)
            + _SIGMAS * np.sqrt(variance / np.maximum(count, 1))
        )
        return float(count[np.abs(mean) > allowed].sum() / count.sum())


def _means(values: _Floats, mask: NDArray[np.bool_]) -> _Floats:
    """Return the mean of each row over its mask; 0 where the mask is empty."""
    sums = np.where(mask, values, 0.0).sum(axis=1)
    return np.asarray(sums / np.maximum(np.count_nonzero(mask, axis=1), 1))


def _quantile(values: _Floats, weights: _Floats, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def _spread(ratios: _Floats, weights: _Floats) -> float:
    """Return the interquartile range of ratios relative to their median."""
    if not weights.any():
        return 0.0
    low, middle, high = (_quantile(ratios, weights, share) for share in (0.25, 0.5, 0.75))
    return (high - low) / middle


def _share_outside(votes: _Floats, weights: _Floats, expected: float, factor: float) -> float:
    """Return the larger share of the votes: above expected x factor, or below expected / factor."""
    above, below = votes > expected * factor, votes < expected / factor
    return float(max(weights[above].sum(), weights[below].sum()) / weights.sum())


def lamp_factor(times_s: Iterable[float], mains_hz: float | None) -> float:
    """Return the largest factor by which flickering lamps change the ratio of two exposures.

    An exposure of t seconds averages a flicker of f Hz to sinc(f t) of its depth.  Without a known
    frequency of the mains that is at most 1 / (pi f t).
    """
    one, other = (
        LAMP_DEPTH * min(1.0, 1 / (math.pi * _FLICKER_HZ * time_s))
        if mains_hz is None
        else LAMP_DEPTH * abs(float(np.sinc(2 * mains_hz * time_s)))
        for time_s in times_s
    )
    return max((1 + one) / (1 - other), (1 + other) / (1 - one))
