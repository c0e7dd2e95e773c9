"""Exchanges of exposures for a camera without noise, against the error computed gap by gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_cameras import small_camera

from camctl.exposure.accurate import gap_filling
from camctl.exposure.accurate.gap_filling import GapFilling, TimeLimit, _Gaps, _Places
from camctl.exposure.exposure_choices import TimeCosts
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.front import Front
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import FloatArray, linear_response
from camctl.model.response.desired import DesiredResponse, desired_response

REACH = np.log(500.0)
COSTS = TimeCosts(factor=2.0, least=3.0, extra=1.0, waiting=0.5)


def filling(
    response: str = "log", dynamic_range: float = 1000.0, bits: int = 6, limit: float = 2000.0
) -> GapFilling:
    desired = desired_response(response, dynamic_range)
    within = TimeLimit(limit, COSTS, unit=1.0)
    return GapFilling(linear_response(bits), desired, within, REACH, (2, 8))


def error(levels: FloatArray, row: FloatArray, desired: DesiredResponse) -> float:
    """Return the sum of the cubes of the gaps in u, from 0 to 1."""
    light = (levels * np.exp(-row)[:, np.newaxis]).ravel()
    edges = np.sort(np.clip(light, desired.e_min, 1.0))
    return float((np.diff(desired.u(edges), prepend=0.0, append=1.0) ** 3).sum())


@pytest.mark.parametrize("response", ["log", "linear", "gamma"])
def test_derivatives_are_those_of_the_error(response: str) -> None:
    each = filling(response)
    row = np.array([0.0, 0.013, 1.7, 2.3, 4.1])
    value, slopes, curvature = each._derivatives(row)
    assert value == pytest.approx(error(each.response.levels, row, each.desired), rel=1e-10)
    assert np.allclose(curvature, curvature.T)
    assert np.linalg.eigvalsh(curvature).min() >= -1e-12 * np.trace(curvature)
    for k in range(1, row.size):
        step = np.zeros(row.size)
        step[k] = 1e-7
        values = [error(each.response.levels, row + sign * step, each.desired) for sign in (1, -1)]
        assert slopes[k] == pytest.approx((values[0] - values[1]) / 2e-7, rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("response", ["log", "linear"])
def test_what_an_exposure_lowers_is_what_it_does_where_no_gap_is_divided_twice(
    response: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_filling, "FEWEST", 1 << 16)
    each = filling(response, bits=4)
    row = np.array([0.0, 0.3, 2.0, 4.5])
    places = _Places(each, row.size)
    lowered, levels = places._lowered(_Gaps(each, row)), each.response.levels
    before = error(levels, row, each.desired)
    edges = np.sort((levels * np.exp(-row)[:, np.newaxis]).ravel())
    compared = 0
    for k in range(97, places._exposures.size, 97):
        own = levels * np.exp(-places._exposures[k])
        shared = np.searchsorted(edges, own[(own > each.desired.e_min) & (own < 1)])
        if np.unique(shared).size < shared.size:
            continue
        exact = before - error(levels, np.append(row, places._exposures[k]), each.desired)
        assert lowered[k] == pytest.approx(exact, rel=1e-3, abs=1e-3 * before)
        compared += 1
    assert compared >= 10


def test_time_is_kept_and_its_slopes_are_those_of_the_total() -> None:
    within = filling().within
    sets = np.array([[0.0, 2.0, 6.0], [0.0, 0.5, 5.0], [0.0, 0.1, 8.0]])
    for k in range(3):
        step = np.zeros((1, 3))
        step[:, k] = 1e-6
        slope = (within.total(sets + step) - within.total(sets - step)) / 2e-6
        assert np.allclose(within.slopes(sets)[:, k], slope, rtol=1e-6)
    times = within.total(within.scaled(sets))
    assert np.all(times <= within.limit * (1 + 1e-9))
    assert np.allclose(times, np.minimum(within.total(sets), within.limit))


@pytest.mark.parametrize("response", ["log", "linear", "gamma"])
def test_exchanges_lower_the_error_within_time_and_count(response: str) -> None:
    each = filling(response, limit=600.0)
    row = each.within.scaled(np.linspace(0.0, REACH, 5)[np.newaxis])[0]
    settled, after = each.settled(row)
    better, least = each.improved(row, 20, np.random.default_rng(0))
    before = error(each.response.levels, row, each.desired)
    assert least < after < before
    for found, stated in ((settled, after), (better, least)):
        assert error(each.response.levels, found, each.desired) == pytest.approx(stated, rel=1e-5)
        assert each.within.total(found[np.newaxis])[0] <= each.within.limit * (1 + 1e-9)
        assert found[0] == 0.0
        assert np.all(np.diff(found) >= 0)
        assert found[-1] <= REACH
    assert 2 <= better.size <= 8


@pytest.mark.parametrize("response", ["log", "linear"])
def test_in_whole_steps_no_single_step_of_an_exposure_is_better(response: str) -> None:
    """Rounded alone, levels that interleave no longer do."""
    each, step = filling(response, limit=600.0), 0.002
    row = np.log1p(np.array([0.0, 0.0011, 0.0207, 0.5313, 1.7777, 40.1234]))
    found = each.stepped(row, step, 10**8)
    number = np.expm1(found) / step
    assert np.allclose(number, np.round(number), atol=1e-6)
    assert each.within.total(found[np.newaxis])[0] <= each.within.limit
    rounded = np.log1p(np.round(np.expm1(row) / step) * step)
    least = error(each.response.levels, found, each.desired)
    assert least < error(each.response.levels, rounded, each.desired)
    compared = 0
    for k in range(1, row.size):
        for sign in (1, -1):
            beside = np.round(number)
            beside[k] += sign
            other = np.log1p(np.sort(beside) * step)
            if beside[k] >= 0 and each.within.total(other[np.newaxis])[0] <= each.within.limit:
                assert error(each.response.levels, other, each.desired) >= least * (1 - 1e-5)
                compared += 1
    assert compared >= 8


def test_the_levels_of_a_front_without_noise_are_those_in_the_steps_of_the_times() -> None:
    """Steps of 10 us are two gaps of 12 bits: sets that were rounded had a fifth of the levels."""
    request = CaptureRequest(response="linear", dynamic_range=256.0)
    with small_camera("ideal-12", np.full((12, 16), 100.0)) as camera:
        desired = desired_response("linear", 256.0)
        front = Front(camera.controls, desired, 0.02, request=request)
        point = front.at_time(1.0)
    assert point.levels == pytest.approx(front.levels_of(point.settings), rel=1e-6)
    assert point.levels > 15_000


def test_more_levels_than_random_changes_find() -> None:
    """In a second, a camera without noise has 310 levels; random changes alone found 291."""
    request = CaptureRequest(response="log", dynamic_range=1000.0)
    with small_camera("ideal-8", np.full((12, 16), 100.0)) as camera:
        front = Front(camera.controls, desired_response("log", 1000.0), 1 / 800, request=request)
        assert front.levels_of(front.at_time(1.0).settings) > 300


def front_without_noise(noise: NoiseModel | None = None) -> Front:
    request = CaptureRequest(response="linear", dynamic_range=256.0)
    with small_camera("ideal-8", np.full((12, 16), 100.0)) as camera:
        controls = camera.controls if noise is None else replace(camera.controls, noise=noise)
        return Front(controls, desired_response("linear", 256.0), 0.02, request=request)


def test_what_exposures_change_is_computed_from_the_gaps_that_they_divide() -> None:
    """Levels in the same gap, and outside the range, among them."""
    for each in (filling("log"), filling("linear"), filling("gamma")):
        row = np.array([0.0, 0.4, 1.1, 5.9])
        more = np.array([[0.0, 0.001], [0.41, 3.0], [5.0, 6.2]])
        found = _Gaps(each, row).errors_with(more)
        for k in range(3):
            both = np.append(row, more[k])
            assert found[k] == pytest.approx(
                error(each.response.levels, both, each.desired), rel=1e-9
            )


def test_a_range_without_end_has_a_front_without_noise() -> None:
    """The logarithm of its darkest light does not exist."""
    request = CaptureRequest(response="gamma", dynamic_range=256.0)
    with small_camera("ideal-4", np.full((12, 16), 100.0)) as camera:
        front = Front(camera.controls, desired_response("gamma", np.inf), 0.02, request=request)
        point = front.at_time(0.6)
    assert point.levels == pytest.approx(front.levels_of(point.settings), rel=1e-9)
    assert point.n > 1


def test_with_little_noise_sets_in_the_camera_s_steps_are_compared() -> None:
    """Sets between them had more levels than any that the camera can take, and pushed these out."""
    noise = NoiseModel(10_000 / 256, read_noise_e=((1.0, 0.8),), photon_noise=False)
    front = front_without_noise(noise)
    assert not front.is_smooth
    sets, step = front._sets, front._problem.available.step
    for limit in (5.0, 12.0):
        rated = sets.within(limit)
        place = (np.array([shot.time for shot in rated.shots]) - 1) / step
        assert np.allclose(place, np.round(place), atol=1e-5)
        assert rated.time <= limit * (1 + 1e-9)


def test_a_longer_time_has_no_fewer_levels_than_the_set_it_starts_from() -> None:
    sets = front_without_noise()._sets
    start = sets.within(8.0)
    assert sets.within(8.4, thorough=False, start=start.shots).levels >= start.levels
