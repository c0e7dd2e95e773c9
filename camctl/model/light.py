"""The light of samples from all frames: maximum likelihood, or the posterior mean.

Each frame says of the light E that its own sample, of exposure e_j, lies within a step of the
quantiser.  Where noise of half a step or more dithers the quantiser and clips nothing, a sample is
a normal measurement of E with variance (photons + reading + step^2 / 12) / e_j^2, and maximum
likelihood is the mean weighted with the inverse variances, taken at a first estimate of E, which
the sum of the samples gives and no single one decides.  A sample that noise may saturate is a
measurement if it is not saturated, and else says that its light is above full scale.  Elsewhere the
posterior mean is computed from the exact probabilities of the steps, once for each combination of
samples that occurs; the prior is flat in E >= 0.  Light is irradiance at exposure 1, where full
scale, M + 1 levels, is 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import normal_cdf
from camctl.model.light_bins import BINS_OF_OCTAVE, LightBins
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import CLIPPING_SIGMAS, SensorModel
from camctl.model.step_posterior import REACH, FrameSet, StepPosterior
from camctl.model.step_scores import StepScores
from camctl.system.picture_operations import looked_up

Floats32 = NDArray[np.float32]

#: Noise in steps below which the quantiser's mean error exceeds 0.7 % of a step: the first harmonic
#: of Widrow and Kollar (Quantization Noise, 2008) is exp(-2 (pi s)^2) / pi.
_DITHERED = 0.5

#: Noise in steps below which the likelihood is nearly even within a step, so that its maximum is
#: no better than any light there: with 0.25 of it, a step holds 4 standard deviations.
_SHARP = 0.25

#: Shares of the information above which a frame decides the method, and above which it is not
#: left out: of all frames that are clipped, or, divided by the number of frames, of each.
_DECISIVE, _NOTABLE = 0.05, 0.01

#: What noise that is cut off at black moves a mean by, of its deviation: 1 % of the square.
_MOST_MOVED = 0.1
#: Variance of a sample that is not less, of full scale squared.
_LEAST_VARIANCE = 1e-16

KEPT_TABLES = 16
"""Sets of frames whose tables are kept: a few captures of three colours each."""

#: A light of fewer standard deviations is truncated at 0: beyond it, 0.1 % of the probability is.
_NEAR_ZERO = CLIPPING_SIGMAS


@dataclass(frozen=True, eq=False)
class _Weights:
    """The normal measurements at some lights; arrays (n, B) for n frames, or (B,).

    Attributes:
        share: of the information that each frame has, whether or not it is clipped
        weight: of its sample in the mean; its sum over the frames is 1
        spread: standard deviation of each sample as irradiance
        steps: that of noise alone in steps of the quantiser
        clipped, saturated: whether noise clips the sample at the lowest value, or saturates it
        above: whether the light is so near full scale that a saturated sample says that it is above
        deviation: standard deviation of the mean, pattern noise included
        pattern: that of the pattern noise alone
        of_sum: that of the light that the sum of the samples shows, likewise: each of the frames
            that are not saturated adds its slope, levels / light, and its noise
    """

    share: FloatArray
    weight: FloatArray
    spread: FloatArray
    steps: FloatArray
    clipped: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    above: NDArray[np.bool_]
    deviation: FloatArray
    pattern: FloatArray
    of_sum: FloatArray

    @classmethod
    def at(cls, frames: FrameSet, sensor: SensorModel, E: FloatArray) -> _Weights:
        """Return them at the lights E, (B,)."""
        exposures = np.array(frames.exposures)[:, np.newaxis]
        unit = sensor.level
        dark = np.array([each.dark_levels * unit for each in frames.noise])[:, np.newaxis]
        x = exposures * E + dark
        noise = np.stack(
            [sensor.spread(row, each) for row, each in zip(x, frames.noise, strict=True)]
        )
        step = np.maximum(sensor.step(x), 1e-12)
        reach = CLIPPING_SIGMAS * np.sqrt(noise)
        saturated = x + reach >= sensor.full
        variance = (noise + step**2 / 12) / exposures**2
        if frames.noise[0].compression_levels:  # exact probabilities are not used
            above = (x - sensor.light[0]) / np.sqrt(noise)
            clipped, moved = _at_black(above, np.sqrt(noise) / exposures, variance, saturated)
            variance *= 1 + moved
        else:
            clipped = x - reach < sensor.light[0] - sensor.gap[0] / 2
        certain = x - reach >= sensor.full
        information = np.where(certain, 0.0, 1 / variance)
        total = information.sum(axis=0)
        # Where every frame is clipped, the one that is least so stands for all: the shortest of
        # those that are saturated, the longest of those without light.
        weight = np.where(saturated | clipped, 0.0, 1 / variance)
        none = weight.sum(axis=0) == 0
        lit = ~saturated
        best = np.where(lit.any(axis=0), np.argmax(exposures * lit, axis=0), np.argmin(exposures))
        weight[best[none], np.flatnonzero(none)] = 1 / variance[best[none], np.flatnonzero(none)]
        sums = weight.sum(axis=0)
        weight = weight / sums
        offsets = np.array([each.dsnu_levels * unit for each in frames.noise])[:, np.newaxis]
        pattern = (weight * offsets / exposures).sum(axis=0) ** 2
        prnu = max(each.prnu for each in frames.noise)
        pattern = pattern + (prnu * E) ** 2
        deviation = np.sqrt(1 / sums + pattern)
        counts = (x < sensor.full) | (exposures == exposures.min())
        slopes = np.where(counts, exposures / step, 0.0)
        of_sum = (slopes**2 * variance).sum(axis=0)
        of_sum += (slopes * offsets / exposures).sum(axis=0) ** 2
        return cls(
            information / np.maximum(total, 1e-300),
            weight,
            np.sqrt(variance),
            np.sqrt(noise) / step,
            clipped,
            saturated,
            saturated & (x - CLIPPING_SIGMAS * exposures / np.sqrt(sums) - reach < sensor.full),
            deviation,
            np.sqrt(pattern),
            np.sqrt(of_sum / slopes.sum(axis=0) ** 2 + (prnu * E) ** 2),
        )


def _at_black(
    above: FloatArray, spread: FloatArray, variance: FloatArray, saturated: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which samples do not count since noise is cut off at black, (n, B).

    Those count whose light is above the least one by so many deviations that the noise of all of
    them moves the mean by `_MOST_MOVED` of its own.  Others are black in several frames at once,
    since errors of files are not independent: they count where there is nothing else, all of them.

    Args:
        above: light of samples above the least one, deviations, (n, B)
        spread: these, as irradiance
        variance: of samples, as irradiance
        saturated: samples that do not count either

    Returns:
        these, and the square of what black moves the mean of the others by, over its variance, (B,)
    """
    z = np.linspace(0.0, CLIPPING_SIGMAS, 512)
    least = np.interp(-_MOST_MOVED / math.sqrt(len(above)), -_moved(z), z)
    dark = above < least
    clipped = dark & ~(dark | saturated).all(axis=0)
    weight = np.where(saturated | clipped, 0.0, 1 / variance)
    moved = np.square((weight * spread * _moved(above)).sum(axis=0))
    return clipped, np.asarray(moved / np.maximum(weight.sum(axis=0), 1e-300))


def _moved(z: FloatArray) -> FloatArray:
    """Return what noise that is cut off z deviations below the light moves the mean by, of one."""
    return np.asarray(np.exp(-z * z / 2) / math.sqrt(2 * math.pi) - z * (1 - normal_cdf(z)))


def light_of_sums(frames: FrameSet, sensor: SensorModel) -> FloatArray:
    """Return the light of each sum of the frames without noise, (n white + 1,).

    These are the levels of all frames, merged.
    """
    exposures = np.array(frames.exposures)
    dark = np.array([each.dark_levels * sensor.level for each in frames.noise])
    edges = (frames.response.levels - dark[:, np.newaxis]) / exposures[:, np.newaxis]
    edges = np.concatenate(([0.0], np.sort(edges, axis=None), [np.inf]))
    first = np.maximum((edges[1:] + edges[:-1]) / 2, 0.0)
    places = np.arange(exposures.size * sensor.white + 1) - exposures.size * sensor.black
    first = np.minimum(first, sensor.full / exposures.min())
    return np.asarray(first[np.maximum(places, 0)])


def deviation_of_sums(frames: FrameSet, sensor: SensorModel, E: FloatArray) -> FloatArray:
    """Return the standard deviation of the light that the sum of the frames shows, at E, (B,)."""
    return _Weights.at(frames, sensor, E).of_sum


class LightTables:
    """What estimates the light of samples, tabulated by their values and by a first estimate.

    Args:
        frames: the frames' exposures and noise, and the camera's response

    Attributes:
        sensor: the camera
        light_bins: bins of light
        bins: returns the bin of each light
        irradiance: (n, white + 1) float32, the light of each value in each frame
        lights: (B,) the middle of each bin of light
        deviation: (B,) float32, standard deviation of an estimate in each bin
        of_sum: (B,) that of the light that the sum of the frames shows
        exposures: (n,) of the frames, relative to the shortest
        weights: (n, B) float32, of a sample of each frame in the mean
        spreads: (n, B) float32, standard deviation of a sample of each frame, as irradiance
        clipped: (n, B) whether noise clips a sample at the lowest value
        first_bins: (n white + 1,) of each sum of samples
        top: largest value of a sample of a file that is not saturated
        white: value from which on a sample may be saturated whatever the sum is
        saturating: (n,) the darkest bin in which it may be
        is_above: (B,) whether what is saturated may say that there is more light than that
    """

    def __init__(self, frames: FrameSet) -> None:
        self.sensor = sensor = SensorModel(frames.response, frames.black)
        self._frames, self._posterior = frames, StepPosterior(frames, sensor)
        self.exposures = exposures = np.array(frames.exposures)
        dark = np.array([each.dark_levels * sensor.level for each in frames.noise])
        light = (sensor.light - dark[:, np.newaxis]) / exposures[:, np.newaxis]
        self.irradiance: Floats32 = light.astype(np.float32)
        self._brightest = np.float32(sensor.full / exposures.min())
        step = float(np.min(sensor.gap[sensor.gap > 0])) / exposures.max()
        self.light_bins = LightBins(2.0 ** np.floor(np.log2(step / 16)), float(self._brightest))
        self.bins, self.lights = self.light_bins.of, self.light_bins.lights
        found = _Weights.at(frames, sensor, self.lights)
        self.weights: Floats32 = found.weight.astype(np.float32)
        self.deviation: Floats32 = found.deviation.astype(np.float32)
        self.of_sum = found.of_sum
        near = found.saturated & (found.share > 0)
        self._kept = (found.share > _NOTABLE / len(exposures)) | near
        self._near = near & (found.weight == 0)
        self._above = found.above & (found.weight == 0)
        # Compression lowers saturated samples beside others, and lifts some to white: such a frame
        # does not count, and what is white says no more than the noise of its frame.
        first = frames.noise[0]
        is_compressed, self.white = bool(first.compression_levels), sensor.white
        self.top = _highest(frames, sensor)
        if is_compressed:
            self.white = self.top + 1
        elif first.file is not None and frames.beside_saturated:
            is_compressed = True
            error = math.sqrt(first.file.by_contrast(np.zeros(1))[0])
            self.white -= math.ceil(CLIPPING_SIGMAS * error)
        if is_compressed:
            self._above = self._near
        self.is_above = self._above.any(axis=0)
        lost = found.saturated & (found.share == 0) if is_compressed else found.saturated
        self.saturating = np.argmax(lost, axis=1)
        self.spreads: Floats32 = found.spread.astype(np.float32)
        self.clipped = found.clipped
        lost = np.where(found.clipped, found.share, 0.0).sum(axis=0) > _NOTABLE
        undithered = (found.share > _DECISIVE) & (found.steps < _DITHERED)
        self.is_exact = lost | undithered.any(axis=0)
        sharp = (found.share > _DECISIVE) & (found.steps < _SHARP)
        self._sharp = sharp.any(axis=0) & self.is_exact
        self._pattern = found.pattern.astype(np.float32)
        self.first_bins = self.bins(light_of_sums(frames, sensor).astype(np.float32))

    @cached_property
    def _scores(self) -> StepScores | None:
        """What finds the light of samples in steps; None: there are too many, or none needs it."""
        exact = np.flatnonzero(self.is_exact & ~self._sharp)
        if not exact.size:
            return None
        # An octave more: what begins near the last of them may be brighter.
        size = min(int(exact[-1]) + 1 + BINS_OF_OCTAVE, self.lights.size)
        if not StepScores.fits(self._frames, self.sensor, self.lights[:size]):
            return None
        return StepScores(self._frames, self.sensor, self.light_bins, size)

    @cached_property
    def steps(self) -> Floats32:
        """(n, B), step of the quantiser of each frame, as irradiance; most pictures need none."""
        exposures = self.exposures[:, np.newaxis]
        return np.asarray(self.sensor.step(exposures * self.lights) / exposures, np.float32)

    @cached_property
    def variances(self) -> Floats32:
        """(n, B), variance of a sample of each frame as irradiance, above 0."""
        return np.square(self.spreads) + np.float32(_LEAST_VARIANCE)

    @cached_property
    def of_values(self) -> tuple[Floats32, Floats32]:
        """(n, white + 1), square of the step, and variance, at the light of each value."""
        bins = self.bins(self.irradiance)
        steps, variances = (
            np.take_along_axis(each, bins, axis=1) for each in (self.steps, self.variances)
        )
        return np.square(steps), variances

    def estimate(
        self, values: Sequence[NDArray[Any]], total: NDArray[Any]
    ) -> tuple[Floats32, Floats32]:
        """Return the light of samples and its standard deviation, as irradiance at exposure 1.

        Args:
            values: samples of each frame, (S,) up to white, black included
            total: their sum, (S,)
        """
        E, deviation = self.mean(values, total)
        self.refine(values, E, deviation)
        return E, deviation

    def mean(
        self, values: Sequence[NDArray[Any]], total: NDArray[Any]
    ) -> tuple[Floats32, Floats32]:
        """Return the same as if noise dithered the quantiser and clipped nothing."""
        samples = [looked_up(*each) for each in zip(self.irradiance, values, strict=True)]
        bins = self.first_bins.take(total)
        for each, lowest in zip(values, self.saturating, strict=True):
            # The sum does not always show that noise saturated a sample.
            bins[np.flatnonzero((each >= self.white) & (bins < lowest))] = lowest
        E = self.weights[0].take(bins)
        E *= samples[0]
        for place in range(1, len(values)):
            weighted = self.weights[place].take(bins)
            weighted *= samples[place]
            E += weighted
        deviation = self.deviation.take(bins)
        self._add_saturated(values, samples, bins, E, deviation)
        self._truncate(E, deviation)
        return E, deviation

    def refine(self, values: Sequence[NDArray[Any]], E: Floats32, deviation: Floats32) -> None:
        """Replace what `mean` returned where exact probabilities of the steps say another light.

        Args:
            values: samples of each frame, (S,)
            E: their light
            deviation: of it
        """
        bins = self.bins(E)
        chosen = np.flatnonzero(self.is_exact.take(bins))
        all_count = np.zeros(chosen.size, np.bool_)
        if chosen.size and self._scores is not None:
            first = bins[chosen]
            here = [each[chosen] for each in values]
            light, error, meets = self._scores.of(here, first)
            meets = meets & (light <= self._brightest)  # levels that coincide have no slope
            moved = meets & ~self._sharp.take(first)  # scores within a step say nothing
            kept = chosen[moved]
            E[kept] = light[moved]
            deviation[kept] = np.hypot(error, self._pattern.take(first))[moved]
            bins[kept] = self.bins(E[kept])
            all_count = ~meets | self._ends_at_white(here, bins[chosen])
            rest = ~moved | all_count | (error * _NEAR_ZERO > light)
            chosen, all_count = chosen[rest], all_count[rest]
        if chosen.size:
            here = [each[chosen] for each in values]
            all_count |= self._ends_at_white(here, bins[chosen])
            counts = [row.take(bins[chosen]) | all_count for row in self._kept]
            mean, spread = self._posterior.of(here, counts)
            known = np.isfinite(mean)  # else all probabilities are 0
            E[chosen[known]], deviation[chosen[known]] = mean[known], spread[known]

    def _ends_at_white(
        self, values: Sequence[NDArray[Any]], bins: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Return where a saturated sample says that the light is above full scale."""
        found = np.zeros(bins.size, np.bool_)
        for above, each in zip(self._above, values, strict=True):
            found |= above.take(bins) & (each >= self.sensor.white)
        return found

    def _add_saturated(
        self,
        values: Sequence[NDArray[Any]],
        samples: list[Floats32],
        bins: NDArray[np.intp],
        E: Floats32,
        deviation: Floats32,
    ) -> None:
        """Add what the frames say that noise may or may not saturate; they have no weight yet."""
        some = np.flatnonzero(self.is_above.take(bins))
        for place, (near, above_full) in enumerate(zip(self._near, self._above, strict=True)):
            chosen = some[above_full.take(bins[some])]
            is_white = values[place][chosen] >= self.sensor.white
            counts = is_white | near.take(bins[chosen])
            chosen, is_white = chosen[counts], is_white[counts]
            if not chosen.size:
                continue
            mean = E[chosen].astype(np.float64)
            # The differences of pixels are the same in each frame.
            pattern = self._pattern.take(bins[chosen]).astype(np.float64)
            square = np.square(deviation[chosen].astype(np.float64)) - pattern**2
            spread = np.sqrt(np.maximum(square, _LEAST_VARIANCE))
            other = self.spreads[place].take(bins[chosen])
            share = spread**2 / (spread**2 + other**2)
            measured = mean + share * (samples[place][chosen] - mean)
            full = float(self.irradiance[place, -1])
            above, narrower = truncated((mean - full) / np.hypot(spread, other))
            E[chosen] = np.where(is_white, mean + spread * np.sqrt(share) * above, measured)
            left = np.maximum(1 - share * np.where(is_white, narrower, 1.0), 1e-6)
            deviation[chosen] = np.hypot(spread * np.sqrt(left), pattern)

    def _truncate(self, E: Floats32, deviation: Floats32) -> None:
        """Replace lights near 0 by their posterior mean above 0, and their deviations likewise."""
        near = np.flatnonzero(_NEAR_ZERO * deviation > E)
        if near.size:
            spread = deviation[near].astype(np.float64)
            deviation[near] = spread * cut_at_zero(E, spread, near)


def truncated(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much a normal variable, cut at -a, has a larger mean and less variance.

    It has mean 0 and variance 1; -5 stands for any `a` below.
    """
    a = np.maximum(a, -REACH)
    larger = np.exp(-(a**2) / 2) / np.sqrt(2 * np.pi) / normal_cdf(a)
    return larger, larger * (a + larger)


def cut_at_zero(light: Floats32, spread: FloatArray, near: Any) -> FloatArray:
    """Replace lights by their posterior means above 0; return the factors of their deviations.

    Args:
        light: of samples
        spread: standard deviation of those that are replaced
        near: where these are
    """
    larger, narrower = truncated(light[near] / spread)
    light[near] += spread * larger
    return np.sqrt(np.maximum(1 - narrower, 1e-6))


def _highest(frames: FrameSet, sensor: SensorModel) -> int:
    """Return the largest value that is not saturated: as far as any file, or these, err at most."""
    of_any = sensor.highest(None)
    if frames.most_rounding is None:
        return of_any
    noises = (
        replace(each, compression_levels=max(each.compression_levels, frames.most_rounding))
        for each in frames.noise
    )
    return max(of_any, min(sensor.highest(each) for each in noises))


@lru_cache(maxsize=KEPT_TABLES)
def light_tables(frames: FrameSet) -> LightTables:
    """Return the tables of a set of frames; those of the last sets are kept."""
    return LightTables(frames)


def is_certain(frames: FrameSet, others: Sequence[FrameSet], most: float) -> NDArray[np.bool_]:
    """Return for each bin of light whether its standard deviation is known.

    Args:
        frames: with the noise that was measured
        others: with noises that differ by its uncertainty, see `NoiseFit.neighbours`
        most: largest relative uncertainty of a known standard deviation
    """
    tables = light_tables(frames)
    # With the same weights: where noise decides whether a frame counts, other weights would differ.
    first, *rest = (_Weights.at(each, tables.sensor, tables.lights) for each in (frames, *others))
    middle, *found = (
        np.sqrt(np.sum((first.weight * each.spread) ** 2, axis=0)) for each in (first, *rest)
    )
    changes = [each / middle - 1 for each in found]
    return np.asarray(np.sqrt(np.sum(np.square(changes), axis=0)) <= most)
