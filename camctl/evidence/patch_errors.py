"""Patches of two frames compared with the prediction of the sensor model, and the fits to them.

A fit measures at rest what the model lacks: with a known noise one factor for the variance of
samples and one for the variance of means; without one, variance and mean error as functions of
brightness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches, marked_samples
from camctl.model.quantiles import NORMAL_MAD, median, median_of_ascending
from camctl.model.sensor import RESPONSE_ERROR, Prediction, SensorModel
from camctl.system.picture_operations import looked_up

MEAN_RADIUS = 2
"""Half the side, without the middle, of the squares whose mean is tested: 5 x 5 samples."""

MEAN_SAMPLES = (2 * MEAN_RADIUS + 1) ** 2

LEAST_PATCHES = 32
"""Patches of one measured value, at least: its standard error is then 20 % of their scatter."""

MOST_OFFSET = 0.001
"""Largest light that is added to all samples, as a share of full scale: smear of a CCD without a
shutter, of which data sheets state -60 dB at most."""

LEAST_USABLE = 0.75
"""Share of the samples of a patch that must be in range in both frames."""

TRIM = 4.0
"""Standard deviations from which a patch is left out: noise leaves out a third of one of the 4,800
patches of a frame."""

MOST_BIAS = 0.25
"""Error of a response that mean errors of photographs may show, as a share of the light: beyond it
all samples of a brightness have moved."""

MOST_BINS = 24
"""Bins of brightness in which unknown noise is measured, at most: as many values as a fit of photon
noise, read noise and the processing of photographs has bends."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PatchErrors:
    """Patches of one or all colours in range in both frames, one row for each.

    Attributes:
        kept: which of all patches these are
        brightness: mean brightness in the longer frame
        light: mean of the prediction
        error: mean of the light beyond it
        variance: of the light beyond it, within the patch
        own, shared: means of the predicted variances
        count: samples in range
    """

    kept: NDArray[np.bool_]
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
        saturated: Sequence[int],
        before: Patches,
        after: Patches,
        rests: NDArray[np.bool_] | None = None,
        least: float = LEAST_USABLE,
    ) -> PatchErrors:
        """Compare patches, and keep those that rest and are in range.

        Args:
            sensor: light of each brightness
            prediction: of the shorter frame by the longer one
            saturated: brightness from which samples of both may be saturated ones
            before: patches of the shorter frame
            after: of the longer one
            rests: patches that count, (patches,); None: all
            least: share of the samples of a patch that must be in range in both
        """
        usable = (before < saturated[0]) & (after < saturated[1])
        number = marked_samples(usable)
        kept = number >= max(least * usable.shape[1], 1)
        if rests is not None:
            kept &= rests
        before, after, usable = before[kept], after[kept], usable[kept]
        count = np.maximum(number[kept], 2).astype(np.float64)

        weights = usable / count[:, np.newaxis]

        def mean(values: _Floats) -> _Floats:
            return np.asarray(np.einsum("ps,ps->p", values, weights))

        predicted = looked_up(prediction.mean, after)
        errors = looked_up(sensor.light, before) - predicted
        error = mean(errors)
        errors -= error[:, None]
        variance = mean(np.square(errors, out=errors)) * count / (count - 1)
        own, shared = (mean(looked_up(each, after)) for each in (prediction.own, prediction.shared))
        light = mean(predicted)
        return cls(kept, mean(after.astype(np.float64)), light, error, variance, own, shared, count)


def _trimmed_median(values: _Floats, spread: float) -> float:
    """Return the median of positive values, without those above by `TRIM` times `spread` of it."""
    ascending, size = np.sort(values), 0
    while size != ascending.size:
        size = ascending.size
        most = median_of_ascending(ascending) * (1 + TRIM * spread)
        ascending = ascending[: np.searchsorted(ascending, most, side="right")]
    return median_of_ascending(ascending)


def _medians(ascending: _Floats, counts: NDArray[np.intp]) -> _Floats:
    """Return the medians of rows of ascending numbers, of each of which so many count."""
    rows = np.arange(len(ascending))
    return np.asarray((ascending[rows, (counts - 1) // 2] + ascending[rows, counts // 2]) / 2)


def _trimmed_means(values: _Floats, counts: NDArray[np.intp]) -> _Floats:
    """Return means of rows of positive values without those above `TRIM` squared times the median.

    Blocks of JPEG files have such variances: many are smooth and some are not.

    Args:
        values: infinite in the places that do not count; they are sorted in place
        counts: of the places that do, in each row
    """
    values.sort(axis=1)
    most = TRIM**2 * np.maximum(_medians(values, counts), 1e-12)
    kept = values <= most[:, np.newaxis]
    return np.asarray(np.where(kept, values, 0.0).sum(axis=1) / np.count_nonzero(kept, axis=1))


def fitted_model(part: PatchErrors, prediction: Prediction) -> Prediction:
    """Return the prediction of a noise model, with what the patches show beyond it."""
    if part.size < LEAST_PATCHES:
        return prediction
    scatter = float(np.sqrt(2 / part.count.mean()))
    factor = _trimmed_median(part.variance / (part.own + part.shared), scatter)
    factor = max(factor, 1.0)
    variance = factor * part.own / part.count + part.shared
    # Dark patches show light that is added to all: the error of black, smear and stray light.
    # Bright ones show the ratio.
    offset = _within(weighted_median(part.error, 1 / variance), MOST_OFFSET)
    lit = part.light > 0
    ratios = (part.error - offset)[lit] / part.light[lit]
    correction = _within(
        weighted_median(ratios, np.square(part.light[lit]) / variance[lit]), TRIM * RESPONSE_ERROR
    )
    errors = part.error - offset - correction * part.light
    # Beyond the error of black, which is uniform up to sqrt(3) times its deviation, it may be
    # smear, of which parts of the picture have more.
    smear = max(0.0, abs(offset) - math.sqrt(3) * prediction.black_error)
    variance = variance + smear**2 + np.square(RESPONSE_ERROR * part.light)
    # What means scatter more is shared by neighbours, as the noise of a row and an error of the
    # response at a brightness are.
    order, bins = _by_brightness(part)
    scattered = np.array_split((np.abs(errors) / np.sqrt(variance))[order], len(bins))
    places = [median_of_ascending(each) for each in bins]
    squares = [max(1.0, (median(each) / NORMAL_MAD) ** 2) for each in scattered]
    more = np.interp(np.arange(prediction.mean.size), places, squares)
    own, shared = factor * prediction.own, prediction.shared + smear**2
    shared = shared + (more - 1) * (own / MEAN_SAMPLES + shared)
    mean = prediction.mean * (1 + correction) + offset
    # The variance of the median of normal variables is pi / 2 times that of their mean.
    error = math.sqrt(math.pi / 2 / float(np.sum(1 / variance)))
    error = min(error, prediction.black_error)
    return replace(prediction, mean=mean, own=own, shared=shared, black_error=error)


def _by_brightness(part: PatchErrors) -> tuple[NDArray[np.intp], list[_Floats]]:
    """Return the order of patches by brightness, and the brightness in bins of it, ascending."""
    order = np.argsort(part.brightness, kind="stable")
    count = min(MOST_BINS, part.size // LEAST_PATCHES)
    return order, np.array_split(part.brightness[order], count)


def _within(value: float, most: float) -> float:
    """Return a value within -most and most."""
    return min(max(value, -most), most)


def fitted_tables(part: PatchErrors, prediction: Prediction) -> Prediction:
    """Return mean and variance by brightness, measured in patches; rounding is the least."""
    if part.size < LEAST_PATCHES:
        return prediction
    order, bins = _by_brightness(part)
    least = (part.own + part.shared)[order]
    unit = np.maximum(part.light[order], np.sqrt(least))
    # Those beside a bin, too: a band of a smooth sky has one error of its own in JPEG files.
    ends, numbers = np.cumsum([0, *map(len, bins)]), np.arange(len(bins))
    first = ends[np.maximum(numbers - 1, 0)]
    counts = ends[np.minimum(numbers + 2, len(bins))] - first
    columns = np.arange(counts.max())
    others = columns >= counts[:, np.newaxis]
    near = np.minimum(first[:, np.newaxis] + columns, part.size - 1)

    def rows(values: _Floats, other: float = np.inf) -> _Floats:
        return np.where(others, other, values.take(near))

    own = _trimmed_means(rows(part.variance[order] / least), counts)
    biases = rows(part.error[order] / unit)
    bias = np.clip(_medians(np.sort(biases, axis=1), counts), -MOST_BIAS, MOST_BIAS)
    errors = np.square(biases - bias[:, np.newaxis]) * (np.square(unit) / least).take(near)
    samples = rows(part.count[order], 0.0).sum(axis=1) / counts
    shared = np.maximum(_trimmed_means(errors, counts) - own / samples, 0.0)
    places = [median_of_ascending(each) for each in bins]
    at = np.arange(prediction.mean.size)
    bias, own, shared = (np.interp(at, places, each) for each in (bias, own, shared))
    least = prediction.own + prediction.shared
    unit = np.maximum(prediction.mean, np.sqrt(least))
    own, shared = own * least, shared * least
    # What is brighter than the patches is one of few lamps.  Noise grows with the light at most, as
    # photon noise does; the mean error is at least what an offset makes and at most what a wrong
    # response makes, and uniform between them.
    last = [float(np.interp(places[-1], at, table)) for table in (prediction.mean, own, unit)]
    times = np.maximum(prediction.mean / max(last[0], 1e-12), 1.0)
    far = np.maximum(unit - last[2], 0.0) * (at > places[-1])
    own = np.where(at > places[-1], np.maximum(own, last[1] * times), own)
    return replace(
        prediction,
        mean=prediction.mean + bias * (unit - far / 2),
        own=np.maximum(own, prediction.own),
        shared=np.maximum(shared, prediction.shared) + np.square(bias * far) / 12,
        black_error=0.0,  # the mean errors hold it
    )


def weighted_median(values: _Floats, weights: _Floats) -> float:
    """Return the median of values, (N,), with weights >= 0; 0 of none."""
    return weighted_quantile(values, weights, 0.5)


def weighted_quantile(values: _Floats, weights: _Floats, share: float) -> float:
    """Return the value below which values, (N,), have this share of all weights; 0 of none."""
    if not values.size:
        return 0.0
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][int(np.searchsorted(total, total[-1] * share))])
