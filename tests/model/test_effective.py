from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import UsageError
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response

EIGHT_BIT = linear_response(8)


@pytest.mark.parametrize(
    ("name", "dynamic_range", "printed", "doubling_levels", "printed_levels"),
    [
        ("linear", 1000.0, (1, 1.003, 2.985), 336, 522),
        ("gamma", 1000.0, (1, 1.003, 5.146), 317, 408),
        ("log", 1000.0, (1, 9.91, 88.38), 28, 392),
        ("log", 16000.0, (1, 9.91, 88.38), 6.5, 74),
    ],
)
def test_effective_levels_of_doubling_and_printed_sets(
    name: str,
    dynamic_range: float,
    printed: tuple[float, ...],
    doubling_levels: float,
    printed_levels: float,
) -> None:
    desired = desired_response(name, dynamic_range)
    digits = 1 if doubling_levels < 10 else None
    doubling = effective_levels(EffectiveCamera.of(EIGHT_BIT, (1, 2, 4)), desired)
    assert round(doubling, digits) == doubling_levels
    assert round(effective_levels(EffectiveCamera.of(EIGHT_BIT, printed), desired)) == (
        printed_levels
    )


def test_effective_levels_of_equal_steps_are_their_number() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1,))
    assert effective_levels(camera, desired_response("linear", 256.0)) == pytest.approx(255, 1e-12)


@pytest.mark.parametrize(
    ("exposures", "distinct"),
    [((1, 2, 4), 511), ((1, 1.003, 1.007, 1.166, 4.975), 1263), ((1, 1.1, 1.21), 719)],
)
def test_coincident_levels_are_counted_once(exposures: tuple[float, ...], distinct: int) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, exposures)
    assert camera.levels_distinct == distinct
    assert camera.levels_total == 255 * len(exposures)


def test_a_chain_of_close_levels_is_not_one_group() -> None:
    """Levels at distances of 0.6 tolerances form groups of two, not one group of ten."""
    exposures = [1 / (1 + 0.6e-12 * k) for k in range(10)]
    camera = EffectiveCamera.of(linear_response(1), exposures)
    assert np.array_equal(camera.distinct, camera.levels[::2])


@pytest.mark.parametrize(
    ("exposures", "message"),
    [
        ((), "invalid number of exposures 0: expected 1 to 64"),
        ((1.0,) * 65, "invalid number of exposures 65: expected 1 to 64"),
        ((1, -2), "invalid exposure -2: expected a positive, finite number"),
        ((1, 0), "invalid exposure 0: expected a positive, finite number"),
        ((1, float("nan")), "invalid exposure nan: expected a positive, finite number"),
        ((1, 1e101), "invalid exposures: expected values from 1e-100 to 1e100"),
    ],
)
def test_invalid_exposures_are_refused(exposures: tuple[float, ...], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        EffectiveCamera.of(EIGHT_BIT, exposures)
