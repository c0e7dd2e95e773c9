from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.response.auto import BINS, MAX_DENSITY, MIN_DENSITY, auto_response, bounded_shares
from camctl.model.response.camera import FloatArray, standard_response
from camctl.model.response.desired import desired_response


def densities(E: FloatArray) -> FloatArray:
    """Return the density of u over ln E in each bin, for a dynamic range of 1000."""
    edges = 1000.0 ** (np.arange(BINS + 1) / BINS - 1)
    return np.asarray(np.diff(auto_response(E, 1000.0).u(edges)) * BINS)


def test_uniform_histogram_gives_constant_contrast() -> None:
    E = 1000.0 ** -np.linspace(0, 1, 64_001)
    desired = auto_response(E, 1000.0)
    log = desired_response("log", 1000.0)
    probe = 1000.0 ** -(np.arange(65) / 64)
    np.testing.assert_allclose(desired.u(probe), log.u(probe), atol=2e-3)


@pytest.mark.parametrize(
    "scene",
    [
        np.full(1000, 0.3),
        np.concatenate([np.full(5000, 0.002), np.full(3, 0.9)]),
        np.random.default_rng(0).lognormal(-3, 1, 20_000),
    ],
    ids=["one irradiance", "two irradiances", "log-normal scene"],
)
def test_density_stays_within_its_bounds(scene: FloatArray) -> None:
    found = densities(scene)
    assert found.min() >= MIN_DENSITY * 0.99
    occupied = found[np.histogram(scene, 1000.0 ** (np.arange(65) / 64 - 1))[0] > 0]
    assert occupied.max() <= MAX_DENSITY * 1.01
    assert occupied.mean() > found.mean()


def test_frame_without_light_gives_constant_contrast_above_the_darkest_bin() -> None:
    """All pixels lie in the darkest bin, which gets the largest density; all others are equal."""
    found = densities(np.zeros(100))
    assert found[0] == pytest.approx(MAX_DENSITY, rel=1e-6)
    assert np.ptp(found[1:]) < 1e-6


def test_bounded_shares_sum_to_one_and_keep_the_order() -> None:
    histogram = np.array([0.0, 1, 2, 4, 100])
    share = bounded_shares(histogram, 0.02, 0.5)
    assert share.sum() == pytest.approx(1)
    assert list(share) == sorted(share)
    assert bounded_shares(np.zeros(4), 0.1, 0.5).tolist() == [0.25] * 4


def test_weights_count_like_repeated_pixels() -> None:
    E = np.array([0.01, 0.01, 0.01, 0.2])
    by_pixel = auto_response(E, 1000.0)
    by_weight = auto_response(np.array([0.01, 0.2]), 1000.0, weights=[3, 1])
    assert by_pixel.key == by_weight.key


def test_large_frame_is_sampled_evenly() -> None:
    E = np.random.default_rng(3).lognormal(-3, 1, 1_000_000)
    sampled, full = auto_response(E, 1000.0), auto_response(E, 1000.0, weights=np.ones(E.size))
    probe = 1000.0 ** -np.linspace(0, 1, 50)
    np.testing.assert_allclose(sampled.u(probe), full.u(probe), atol=0.01)


def test_exposures_can_be_found_for_an_auto_response() -> None:
    scene = np.random.default_rng(0).lognormal(-3, 1, 20_000)
    desired = auto_response(scene, 1000.0)
    found = solve(standard_response("srgb", 6), desired, 3, search=SearchOptions(effort=0.1))
    assert 0 < found.xi < found.levels_wanted


@pytest.mark.parametrize(
    ("frame", "dynamic_range", "error", "message"),
    [
        ([], 1000.0, DataError, "the metering frame is empty"),
        ([0.5, float("nan")], 1000.0, DataError, "a negative or non-finite irradiance"),
        ([0.5, -0.1], 1000.0, DataError, "a negative or non-finite irradiance"),
        ([0.5], 1.0, UsageError, "invalid dynamic range 1: expected a finite number above 1"),
        ([0.5], float("inf"), UsageError, "invalid dynamic range inf: expected a finite number"),
    ],
)
def test_invalid_metering_frames_are_refused(
    frame: list[float], dynamic_range: float, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        auto_response(frame, dynamic_range)


def test_weights_of_another_size_are_refused() -> None:
    message = "the metering frame has 2 irradiances and 1 weights: expected one weight for each"
    with pytest.raises(DataError, match=message):
        auto_response([0.1, 0.2], 1000.0, weights=[1])
