"""The searches against independent ones: random starts and moves with the exact objectives.

The measured curves are those of the Database of Response Functions in $CAMCTL_DATA/dorf.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from camctl.exposure.accuracy import COUNTS, accurate_sets
from camctl.exposure.candidates import BatchScore
from camctl.exposure.exposure_choices import (
    AccuracyProblem,
    AvailableExposures,
    SettingsGrid,
    TimeCosts,
)
from camctl.exposure.grid_search import solve_settings
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.objective import ExposureProblem
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import CameraResponse, FloatArray, linear_response
from camctl.model.response.camera import standard_response as standard
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.response.tabulated import tabulated_desired
from tests.bench.bench_search_audit import CURVES, REGRET, least_xi, measured


def table(points: int, span: float, *, flat: bool = False, seed: int = 1) -> DesiredResponse:
    """Return a tabulated response with random steps, some of them 0 if it is flat in parts."""
    rng = np.random.default_rng(seed)
    steps = rng.random(points) * (rng.random(points) > 0.4 if flat else 1.0)
    steps[-1] += 0.1
    return tabulated_desired(np.geomspace(1 / span, 1, points), np.cumsum(steps))


CASES: dict[str, tuple[CameraResponse, DesiredResponse, int]] = {
    "8 bit, log 1:256": (linear_response(8), desired_response("log", 256.0), 3),
    "6 bit, log 1:256": (linear_response(6), desired_response("log", 256.0), 4),
    "3 bit, log 1:100,000": (linear_response(3), desired_response("log", 1e5), 6),
    "5 bit, table": (linear_response(5), table(20, 3755.0), 2),
    "3 bit, table": (linear_response(3), table(9, 300.0, seed=4), 3),
    "8 bit sRGB, flat table": (standard("srgb", 8), table(15, 1000.0, flat=True), 3),
    "10 bit, gamma": (linear_response(10), desired_response("gamma", 1000.0), 2),
    "8 bit sRGB, linear": (standard("srgb", 8), desired_response("linear", 16.0), 3),
    "12 bit, log": (linear_response(12), desired_response("log", 4000.0), 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_no_random_search_finds_a_smaller_xi(name: str) -> None:
    response, desired, n = CASES[name]
    problem = ExposureProblem(response, desired, n)
    found = solve(response, desired, n)
    known = least_xi(problem, np.log(found.exposures), 1200)
    assert found.xi <= known * (1 + REGRET)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "bits", "span", "n", "known"),
    [
        (141, 7, 30195.0, 5, 82.15770867148869),  # 1, 7.624, 58.13, 443.2, 3378.8
        (141, 7, 100.0, 3, math.inf),
        (5, 8, 1000.0, 3, math.inf),
        (61, 5, 16000.0, 4, math.inf),
    ],
)
def test_no_random_search_finds_a_smaller_xi_for_measured_curves(
    place: int, bits: int, span: float, n: int, known: float
) -> None:
    if not CURVES.exists():
        pytest.skip("real data not present: set CAMCTL_DATA to its folder")
    camera, desired = measured(place, bits), desired_response("log", span)
    problem = ExposureProblem(camera, desired, n)
    found = solve(camera, desired, n, search=SearchOptions(seed=3))
    known = min(known, least_xi(problem, np.log(found.exposures), 1200))
    assert found.xi <= known * (1 + REGRET)


@pytest.mark.parametrize(
    "desired",
    [
        desired_response("log", 1e5),
        desired_response("linear", 16.0),
        desired_response("gamma", 1000.0),
        desired_response("gamma", 1000.0, gamma=0.3),
        desired_response("gamma", 300.0, gamma=2.2),
        table(12, 4000.0),
        table(12, 4000.0, flat=True),
        table(2, 50.0),
        table(10_000, 4000.0),
    ],
    ids=lambda desired: desired.description,
)
@pytest.mark.parametrize("response", [linear_response(4), standard("srgb", 8)])
def test_a_batch_has_the_exact_objective(
    response: CameraResponse, desired: DesiredResponse
) -> None:
    rng = np.random.default_rng(2)
    for n in (2, 5):
        problem = ExposureProblem(response, desired, n)
        logs = np.sort(rng.uniform(0, math.log(desired.dynamic_range), (12, n)), axis=1)
        logs[:, 0] = logs[:3, 1] = 0.0
        exposures = np.exp(logs)
        exact = [problem.score(row) for row in exposures.tolist()]
        batch = BatchScore(problem, exact=True)(exposures)
        assert batch == pytest.approx(exact, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_no_set_of_a_list_has_a_smaller_xi(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.unique(2.0 ** (np.round(rng.uniform(0, 9, 9) * 3) / 3))
    response = linear_response(int(rng.integers(3, 7)))
    desired = table(12, 500.0, seed=seed) if seed % 2 else desired_response("log", 500.0)
    found = solve_settings(response, desired, 3, SettingsGrid(times))
    problem = ExposureProblem(response, desired, 3)
    least = min(
        problem.score((np.array(chosen) / chosen[0]).tolist()) for chosen in combinations(times, 3)
    )
    assert found.enumerated
    assert found.xi == pytest.approx(least, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bits", "conversion", "name", "time"),
    [(8, 39.0, "log", 25.0), (8, 39.0, "gamma", 12.0), (10, 6.0, "log", 60.0), (8, 20.0, "log", 8)],
)
def test_no_random_set_of_equal_time_is_more_accurate(
    bits: int, conversion: float, name: str, time: float
) -> None:
    """Any number of exposures, and moves of what was found, by the exact prediction."""
    noise = NoiseModel(conversion, ((1.0, 5.0),))
    costs = TimeCosts(least=1.5, fixed=2.0)
    available = AvailableExposures(costs=costs)
    desired = desired_response(name, 1000.0)
    problem = AccuracyProblem(linear_response(bits), desired, noise, available)
    found = accurate_sets(problem, COUNTS).within(time)
    rng = np.random.default_rng(1)
    frame = noise.frame(gain=1.0, time_s=0.0)

    def fitted(logs: FloatArray) -> FloatArray:
        """Return exposures whose time is at most `time`, their logarithms scaled."""
        scales = np.linspace(1.0, 0.0, 200)
        rows = np.exp(np.maximum(logs, 0.0) * scales[:, np.newaxis])
        return np.asarray(rows[np.argmax(costs.each(rows).sum(axis=1) <= time)])

    def levels(exposures: FloatArray) -> float:
        camera = EffectiveCamera.of(problem.response, sorted(exposures.tolist()))
        return noisy_effective_levels(camera, desired, [frame] * exposures.size)

    best = np.log([shot.exposure for shot in found.shots])
    most = levels(np.exp(best))
    assert most == pytest.approx(found.levels, rel=1e-9)
    for trial in range(160):
        if trial % 2:
            scale = 10 ** rng.uniform(-2.5, -0.5)
            logs = best + scale * rng.standard_normal(best.size) * (rng.random(best.size) < 0.6)
        else:
            n = int(rng.integers(max(1, best.size - 2), min(16, best.size + 2) + 1))
            logs = np.append(0.0, rng.uniform(0, 5, n - 1))
        logs[0] = 0.0
        if costs.total([1.0] * logs.size) > time:
            continue
        exposures = fitted(logs)
        value = levels(exposures)
        assert value <= found.levels * 1.002
        if value > most:
            most, best = value, np.log(exposures)
