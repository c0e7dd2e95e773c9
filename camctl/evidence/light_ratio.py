"""Checks on the pixels that each frame had the exposure that the camera reported.

The longer of two frames predicts the light of the shorter one, patch by patch, with the variance
of the sensor model, see `camctl.evidence.patch_errors`.  The ratio of their light is the weighted
mean of what the patches show, without those in which something moved; its interval holds the noise,
and the errors of black level, rounding and response that patches have in common.  A frame
contradicts its exposure where the interval, at the significance level of a capture, does not hold
the stated ratio, and most samples differ from it to the same side.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import MOST_OFFSET, PatchErrors, weighted_median
from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.ratio_check import (
    LAMP_DEPTH,
    LEAST_COMPARED,
    MOST,
    RatioCheck,
    significant_sigmas,
)
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.model.noise import FrameNoise
from camctl.model.quantiles import NORMAL_MAD, median
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import (
    BLACK_ERROR_LEVELS,
    RESPONSE_ERROR,
    SensorModel,
)

MOST_CHANGE = 1.1
"""Factor by which lamps may change a ratio before the picture is not trustworthy, either."""
#: Slowest usual flicker, Hz: twice the frequency of the mains.
_FLICKER_HZ = 100.0
#: Logarithm of a ratio that says nothing where it is the half of an interval: a factor of 2.
_WIDEST = math.log(2.0)
#: Rounds of the fit: the tolerance changes by less than a tenth after these.
_ROUNDS = 5
#: Comparisons of two frames that are kept, 0.1 MB each.
_MOST_KNOWN = 32

_Floats = NDArray[np.float64]


class FrameSample(NamedTuple):
    """Patches of a frame, and its noise; None where it is unknown."""

    patches: Patches
    noise: FrameNoise | None


class _Votes(NamedTuple):
    """What patches show of the ratio of two frames; arrays are (patches,).

    Attributes:
        logs: logarithm of the light in the shorter frame over the prediction
        sigmas: standard deviation of it in a patch
        counts: samples
        tolerance: error of their mean that noise and common errors make at the significance level
        mean: weighted mean, without what moved
    """

    logs: _Floats
    sigmas: _Floats
    counts: _Floats
    tolerance: float
    mean: float


class NeighbourCheck:
    """Compares neighbouring frames of a capture on patches of their pixels.

    Args:
        real: the camera's response as levels
        black: brightness without light, DN
        layout: pixel layout of a frame
        pairs: of frames in a capture, over which the significance level is divided
        response_error: standard deviation of the relative error of the response
        offset: that of the offset of a frame of unknown noise, levels of 255; see `FILE_OFFSET`

    Attributes:
        scale: irradiance of each brightness
    """

    def __init__(
        self,
        real: CameraResponse,
        black: int,
        layout: Layout = Layout.MONO,
        pairs: int = 1,
        response_error: float = RESPONSE_ERROR,
        offset: float = 0.0,
    ) -> None:
        self._response_error = response_error
        self.scale = SensorModel(real, black)
        self._offset = offset / 255 * real.M
        self._layout = layout
        self._sigmas = significant_sigmas(pairs)
        self._samples: dict[int, FrameSample] = {}
        self._known: dict[tuple[int, int, float], tuple[FrameSample, FrameSample, _Votes]] = {}

    def add(self, position: int, pixels: Pixels, noise: FrameNoise | None = None) -> FrameSample:
        """Keep a sample of the frame at `position` of the sequence, and return it."""
        sample = self._samples[position] = self.sample(pixels, noise)
        return sample

    def remove(self, position: int) -> None:
        """Forget the frame at `position`: it will be shot again."""
        del self._samples[position]

    def clear(self) -> None:
        """Forget all frames."""
        self._samples.clear()
        self._known.clear()

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
        lamps = min(lamp_factor(times_s, mains_hz), most)
        return self.compare(self._samples[position - 1], self._samples[position], expected, lamps)

    def sample(self, pixels: Pixels, noise: FrameNoise | None = None) -> FrameSample:
        """Return the patches of a frame with its noise."""
        return FrameSample(sample_patches(self._layout.planes(pixels), self.scale.white), noise)

    def samples(self, count: int) -> list[FrameSample]:
        """Return the patches of the frames 0 to `count` - 1."""
        return [self._samples[position] for position in range(count)]

    def compare(
        self, before: FrameSample, after: FrameSample, expected: float, lamps: float = 1.0
    ) -> RatioCheck:
        """Compare two samples on what is unsaturated in both, and not dark.

        Args:
            before: of one frame
            after: of the next frame
            expected: ratio of their exposures, after over before
            lamps: factor by which lamps may change it; see `lamp_factor`
        """
        is_longer = expected >= 1
        short, long = (before, after) if is_longer else (after, before)
        ratio = max(expected, 1 / expected)
        votes = self._votes(short, long, ratio)
        off = votes.mean
        if not votes.logs.size or votes.tolerance > _WIDEST:
            off = self._rough(short, long, ratio)
        if abs(off) > votes.tolerance:  # its errors are those of another ratio
            found = ratio / math.exp(off)
            if found >= 1:
                votes = self._votes(short, long, found)
            else:  # the frame that was to be the longer one is the shorter one
                votes = self._votes(long, short, 1 / found)
                votes = votes._replace(logs=-votes.logs, mean=-votes.mean)
            votes = votes._replace(logs=votes.logs + off, mean=votes.mean + off)
        logs, counts = votes.logs, votes.counts
        # Blooming and smear saturate parts of a picture whose other parts have the right light.
        if not counts.sum() or _share_outside(logs, counts, votes.tolerance) > 0.5:
            white = self._saturated_votes(short, long, ratio)
            darker = self._saturated_votes(long, short, 1 / ratio)
            logs = np.concatenate((logs, -white[0], darker[0]))
            counts = np.concatenate((counts, white[1], darker[1]))
        compared = counts.sum() / short.patches.size
        # Fewer samples than most of a patch give no ratio.
        is_unknown = counts.sum() < MOST * short.patches.shape[1] or votes.tolerance > _WIDEST
        if is_unknown or self.scale.is_coarse:
            return RatioCheck(
                expected=expected, measured=None, tolerance=1.0, agrees=True, moved=0.0
            )
        share = _share_outside(logs, counts, votes.tolerance)
        agrees = share <= 0.5 or abs(votes.mean) <= votes.tolerance
        is_measured = votes.counts.sum() >= counts.sum() / 2
        found = ratio / math.exp(votes.mean)
        return RatioCheck(
            expected=expected,
            measured=(found if is_longer else 1 / found) if is_measured else None,
            tolerance=math.expm1(votes.tolerance),
            agrees=agrees,
            moved=self._moved(votes) / float(counts.sum()),
            compared=compared,
            contradicting=share,
            contradicts=(
                not agrees
                and compared >= LEAST_COMPARED
                and _share_outside(logs, counts, votes.tolerance + math.log(lamps)) > 0.5
            ),
        )

    def _votes(self, short: FrameSample, long: FrameSample, ratio: float) -> _Votes:
        """Return what the patches of two frames show of this ratio of their exposures.

        It is asked several times: when a frame arrives, for the delay, and for movement.
        """
        key = id(short.patches), id(long.patches), ratio
        if key not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                del self._known[next(iter(self._known))]
            self._known[key] = short, long, self._counted(short, long, ratio)
        return self._known[key][2]

    def _counted(self, short: FrameSample, long: FrameSample, ratio: float) -> _Votes:
        sensor = self.scale
        # Means of patches have no shift as single samples have, whose noise goes with their light.
        mean = sensor.expected(ratio, short.noise, long.noise)
        prediction = replace(sensor.neighbour(ratio, short.noise, long.noise), mean=mean)
        limits = [sensor.highest(each.noise) + 1 for each in (short, long)]
        rests = ~np.logical_or.reduce(
            [
                _is_cut(each.patches, limit, sensor.white)
                for each, limit in zip((short, long), limits, strict=True)
            ]
        )
        part = PatchErrors.of(
            sensor, prediction, limits, short.patches, long.patches, rests, least=0.0
        )
        own = part.own
        if short.noise is None or long.noise is None:
            own = np.maximum(own, part.variance)
        response = np.square(self._response_error * part.light)
        sigmas = np.sqrt(own / part.count + part.shared + response)
        # Of light that is added to samples the largest size is known: 12^-0.5 of it is the standard
        # deviation of what is uniform up to it.
        added = 12**-0.5 * MOST_OFFSET * sensor.full
        added = math.hypot(added, BLACK_ERROR_LEVELS * sensor.level * (1 - 1 / ratio))
        of_short = self._offset_light(part.light)
        of_long = self._offset_light(part.light * ratio) / ratio
        uncertain = np.hypot(np.hypot(of_short, of_long), added)
        seen, least = part.light + part.error, np.hypot(sigmas, uncertain)
        # The mean of both frames, weighted by the noise of reading, which is the same in both, does
        # not depend on their difference.  What differs by more than noise anywhere counts, too.
        both = (ratio**2 * part.light + seen) / (ratio**2 + 1)
        differ = np.abs(part.error) >= significant_sigmas(part.size) * least
        used = (both >= self._sigmas * least) | differ
        light, seen = np.maximum(part.light, least)[used], np.maximum(seen, least / 100)[used]
        logs, counts = np.log(seen / light), part.count[used]
        if not logs.size:
            return _Votes(logs, logs, counts, 0.0, 0.0)
        relative, uncertain = sigmas[used] / light, uncertain[used] / light
        # Errors of rounding, and parts of a picture that differ, are alike where brightness is.
        different = np.unique(np.rint(part.brightness[used])).size
        shared = np.sqrt(part.shared[used]) / light
        middle, extra, weights = _fitted(logs, np.hypot(relative, uncertain), self._sigmas)
        total = float(weights.sum())
        added, common = (float((weights * each).sum()) / total for each in (uncertain, shared))
        rest = math.hypot(common, extra) / math.sqrt(different)
        error = math.hypot(self._response_error, added, rest, 1 / math.sqrt(total))
        return _Votes(logs, relative, counts, self._sigmas * error, middle)

    def _offset_light(self, light: _Floats) -> _Floats:
        """Return the light that the offset of a frame adds to samples of this light."""
        return self._offset * self.scale.step(light)

    def _rough(self, short: FrameSample, long: FrameSample, ratio: float) -> float:
        """Return the logarithm of the median ratio of light over `ratio`; 0 where there is none.

        Unknown noise is measured beside the prediction, and is large beside a wrong one.
        """
        sensor = self.scale
        limits = [sensor.highest(each.noise) for each in (short, long)]
        usable = (short.patches <= limits[0]) & (long.patches <= limits[1])
        one, other = (
            np.where(usable, sensor.light[each.patches], 0.0).sum(axis=1) for each in (short, long)
        )
        # Of what is rounded to black only the most is known, which may contradict the ratio.
        least = math.hypot(12**-0.5 * sensor.level, float(self._offset_light(np.zeros(1))[0]))
        least = self._sigmas * least * np.maximum(usable.sum(axis=1), 1)
        logs = np.log(np.maximum(one, least) * ratio / np.maximum(other, least))
        shows = ((one > least) | (logs < 0)) & ((other > least) | (logs > 0)) & usable.any(axis=1)
        shows &= (one > least) | (other > least)
        return median(logs[shows]) if shows.any() else 0.0

    def _saturated_votes(
        self, dim: FrameSample, bright: FrameSample, ratio: float
    ) -> tuple[_Floats, _Floats]:
        """Return votes of samples that are saturated, though `dim` x `ratio` is not.

        Returns:
            logarithm of the factor by which the light is larger at least, and samples, (patches,);
            none where light that flows out of others, saturated rightly, is enough for it
        """
        sensor = self.scale
        light = sensor.light[dim.patches]
        is_white = bright.patches >= sensor.white
        only = (dim.patches <= sensor.highest(dim.noise)) & is_white
        count = np.count_nonzero(only, axis=1)
        mean = np.where(only, light, 0.0).sum(axis=1) / np.maximum(count, 1)
        variance = np.square(sensor.step(mean)) / 12 + np.square(BLACK_ERROR_LEVELS * sensor.level)
        if dim.noise is not None:
            variance += sensor.variance(mean, dim.noise) / np.maximum(count, 1)
        expected = (
            ratio * (mean + self._sigmas * np.sqrt(variance)) * (1 + 3 * self._response_error)
        )
        limit = sensor.light[sensor.highest(bright.noise)]
        wrong = (count > 0) & (expected < limit)
        needed = float(((sensor.full - expected) * count)[wrong].sum())
        right = is_white & ~wrong[:, np.newaxis]
        beyond = float(np.sum(np.maximum(ratio * light - sensor.full, 0.0), where=right))
        if needed <= beyond:  # charge is conserved
            wrong[:] = False
        factor = np.log(limit / np.maximum(expected[wrong], sensor.level / 100))
        return factor, count[wrong].astype(np.float64)

    def _moved(self, votes: _Votes) -> float:
        """Return how many samples are in patches whose ratio differs from most."""
        differs = np.abs(votes.logs - votes.mean) > self._sigmas * votes.sigmas
        return float(votes.counts[differs].sum())


def _fitted(logs: _Floats, sigmas: _Floats, limit: float) -> tuple[float, float, _Floats]:
    """Return the weighted mean of logarithms, what they scatter beyond `sigmas`, and the weights.

    The scatter comes from parts of the picture that differ, as by light that spreads: a random
    effect (DerSimonian and Laird, 1986).  What is beyond `limit` standard deviations has moved, and
    has no weight.
    """
    mean = weighted_median(logs, 1 / np.square(sigmas))
    for _ in range(_ROUNDS):
        scatter = median(np.abs(logs - mean)) / NORMAL_MAD
        extra = max(scatter**2 - median(sigmas) ** 2, 0.0)
        weights = 1 / (np.square(sigmas) + extra)
        kept = np.where(np.square(logs - mean) * weights <= limit**2, weights, 0.0)
        if kept.any():
            weights = kept
        mean = float((weights * logs).sum() / weights.sum())
    return mean, math.sqrt(extra), weights


def _is_cut(patches: Patches, limit: int, white: int) -> NDArray[np.bool_]:
    """Return in which patches noise saturates some samples of a brightness, and not others.

    The mean of the others is too small: it is as near to the limit as the limit to saturation.
    """
    inside = patches < limit
    count = np.maximum(np.count_nonzero(inside, axis=1), 1)
    mean = np.where(inside, patches, 0).sum(axis=1) / count
    return np.asarray(~inside.all(axis=1) & (mean >= 2 * limit - white))


def _share_outside(logs: _Floats, counts: _Floats, limit: float) -> float:
    """Return the larger share of the votes: above a limit, or below its negative."""
    if not counts.size:
        return 0.0
    sides = (float(counts[side].sum()) for side in (logs > limit, logs < -limit))
    return max(sides) / float(counts.sum())


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
