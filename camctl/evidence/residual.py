"""The normalised residual between two frames of different exposure.

The brightness of the longer frame predicts the light of the shorter one, with a variance.  The
residual is what the shorter frame shows beyond it, over the standard deviation: of a single sample
and of the mean of 5 x 5, in which noise averages out and what neighbours share does not.

Where the noise is known, the sensor model predicts the variance; one factor for the variance of
samples and one for the variance of means hold what it lacks (lag, rows that differ).  Where it is
unknown, as for photographs, variance and mean error are measured as functions of brightness in
patches at rest: parts that `camctl.evidence.moved_parts` finds are left out, and others lose their
weight by iterated trimming.  Photographs have errors at edges besides: see `camctl.evidence.edges`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import Ranges, edge_levels, ranges_at
from camctl.evidence.moved_parts import moved_patches
from camctl.evidence.patches import Patches
from camctl.interface.camera import Pixels
from camctl.model.noise import FrameNoise
from camctl.model.sensor import JPEG_BLOCK_ERROR, Prediction, SensorModel
from camctl.system.picture_operations import opencv

MEAN_RADIUS = 2
"""Half the side, without the middle, of the squares whose mean is tested: 5 x 5 samples."""

MEAN_SAMPLES = (2 * MEAN_RADIUS + 1) ** 2

#: Standard deviations beyond which 1 of 2,000 samples is by noise.
_USUAL_SIGMAS = 3.5
#: Standard deviation of the relative error of a response: twice the linearity error (EMVA 1288)
#: that data sheets of machine-vision cameras state, 0.2 to 0.3 %.
_RESPONSE_ERROR = 0.005
#: Share of the samples of a patch that must be in range in both frames.
_LEAST_USABLE = 0.75
#: Patches of one measured value, at least: its standard error is then 20 % of their scatter.
_LEAST_PATCHES = 32
#: Bins of brightness in which unknown noise is measured, at most: as many values as a fit of photon
#: noise, read noise and the processing of photographs has bends.
_MOST_BINS = 24
#: Rounds of trimming, and standard deviations from which a patch is left out.
_ROUNDS, _TRIM = 6, 4.0
#: Median absolute deviation of a normal variable, standard deviations.
_NORMAL_MAD = 0.6745
#: Error of a response that mean errors of photographs may show, as a share of the light: beyond it
#: all samples of a brightness have moved.
_MOST_BIAS = 0.25
#: Largest factor of the variance by which patches at rest show a known noise too small: beyond it
#: most of what can be compared moves.
_MOST_FACTOR = 2.0
#: Largest light that is added to all samples, as a share of full scale: smear of a CCD without a
#: shutter, of which data sheets state -60 dB at most.
_MOST_OFFSET = 0.001
#: Largest correction of a ratio that agrees, relative: see `camctl.evidence.light_ratio`.
_MOST_CORRECTION = 0.02

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Side:
    """One of two frames that are compared.

    Attributes:
        position: of the frame in the capture
        exposure: relative to the shortest frame
        noise: of the frame; None where it is unknown
    """

    position: int
    exposure: float
    noise: FrameNoise | None


@dataclass(frozen=True, eq=False)
class Tables:
    """The prediction by the brightness of the longer frame, (colours, white + 1) each.

    Attributes:
        mean: light of the shorter frame
        sample: standard deviation of a sample
        square: standard deviation of the mean of 5 x 5, times 5: as if it were of a sample
        skewness: of a sample
    """

    mean: _Floats
    sample: _Floats
    square: _Floats
    skewness: _Floats


@dataclass(frozen=True, eq=False)
class Pair:
    """A shorter and a longer exposure.

    Args:
        sensor: light of each brightness
        short, long: the frames
        ratio: of the light in the longer frame to that in the shorter one, as most patches show
        samples: patches of both frames, colour by colour
        colours: of a pixel, 1 or 3: planes that may differ where the noise is unknown
    """

    sensor: SensorModel
    short: Side
    long: Side
    ratio: float
    samples: tuple[Patches, Patches]
    colours: int = 1

    @property
    def is_known(self) -> bool:
        """Whether the noise of both frames is known."""
        return self.short.noise is not None and self.long.noise is not None

    @property
    def is_processed(self) -> bool:
        """Whether a program made the frames: pixels have three colours, and unknown noise."""
        return self.colours > 1 and not self.is_known

    @cached_property
    def saturated(self) -> int:
        """Brightness from which samples of the longer frame may be saturated ones."""
        return self.sensor.highest(self.long.noise) + 1

    @cached_property
    def is_measured(self) -> bool:
        """Whether the variance is known, or enough patches at rest have shown it."""
        return self.is_known or all(part.size >= _LEAST_PATCHES for part in self._parts)

    @cached_property
    def tables(self) -> Tables:
        """Mean and standard deviations, fitted to the patches at rest."""
        prediction = self.sensor.neighbour(self.ratio, self.short.noise, self.long.noise)
        fit = _fitted_model if self.is_known else _fitted_tables
        fits = [fit(part, prediction) for part in self._parts]
        fits = fits * (self.colours // len(fits))
        mean, own, shared, skewness = (
            np.stack([getattr(each, field.name) for each in fits]) for field in fields(Prediction)
        )
        if self.is_processed:
            block = JPEG_BLOCK_ERROR / 255 * self.sensor.white * self.sensor.step(mean)
            shared = np.maximum(shared, np.square(block))
        shared = shared + np.square(_RESPONSE_ERROR * mean)
        squares = own + MEAN_SAMPLES * shared
        for table in (mean, own, shared, squares):  # of saturated samples: at least
            table[:, self.saturated :] = table[:, [self.saturated - 1]]
        return Tables(mean, np.sqrt(own + shared), np.sqrt(squares), skewness)

    @cached_property
    def _parts(self) -> list[_Part]:
        """Patches in range in both frames: of all colours together if the noise is known."""
        prediction = self.sensor.neighbour(self.ratio, self.short.noise, self.long.noise)
        before, after = self.samples
        count = 1 if self.is_known else self.colours
        rests = np.ones(len(before), np.bool_)
        if not self.is_known:
            sensor = self.sensor
            rests = ~moved_patches(before, after, self.colours, sensor.black, sensor.white)
        return [
            _Part.of(self.sensor, prediction, self.saturated, *each)
            for each in zip(
                *(np.array_split(a, count) for a in (before, after, rests)), strict=True
            )
        ]

    @cached_property
    def compared(self) -> float:
        """Share of the samples of the patches that the longer frame does not saturate."""
        return float(np.mean(self.samples[1] < self.saturated))

    def limits(self, sigmas: float) -> Limits:
        """Return the brightness that holds the light within `sigmas` standard deviations.

        Where the longer frame is saturated there is no largest brightness.
        """
        white, tables, light = self.sensor.white, self.tables, self.sensor.light
        # Few photons are more often many more than their mean than a normal variable is (Cornish
        # and Fisher, 1938).
        beyond = sigmas + (sigmas**2 - 1) / 6 * tables.skewness
        low = np.searchsorted(light, tables.mean - sigmas * tables.sample)
        high = np.searchsorted(light, tables.mean + beyond * tables.sample, side="right") - 1
        if not self.is_measured:
            low[:], high[:] = 0, white
        high[:, self.saturated :] = white
        least, most = (np.clip(each, 0, white).astype(np.uint16) for each in (low, high))
        return Limits(least, np.maximum(most, least), self, sigmas)

    @property
    def contradicting(self) -> float:
        """Share of the samples of the patches that contradict: by noise alone 1 of 2,000."""
        parts = [np.array_split(each, self.colours) for each in self.samples]
        limits = self.limits(_USUAL_SIGMAS)
        found = [
            (before < limits.low[k][after]) | (before > limits.high[k][after])
            for k, (before, after) in enumerate(zip(*parts, strict=True))
        ]
        return float(np.mean(np.concatenate(found)))


@dataclass(frozen=True, eq=False)
class _Part:
    """Patches of one or all colours in range in both frames, one row for each.

    Attributes:
        brightness: mean brightness in the longer frame
        light: mean of the prediction
        error: mean of the light beyond it
        variance: of the light beyond it, within the patch
        own, shared: means of the predicted variances
        count: samples in range
    """

    brightness: _Floats
    light: _Floats
    error: _Floats
    variance: _Floats
    own: _Floats
    shared: _Floats
    count: _Floats

    @property
    def size(self) -> int:
        """Number of patches."""
        return self.count.size

    @classmethod
    def of(
        cls,
        sensor: SensorModel,
        prediction: Prediction,
        saturated: int,
        before: Patches,
        after: Patches,
        rests: NDArray[np.bool_],
    ) -> _Part:
        """Compare patches, and keep those that rest and are in range."""
        usable = (after < saturated) & (before < saturated)
        kept = rests & (np.count_nonzero(usable, axis=1) >= _LEAST_USABLE * usable.shape[1])
        before, after, usable = before[kept], after[kept], usable[kept]
        count = np.maximum(np.count_nonzero(usable, axis=1), 2).astype(np.float64)

        def mean(values: _Floats) -> _Floats:
            return np.asarray(np.where(usable, values, 0.0).sum(axis=1) / count)

        errors = sensor.light[before] - prediction.mean[after]
        error = mean(errors)
        variance = mean(np.square(errors - error[:, None])) * count / (count - 1)
        tables = (prediction.mean, prediction.own, prediction.shared)
        light, own, shared = (mean(table[after]) for table in tables)
        return cls(mean(after.astype(np.float64)), light, error, variance, own, shared, count)


def _trimmed_median(values: _Floats, spread: float) -> float:
    """Return the median of positive values, without those above by `_TRIM` times `spread` of it."""
    found = float(np.median(values))
    for _ in range(_ROUNDS):
        found = float(np.median(values[values <= found * (1 + _TRIM * spread)]))
    return found


def _trimmed_mean(values: _Floats) -> float:
    """Return the mean of positive values without those above `_TRIM` squared times the median.

    Blocks of JPEG files have such variances: many are smooth and some are not.
    """
    return float(np.mean(values[values <= _TRIM**2 * max(float(np.median(values)), 1e-12)]))


def _fitted_model(part: _Part, prediction: Prediction) -> Prediction:
    """Return the prediction of a noise model, with what the patches show beyond it."""
    if part.size < _LEAST_PATCHES:
        return prediction
    scatter = float(np.sqrt(2 / part.count.mean()))
    factor = _trimmed_median(part.variance / (part.own + part.shared), scatter)
    factor = min(max(factor, 1.0), _MOST_FACTOR)
    variance = factor * part.own / part.count + part.shared
    # Dark patches show light that is added to all, as smear and stray light are; bright ones show
    # the ratio.
    offset = _within(_weighted_median(part.error, 1 / variance), _MOST_OFFSET)
    lit = part.light > 0
    ratios = (part.error - offset)[lit] / part.light[lit]
    correction = _within(
        _weighted_median(ratios, np.square(part.light[lit]) / variance[lit]), _MOST_CORRECTION
    )
    errors = part.error - offset - correction * part.light
    variance = variance + offset**2 + np.square(_RESPONSE_ERROR * part.light)
    more = (float(np.median(np.abs(errors) / np.sqrt(variance))) / _NORMAL_MAD) ** 2
    more = min(max(more, 1.0), _MOST_FACTOR)
    own, shared = factor * prediction.own, prediction.shared + offset**2
    # What means scatter more is shared by neighbours, as the noise of a row is.
    shared = shared + (more - 1) * (own / MEAN_SAMPLES + shared)
    mean = prediction.mean * (1 + correction) + offset
    return replace(prediction, mean=mean, own=own, shared=shared)


def _within(value: float, most: float) -> float:
    """Return a value within -most and most."""
    return min(max(value, -most), most)


def _fitted_tables(part: _Part, prediction: Prediction) -> Prediction:
    """Return mean and variance by brightness, measured in patches; rounding is the least."""
    if part.size < _LEAST_PATCHES:
        return prediction
    order = np.argsort(part.brightness, kind="stable")
    bins = np.array_split(order, min(_MOST_BINS, part.size // _LEAST_PATCHES))
    places, rows = [], []
    for number, middle in enumerate(bins):
        # Those beside it, too: a band of a smooth sky has one error of its own in JPEG files.
        each = np.concatenate(bins[max(0, number - 1) : number + 2])
        least = part.own[each] + part.shared[each]
        own = _trimmed_mean(part.variance[each] / least)
        unit = np.maximum(part.light[each], np.sqrt(least))
        bias = _within(float(np.median(part.error[each] / unit)), _MOST_BIAS)
        errors = np.square(part.error[each] - bias * unit) / least
        shared = max(_trimmed_mean(errors) - own / part.count[each].mean(), 0.0)
        places.append(float(np.median(part.brightness[middle])))
        rows.append((bias, own, shared))
    at = np.arange(prediction.mean.size)
    bias, own, shared = (np.interp(at, places, column) for column in zip(*rows, strict=True))
    least = prediction.own + prediction.shared
    return replace(
        prediction,
        mean=prediction.mean + bias * np.maximum(prediction.mean, np.sqrt(least)),
        own=np.maximum(own * least, prediction.own),
        shared=np.maximum(shared * least, prediction.shared),
    )


def _weighted_median(values: _Floats, weights: _Floats) -> float:
    if not values.size:
        return 0.0
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the brightness of the shorter frame.

    Attributes:
        low, high: least and largest one by the brightness of the longer frame, (colours, white + 1)
        pair: of frames
        sigmas: standard deviations that they are away from the mean
    """

    low: NDArray[np.uint16]
    high: NDArray[np.uint16]
    pair: Pair
    sigmas: float

    def outside(
        self,
        short: Pixels,
        long: Pixels,
        ranges: Ranges | None = None,
        first: tuple[int, int] = (0, 0),
        every: tuple[int, int] = (1, 1),
    ) -> NDArray[np.bool_]:
        """Return which samples of a shorter exposure contradict the longer one.

        Args:
            short: brightness, (rows, columns) or (rows, columns, colours)
            long: likewise, of the same shape
            ranges: `local_ranges` of the longer frame, for limits at edges
            first: row and column of the frame where they begin
            every: distance of their rows and of their columns in it
        """
        found = outside_limits(self.low, self.high, short, long)
        if ranges is None:
            return found
        places = np.nonzero(found)
        if places[0].size:
            around = ranges_at(ranges, places, first, every)
            colour = places[2] if len(self.low) > 1 else np.zeros_like(places[0])
            found[places] = self._outside_edges(colour, short[places], long[places], around)
        return found

    def _outside_edges(
        self, colour: NDArray[np.intp], short: Pixels, long: Pixels, ranges: Ranges
    ) -> NDArray[np.bool_]:
        """Return which samples, (N,), contradict with these ranges of brightness around them."""
        sensor, tables = self.pair.sensor, self.pair.tables
        after = colour, np.minimum(long, sensor.white)
        mean = tables.mean[after]
        edges = edge_levels(ranges, sensor.white) * sensor.step(mean)
        error = np.abs(sensor.light[np.minimum(short, sensor.white)] - mean)
        return np.asarray(error > self.sigmas * np.hypot(tables.sample[after], edges))


def outside_limits(
    low: NDArray[np.uint16], high: NDArray[np.uint16], short: Pixels, long: Pixels
) -> NDArray[np.bool_]:
    """Return which samples are outside of limits, (colours, white + 1) each."""
    if short.dtype == long.dtype == np.uint8 and (cv2 := opencv()) is not None:
        # Five times as fast.  What is below the least brightness wraps to a large one; what is
        # above white counts as white.
        white = low.shape[1] - 1
        codes = np.minimum(np.arange(256), white)
        low, high = low[:, codes], np.where(high == white, 255, high)[:, codes]
        least, span = low.astype(np.uint8), (high - low).astype(np.uint8)
        # Tables that differ from channel to channel are slower than planes.
        planes = [[short], [long]] if len(low) == 1 else [cv2.split(short), cv2.split(long)]
        found = []
        for before, after, *tables in zip(*planes, least, span, strict=True):
            lowest, widest = (cv2.LUT(after, table) for table in tables)
            np.subtract(before, lowest, out=lowest)
            found.append(np.greater(lowest, widest, out=widest.view(np.bool_)))
        if len(found) == 1:
            return np.asarray(found[0])
        return np.asarray(cv2.merge([each.view(np.uint8) for each in found])).view(np.bool_)
    short, long = (np.minimum(each, low.shape[1] - 1) for each in (short, long))
    if len(low) == 1:
        return np.asarray((short < low[0][long]) | (short > high[0][long]))
    parts = (
        outside_limits(low[[k]], high[[k]], short[..., k], long[..., k]) for k in range(len(low))
    )
    return np.stack(list(parts), axis=-1)
