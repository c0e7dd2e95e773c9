"""The noise of a capture, measured in its own pixels.

Where two frames are both within their range, the difference of the irradiances that they give for a
pixel is noise and quantisation alone: the scene cancels.  Its variance over patches of different
brightness gives electrons per level and read noise (the photon transfer method of EMVA 1288, with
pairs of frames of any exposures instead of equal ones).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import LEAST_USABLE, TRIM
from camctl.evidence.patches import Patches
from camctl.model.distribution import MAX_READ_NOISE, MIN_ELECTRONS
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise, MeasuredNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.model.sensor import SensorModel

#: Patches with a mean below this level are not used: clipping at black lessens their noise, and
#: with little noise many of their samples are alike.
_LEAST_LEVEL = 4.0
#: Fewest patches for a measurement.
_LEAST_PATCHES = 48
#: Patches of more contrast are not used: an error of the exposures would add to their difference.
_MOST_CONTRAST = 0.1
_ROUNDS = 8
#: Effective levels more uncertain than by this share are not stated: patches of nearly one
#: brightness do not distinguish photon noise from read noise.
_MOST_UNCERTAIN = 0.25
#: Levels of files that may have been compressed with loss; others are kept as they are.
_COMPRESSED = 255
#: Share of the patches that may show something that moved, standard errors that are no chance, and
#: the least excess of variance, levels squared: a third of that of the quantisers.
_OUTLIERS, _CHANCE, _LEAST_EXCESS = 0.02, 5.0, 1 / 36
#: Harmonics of the error of quantisation: noise of a tenth of a step leaves 0.16 of the third.
_HARMONICS, _SMALLEST_STEP = 3, 1e-12

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Patches:
    """Variances of the differences of frames, in levels squared; one row for each patch.

    Attributes:
        variance: measured
        terms: (K, 2): what one inverse electron per level, and read noise of one level, add
        step: of the shorter frame's quantiser, squared
        rounding: what the quantiser of the longer frame adds
        phases: (K, harmonics): means of exp(2 pi i k m) over the samples, where m is the light in
            steps of the shorter frame, k = 1, 2, ...
        freedom: degrees of freedom of the variance
        is_even: whether a patch has so little contrast that its variance is noise
        is_plain: whether errors of its colours, which frames share, are small
    """

    variance: _Floats
    terms: _Floats
    step: _Floats
    rounding: _Floats
    phases: NDArray[np.complexfloating[Any, Any]]
    freedom: _Floats
    is_even: NDArray[np.bool_]
    is_plain: NDArray[np.bool_]

    @staticmethod
    def joined(parts: Sequence[_Patches]) -> _Patches:
        """Return the patches of all parts."""
        names = [each.name for each in fields(_Patches)]
        return _Patches(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in names)
        )

    def where(self, chosen: NDArray[np.bool_]) -> _Patches:
        """Return some of the patches."""
        return _Patches(*(getattr(self, field.name)[chosen] for field in fields(_Patches)))

    def compression(self, noise: _Floats) -> float:
        """Return the standard deviation of the errors that compression adds, levels.

        It is the root mean square of what noise and quantisers do not explain, in steps of the
        quantisers, of all patches but the `_OUTLIERS` with most of it, which may show something
        that moved; 0 where that is by chance.
        """
        expected = self.terms @ noise
        expected = expected + self.quantisation(expected)
        steps = np.maximum(self.step + 12 * self.rounding, _SMALLEST_STEP)
        excess = (self.variance - expected) / steps
        most = float(np.quantile(excess, 1 - _OUTLIERS))
        excess = np.minimum(excess, most)
        mean, error = float(excess.mean()), float(excess.std()) / math.sqrt(excess.size)
        return math.sqrt(mean) if mean > max(_CHANCE * error, _LEAST_EXCESS) else 0.0

    def quantisation(self, noise: _Floats) -> _Floats:
        """Return what the quantisers add to the variance of a noise, as in the terms.

        A light of m steps and Gaussian noise of s are rounded to a whole number.  Its mean square
        error and its mean error are Fourier series of m (Widrow and Kollar, Quantization Noise,
        2008); without their harmonics they are s^2 + 1/12 and 0.  Noise of half a step leaves
        0.7 % of the first harmonic, noise of a third of a step a tenth.
        """
        k = np.arange(1, _HARMONICS + 1)
        total = (noise + self.rounding)[:, None]
        # Where noise is one step, they are below 1e-8.
        square = np.minimum(total / np.maximum(self.step, _SMALLEST_STEP)[:, None], 1.0)
        weights = (-1.0) ** k * np.exp(-2 * (math.pi * k) ** 2 * square)
        waves = weights * self.phases.real * (1 / (math.pi * k) ** 2 + 4 * square)
        mean_error = (weights / (math.pi * k) * self.phases.imag).sum(axis=1)
        found = self.rounding + self.step * (1 / 12 + waves.sum(axis=1) - mean_error**2)
        return np.asarray(found)

    def fit(self) -> _Fit:
        """Return what fits best, both noises >= 0.

        Raises:
            np.linalg.LinAlgError: the patches do not distinguish the two noises
        """
        # The median of the single patches is a start that moving objects do not disturb.  It is
        # too large by what quantisation adds: from too small a one, few patches would fit.
        start = float(np.median(self.variance / self.terms.sum(axis=1)))
        found, covariance = np.array([start, start]), np.zeros((2, 2))
        for _ in range(_ROUNDS):
            noise = self.terms @ found
            quantisation = self.quantisation(noise)
            expected = noise + quantisation
            scatter = np.sqrt(2 / self.freedom) * expected
            used = np.abs(self.variance - expected) <= (TRIM * scatter + 0.5 * quantisation)
            if np.count_nonzero(used) <= 2:
                break
            terms = self.terms[used] / scatter[used, None]
            values = (self.variance - quantisation)[used] / scatter[used]
            found, covariance = _least_squares(terms, values)
        return _Fit(found, covariance)


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


class NoiseFit(NamedTuple):
    """Noise that patches show, as (inverse electrons per level, squared read noise) at gain 1.

    Attributes:
        noise: what fits best, (2,)
        neighbours: noises whose squared effects add up to the variance of the effect of `noise`
        freedom: number of independent differences of samples that were used
        compression_levels: standard deviation of what compression adds to brightness where there
            is contrast, levels of the response; even parts have next to none
    """

    noise: _Floats
    neighbours: list[_Floats]
    freedom: int
    compression_levels: float


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
    camera = EffectiveCamera.of(response, exposures)

    def levels(found: _Floats) -> float:
        inverse, square = found.tolist()
        frames = [
            replace(
                frame,
                electrons_per_level=electrons_per_level(inverse) / gain,
                read_noise_levels=min(_read_noise(square, gain, frame), MAX_READ_NOISE),
            )
            for gain, frame in zip(gains, noise, strict=True)
        ]
        return Posterior(camera, desired, frames).inverse.effective_levels

    middle = levels(fit.noise)
    uncertainty = math.dist([middle] * len(fit.neighbours), [*map(levels, fit.neighbours)])
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


def fit_noise(
    response: CameraResponse,
    samples: Sequence[Patches],
    exposures: Sequence[float],
    gains: Sequence[float],
    black: int,
    plain: NDArray[np.bool_] | None = None,
) -> NoiseFit | None:
    """Return the noise that patches show; None where too few are in range in two frames.

    Args:
        response: the camera's response as levels
        samples: brightness of the same patches of each frame, (patches, samples), black included
        exposures: relative exposures of the frames
        gains: linear gain of each frame
        black: black level, DN
        plain: patches that show what compression adds, (patches,); None: all
    """
    if len(exposures) < 2:
        return None
    order = np.argsort(exposures, kind="stable")
    sensor = SensorModel(response, black)
    found = [
        _pair(
            [samples[k] for k in pair],
            [exposures[k] for k in pair],
            [gains[k] for k in pair],
            sensor,
            response.M + 1.0,
            np.ones(len(samples[0]), np.bool_) if plain is None else plain,
        )
        for pair in zip(order[:-1].tolist(), order[1:].tolist(), strict=True)
    ]
    everywhere = _Patches.joined(found)
    patches = everywhere.where(everywhere.is_even)
    if patches.variance.size < _LEAST_PATCHES:
        return None
    try:
        fit = patches.fit()
        neighbours = fit.neighbours()
    except np.linalg.LinAlgError:
        return None
    shown = everywhere.where(everywhere.is_plain)
    is_shown = response.M <= _COMPRESSED and shown.variance.size >= _LEAST_PATCHES
    compression = shown.compression(fit.noise) if is_shown else 0.0
    return NoiseFit(fit.noise, neighbours, int(patches.freedom.sum()), compression)


def electrons_per_level(inverse: float) -> float:
    """Return the electrons of a level from their measured inverse, infinite for 0."""
    return max(1 / inverse, MIN_ELECTRONS) if inverse > 0 else math.inf


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
    full: float,
    plain: NDArray[np.bool_],
) -> _Patches:
    """Return the patches of a shorter and a longer frame that are in range in both.

    Differences are in levels of the shorter frame, of which full scale has `full`.
    """
    light, squared_step = sensor.light * full, np.square(sensor.gap * full)
    ratio = exposures[1] / exposures[0]
    predicted = light / ratio
    before, after = (each.astype(np.intp) for each in samples)  # once, for all tables
    short, long = light.take(before), predicted.take(after)
    usable = np.maximum(before, after) <= sensor.highest(None)
    count, counted = np.count_nonzero(usable, axis=1), usable.astype(np.float64)

    def mean(values: _Floats) -> _Floats:
        return np.asarray(np.einsum("ps,ps->p", values, counted) / np.maximum(count, 1))

    middle = mean(long)
    difference = short - long
    spread = mean((difference - mean(difference)[:, None]) ** 2) * count / np.maximum(count - 1, 1)
    # The covariance of the frames is the scene's contrast: their noise is independent.
    contrast = mean((long - middle[:, None]) * (short - mean(short)[:, None]))
    used = (count >= LEAST_USABLE * usable.shape[1]) & (mean(short) >= _LEAST_LEVEL)
    is_even = contrast <= (_MOST_CONTRAST * np.maximum(middle, 1.0)) ** 2
    photon = middle * (gains[0] + gains[1] / ratio)
    read = np.full(middle.size, gains[0] ** 2 + (gains[1] / ratio) ** 2)
    terms = np.stack([np.maximum(photon, 0.0), read], axis=1)
    steps = np.interp(predicted, light, np.arange(light.size))
    codes, weights = after[used], usable[used] / count[used, np.newaxis]
    phases = np.empty((codes.shape[0], _HARMONICS), np.complex128)
    for k in range(_HARMONICS):
        turns = np.exp(2j * math.pi * (k + 1) * steps)  # of each value, not of each sample
        phases[:, k].real = np.einsum("ps,ps->p", turns.real.take(codes), weights)
        phases[:, k].imag = np.einsum("ps,ps->p", turns.imag.take(codes), weights)
    return _Patches(
        spread[used],
        terms[used],
        mean(squared_step.take(before))[used],
        mean(squared_step.take(after))[used] / 12 / ratio**2,
        phases,
        np.maximum(count[used] - 1.0, 1.0),
        is_even[used],
        plain[used],
    )
