"""Exposures with the best worst-case signal-to-noise ratio: a method without a quantiser.

Hasinoff, Durand and Freeman, "Noise-Optimal Capture for High Dynamic Range Photography" (CVPR
2010), choose times and gains of n frames so that the signal-to-noise ratio of the merged irradiance
is as large as possible where it is worst in the range, within a time budget.  Here:

- range: E from e_min to 1; the brightest light just saturates the shortest exposure, e = 1;
- frame j of exposure e_j = time x gain counts x = E e_j K (M + 1) / g_j electrons, with the
  variance v = x + r(g_j)^2 + D t_j + (K / g_j)^2 / 12: photons, read noise, dark current, and the
  quantiser's step as a uniform error; where E e_j > 1 it is saturated and does not count;
- the merge weights frames by inverse variance, so that squared ratios add: SNR^2(E) = sum x^2 / v;
- maximise the minimum of SNR^2(E) over the range, subject to sum of times <= budget; without a
  budget the best set is finite too, since longer exposures saturate on more of the range.

Between two saturation points SNR grows with E: the minimum lies just above one, or at e_min.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import FloatArray

_CANDIDATES, _KEPT, _ROUNDS = 4096, 64, 60
"""Random sets at the beginning, the best that are kept, and rounds in which each is changed."""


@dataclass(frozen=True)
class NoiseOptimalProblem:
    """The camera, the range and the time.

    Attributes:
        noise: of the camera
        full_scale_levels: M + 1, levels of full scale
        e_min: smallest irradiance of the range; the largest is 1
        gains: gains to choose from, ascending
        longest: longest time of a frame, in units of the shortest exposure at gain 1
        budget: longest sum of times, same unit
        unit_s: seconds in that unit
    """

    noise: NoiseModel
    full_scale_levels: int
    e_min: float
    gains: tuple[float, ...] = (1.0,)
    longest: float = math.inf
    budget: float = math.inf
    unit_s: float = 0.0


@dataclass(frozen=True)
class NoiseOptimalSet:
    """A set of exposures: (n,) times and gains, by ascending exposure, and its worst SNR."""

    times: tuple[float, ...]
    gains: tuple[float, ...]
    worst_snr: float


def worst_snr(problem: NoiseOptimalProblem, exposures: FloatArray, gains: FloatArray) -> FloatArray:
    """Return the smallest SNR in the range, (B,), of sets (B, n) of ascending exposures from 1."""
    ends = np.concatenate([exposures[:, 1:], np.full((len(exposures), 1), 1 / problem.e_min)], 1)
    # Points just above the saturation of the next exposure; those below the range are e_min.
    E = np.maximum(1 / np.maximum(ends, 1.0), problem.e_min)
    squared = _squared_snr(
        problem, E[:, :, np.newaxis], exposures[:, np.newaxis], gains[:, np.newaxis]
    )
    counts = exposures[:, np.newaxis] <= exposures[:, :, np.newaxis]  # frames not saturated there
    found: FloatArray = np.sqrt((squared * counts).sum(axis=2).min(axis=1))
    return found


def _squared_snr(
    problem: NoiseOptimalProblem, E: FloatArray, exposures: FloatArray, gains: FloatArray
) -> FloatArray:
    noise = problem.noise
    per_level = noise.conversion_e_per_dn / gains
    electrons = E * exposures * per_level * problem.full_scale_levels
    known, read_e = zip(*noise.read_noise_e, strict=True)
    read = np.interp(np.log(gains), np.log(known), read_e)
    dark = noise.dark_current_e_s * problem.unit_s * exposures / gains
    photons = electrons if noise.photon_noise else 0.0
    return np.asarray(electrons**2 / (photons + read**2 + dark + per_level**2 / 12))


def noise_optimal(problem: NoiseOptimalProblem, n: int) -> NoiseOptimalSet:
    """Return the set of n exposures with the best worst-case SNR that was found.

    A random search: the best of many random sets are changed at smaller and smaller scales.

    Raises:
        UsageError: n exposures do not fit into the budget
    """
    gains = np.asarray(problem.gains, dtype=np.float64)
    if n / gains[-1] > problem.budget:
        raise UsageError(
            f"{n} exposures do not fit into {problem.budget:.4g} times the shortest exposure",
            hint="allow more time, or take fewer exposures",
        )
    random = np.random.Generator(np.random.PCG64(0))
    reach = min(math.log(1 / problem.e_min), math.log(problem.longest * gains[-1]))
    logs = random.uniform(0, reach, (_CANDIDATES, n)) * random.uniform(0, 1, (_CANDIDATES, 1))
    best = _Ranked(problem, gains)
    best.add(logs, random.integers(0, gains.size, (_CANDIDATES, n)))
    for step in range(_ROUNDS):
        scale = reach * 0.3 * 0.9**step
        copies = np.repeat(np.arange(len(best.logs)), 8)
        moved = random.random((copies.size, n)) < 0.5
        changed = best.logs[copies] + moved * random.normal(0, scale, (copies.size, n))
        swapped = random.random((copies.size, n)) < 0.15
        indices = best.indices[copies]
        others = random.integers(0, gains.size, indices.shape)
        best.add(np.clip(changed, 0, reach), np.where(swapped, others, indices))
    exposures, found = np.exp(best.logs[0]), gains[best.indices[0]]
    return NoiseOptimalSet(
        tuple((exposures / found).tolist()), tuple(found.tolist()), float(best.scores[0])
    )


class _Ranked:
    """The best sets so far, best first: ln(exposure) ascending from 0, and indices of gains."""

    def __init__(self, problem: NoiseOptimalProblem, gains: FloatArray) -> None:
        self._problem, self._gains = problem, gains
        self.logs = np.empty((0, 0))
        self.indices: NDArray[np.int64] = np.empty((0, 0), np.int64)
        self.scores = np.empty(0)

    def add(self, logs: FloatArray, indices: NDArray[np.int64]) -> None:
        """Add sets, and keep the best of all."""
        order = np.argsort(logs, axis=1)
        logs, indices = np.take_along_axis(logs, order, 1), np.take_along_axis(indices, order, 1)
        logs[:, 0] = 0.0
        gains = self._gains[indices]
        scores = worst_snr(self._problem, np.exp(logs), gains)
        times = np.exp(logs) / gains
        too_long = times.sum(axis=1) / self._problem.budget - 1
        # Sets over the budget rank below all others, the shortest of them first.
        invalid = (too_long > 0) | (times > self._problem.longest * (1 + 1e-9)).any(axis=1)
        scores = np.where(invalid, -1.0 - np.maximum(too_long, 0.0), scores)
        if self.scores.size:
            logs = np.concatenate([self.logs, logs])
            indices = np.concatenate([self.indices, indices])
            scores = np.concatenate([self.scores, scores])
        best = np.argsort(-scores, kind="stable")[:_KEPT]
        self.logs, self.indices, self.scores = logs[best], indices[best], scores[best]
