from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.grid_search import against_ideal, combined, solve_settings, stepped, true_time
from camctl.exposure.objective import xi
from camctl.response.auto import auto_response
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

EIGHT_BIT = linear_response(8)
THIRDS = 2.0 ** (np.arange(-39, 16) / 3)
LOG = desired_response("log", 1000.0)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
def test_enumeration_finds_the_best_set_there_is(name: str) -> None:
    """Every set of three scored one by one, on an uneven grid."""
    settings = [0.01, 0.0101, 0.013, 0.02, 0.031, 0.05, 0.1, 0.4, 1.1]
    desired = desired_response(name, 300.0)
    found = solve_settings(EIGHT_BIT, desired, 3, settings)
    best = min(
        xi(EffectiveCamera.of(EIGHT_BIT, [t / chosen[0] for t in chosen]), desired, 765)
        for chosen in combinations(settings, 3)
    )
    assert found.enumerated
    assert found.xi == pytest.approx(best, rel=1e-12)
    assert set(found.settings) <= set(settings)


def test_a_third_stop_dial_needs_each_ratio_once() -> None:
    found = solve_settings(EIGHT_BIT, LOG, 4, THIRDS)
    assert found.enumerated
    assert found.evaluations < 30_000
    assert found.xi == pytest.approx(258.91, abs=0.01)


def test_a_fine_grid_reaches_the_free_optimum() -> None:
    grid = stepped(1e-4, 1.0, 1e-4)
    for name in ("linear", "log"):
        possible, ideal = against_ideal(EIGHT_BIT, desired_response(name, 1000.0), 3, grid.tolist())
        assert not possible.enumerated
        assert possible.xi <= ideal.xi * 1.002
        assert np.all(np.isin(possible.settings, grid))


def test_the_base_is_kept_in_its_range() -> None:
    found = solve_settings(EIGHT_BIT, LOG, 3, stepped(1e-4, 1.0, 1e-4), base=(3e-3, 3.5e-3))
    assert 3e-3 <= found.settings[0] <= 3.5e-3
    assert found.exposures[0] == 1


def test_shutter_time_is_kept_under_its_limit() -> None:
    free = solve_settings(EIGHT_BIT, LOG, 3, THIRDS, base=(1 / 256, 1 / 256))
    held = solve_settings(EIGHT_BIT, LOG, 3, THIRDS, base=(1 / 256, 1 / 256), total_limit=0.1)
    assert sum(free.settings) > 0.1 >= sum(held.settings)
    assert held.xi > free.xi


def test_gain_widens_what_times_can_do() -> None:
    times = [0.001, 0.01]
    with pytest.raises(UsageError, match="3 different exposures from 2 settings"):
        solve_settings(EIGHT_BIT, LOG, 3, times)
    found = solve_settings(EIGHT_BIT, LOG, 3, times, gains=[1, 2, 8])
    assert np.all(np.isin(found.settings, combined(times, [1, 2, 8])))


def test_equal_products_are_one_exposure() -> None:
    assert combined([0.1, 0.2, 0.4], [1, 2]).tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8])


def test_dial_labels_mean_true_times() -> None:
    assert true_time(1 / 30) == 1 / 32
    assert true_time(1 / 1000) == 1 / 1024
    assert true_time(15) == 16


def test_settings_for_a_metered_response_are_quick_and_good() -> None:
    """The table of u ranks by a lower bound: its choice is within 2 % of the best set."""
    scene = np.random.default_rng(1).lognormal(-3, 1.2, 5000).clip(0, 1)
    desired = auto_response(scene, 1000.0)
    grid = 2.0 ** (np.arange(0, 22) / 2)
    found = solve_settings(EIGHT_BIT, desired, 3, grid)
    best = min(
        xi(EffectiveCamera.of(EIGHT_BIT, [1, *rest]), desired, 765)
        for rest in combinations(grid[1:].tolist(), 2)
    )
    assert found.xi <= best * 1.02


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ([], UsageError, "empty list of settings"),
        ([1.0, -2.0, 3.0], DataError, "setting -2 is not a positive"),
        ([1.0, float("nan"), 3.0], DataError, "setting nan"),
    ],
)
def test_lists_that_cannot_be(settings: list[float], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        solve_settings(EIGHT_BIT, LOG, 2, settings)


def test_limits_that_nothing_meets_say_the_least() -> None:
    with pytest.raises(UsageError, match=r"no 3 settings sum to 5 or less; the least is 7"):
        solve_settings(EIGHT_BIT, LOG, 3, [1, 2, 4, 8], total_limit=5)
    with pytest.raises(UsageError, match=r"bases of this grid lie in 1 \.\. 2"):
        solve_settings(EIGHT_BIT, LOG, 3, [1, 2, 4, 8], base=(100, 200))


@pytest.mark.parametrize("values", [(0, 1, 0.1), (1, 0.5, 0.1), (1, 2, 0), (1, 2, float("nan"))])
def test_ranges_that_cannot_be(values: tuple[float, float, float]) -> None:
    with pytest.raises(UsageError, match="0 < minimum <= maximum"):
        stepped(*values)
