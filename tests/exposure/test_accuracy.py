from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations, combinations_with_replacement, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import some

from camctl.errors import DataError, UsageError
from camctl.exposure.accuracy import NEAR_TIE, AccuracySolution, accurate_sets, solve_accuracy
from camctl.exposure.accurate import judge
from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.exposure_choices import (
    AccuracyProblem,
    AvailableExposures,
    Shot,
    TimeCosts,
    bases,
)
from camctl.exposure.noise import noisy_effective_levels
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.camera import CameraResponse, linear_response, standard_response
from camctl.model.response.desired import DesiredResponse, desired_response

EIGHT_BIT = linear_response(8)
REAL = NoiseModel(39.0, ((1.0, 3.0),))
NOISELESS = NoiseModel(39.0, photon_noise=False)


def problem_of(
    name: str = "log",
    span: float = 1000.0,
    *,
    response: CameraResponse = EIGHT_BIT,
    noise: NoiseModel = REAL,
    available: AvailableExposures | None = None,
) -> AccuracyProblem:
    desired = desired_response(name, span)
    return AccuracyProblem(response, desired, noise, available or AvailableExposures())


def exact_levels(problem: AccuracyProblem, exposures: list[float], gains: list[float]) -> float:
    camera = EffectiveCamera.of(problem.response, exposures)
    noise = [problem.noise.frame(gain=gain, time_s=0.0) for gain in gains]
    return noisy_effective_levels(camera, problem.desired, noise)


def random_list_problem(rng: np.random.Generator) -> tuple[AccuracyProblem, int]:
    """Return a camera of random bits, curve and noise, and a short list of its settings."""
    bits = int(rng.choice([4, 6, 8, 10]))
    response = linear_response(bits)
    if rng.random() < 0.4:
        response = standard_response(str(rng.choice(["srgb", "rec709"])), bits)
    conversion = 10 ** rng.uniform(3, 5) / (response.M + 1)
    noise = NoiseModel(conversion, ((1.0, rng.uniform(0, 0.5) * conversion),))
    times = np.unique(2.0 ** (np.round(rng.uniform(-9, 0, int(rng.integers(3, 7))) * 3) / 3))
    gains = (1.0,) if rng.random() < 0.5 else (1.0, 2.0, 4.0)
    available = AvailableExposures(times, gains)
    name = str(rng.choice(["linear", "gamma", "log"]))
    span = float(rng.choice([100, 1000, 16000]))
    problem = problem_of(name, span, response=response, noise=noise, available=available)
    return problem, int(rng.integers(2, 4)) if len(gains) == 1 else 2


def every_set(problem: AccuracyProblem, n: int) -> list[tuple[float, float]]:
    """Return total time and exact effective levels of all sets of n settings of a list."""
    shots = [
        (time, gain)
        for time in np.ravel(np.asarray(problem.available.times)).tolist()
        for gain in problem.available.gains
    ]
    found = []
    for chosen in combinations_with_replacement(shots, n):
        products = [time * gain for time, gain in chosen]
        exposures = [product / min(products) for product in products]
        # An exposure that shows the darkest light above the first sixteen levels is of no use.
        if max(exposures) <= problem.reach * (1 + 1e-9):
            levels = exact_levels(problem, exposures, [gain for _, gain in chosen])
            times = [time for _, time in sorted(zip(products, (t for t, _ in chosen), strict=True))]
            found.append((problem.available.costs.total(times), levels))
    return found


def misses(seeds: Iterable[int]) -> list[int]:
    """Return the seeds whose result is not the shortest set within `NEAR_TIE` of the best one."""
    wrong = []
    for seed in seeds:
        problem, n = random_list_problem(np.random.default_rng(seed))
        sets = every_set(problem, n)
        least = (1 - NEAR_TIE) * max(levels for _, levels in sets)
        shortest = min(time for time, levels in sets if levels >= least)
        found = solve_accuracy(problem, [n])
        if not (
            math.isclose(found.total_time, shortest, rel_tol=1e-9)
            and found.effective_levels >= least * (1 - 1e-9)
        ):
            wrong.append(seed)
    return wrong


@pytest.mark.slow
def test_no_set_of_a_short_list_is_missed() -> None:
    assert misses(range(2)) == []


@pytest.mark.parametrize(
    "costs",
    [
        TimeCosts(least=0.1, extra=0.02, fixed=0.3),
        TimeCosts(4.0, least=0.1, extra=0.02, fixed=0.3, waiting=3.0),
    ],
)
@pytest.mark.parametrize("seed", range(6, 10))
def test_a_limit_counts_what_exposures_take_beside_their_shutter_times(
    costs: TimeCosts, seed: int
) -> None:
    problem, n = random_list_problem(np.random.default_rng(seed))
    problem = replace(problem, available=replace(problem.available, costs=costs))
    sets = every_set(problem, n)
    limit = float(np.median([time for time, _ in sets]))
    best = max(levels for time, levels in sets if time <= limit)
    found = solve_accuracy(problem, [n], total_limit=(limit + costs.fixed) * (1 + 1e-9))
    assert costs.total(found.times) <= limit * (1 + 1e-8)
    assert found.effective_levels >= (1 - NEAR_TIE) * best * (1 - 1e-9)


@pytest.mark.parametrize("is_list", [False, True])
@pytest.mark.parametrize("waiting", [0.0, 3.0])
def test_sets_are_changed_at_the_time_that_they_then_take(waiting: float, is_list: bool) -> None:
    problem = random_list_problem(np.random.default_rng(7))[0] if is_list else problem_of("log")
    costs = TimeCosts(4.0, least=0.3, extra=0.02, fixed=0.3, waiting=waiting)
    problem = replace(problem, available=replace(problem.available, costs=costs))
    search = DesignSearch(FrameAccuracy(problem), bases(problem)[0], (1, 5))
    rng = np.random.default_rng(3)
    for n in (1, 2, 4):
        options = [int(search.bases[0]), *rng.integers(search.cost.size, size=n - 1).tolist()]
        design = search.changed(search.fastest(1), options, [0])
        shots = search.shots(design)
        assert design.time == pytest.approx(costs.total([shot.time for shot in shots]))
        _, rest_time, _ = search.rests(design)
        times = search.times_with(design, rest_time, np.arange(n + 1))
        for place in range(n):
            if n > 1:
                rest = search.changed(design, [], [place])
                assert rest_time[place] == pytest.approx(rest.time)
            for option in rng.integers(search.cost.size, size=6).tolist():
                changed = search.changed(design, [option], [place])
                assert times[place, option] == pytest.approx(changed.time)
                assert times[n, option] == pytest.approx(search.changed(design, [option], []).time)
        some_options = rng.integers(search.cost.size, size=(2, 3))
        for places in combinations(range(n), 2):
            pairs = search.times_of_pairs(design, places, tuple(some_options))
            for (row, one), (column, other) in product(*map(enumerate, some_options.tolist())):
                changed = search.changed(design, [one, other], list(places))
                assert pairs[row, column] == pytest.approx(changed.time)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds",
    [(*range(2, 6), *range(100, 106)), pytest.param(range(106, 120), marks=pytest.mark.proof)],
)
def test_no_set_of_a_short_list_is_missed_by_many_cameras(seeds: Iterable[int]) -> None:
    assert misses(seeds) == []


@pytest.mark.parametrize(
    ("name", "n", "least", "longest"),
    [
        ("linear", 3, 69.5, 3.1),
        pytest.param("gamma", 6, 129.0, 16.5, marks=pytest.mark.slow),
    ],
)
def test_exposures_for_the_noise_of_an_8_bit_sensor(
    name: str, n: int, least: float, longest: float
) -> None:
    """The sensor of the preset "standard"; the limits come from an own Monte-Carlo simulation."""
    found = solve_accuracy(problem_of(name, noise=NoiseModel(39.0625, ((1.0, 3.0),))), [n])
    assert found.effective_levels >= least
    assert found.total_time <= longest


def test_effective_levels_are_those_of_the_exact_prediction() -> None:
    problem = problem_of("gamma")
    found = solve_accuracy(problem, [3])
    exact = exact_levels(problem, list(found.exposures), list(found.gains))
    assert found.effective_levels == pytest.approx(exact, rel=1e-12)
    assert found.effective_levels < found.effective_levels_noise_free


@pytest.mark.parametrize("seed", some(range(3), every=3))
def test_no_random_set_of_the_same_time_is_more_accurate(seed: int) -> None:
    problem = problem_of("log")
    found = solve_accuracy(problem, [3], total_limit=40.0, near_tie=0.0)
    assert found.total_time <= 40.0
    rng = np.random.default_rng(seed)
    for _ in range(60):
        second, third = np.sort(np.exp(rng.uniform(0, math.log(38), 2)))
        scale = min(1.0, 39 / (second + third))
        exposures = [1.0, max(1.0, second * scale), max(1.0, third * scale)]
        assert exact_levels(problem, exposures, [1.0] * 3) <= found.effective_levels * 1.0005


def test_near_ties_are_broken_by_time() -> None:
    best = solve_accuracy(problem_of("log"), [3], near_tie=0.0)
    chosen = solve_accuracy(problem_of("log"), [3])
    assert chosen.total_time < 0.95 * best.total_time
    assert chosen.effective_levels >= (1 - NEAR_TIE) * best.effective_levels


@pytest.mark.slow
def test_gain_is_raised_where_time_is_short() -> None:
    slow = problem_of("log")
    fast = problem_of("log", available=AvailableExposures(gains=(1.0, 2.0, 4.0, 8.0)))
    limit = 6.0
    at_gain_1 = solve_accuracy(slow, [3], total_limit=limit)
    found = solve_accuracy(fast, [3], total_limit=limit)
    assert found.total_time <= limit
    assert max(found.gains) > 1
    assert found.effective_levels > 1.2 * at_gain_1.effective_levels
    below_n = solve_accuracy(fast, [3], total_limit=1.0)
    assert below_n.total_time <= 1.0
    assert min(below_n.gains) > 1


@pytest.mark.slow
def test_a_time_limit_chooses_the_number_of_exposures() -> None:
    short = solve_accuracy(problem_of("log"), total_limit=8.0)
    long = solve_accuracy(problem_of("log"), total_limit=300.0)
    assert len(short.exposures) < len(long.exposures)
    assert short.effective_levels < long.effective_levels
    assert (short.total_time, long.total_time) <= (8.0, 300.0)
    by_count = [solve_accuracy(problem_of("log"), [n], total_limit=8.0) for n in range(1, 5)]
    assert short.effective_levels >= (1 - NEAR_TIE) * max(x.effective_levels for x in by_count)


def test_an_accuracy_is_reached_in_the_least_time() -> None:
    found = solve_accuracy(problem_of("log"), [2, 3, 4], accuracy=90.0)
    assert found.effective_levels >= 90
    for n in (2, 3, 4):
        sooner = solve_accuracy(
            problem_of("log"), [n], total_limit=0.98 * found.total_time, near_tie=0.0
        )
        assert sooner.effective_levels < 90


def test_an_accuracy_that_no_set_reaches_is_refused_with_the_best() -> None:
    with pytest.raises(UsageError, match=r"no set of 2 exposures has 1000 .* the best has 62") as e:
        solve_accuracy(problem_of("log"), [2], accuracy=1000.0)
    assert "x the shortest" in str(e.value)


def test_an_accuracy_beyond_all_numbers_is_refused_with_the_best() -> None:
    available = AvailableExposures(np.arange(1, 3001) * 1e-3, base=(0.01, 0.01), unit_s=1.0)
    with pytest.raises(UsageError, match=r"has 1e\+308 .* the best has"):
        solve_accuracy(problem_of("log", available=available), [3], accuracy=1e308)


def test_without_noise_the_levels_interleave() -> None:
    """Noise-free effective levels decide: (1, 1) of an 8-bit camera has 255, interleaved 386."""
    found = solve_accuracy(problem_of("linear", 512.0, noise=NOISELESS), [2])
    assert found.effective_levels == pytest.approx(found.effective_levels_noise_free)
    assert found.effective_levels > 380
    assert found.total_time < 2.01


def test_few_sets_are_rated_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    """An exact rating takes up to 0.05 s of processor time for 10 bits, and a user waits for it."""
    rated: list[int] = []

    def counted(
        camera: EffectiveCamera, desired: DesiredResponse, noise: Sequence[FrameNoise]
    ) -> float:
        rated.append(len(noise))
        return noisy_effective_levels(camera, desired, noise)

    monkeypatch.setattr(judge, "noisy_effective_levels", counted)
    noise = NoiseModel(6.0, ((1.0, 5.0),))
    problem = problem_of("log", response=linear_response(10), noise=noise)
    solve_accuracy(problem, total_limit=50.0)
    assert len(rated) <= 45


def test_dark_current_changes_the_exposures() -> None:
    noisy = NoiseModel(39.0, ((1.0, 3.0),), dark_current_e_s=500.0)
    available = AvailableExposures(unit_s=0.1)
    dark = solve_accuracy(problem_of("log", noise=noisy, available=available), [2])
    none = solve_accuracy(problem_of("log"), [2])
    assert dark.exposures[1] != pytest.approx(none.exposures[1], rel=0.03)
    assert dark.effective_levels < none.effective_levels


@pytest.mark.parametrize("dark", some([500.0, 2000.0, 5000.0], every=3, first=1))
def test_dark_current_that_fills_the_range_shortens_the_exposures(dark: float) -> None:
    """At 2,000 e-/s a frame of 45 times the shortest exposure holds 230 of 255 levels of it."""
    noisy = NoiseModel(39.0, ((1.0, 3.0),), dark_current_e_s=dark)
    problem = problem_of("log", noise=noisy, available=AvailableExposures(unit_s=0.1))
    rate = accurate_sets(problem, [2]).judge
    best = max(rate((Shot(1.0, 1.0, 1.0), Shot(e, e, 1.0))).levels for e in np.geomspace(2, 60, 40))
    assert solve_accuracy(problem, [2]).effective_levels >= 0.994 * best  # near ties are shorter


def test_limits_of_the_camera_are_kept() -> None:
    available = AvailableExposures(gains=(1.0, 4.0), longest=10.0)
    found = solve_accuracy(problem_of("log", available=available), [3])
    assert max(found.times) <= 10 * (1 + 1e-9)
    assert max(found.exposures) > 10
    assert found.exposures == pytest.approx(
        [time * gain for time, gain in zip(found.times, found.gains, strict=True)]
    )


def test_long_lists_of_settings_are_searched() -> None:
    times = np.arange(1, 3001) * 1e-3
    available = AvailableExposures(times, base=(0.01, 0.01), unit_s=1.0)
    found = solve_accuracy(problem_of("log", available=available), [3])
    free = solve_accuracy(problem_of("log"), [3])
    assert set(np.round(found.times, 9)) <= set(np.round(times, 9))
    assert found.times[0] == 0.01
    assert not found.enumerated
    assert found.effective_levels >= (1 - NEAR_TIE) * free.effective_levels


CAMERAS = given(
    bits=st.integers(2, 10),
    electrons=st.floats(0.5, 1e4),
    read=st.floats(0, 20),
    name=st.sampled_from(["linear", "gamma", "log"]),
    span=st.floats(2, 1e5),
    n=st.integers(1, 3),
)


def check_solution(
    bits: int, electrons: float, read: float, name: str, span: float, n: int
) -> None:
    noise = NoiseModel(electrons, ((1.0, read),))
    found = solve_accuracy(problem_of(name, span, response=linear_response(bits), noise=noise), [n])
    assert isinstance(found, AccuracySolution)
    assert len(found.exposures) == len(found.times) == len(found.gains) == n
    assert found.exposures[0] == 1
    assert found.exposures == tuple(sorted(found.exposures))
    assert found.effective_levels > 0


test_any_camera_has_a_solution = settings(max_examples=5)(CAMERAS(check_solution))
test_more_cameras_have_a_solution = pytest.mark.slow(
    settings(max_examples=15)(CAMERAS(check_solution))
)


@pytest.mark.slow
def test_the_result_is_always_the_same() -> None:
    first, second = (solve_accuracy(problem_of("gamma"), [4]) for _ in range(2))
    assert first.exposures == second.exposures


@pytest.mark.parametrize(
    ("count", "limit", "accuracy", "message"),
    [
        (0, math.inf, None, "invalid number of exposures 0"),
        (3, 2.0, None, "3 exposures take 3 x the shortest at least, more than the 2 x"),
        (3, math.inf, -1.0, "invalid accuracy -1"),
        (3, math.inf, math.nan, "invalid accuracy nan"),
    ],
)
def test_requests_that_cannot_be_met_are_refused(
    count: int, limit: float, accuracy: float | None, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        solve_accuracy(problem_of(), [count], total_limit=limit, accuracy=accuracy)


def test_invalid_settings_are_refused() -> None:
    with pytest.raises(UsageError, match="the list of settings is empty"):
        AvailableExposures(times=())
    with pytest.raises(DataError, match="invalid setting -1"):
        AvailableExposures(times=(1.0, -1.0))
    with pytest.raises(UsageError, match="invalid limits"):
        AvailableExposures(longest=0.5)
    with pytest.raises(UsageError, match="no setting between 5 and 6"):
        solve_accuracy(problem_of(available=AvailableExposures((1.0, 2.0), base=(5.0, 6.0))), [2])
