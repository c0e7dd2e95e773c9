"""What noise does to a camera: levels that it drowns, and effective levels with it counted in."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.exposure.effective import EffectiveCamera
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse

SAMPLES = 4096
WIDEST_NOISE = 64.0
_REACH = 6.0
_CHUNK = 256

_GRID = np.linspace(-_REACH, _REACH, 12_001)
_CDF = np.array([0.5 * math.erfc(-x / math.sqrt(2)) for x in _GRID.tolist()])


def normal_cdf(x: FloatArray) -> FloatArray:
    """Return the normal distribution function, to 1e-7; 0 and 1 beyond 6 sigma."""
    return np.asarray(np.interp(x, _GRID, _CDF, left=0.0, right=1.0))


def signal(response: CameraResponse, E: FloatArray) -> FloatArray:
    """Return what the quantiser sees, in brightness levels: k at level k, straight in between."""
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
    if not (math.isfinite(read_noise_levels) and 0 <= read_noise_levels <= WIDEST_NOISE):
        raise UsageError(
            f"noise of {read_noise_levels:g} levels", hint=f"give 0 to {WIDEST_NOISE:g}"
        )
    if not electrons_per_level > 0:
        raise UsageError(f"{electrons_per_level:g} electrons a level", hint="give a number above 0")


def _frame_noise(
    response: CameraResponse, E: FloatArray, read_noise: float, electrons: float
) -> FloatArray:
    """Return the standard deviation of one frame at E (its own exposure), in levels."""
    photon = response.slope(E) ** 2 * E / (electrons * (response.M + 1))
    return np.sqrt(photon + read_noise**2)


def quiet_levels(
    camera: EffectiveCamera,
    desired: DesiredResponse,
    levels_wanted: float,
    *,
    read_noise_levels: float,
    electrons_per_level: float = math.inf,
    share: float = 1.0,
) -> FloatArray:
    """Return the levels (K,) ascending that noise leaves usable.

    A level of one frame is dropped where that frame's noise, carried to irradiance, exceeds `share`
    times the wanted spacing 1 / g' there (the paper's section 3.1: levels most affected by noise
    leave the effective response).  Levels outside [e_min, 1] stay.
    """
    _check(read_noise_levels, electrons_per_level)
    if not share > 0:
        raise UsageError(f"share {share:g} of the wanted spacing", hint="give a number above 0")
    kept: list[FloatArray] = []
    for e in camera.exposures:
        own = camera.response.levels
        sigma = _frame_noise(camera.response, own, read_noise_levels, electrons_per_level)
        noise = sigma / (e * camera.response.slope(own))
        levels = own / e
        inside = (levels >= desired.e_min) & (levels <= 1)
        wanted = levels_wanted * desired.slope(np.clip(levels, desired.e_min, 1.0))
        kept.append(levels[~inside | (noise * wanted <= share)])
    return np.sort(np.concatenate(kept))


def noisy_effective_levels(
    camera: EffectiveCamera,
    desired: DesiredResponse,
    *,
    read_noise_levels: float,
    electrons_per_level: float | Sequence[float] = math.inf,
) -> float:
    """Return L = (12 mse)^(-1/2): effective levels with the frames' noise counted in.

    The mean square error in u is taken over `SAMPLES` even steps of u, at each from the exact
    distribution of the sum: normal probabilities of each frame's steps, convolved over the frames,
    read off the middle (in u) of the gap that the sum names.  Frames are clipped at black and
    white.  Without noise it is `effective_levels` up to the sampling of u.

    Args:
        camera: the effective camera
        desired: the response in which errors count
        read_noise_levels: standard deviation of a frame's noise, in brightness levels, 0..64
        electrons_per_level: as in `EffectiveCamera.standard_deviation`; infinite: no photon noise
    """
    n = len(camera.exposures)
    electrons = np.broadcast_to(np.asarray(electrons_per_level, dtype=np.float64), (n,))
    _check(read_noise_levels, float(electrons.min()))
    edges = np.concatenate([[desired.e_min], camera.levels, [1.0]])
    heights = desired.u(edges)
    middles = (heights[:-1] + heights[1:]) / 2
    u = (np.arange(SAMPLES) + 0.5) / SAMPLES
    E = desired.inverse(u)
    square = 0.0
    for first in range(0, SAMPLES, _CHUNK):
        part = slice(first, first + _CHUNK)
        start, chances = _distribution(camera, E[part], read_noise_levels, electrons)
        sums = start[:, np.newaxis] + np.arange(chances.shape[1])
        read = middles[np.minimum(sums, camera.levels_total)]
        square += float(np.sum(chances * (read - u[part, np.newaxis]) ** 2))
    return float((12 * square / SAMPLES) ** -0.5)


def _distribution(
    camera: EffectiveCamera, E: FloatArray, read_noise: float, electrons: FloatArray
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the first sum that can occur at each E (Q,), and the chances from there on (Q, W)."""
    M = camera.response.M
    start = np.zeros(E.size, dtype=np.intp)
    chances = np.ones((E.size, 1))
    for e, own in zip(camera.exposures, electrons.tolist(), strict=True):
        seen = signal(camera.response, e * E)
        sigma = np.maximum(_frame_noise(camera.response, e * E, read_noise, own), 1e-9)
        low = np.clip(np.floor(seen - _REACH * sigma), 0, M).astype(np.intp)
        high = np.clip(np.floor(seen + _REACH * sigma), 0, M).astype(np.intp)
        size = int((high - low).max()) + 1
        level = low[:, np.newaxis] + np.arange(size + 1)
        above = normal_cdf((seen[:, np.newaxis] - level) / sigma[:, np.newaxis])
        above = np.where(level <= low[:, np.newaxis], 1.0, np.where(level > M, 0.0, above))
        above[:, -1] = 0.0
        single = above[:, :-1] - above[:, 1:]
        total = np.zeros((E.size, chances.shape[1] + size - 1))
        for step in range(size):
            total[:, step : step + chances.shape[1]] += single[:, step : step + 1] * chances
        start, chances = start + low, total
    return start, chances
