"""The noise of a capture, measured in its own pixels.

Where two frames are both within their range, the difference of the irradiances that they give for a
pixel is noise and quantisation alone: the scene cancels.  Its variance over patches of different
brightness gives electrons per level and read noise (the photon transfer method of EMVA 1288, with
pairs of frames of any exposures instead of equal ones).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import LEAST_USABLE, MOST_BIAS, TRIM
from camctl.evidence.patch_noise import (
    LEAST_STEP,
    NoisePatches,
    VarianceModel,
    electrons_per_level,
)
from camctl.evidence.patches import Patches, marked_samples
from camctl.model.block_rounding import BlockRounding
from camctl.model.distribution import most_read_noise
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise, MeasuredNoise
from camctl.model.quantiles import median
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.model.sensor import SensorModel
from camctl.system.picture_operations import looked_up

#: Patches with a mean below this level in the longer frame are not used: what is clipped at black
#: does not show its light.
_LEAST_LEVEL = 4.0
#: Fewest patches for a measurement.
_LEAST_PATCHES = 48
#: Standard errors that the last round changes the noise by at most.
_MET = 0.02
#: Patches of more contrast, beyond their noise, are not used: an error of the exposures would add
#: to their difference.
_MOST_CONTRAST = 0.1
#: Rounds of a fit, and of one that begins with what another colour shows, which is near.
_ROUNDS, _ROUNDS_OF_MULTIPLE = 8, 2
#: Patches of all colours of a file that are enough: so many of 64 samples show noise to 0.2 %.
_ENOUGH = 8192
#: Effective levels more uncertain than by this share are not stated: patches of nearly one
#: brightness do not distinguish photon noise from read noise.
_MOST_UNCERTAIN = 0.25
#: Levels of files that may have been compressed with loss; others are kept as they are.
_COMPRESSED = 255
#: Share of the patches that may show something that moved, standard errors that are no chance, and
#: the least excess of variance, levels squared: a third of that of the quantisers.
_OUTLIERS, _CHANCE, _LEAST_EXCESS = 0.02, 5.0, 1 / 36
#: Change of the noise, as a share of what a patch shows or of rounding, for the slope of variances.
_SMALL_CHANGE = 0.02

_Floats = NDArray[np.float64]


class _Fit(NamedTuple):
    """Inverse electrons per level and squared read noise, and the covariance of both."""

    noise: _Floats
    covariance: _Floats

    def neighbours(self) -> list[_Floats]:
        """Return noises whose squared effects add up to the variance of the effect of `noise`."""
        found = []
        for axis in np.linalg.cholesky(self.covariance).T:
            # Of both directions the one that leads farther before a noise is below 0.
            steps = [sign * axis for sign in (1, -1)]
            shares = [
                min(1.0, *(-self.noise[step < 0] / step[step < 0]).tolist(), 1.0) for step in steps
            ]
            best = int(shares[1] > shares[0])
            found.append(np.maximum(self.noise + shares[best] * steps[best], 0.0))
        return found

    def multiples(self, like: NoiseFit) -> list[_Floats]:
        """Return the same where `noise` is a multiple of another one, which has its own errors."""
        size = float(like.noise @ like.noise)
        times = float(self.noise @ like.noise) / size
        error = math.sqrt(self.covariance.trace() / size)
        return [(times + error) * like.noise, *(times * each for each in like.neighbours)]


class NoiseFit(NamedTuple):
    """Noise that patches show, as (inverse electrons per level, squared read noise) at gain 1.

    Attributes:
        noise: what fits best, (2,)
        neighbours: noises whose squared effects add up to the variance of the effect of `noise`
        freedom: number of independent differences of samples that were used
        compression_levels: standard deviation of what compression adds to brightness where there
            is contrast, levels of the response; even parts have next to none
        contrast: of what a file makes of noise, see `BlockRounding`
    """

    noise: _Floats
    neighbours: list[_Floats]
    freedom: int
    compression_levels: float
    contrast: float


@dataclass(frozen=True)
class _Question:
    """Patches whose noise is asked for; two of the same content are equal.

    Attributes:
        content: digest of all that the noise follows from
        patches: of the frames
        model: of their variance
        like: what another colour shows, whose noise this one's is a multiple of; None: it is not
    """

    content: bytes
    patches: NoisePatches = field(compare=False)
    model: VarianceModel = field(compare=False)
    like: NoiseFit | None = field(compare=False)

    @classmethod
    def of(
        cls,
        patches: NoisePatches,
        model: VarianceModel,
        response: CameraResponse,
        black: int,
        gains: Sequence[float],
        like: NoiseFit | None,
    ) -> _Question:
        names = [each.name for each in fields(patches) if each.name not in ("is_even", "is_plain")]
        known = like and like.noise.tolist()
        digest = blake2b(repr((black, model.file, known, *gains)).encode())
        for each in (response.levels, *(getattr(patches, name) for name in names)):
            digest.update(np.ascontiguousarray(each).data)
        return cls(digest.digest(), patches, model, like)


@lru_cache(maxsize=8)
def _fit(question: _Question) -> _Fit:
    """Return the noises >= 0 that fit best; those of the last questions are kept.

    A plan and the picture that is made after it ask the same.

    Raises:
        np.linalg.LinAlgError: the patches do not distinguish the two noises
    """
    patches, model = question.patches, question.model
    # The median of the single patches is a start that moving objects do not disturb.  It is too
    # large by what quantisation adds: from too small a one, few patches would fit.
    each = patches.terms.sum(axis=0)
    start = median(patches.variance / each)
    change = _SMALL_CHANGE * max(start, median(patches.quantisers.sum(axis=0) / each))
    found, covariance, axes = np.array([start, start]), np.zeros((2, 2)), np.eye(2)
    rounds = _ROUNDS
    if question.like is not None:
        found, rounds = question.like.noise, _ROUNDS_OF_MULTIPLE
        axes = (found / found.sum())[np.newaxis]
    for _ in range(rounds):
        table = model.tables(found)
        lit = patches.fitted(model, table)
        expected, scatter = lit.scatter(model, table)
        others = [lit.moments(model, model.tables(found + change * axis)).variance for axis in axes]
        slopes = (np.stack(others) - expected) / change
        beyond = patches.variance - expected
        used = (np.abs(beyond) <= TRIM * scatter) & (scatter > 0)
        # Neighbours have the errors of their light in common: these may not be more than chance.
        certain = used & (np.square(scatter) <= 4 / patches.freedom * expected**2)
        if np.count_nonzero(certain) >= _LEAST_PATCHES:
            used = certain
        if np.count_nonzero(used) <= 2:
            break
        terms = (slopes[:, used] / scatter[used]).T
        before = found
        if len(axes) == 2:
            values = (beyond + found @ slopes)[used] / scatter[used]
            found, covariance = _least_squares(terms, values)
        else:
            values = (beyond + found.sum() * slopes[0])[used] / scatter[used]
            found, covariance = _multiple(terms[:, 0], values, axes[0])
        if (np.square(found - before) <= _MET**2 * covariance.diagonal()).all():
            break
    return _Fit(found, covariance)


def _compression(patches: NoisePatches, model: VarianceModel, noise: _Floats) -> float:
    """Return the standard deviation of the errors that compression adds, levels.

    It is the root mean square of what noise and quantisers do not explain, in steps of the
    quantisers, of all patches but the `_OUTLIERS` with most of it, which may show something that
    moved; 0 where that is by chance.
    """
    table = model.tables(noise)
    expected = patches.fitted(model, table).moments(model, table).variance
    steps = np.maximum(12 * patches.quantisers.sum(axis=0), LEAST_STEP)
    excess = (patches.variance - expected) / steps
    most = float(np.quantile(excess, 1 - _OUTLIERS))
    excess = np.minimum(excess, most)
    mean, error = float(excess.mean()), float(excess.std()) / math.sqrt(excess.size)
    return math.sqrt(mean) if mean > max(_CHANCE * error, _LEAST_EXCESS) else 0.0


def _contrast(patches: NoisePatches, model: VarianceModel, noise: _Floats) -> float:
    """Return the share of the frequencies that contrast makes any part of a step.

    It is that of the variance which these would have more than smooth patches, of all patches but
    the `_OUTLIERS` with most of it.
    """
    lit = patches.fitted(model, table := model.tables(noise))
    moments = lit.moments(model, table)
    smooth, rough = moments.variance, lit.with_contrast(model, moments.by_noise)
    # Patches with contrast decide it, whose variance scatters by its own size.
    excess, more = (patches.variance - smooth) / rough, 1 - smooth / rough
    excess = np.minimum(excess, np.quantile(excess, 1 - _OUTLIERS))
    return float(np.clip((excess @ more) / (more @ more), 0, 1))


def _least_squares(terms: _Floats, values: _Floats) -> tuple[_Floats, _Floats]:
    """Return two coefficients >= 0 of least squares, and their covariance for any sign."""
    square, product = terms.T @ terms, terms.T @ values
    both = np.linalg.solve(square, product)
    residual = values - terms @ both
    # Errors larger than by noise alone, as by contrast, make the coefficients as uncertain.
    scale = max(1.0, float(residual @ residual) / (values.size - 2))
    covariance = scale * np.linalg.inv(square)
    if both.min() >= 0:
        return np.asarray(both), np.asarray(covariance)
    alone = np.maximum(product / np.diagonal(square), 0.0)
    errors = square.diagonal() * alone**2 - 2 * product * alone
    alone[np.argmax(errors)] = 0.0
    return np.asarray(alone), np.asarray(covariance)


def _multiple(terms: _Floats, values: _Floats, axis: _Floats) -> tuple[_Floats, _Floats]:
    """Return the multiple >= 0 of a noise by least squares, and its covariance."""
    square = float(terms @ terms)
    times = max(float(terms @ values) / square, 0.0)
    residual = values - times * terms
    scale = max(1.0, float(residual @ residual) / (values.size - 1)) / square
    return times * axis, scale * np.outer(axis, axis)


def measure_noise(
    response: CameraResponse,
    desired: DesiredResponse,
    samples: Sequence[Patches],
    exposures: Sequence[float],
    noise: Sequence[FrameNoise],
    gains: Sequence[float],
) -> MeasuredNoise | None:
    """Return the noise that the pixels show; None where too few are in range in two frames.

    Args:
        response: the camera's response as levels
        desired: the desired response of the capture
        samples: brightness of the same patches of each frame, (patches, samples), black included
        exposures: relative exposures of the frames
        noise: noise of each frame as far as it is known: black level, dark current, PRNU and DSNU,
            which frames have in common, are taken from it
        gains: linear gain of each frame
    """
    fit = fit_noise(response, samples, exposures, gains, noise[0].black)
    if fit is None:
        return None
    camera, most = EffectiveCamera.of(response, exposures), most_read_noise(response)

    def levels(found: _Floats) -> float:
        inverse, square = found.tolist()
        frames = [
            replace(
                frame,
                electrons_per_level=electrons_per_level(inverse * gain),
                read_noise_levels=min(_read_noise(square, gain, frame), most),
            )
            for gain, frame in zip(gains, noise, strict=True)
        ]
        return Posterior(camera, desired, frames).inverse.effective_levels

    middle = levels(fit.noise)
    errors = [levels(each) - middle for each in fit.neighbours]
    undithered = _undithered(fit.noise)
    if undithered > 0.1 * max(abs(each[1] - fit.noise[1]) for each in fit.neighbours):
        # Levels that interleave follow read noise steeply: of both directions the larger change.
        change = np.array([0.0, undithered])
        less, more = np.maximum(fit.noise - change, 0.0), fit.noise + change
        errors.append(max(levels(less) - middle, middle - levels(more)))
    uncertainty = math.hypot(*errors)
    if uncertainty > _MOST_UNCERTAIN * middle:
        return None
    inverse, square = fit.noise.tolist()
    return MeasuredNoise(
        effective_levels=middle,
        uncertainty=uncertainty,
        electrons_per_level=1 / inverse if inverse > 0 else None,
        read_noise_levels=math.sqrt(square),
        samples=fit.freedom,
    )


def _undithered(noise: _Floats) -> float:
    """Return the standard error of squared read noise from quantisers that no noise dithers.

    The fit takes the errors of two quantisers as independent.  With noise of standard deviation s
    levels, and phases c steps apart, their covariance is the sum over k of cos(2 pi k c)
    exp(-4 pi^2 k^2 s^2) / (2 pi^2 k^2): each error is a Fourier series of the light, of which noise
    leaves its characteristic function (Widrow and Kollar, Quantization Noise, 2008).  Of c nothing
    is known; s is that of the darkest patches that are used.
    """
    variance = float(noise @ [_LEAST_LEVEL, 1.0])
    return math.exp(-4 * math.pi**2 * variance) / (2 * math.pi**2 * math.sqrt(2))


def fit_noise(
    response: CameraResponse,
    samples: Sequence[Patches],
    exposures: Sequence[float],
    gains: Sequence[float],
    black: int,
    plain: NDArray[np.bool_] | None = None,
    file: BlockRounding | None = None,
    like: NoiseFit | None = None,
) -> NoiseFit | None:
    """Return the noise that patches show; None where too few are in range in two frames.

    Args:
        response: the camera's response as levels
        samples: brightness of the same patches of each frame, (patches, samples), black included
        exposures: relative exposures of the frames
        gains: linear gain of each frame
        black: black level, DN
        plain: patches that show what compression adds, (patches,); None: that is not asked for
        file: what the files of the frames make of noise in patches that are their blocks
        like: what green shows, of which red and blue of such files have the most: their own noise
            is then found as a multiple of it
    """
    if len(exposures) < 2:
        return None
    order = np.argsort(exposures, kind="stable")
    sensor, model = SensorModel(response, black), VarianceModel(response, black, gains, file)
    shown = np.zeros(len(samples[0]), np.bool_) if plain is None else plain
    found = [
        _pair(
            [samples[k] for k in pair],
            [exposures[k] for k in pair],
            [gains[k] for k in pair],
            sensor,
            model,
            shown,
        )
        for pair in zip(order[:-1].tolist(), order[1:].tolist(), strict=True)
    ]
    everywhere = NoisePatches.joined(found)
    most = _ENOUGH // (file.colours if file else 1)
    patches = _some(everywhere, everywhere.is_even, model, most)
    if patches.variance.size < _LEAST_PATCHES:
        return None
    try:
        fit = _fit(_Question.of(patches, model, response, black, gains, like))
        neighbours = fit.neighbours() if like is None else fit.multiples(like)
    except np.linalg.LinAlgError:
        return None
    compression = contrast = 0.0
    if response.M <= _COMPRESSED:
        every = _some(everywhere, everywhere.is_plain, model, most)
        if every.variance.size >= _LEAST_PATCHES:
            if file is None:
                compression = _compression(every, model, fit.noise)
            else:
                contrast = _contrast(every, model, fit.noise)
    return NoiseFit(fit.noise, neighbours, int(patches.freedom.sum()), compression, contrast)


def _some(
    patches: NoisePatches, chosen: NDArray[np.bool_], model: VarianceModel, most: int
) -> NoisePatches:
    """Return the chosen patches, or some of them, with the range of their light."""
    places = np.flatnonzero(chosen)
    return patches.where(places[:: max(1, places.size // most)]).with_ends(model)


def _read_noise(square: float, gain: float, known: FrameNoise) -> float:
    """Return the read noise of a frame from its square at gain 1, levels.

    Where none was found it is too small beside the photon noise of the patches, and the known one
    stands.  The shot noise of the dark current grows with the time of a frame, and is known.
    """
    if not square:
        return known.read_noise_levels
    return math.hypot(
        math.sqrt(square) * gain, math.sqrt(known.dark_levels / known.electrons_per_level)
    )


def _pair(
    samples: Sequence[Patches],
    exposures: Sequence[float],
    gains: Sequence[float],
    sensor: SensorModel,
    model: VarianceModel,
    plain: NDArray[np.bool_],
) -> NoisePatches:
    """Return the patches of a shorter and a longer frame that are in range in both.

    Differences are in levels of the shorter frame, of which full scale has M + 1.
    """
    full = 1 / sensor.level
    light, squared_step = sensor.light * full, np.square(sensor.gap * full)
    ratio = exposures[1] / exposures[0]
    predicted = light / ratio
    usable = np.maximum(*samples) <= sensor.highest(None)
    # A file spreads over a block what saturation does to some of it.
    least = (LEAST_USABLE if model.file is None else 1.0) * usable.shape[1]
    chosen = np.flatnonzero(marked_samples(usable) >= least)
    usable = usable[chosen]
    count, counted = marked_samples(usable), usable.astype(np.float64)

    def mean(values: _Floats) -> _Floats:
        return np.asarray(np.einsum("ps,ps->p", values, counted) / np.maximum(count, 1))

    long = looked_up(predicted, samples[1][chosen])
    middle = mean(long)
    lit = ratio * middle >= _LEAST_LEVEL
    chosen, count, counted = chosen[lit], count[lit], counted[lit]
    long, middle = long[lit], middle[lit]
    before, after = (each[chosen] for each in samples)
    short = looked_up(light, before)
    difference = short - long
    bias = mean(difference)
    spread = mean((difference - bias[:, None]) ** 2) * count / np.maximum(count - 1, 1)
    # The covariance of the frames is the scene's contrast: their noise is independent.
    contrast = mean((long - middle[:, None]) * (short - mean(short)[:, None]))
    is_even = contrast <= (_MOST_CONTRAST * middle) ** 2 + spread
    photon = middle * (gains[0] + gains[1] / ratio)
    read = np.full(middle.size, gains[0] ** 2 + (gains[1] / ratio) ** 2)
    terms = np.stack([np.maximum(photon, 0.0), read])
    rounding = [mean(looked_up(squared_step, each)) / 12 for each in (before, after)]
    # What moved, or has another exposure, is not of one light.
    error = TRIM * np.sqrt(spread / np.maximum(count, 1)) + np.sqrt(12 * rounding[0])
    used = np.abs(bias) <= error + MOST_BIAS * middle
    own = mean((long - middle[:, None]) ** 2)
    # Where the quantiser of the shorter frame is not dithered, its phase is hardly known.
    error = np.sqrt(own / np.maximum(count, 1) + rounding[0])
    every = NoisePatches(
        variance=spread,
        terms=terms,
        quantisers=np.stack([rounding[0], rounding[1] / ratio**2]),
        light=np.stack([middle, error]),
        contrast=np.stack([np.maximum(contrast, 0.0), np.zeros_like(contrast)]),
        spread=own * count / np.maximum(count - 1, 1),
        first=np.array([model.first(gain) for gain in gains])[:, None] + np.zeros_like(count),
        ends=np.zeros((4, middle.size)),
        ratio=np.full(middle.size, ratio),
        freedom=np.maximum(count - 1.0, 1.0),
        is_even=is_even,
        is_plain=plain[chosen],
    )
    return every.where(used)
