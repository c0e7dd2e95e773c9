"""The effect of noise: effective levels with noise included, and a noise term of the objective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError, unknown_name
from camctl.exposure.effective import EffectiveCamera
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse

SAMPLES = 4096
"""Steps of u over which the mean square error is averaged."""

MAX_READ_NOISE = 64.0
"""Largest read noise in brightness levels; memory grows with it."""

NORMAL_REACH = 6.0
"""Standard deviations beyond which a normal probability counts as 0 (it is about 1e-9)."""

CHUNK = 256
"""Samples of u computed at once, which bounds the memory used."""

_NORMAL_GRID = np.linspace(-NORMAL_REACH, NORMAL_REACH, 12_001)
_NORMAL_CDF = np.array([0.5 * math.erfc(-x / math.sqrt(2)) for x in _NORMAL_GRID.tolist()])


NOISE_KINDS: tuple[str, ...] = ("paper", "time", "aperture", "gain")


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
        UsageError: an unknown kind, or a number that is negative or not finite
    """

    sigma: float
    weight: float = 1.0
    kind: str = "paper"

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise unknown_name("noise term", self.kind, NOISE_KINDS)
        for name in ("sigma", "weight"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"invalid noise {name} {value:g}: expected a number >= 0")

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


def normal_cdf(x: FloatArray) -> FloatArray:
    """Return the normal distribution function, to 1e-7; 0 and 1 beyond `NORMAL_REACH`."""
    return np.asarray(np.interp(x, _NORMAL_GRID, _NORMAL_CDF, left=0.0, right=1.0))


def quantiser_input(response: CameraResponse, E: FloatArray) -> FloatArray:
    """Return the analog signal at E in brightness levels: k at level k, linear in between."""
    levels, counts = np.unique(response.levels, return_counts=True)
    height = np.cumsum(counts).astype(np.float64)
    if levels.size == 1:
        return np.asarray(height[0] * E / levels[0])
    first = (height[1] - height[0]) / (levels[1] - levels[0])
    last = (height[-1] - height[-2]) / (levels[-1] - levels[-2])
    inside = np.interp(E, levels, height)
    below = np.maximum(height[0] + first * (E - levels[0]), 0.0)
    above = height[-1] + last * (E - levels[-1])
    return np.where(levels[0] > E, below, np.where(levels[-1] < E, above, inside))


def _check(read_noise_levels: float, electrons_per_level: float) -> None:
    if not (math.isfinite(read_noise_levels) and 0 <= read_noise_levels <= MAX_READ_NOISE):
        raise UsageError(
            f"invalid read noise of {read_noise_levels:g} levels: expected 0 to {MAX_READ_NOISE:g}"
        )
    if not electrons_per_level > 0:
        raise UsageError(
            f"invalid number of electrons per level {electrons_per_level:g}: expected a positive "
            "number"
        )


def _frame_noise(
    response: CameraResponse, E: FloatArray, read_noise: float, electrons: float
) -> FloatArray:
    """Return the standard deviation of one frame in levels; E is at this frame's exposure."""
    photon = response.slope(E) ** 2 * E / (electrons * (response.M + 1))
    return np.sqrt(photon + read_noise**2)


def noisy_effective_levels(
    camera: EffectiveCamera,
    desired: DesiredResponse,
    *,
    read_noise_levels: float,
    electrons_per_level: float | Sequence[float] = math.inf,
) -> float:
    """Return L = (12 mse)^(-1/2): the effective levels with the frames' noise included.

    The mean square error in u is the mean over `SAMPLES` equal steps of u.  At each step it follows
    from the exact distribution of the sum: normal probabilities of each frame's brightness,
    convolved over the frames, with the midpoint (in u) of the gap as the value of a sum.  Frames
    are clipped at black and white.  Without noise the result is `effective_levels` except for the
    sampling of u.

    Args:
        camera: the effective camera
        desired: the response in which errors are measured
        read_noise_levels: standard deviation of a frame's noise, in brightness levels, 0 to 64
        electrons_per_level: as in `EffectiveCamera.standard_deviation`; infinite: no photon noise

    Raises:
        UsageError: the noise or the number of electrons is out of range
    """
    n = len(camera.exposures)
    electrons = np.broadcast_to(np.asarray(electrons_per_level, dtype=np.float64), (n,))
    _check(read_noise_levels, float(electrons.min()))
    edges = np.concatenate([[desired.e_min], camera.levels, [1.0]])
    heights = desired.u(edges)
    midpoints = (heights[:-1] + heights[1:]) / 2
    u = (np.arange(SAMPLES) + 0.5) / SAMPLES
    E = desired.inverse(u)
    square = 0.0
    for first in range(0, SAMPLES, CHUNK):
        part = slice(first, first + CHUNK)
        start, probability = _distribution(camera, E[part], read_noise_levels, electrons)
        sums = start[:, np.newaxis] + np.arange(probability.shape[1])
        estimate = midpoints[np.minimum(sums, camera.levels_total)]
        square += float(np.sum(probability * (estimate - u[part, np.newaxis]) ** 2))
    return float((12 * square / SAMPLES) ** -0.5)


def _distribution(
    camera: EffectiveCamera, E: FloatArray, read_noise: float, electrons: FloatArray
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the smallest possible sum at each E (Q,), and the probabilities from it on (Q, W)."""
    M = camera.response.M
    start = np.zeros(E.size, dtype=np.intp)
    probability = np.ones((E.size, 1))
    for e, frame_electrons in zip(camera.exposures, electrons.tolist(), strict=True):
        mean = quantiser_input(camera.response, e * E)
        noise = _frame_noise(camera.response, e * E, read_noise, frame_electrons)
        sigma = np.maximum(noise, 1e-9)
        low = np.clip(np.floor(mean - NORMAL_REACH * sigma), 0, M).astype(np.intp)
        high = np.clip(np.floor(mean + NORMAL_REACH * sigma), 0, M).astype(np.intp)
        size = int((high - low).max()) + 1
        level = low[:, np.newaxis] + np.arange(size + 1)
        above = normal_cdf((mean[:, np.newaxis] - level) / sigma[:, np.newaxis])
        above = np.where(level <= low[:, np.newaxis], 1.0, np.where(level > M, 0.0, above))
        above[:, -1] = 0.0
        single = above[:, :-1] - above[:, 1:]
        total = np.zeros((E.size, probability.shape[1] + size - 1))
        for step in range(size):
            total[:, step : step + probability.shape[1]] += single[:, step : step + 1] * probability
        start, probability = start + low, total
    return start, probability
