"""What keeps the light of combinations of samples returns what it would compute."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.model.light_memory import LightMemory


class _Estimate:
    """Numbers that differ for each combination of samples, and how many were asked for."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(
        self, values: Sequence[NDArray[Any]], total: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        self.asked += total.size
        found = sum(each.astype(np.float64) * 1.7**k for k, each in enumerate(values))
        return np.asarray(found, np.float32), np.asarray(found + total, np.float32)


def _samples(count: int, dtype: type, size: int, levels: int, seed: int) -> list[NDArray[Any]]:
    """Return frames of a noisy picture: a few levels around a light in each."""
    rng = np.random.default_rng(seed)
    light = rng.integers(0, levels, size)
    most = np.iinfo(dtype).max
    return [
        np.minimum(light * (k + 1) + rng.integers(0, 2, size), most).astype(dtype)
        for k in range(count)
    ]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("count", [1, 2, 5, 8, 13])
def test_known_light_is_what_was_estimated(count: int, dtype: type) -> None:
    estimate = _Estimate()
    memory = LightMemory(estimate)
    for seed in range(3):
        values = _samples(count, dtype, 40_000, 20, seed)
        for each in values:
            each[:50] = 0  # black in all frames
        total = np.asarray(np.sum(values, axis=0, dtype=np.uint32))
        found = memory.of(values, total)
        for known, expected in zip(found, _Estimate()(values, total), strict=True):
            np.testing.assert_array_equal(known, expected)
    if count < 8:
        assert estimate.asked < 60_000  # of 120,000: those of the first picture, and new ones


def test_combinations_that_are_all_new_are_not_kept_for_ever() -> None:
    """Where none occurs again, they are estimated without a look-up, and right."""
    estimate = _Estimate()
    memory = LightMemory(estimate)
    rng = np.random.default_rng(0)
    for _ in range(10):
        values = [rng.integers(0, 1 << 16, 60_000).astype(np.uint16) for _ in range(4)]
        total = np.asarray(np.sum(values, axis=0, dtype=np.uint32))
        for found, expected in zip(
            memory.of(values, total), _Estimate()(values, total), strict=True
        ):
            np.testing.assert_array_equal(found, expected)
    again = estimate.asked
    memory.of(values, total)
    assert estimate.asked == again + total.size  # not even these are looked up
