from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure import grid_search
from camctl.exposure.exposure_choices import SettingsGrid, stepped
from camctl.exposure.grid_search import solve_settings
from camctl.exposure.noise import NoiseTerm
from camctl.exposure.objective import Objective, xi
from camctl.exposure.solver import SearchOptions, Solution, solve
from camctl.model.effective import EffectiveCamera
from camctl.model.response.auto import auto_response
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.tabulated import tabulated_desired

EIGHT_BIT = linear_response(8)
THIRDS = 2.0 ** (np.arange(-39, 16) / 3)
LOG = desired_response("log", 1000.0)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
def test_enumeration_finds_the_best_of_all_sets(name: str) -> None:
    """Expected: every set of three, scored one by one, on an uneven grid."""
    settings = [0.01, 0.0101, 0.013, 0.02, 0.031, 0.05, 0.1, 0.4, 1.1]
    desired = desired_response(name, 300.0)
    found = solve_settings(EIGHT_BIT, desired, 3, SettingsGrid(settings))
    best = min(
        xi(EffectiveCamera.of(EIGHT_BIT, [t / chosen[0] for t in chosen]), desired, 765)
        for chosen in combinations(settings, 3)
    )
    assert found.enumerated
    assert found.xi == pytest.approx(best, rel=1e-12)
    assert set(found.settings) <= set(settings)


def test_each_ratio_of_a_third_stop_grid_is_scored_once() -> None:
    found = solve_settings(EIGHT_BIT, LOG, 4, SettingsGrid(THIRDS))
    assert found.enumerated
    assert found.evaluations < 30_000
    assert found.xi == pytest.approx(258.91, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["log", "linear"])
def test_fine_grid_reaches_the_optimum_of_arbitrary_exposures(name: str) -> None:
    times, desired = stepped(1e-4, 1.0, 1e-4), desired_response(name, 1000.0)
    found = solve_settings(EIGHT_BIT, desired, 3, SettingsGrid(times))
    assert not found.enumerated
    assert found.xi <= solve(EIGHT_BIT, desired, 3).xi * 1.002
    assert np.all(np.isin(found.settings, times))


def test_search_on_a_grid_uses_the_whole_objective() -> None:
    """Strong read noise requires longer exposures, on a table of the response, too."""
    grid = SettingsGrid(stepped(1e-3, 1.0, 1e-3), base=(5e-3, 5e-3))
    desired = desired_response("gamma", 256.0)
    points = np.linspace(desired.e_min, 1.0, 50)
    noise = Objective(noise=NoiseTerm(0.05, weight=1e4, kind="time"))
    for response in (desired, tabulated_desired(points, desired.u(points))):
        plain = solve_settings(EIGHT_BIT, response, 2, grid)
        noisy = solve_settings(EIGHT_BIT, response, 2, grid, objective=noise)
        assert noisy.total_exposure > plain.total_exposure


@pytest.mark.slow
def test_same_seed_gives_the_same_settings() -> None:
    grid = SettingsGrid(stepped(1e-3, 1.0, 1e-3), gains=(1, 2))
    search = SearchOptions(seed=7, effort=0.2)
    one = solve_settings(linear_response(5), LOG, 3, grid, search=search)
    two = solve_settings(linear_response(5), LOG, 3, grid, search=search)
    assert one.settings == two.settings


def test_shortest_exposure_lies_in_the_requested_range() -> None:
    grid = SettingsGrid(stepped(1e-4, 1.0, 1e-4), base=(3e-3, 3.5e-3))
    found = solve_settings(EIGHT_BIT, LOG, 3, grid)
    assert 3e-3 <= found.settings[0] <= 3.5e-3
    assert found.exposures[0] == 1


def test_total_exposure_stays_within_its_limit() -> None:
    base = (1 / 256, 1 / 256)
    unlimited = solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(THIRDS, base=base))
    limited = solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(THIRDS, base=base, total_limit=0.1))
    assert sum(unlimited.settings) > 0.1 >= sum(limited.settings)
    assert limited.xi > unlimited.xi


def test_gains_add_exposures() -> None:
    times = [0.001, 0.01]
    with pytest.raises(UsageError, match="3 different exposures cannot be chosen from 2 settings"):
        solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(times))
    found = solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(times, gains=[1, 2, 8]))
    assert set(found.settings) <= {0.001, 0.002, 0.008, 0.01, 0.02, 0.08}


def test_equal_products_of_time_and_gain_are_one_exposure() -> None:
    grid = SettingsGrid([0.1, 0.2, 0.4], [1, 2])
    assert grid.exposures.tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8])


def test_settings_for_a_tabulated_response_are_within_2_percent_of_the_best() -> None:
    """Sets are ranked by a lower bound there."""
    scene = np.random.default_rng(1).lognormal(-3, 1.2, 5000).clip(0, 1)
    desired = auto_response(scene, 1000.0)
    grid = 2.0 ** (np.arange(0, 22) / 2)
    found = solve_settings(EIGHT_BIT, desired, 3, SettingsGrid(grid))
    best = min(
        xi(EffectiveCamera.of(EIGHT_BIT, [1, *rest]), desired, 765)
        for rest in combinations(grid[1:].tolist(), 2)
    )
    assert found.xi <= best * 1.02


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ([], UsageError, "the list of settings is empty; give one setting or more"),
        ([1.0, -2.0], DataError, r"invalid setting -2: expected 1e-12 to 1e\+12"),
        ([1.0, float("nan")], DataError, r"invalid setting nan: expected 1e-12 to 1e\+12"),
    ],
)
def test_invalid_settings_are_refused(
    settings: list[float], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        solve_settings(EIGHT_BIT, LOG, 2, SettingsGrid(settings))


def test_limits_that_no_set_meets_are_refused_with_the_nearest_possible() -> None:
    times = [1, 2, 4, 8]
    message = "no 3 settings have a sum of 5 or less; the smallest sum is 7"
    with pytest.raises(UsageError, match=message):
        solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(times, total_limit=5))
    message = (
        "no 3 exposures start from a setting of 100 to 200; the shortest exposure can be 1 to 2"
    )
    with pytest.raises(UsageError, match=message):
        solve_settings(EIGHT_BIT, LOG, 3, SettingsGrid(times, base=(100, 200)))


@pytest.mark.parametrize("values", [(0, 1, 0.1), (1, 0.5, 0.1), (1, 2, 0), (1, 2, float("nan"))])
def test_invalid_steps_are_refused(values: tuple[float, float, float]) -> None:
    with pytest.raises(UsageError, match="expected 0 < minimum <= maximum and a step above 0"):
        stepped(*values)


def test_too_many_steps_are_refused() -> None:
    with pytest.raises(UsageError, match=r"too many settings \(1000000\): expected at most 200000"):
        stepped(1e-6, 1.0, 1e-6)


def test_too_many_pairs_of_a_time_and_a_gain_are_refused() -> None:
    with pytest.raises(UsageError, match=r"too many pairs of a time and a gain \(4,004,000\)"):
        _ = SettingsGrid(np.arange(1, 2003), np.arange(1, 2001)).exposures


@pytest.mark.parametrize("p", [1.0, 2.5])
def test_the_longest_searches_of_settings_score_no_more_than_they_have_time_for(
    p: float, spent: list[float]
) -> None:
    ideal = Solution(tuple(np.geomspace(1, 1e4, 16).tolist()), 1.0, 1, 1, 1, 1, 1)
    grid, shares = SettingsGrid(np.arange(1, 2000)), list[float]()
    found = solve_settings(
        linear_response(16),
        LOG,
        16,
        grid,
        objective=Objective(p=p),
        ideal=ideal,
        progress=shares.append,
    )
    assert len(found.settings) == 16
    assert sum(spent) < grid_search.MOST_SECONDS + 3 * grid_search.RANKED_SECONDS
    assert shares == sorted(shares)
    assert len(shares) == grid_search.ROUNDS
