"""The effect of noise: effective levels with noise included, and a noise term of the objective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camctl.errors import UsageError, unknown_name
from camctl.findings import Finding
from camctl.model.distribution import MOST_LEVELS, check_noise
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.inverse import posterior_of
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.camera import FloatArray, every_nth_level
from camctl.model.response.desired import DesiredResponse

NOISE_KINDS: tuple[str, ...] = ("paper", "time", "aperture", "gain")

MAX_SIGMA, MAX_WEIGHT = 1e3, 1e15
"""Largest sigma and weight of a noise term: far beyond use, and their product stays finite."""

DITHERS = 0.5
"""Noise in steps from which a coarser quantiser is as accurate within 0.05 % (12 to 16 bits)."""

_NOISELESS = FrameNoise(math.inf, 0.0)


@dataclass(frozen=True)
class NoiseTerm:
    """The noise term of Grossberg and Nayar's equation 4: `weight` times V is added to xi.

    Attributes:
        sigma: standard deviation of one frame at exposure 1, in irradiance (1 is full scale)
        weight: c, in the unit of xi per squared irradiance
        kind: formula of V, for exposures e_1 = 1 <= e_2 ...:
            "paper": sigma^2 sum 1/e_j, as printed for a linear camera;
            "time", "aperture": n sigma^2 / (sum e_j)^2, the variance of the irradiance if the
            signal grows with e and the noise does not (read noise);
            "gain": sigma^2 sum e_j^2 / (sum e_j)^2, if gain amplifies signal and noise

    Raises:
        UsageError: an unknown kind, or a number that is negative or too large
    """

    sigma: float
    weight: float = 1.0
    kind: str = "paper"

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise unknown_name("noise term", self.kind, NOISE_KINDS)
        for name, most in (("sigma", MAX_SIGMA), ("weight", MAX_WEIGHT)):
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise UsageError(f"invalid noise {name} {value:g}: expected 0 to {most:g}")

    def cost(self, exposures: FloatArray) -> FloatArray:
        """Return c V, (B,) from (B, n) exposures."""
        n = exposures.shape[1]
        if self.kind == "paper":
            variance = (1 / exposures).sum(axis=1)
        elif self.kind == "gain":
            variance = (exposures**2).sum(axis=1) / exposures.sum(axis=1) ** 2
        else:
            variance = n / exposures.sum(axis=1) ** 2
        return np.asarray(self.weight * self.sigma**2 * variance)


def noise_findings(noise: NoiseModel | None, camera_id: str | None = None) -> tuple[Finding, ...]:
    """Return a finding where the noise is not known, so that accuracy is of quantisation alone."""
    if noise is not None:
        return ()
    return (Finding(code="quantisation_only", remedies={"calibrate_noise": camera_id}),)


def coarser(
    camera: EffectiveCamera, noise: Sequence[FrameNoise], dithers: float = DITHERS
) -> tuple[EffectiveCamera, tuple[FrameNoise, ...]]:
    """Return a camera of fewer levels, and noise, with nearly the same distribution of errors.

    A quantiser of step k has k^2 / 12 of variance, (k^2 - 1) / 12 more than one of step 1: as much
    is taken from the read noise.  The rest must be `dithers` of a step, so that the quantiser
    stays dithered.  A camera of few levels, or with less noise, is returned as it is.
    """
    step, full = 1, camera.response.M + 1
    least = min(frame.read_noise_levels for frame in noise)
    while full / step > MOST_LEVELS and _without_step(least, 2 * step) >= 2 * step * dithers:
        step *= 2
    if step == 1:
        return camera, tuple(noise)
    response = every_nth_level(camera.response, step)
    finer = full / (response.M + 1)
    frames = (
        replace(
            frame,
            read_noise_levels=_without_step(frame.read_noise_levels, step),
            black=round(frame.black / finer),
        ).in_levels(finer)
        for frame in noise
    )
    return EffectiveCamera.of(response, camera.exposures), tuple(frames)


def _without_step(read_noise_levels: float, step: int) -> float:
    return math.sqrt(max(0.0, read_noise_levels**2 - (step**2 - 1) / 12))


def predicted_mse(
    camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
) -> float:
    """Return the mean square error in u of the sum of noisy frames, quantisation included.

    It is the mean over the range of u, from the exact distribution of the sum and with the
    posterior mean as the value of a sum (see `camctl.model.inverse`).

    Args:
        camera: the effective camera
        desired: the response in which errors are measured
        noise: noise of each frame, in the order of `camera.exposures`

    Raises:
        UsageError: there is not one noise for each exposure, or one is out of range
    """
    check_noise(noise, len(camera.exposures), camera.response)
    camera, frames = coarser(camera, noise)
    return posterior_of(camera, desired, frames).mse


def noisy_effective_levels(
    camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
) -> float:
    """Return L = (12 mse)^(-1/2): the effective levels with the frames' noise included.

    Without noise it is `effective_levels`.  Arguments and errors as in `predicted_mse`.
    """
    check_noise(noise, len(camera.exposures), camera.response)
    if all(replace(frame, black=0) == _NOISELESS for frame in noise):
        return effective_levels(camera, desired)
    return float((12 * predicted_mse(camera, desired, noise)) ** -0.5)
