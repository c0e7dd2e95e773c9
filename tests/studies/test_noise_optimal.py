"""Exposures with the best worst-case SNR: the SNR itself, and the search against enumeration."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from camctl.errors import UsageError
from camctl.model.noise import NoiseModel
from camctl.studies.noise_optimal import NoiseOptimalProblem, noise_optimal, worst_snr

NOISE = NoiseModel(40.0, ((1.0, 3.0), (8.0, 2.0)))
LEVELS = 256


def snr(problem: NoiseOptimalProblem, times: list[float], gains: list[float], E: float) -> float:
    """Return the SNR at one irradiance, written out frame by frame."""
    squared = 0.0
    for time, gain in zip(times, gains, strict=True):
        if E * time * gain <= 1:
            electrons = E * time * problem.noise.conversion_e_per_dn * problem.full_scale_levels
            step = problem.noise.conversion_e_per_dn / gain
            variance = electrons + problem.noise.read_noise(gain) ** 2 + step**2 / 12
            squared += electrons**2 / variance
    return math.sqrt(squared)


@pytest.mark.parametrize(
    ("exposures", "gains"),
    [((1, 3, 40), (1, 1, 1)), ((1, 2, 2), (1, 2, 1)), ((1, 16, 900), (1, 4, 8)), ((1,), (2,))],
)
def test_the_worst_snr_is_the_smallest_in_the_range(
    exposures: tuple[float, ...], gains: tuple[float, ...]
) -> None:
    problem = NoiseOptimalProblem(NOISE, LEVELS, e_min=1e-3)
    found = worst_snr(problem, np.array([exposures], float), np.array([gains], float))[0]
    times = [e / g for e, g in zip(exposures, gains, strict=True)]
    grid = [*np.geomspace(1e-3, 1.0, 4001).tolist(), *(1 / e * (1 + 1e-9) for e in exposures[1:])]
    least = min(snr(problem, times, list(gains), E) for E in grid if 1e-3 <= E <= 1)
    assert found == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("budget", [2.5, 12.0, math.inf])
def test_the_search_finds_what_enumeration_finds(budget: float) -> None:
    problem = NoiseOptimalProblem(NOISE, LEVELS, 1e-3, gains=(1.0, 2.0, 4.0, 8.0), budget=budget)
    found = noise_optimal(problem, 2)
    assert sum(found.times) <= budget * (1 + 1e-9)
    best = 0.0
    for first, second in itertools.product(problem.gains, repeat=2):
        exposures = np.geomspace(1, 1000, 20_000)
        allowed = exposures[1 / first + exposures / second <= budget]
        sets = np.stack([np.ones(allowed.size), allowed], axis=1)
        gains = np.broadcast_to([first, second], sets.shape)
        best = max(best, float(worst_snr(problem, sets, gains).max()))
    assert found.worst_snr >= best * (1 - 1e-3)


def test_little_time_takes_gain_and_much_time_does_not() -> None:
    tight = NoiseOptimalProblem(NOISE, LEVELS, 1e-3, gains=(1.0, 2.0, 4.0, 8.0), budget=2.5)
    free = NoiseOptimalProblem(NOISE, LEVELS, 1e-3, gains=(1.0, 2.0, 4.0, 8.0))
    assert max(noise_optimal(tight, 3).gains) > 1
    assert noise_optimal(free, 3).gains == (1.0, 1.0, 1.0)


def test_a_budget_below_the_shortest_exposures_is_refused() -> None:
    problem = NoiseOptimalProblem(NOISE, LEVELS, 1e-3, budget=2.0)
    with pytest.raises(UsageError, match="3 exposures do not fit into 2 times the shortest"):
        noise_optimal(problem, 3)
