from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure.solver import solve
from camctl.response.auto import CEILING, FLOOR, auto_response, bounded_shares
from camctl.response.camera import standard_response
from camctl.response.desired import desired_response


def shares(E: np.ndarray, dynamic_range: float = 1000.0, bins: int = 64) -> np.ndarray:
    desired = auto_response(E, dynamic_range, bins=bins)
    edges = dynamic_range ** (np.arange(bins + 1) / bins - 1)
    return np.diff(desired.u(edges)) * bins


def test_an_even_histogram_is_constant_contrast() -> None:
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
    ids=["a wall", "two walls", "a scene"],
)
def test_no_bin_gets_less_or_more_than_its_bounds(scene: np.ndarray) -> None:
    found = shares(scene)
    assert found.min() >= FLOOR * 0.99
    held = found[np.histogram(scene, 1000.0 ** (np.arange(65) / 64 - 1))[0] > 0]
    assert held.max() <= CEILING * 1.01
    assert held.mean() > found.mean()


def test_a_frame_without_light_is_constant_contrast() -> None:
    """All pixels lie in the darkest bin: it gets its ceiling, the rest the same each."""
    found = shares(np.zeros(100))
    assert found[0] == pytest.approx(CEILING, rel=1e-6)
    assert np.ptp(found[1:]) < 1e-6


def test_shares_sum_to_one_and_keep_the_order() -> None:
    held = np.array([0.0, 1, 2, 4, 100])
    share = bounded_shares(held, 0.02, 0.5)
    assert share.sum() == pytest.approx(1)
    assert list(share) == sorted(share)
    assert bounded_shares(np.zeros(4), 0.1, 0.5).tolist() == [0.25] * 4


def test_weights_count_as_pixels_do() -> None:
    E = np.array([0.01, 0.01, 0.01, 0.2])
    by_pixel = auto_response(E, 1000.0)
    by_count = auto_response(np.array([0.01, 0.2]), 1000.0, weights=[3, 1])
    assert by_pixel.key == by_count.key


def test_it_can_be_solved_for_any_camera() -> None:
    scene = np.random.default_rng(0).lognormal(-3, 1, 20_000)
    found = solve(standard_response("srgb", 6), auto_response(scene, 1000.0), 3, effort=0.1)
    assert 0 < found.xi < found.levels_wanted


@pytest.mark.parametrize(
    ("frame", "dynamic_range", "error"),
    [
        ([], 1000.0, DataError),
        ([0.5, float("nan")], 1000.0, DataError),
        ([0.5, -0.1], 1000.0, DataError),
        ([0.5], 1.0, UsageError),
        ([0.5], float("inf"), UsageError),
    ],
)
def test_frames_that_cannot_be(
    frame: list[float], dynamic_range: float, error: type[Exception]
) -> None:
    with pytest.raises(error):
        auto_response(frame, dynamic_range)
