"""The noise of a capture, measured in its own pixels.

Where two frames are both within their range, the difference of the irradiances that they give for a
pixel is noise and quantisation alone: the scene cancels.  Its variance over patches of different
brightness gives electrons per level and read noise (the photon transfer method of EMVA 1288, with
pairs of frames of any exposures instead of equal ones).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.distribution import MAX_READ_NOISE, MIN_ELECTRONS
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.inverse import Posterior
from camctl.exposure.patches import Patches
from camctl.noise_model import FrameNoise, MeasuredNoise
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse

#: Patches with a mean below this level are not used: clipping at black lessens their noise, and
#: with little noise many of their samples are alike.
_LEAST_LEVEL = 4.0
#: Samples above this share of full scale are not used: clipping at white lessens their noise.
_HIGHEST = 0.9
#: Share of the samples of a patch that must be usable, and the fewest patches for a measurement.
_LEAST_USABLE, _LEAST_PATCHES = 0.75, 48
#: Patches of more contrast are not used: an error of the exposures would add to their difference.
_MOST_CONTRAST = 0.1
#: A patch whose variance is more than this many standard deviations from the fit has moved.
_MOST_DEVIATIONS = 4.0
_ROUNDS = 8
#: Ratio of the light of bright and dim patches from which both kinds of noise can be distinguished.
_LEAST_SPAN = 4.0
#: Parts of the patches that are fitted by themselves, for the uncertainty.
_PARTS = 4
#: Nodes of u for the effect of an uncertain noise.
_NODES = 64

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Patches:
    """Variances of the differences of frames, in levels squared; one row for each patch.

    Attributes:
        variance: measured, without what quantisation adds
        terms: (K, 2): what one inverse electron per level, and read noise of one level, add
        quantisation: what quantisation adds
        freedom: degrees of freedom of the variance
    """

    variance: _Floats
    terms: _Floats
    quantisation: _Floats
    freedom: _Floats

    def part(self, rows: NDArray[np.bool_] | slice) -> _Patches:
        """Return some of the patches."""
        fields = (self.variance, self.terms, self.quantisation, self.freedom)
        return _Patches(*(field[rows] for field in fields))

    def fit(self) -> tuple[float, float]:
        """Return inverse electrons per level and squared read noise, both >= 0."""
        used = np.ones(self.variance.size, bool)
        # The median of the single patches is a start that moving objects do not disturb.
        start = float(np.median(np.maximum(self.variance, 0.0) / self.terms.sum(axis=1)))
        found = np.array([start, start])
        for _ in range(_ROUNDS):
            expected = self.terms @ found + self.quantisation
            scatter = np.sqrt(2 / self.freedom) * expected
            used = np.abs(self.variance + self.quantisation - expected) <= (
                _MOST_DEVIATIONS * scatter + 0.5 * self.quantisation
            )
            if np.count_nonzero(used) < 2:
                break
            found = _least_squares(self.terms[used], self.variance[used], 1 / scatter[used] ** 2)
        return float(found[0]), float(found[1])


def _least_squares(terms: _Floats, values: _Floats, weights: _Floats) -> _Floats:
    """Return the two coefficients >= 0 of least weighted squares."""
    square = terms.T @ (weights[:, None] * terms)
    product = terms.T @ (weights * values)
    if np.linalg.cond(square) < 1e12:
        both = np.linalg.solve(square, product)
        if both.min() >= 0:
            return np.asarray(both)
    alone = np.maximum(product / np.diagonal(square), 0.0)
    errors = square.diagonal() * alone**2 - 2 * product * alone
    return np.where(np.arange(2) == np.argmin(errors), alone, 0.0)


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
    if len(exposures) < 2:
        return None
    black = noise[0].black
    full = response.M + 1.0
    order = np.argsort(exposures, kind="stable")
    low, high = response.gaps
    light, width = (low + high) / 2 * full, (high - low) * full
    if black:  # samples below the first level continue its distance
        step = width[min(1, response.M)]
        light = np.concatenate(
            [high[0] * full - (np.arange(black, -1, -1) + 0.5) * step, light[1:]]
        )
        width = np.concatenate([np.full(black + 1, step), width[1:]])
    found = [
        _pair(
            [samples[k] for k in pair],
            [exposures[k] for k in pair],
            [gains[k] for k in pair],
            (light, width**2 / 12),
        )
        for pair in zip(order[:-1].tolist(), order[1:].tolist(), strict=True)
    ]
    fields = ("variance", "terms", "quantisation", "freedom")
    patches = _Patches(
        *(np.concatenate([getattr(each, name) for each in found]) for name in fields)
    )
    if patches.variance.size < _LEAST_PATCHES:
        return None
    camera = EffectiveCamera.of(response, exposures)

    def frames(fit: tuple[float, float]) -> list[FrameNoise]:
        electrons = max(1 / fit[0], MIN_ELECTRONS) if fit[0] > 0 else math.inf
        return [
            FrameNoise(
                electrons / gain,
                min(_read_noise(fit[1], gain, frame), MAX_READ_NOISE),
                frame.dark_levels,
                frame.dsnu_levels,
                frame.prnu,
                frame.black,
            )
            for gain, frame in zip(gains, noise, strict=True)
        ]

    fit = patches.fit()
    light = patches.terms[:, 0] / patches.terms[:, 1]
    low_light, high_light = np.quantile(light, (0.05, 0.95))
    if min(fit) == 0 and high_light < _LEAST_SPAN * low_light:
        return None  # patches of one brightness do not tell photon noise from read noise
    levels = Posterior(camera, desired, frames(fit)).inverse.effective_levels
    estimates = [
        _estimated_levels(camera, desired, frames(patches.part(slice(k, None, _PARTS)).fit()))
        for k in range(_PARTS)
    ]
    relative = float(np.std(estimates, ddof=1) / np.mean(estimates)) / math.sqrt(_PARTS)
    return MeasuredNoise(
        effective_levels=levels,
        uncertainty=levels * relative,
        electrons_per_level=1 / fit[0] if fit[0] > 0 else None,
        read_noise_levels=math.sqrt(fit[1]),
        samples=int(patches.freedom.sum()),
    )


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
    tables: tuple[_Floats, _Floats],
) -> _Patches:
    """Return the patches of a shorter and a longer frame that are in range in both.

    Differences are in levels of the shorter frame; `tables` has light in levels and the variance of
    quantisation for each brightness.
    """
    light, quantisation = tables
    ratio = exposures[1] / exposures[0]
    short, long = light[samples[0]], light[samples[1]] / ratio
    usable = np.maximum(short, long * ratio) <= _HIGHEST * light[-1]
    count = np.count_nonzero(usable, axis=1)

    def mean(values: _Floats) -> _Floats:
        return np.asarray(np.where(usable, values, 0.0).sum(axis=1) / np.maximum(count, 1))

    middle = mean(long)
    difference = short - long
    spread = mean((difference - mean(difference)[:, None]) ** 2) * count / np.maximum(count - 1, 1)
    rounding = mean(quantisation[samples[0]] + quantisation[samples[1]] / ratio**2)
    # The covariance of the frames is the scene's contrast: their noise is independent.
    contrast = mean((long - middle[:, None]) * (short - mean(short)[:, None]))
    used = (count >= _LEAST_USABLE * usable.shape[1]) & (mean(short) >= _LEAST_LEVEL)
    used &= contrast <= (_MOST_CONTRAST * np.maximum(middle, 1.0)) ** 2
    photon = middle * (gains[0] + gains[1] / ratio)
    read = np.full(middle.size, gains[0] ** 2 + (gains[1] / ratio) ** 2)
    terms = np.stack([np.maximum(photon, 0.0), read], axis=1)
    patches = _Patches(spread - rounding, terms, rounding, np.maximum(count - 1.0, 1.0))
    return patches.part(used)


def _estimated_levels(
    camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
) -> float:
    """Return effective levels by the variance of the sum over its squared slope."""
    E = desired.inverse((np.arange(_NODES) + 0.5) / _NODES)
    deviation = camera.standard_deviation(
        E,
        electrons_per_level=[frame.electrons_per_level for frame in noise],
        read_noise_levels=[frame.read_noise_levels for frame in noise],
    )
    error = deviation * desired.slope(E)
    # Where a curved camera has no slope, the sum says nothing, whatever its noise.
    error = error[error < 1] if np.any(error < 1) else np.ones(1)
    return float((12 * np.mean(error**2)) ** -0.5)
