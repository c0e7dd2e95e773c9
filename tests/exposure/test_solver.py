from __future__ import annotations

import math
import time

import numpy as np
import pytest
from cells import CELLS, Cell

from camctl.errors import UsageError
from camctl.exposure.batch import BatchScore
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import NoiseTerm, Objective, xi
from camctl.exposure.solver import fewest, solve
from camctl.response.camera import linear_response
from camctl.response.desired import DesiredResponse, desired_response, tabulated_desired

EIGHT_BIT = linear_response(8)
LOG = desired_response("log", 1000.0)


@pytest.mark.parametrize(
    "cell", [cell for cell in CELLS if cell.n <= 4], ids=lambda c: f"{c.response}-{c.n}"
)
def test_small_cells_are_within_half_a_percent_of_the_best_known(cell: Cell) -> None:
    found = solve(EIGHT_BIT, cell.desired, cell.n)
    assert found.xi <= cell.best_xi * 1.005
    assert found.levels_wanted == cell.levels_wanted
    camera = EffectiveCamera.of(EIGHT_BIT, found.exposures)
    assert found.xi == xi(camera, cell.desired, cell.levels_wanted)
    assert found.total_exposure == pytest.approx(sum(found.exposures))
    assert found.exposures[0] == 1
    assert list(found.exposures) == sorted(found.exposures)


@pytest.mark.parametrize(
    "cell", [cell for cell in CELLS if cell.n >= 5], ids=lambda c: f"{c.response}-{c.n}"
)
def test_large_cells_with_a_fifth_of_the_effort(cell: Cell) -> None:
    assert solve(EIGHT_BIT, cell.desired, cell.n, effort=0.2).xi <= cell.best_xi * 1.01


@pytest.mark.parametrize(
    ("desired", "p", "accuracy"),
    [
        (desired_response("linear", 1000.0), 1.0, 1e-4),
        (desired_response("linear", 1000.0), 2.0, 1e-3),
        (desired_response("linear", 1000.0), 1.5, 1e-3),
        (desired_response("gamma", 1000.0), 1.0, 1e-4),
        (desired_response("gamma", 1000.0), 2.0, 1e-3),
        (desired_response("gamma", 1000.0, q=0.2), 1.0, 1e-4),
        (desired_response("gamma", 1000.0, q=0.99), 1.0, 1e-4),
        (desired_response("log", 1000.0), 1.0, 1e-4),
        (desired_response("log", 1000.0), 2.0, 1e-3),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_batches_score_as_the_exact_objective_does(
    desired: DesiredResponse, p: float, accuracy: float
) -> None:
    rng = np.random.default_rng(3)
    exposures = np.sort(np.exp(rng.uniform(0, 5, (150, 4))), axis=1)
    exposures[::2, 1] = 1 + rng.uniform(0, 0.01, 75)
    exposures[:, 0] = 1
    exposures.sort(axis=1)
    goal = Objective(1020, p)
    batch = BatchScore(EIGHT_BIT, desired, goal, 4)(exposures)
    exact = [goal.score(EIGHT_BIT, row, desired) for row in exposures.tolist()]
    np.testing.assert_allclose(batch, exact, rtol=accuracy)


def test_batches_bound_what_they_only_estimate() -> None:
    """Tables and other powers: the mean slope of a gap never exceeds the exact objective."""
    table = tabulated_desired([0.001, 0.01, 0.1, 1.0], [0, 0.4, 0.7, 1])
    exposures = np.array([[1.0, 1.002, 9.0], [1.0, 8.0, 70.0], [1.0, 1.5, 2.5]])
    for desired, p in ((table, 1.0), (table, 2.0), (desired_response("gamma", 1000.0, q=0.4), 1.7)):
        goal = Objective(765, p)
        batch = BatchScore(EIGHT_BIT, desired, goal, 3)(exposures)
        exact = np.array([goal.score(EIGHT_BIT, row, desired) for row in exposures.tolist()])
        assert np.all(batch <= exact * (1 + 1e-5))
        assert np.all(batch > 0.3 * exact)


def test_same_seed_same_bits() -> None:
    first = solve(EIGHT_BIT, LOG, 3, seed=5, effort=0.2)
    again = solve(EIGHT_BIT, LOG, 3, seed=5, effort=0.2)
    other = solve(EIGHT_BIT, LOG, 3, seed=6, effort=0.2)
    assert first.exposures == again.exposures
    assert first.exposures != other.exposures
    assert first.xi == pytest.approx(other.xi, rel=5e-3)


def test_progress_goes_up_to_one() -> None:
    shares: list[float] = []
    solve(EIGHT_BIT, LOG, 2, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_one_exposure_needs_no_search() -> None:
    found = solve(EIGHT_BIT, LOG, 1)
    assert found.exposures == (1.0,)
    assert found.evaluations == 1


def test_a_time_limit_is_kept() -> None:
    started = time.monotonic()
    found = solve(linear_response(12), LOG, 5, time_limit_s=0.5, effort=0.02)
    assert time.monotonic() - started < 3
    assert len(found.exposures) == 5


@pytest.mark.parametrize("limit", [3.5, 10.0, 60.0])
def test_a_budget_of_shutter_time_is_kept_and_used(limit: float) -> None:
    found = solve(EIGHT_BIT, LOG, 3, total_limit=limit)
    free = solve(EIGHT_BIT, LOG, 3)
    assert free.total_exposure > limit
    assert 0.9 * limit < found.total_exposure <= limit
    assert found.xi > free.xi


def test_the_least_budget_leaves_equal_exposures() -> None:
    assert solve(EIGHT_BIT, LOG, 3, total_limit=3).exposures == (1.0, 1.0, 1.0)


def test_a_budget_that_no_set_meets() -> None:
    with pytest.raises(UsageError, match="the least is 3"):
        solve(EIGHT_BIT, LOG, 3, total_limit=2.9)


@pytest.mark.parametrize("n", [0, -1, 17])
def test_numbers_of_exposures_that_cannot_be(n: int) -> None:
    with pytest.raises(UsageError, match="1 to 16"):
        solve(EIGHT_BIT, LOG, n)


def test_jitter_gives_up_an_interleave_that_would_not_survive() -> None:
    """With exposures 1 % off, a 0.3 % interleave is luck: the averaged optimum scores better."""
    desired = desired_response("linear", 256.0)
    sharp = solve(EIGHT_BIT, desired, 2)
    robust = solve(EIGHT_BIT, desired, 2, jitter=0.01)
    goal = Objective(510, jitter=0.01)
    assert goal.score(EIGHT_BIT, sharp.exposures, desired) > sharp.xi * 1.05
    assert robust.xi <= goal.score(EIGHT_BIT, sharp.exposures, desired)


@pytest.mark.parametrize("kind", ["paper", "time", "gain"])
def test_the_noise_term_is_what_its_name_says(kind: str) -> None:
    e = np.array([1.0, 3.0, 8.0])
    expected = {
        "paper": 0.01**2 * np.sum(1 / e),
        "time": 3 * 0.01**2 / np.sum(e) ** 2,
        "gain": 0.01**2 * np.sum(e**2) / np.sum(e) ** 2,
    }[kind]
    noisy = Objective(765, noise=NoiseTerm(0.01, weight=7.0, kind=kind))
    plain = Objective(765)
    difference = noisy.score(EIGHT_BIT, e.tolist(), LOG) - plain.score(EIGHT_BIT, e.tolist(), LOG)
    assert difference == pytest.approx(7 * expected, rel=1e-9)


def test_a_heavy_noise_term_asks_for_longer_exposures() -> None:
    desired = desired_response("gamma", 256.0)
    free = solve(EIGHT_BIT, desired, 2)
    noisy = solve(EIGHT_BIT, desired, 2, noise=NoiseTerm(0.05, weight=1e4, kind="time"))
    assert noisy.total_exposure > free.total_exposure


def test_unknown_noise_names_the_near_ones() -> None:
    with pytest.raises(UsageError, match="did you mean paper"):
        NoiseTerm(0.01, kind="papr")


def test_fewest_exposures_for_a_tolerance() -> None:
    found = fewest(EIGHT_BIT, LOG, tolerance=60, levels_wanted=300)
    fewer = solve(EIGHT_BIT, LOG, len(found.exposures) - 1, levels_wanted=300)
    assert found.xi <= 60 < fewer.xi
    assert found.levels_wanted == 300


def test_a_tolerance_out_of_reach_says_what_is_reached() -> None:
    with pytest.raises(UsageError, match=r"2 exposures do not bring xi down to 1; they reach \d"):
        fewest(EIGHT_BIT, LOG, tolerance=1, levels_wanted=300, most=2)


def test_many_bits_start_from_few() -> None:
    """16 bits: found without the millions of candidates that 8 bits can afford."""
    response = linear_response(16)
    desired = desired_response("linear", 65536.0)
    found = solve(response, desired, 2, effort=0.02)
    equal = xi(EffectiveCamera.of(response, (1, 1)), desired, 2 * response.M)
    interleaved = xi(EffectiveCamera.of(response, (1, 1 + 0.7 / 65536)), desired, 2 * response.M)
    assert found.xi < equal
    assert found.xi <= interleaved
    assert math.isfinite(found.effective_levels)


@pytest.mark.parametrize(
    ("bits", "n", "p"),
    [(1, 1, 2.0), (1, 16, 1.0), (5, 16, 1.0), (1, 3, 16.0), (7, 3, 2.0), (7, 2, 16.0), (3, 4, 1.0)],
)
@pytest.mark.parametrize("dynamic_range", [1.001, 1e7])
def test_the_corners_are_searched_without_a_warning(
    bits: int, n: int, dynamic_range: float, p: float
) -> None:
    for name in ("linear", "gamma", "log"):
        found = solve(
            linear_response(bits), desired_response(name, dynamic_range), n, p=p, effort=1e-3
        )
        assert math.isfinite(found.xi)
        assert found.xi >= 0
        assert found.effective_levels >= 1 - 1e-9
