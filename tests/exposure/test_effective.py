from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import UsageError
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

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


def test_equal_steps_count_as_themselves() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1,))
    assert effective_levels(camera, desired_response("linear", 256.0)) == pytest.approx(255, 1e-12)


@pytest.mark.parametrize(
    ("exposures", "distinct"),
    [((1, 2, 4), 511), ((1, 1.003, 1.007, 1.166, 4.975), 1263), ((1, 1.1, 1.21), 719)],
)
def test_coincident_levels_are_found(exposures: tuple[float, ...], distinct: int) -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, exposures)
    assert camera.levels_distinct == distinct
    assert camera.levels_total == 255 * len(exposures) == camera.multiplicity.sum()


def test_chains_of_near_levels_do_not_merge() -> None:
    """Levels each 0.6 tolerances from the next: groups of two, not one group of all."""
    exposures = [1 / (1 + 0.6e-12 * k) for k in range(10)]
    camera = EffectiveCamera.of(linear_response(1), exposures)
    assert camera.multiplicity.tolist() == [2] * 5


def test_brightness_is_the_sum_of_the_frames() -> None:
    exposures = (1, 2, 2.7)
    camera = EffectiveCamera.of(linear_response(6), exposures)
    E = np.random.default_rng(5).uniform(0, 1.2, (40, 50))
    single = EffectiveCamera.of(linear_response(6), (1,))
    frames = sum(single.brightness(e * E) for e in exposures)
    assert np.array_equal(camera.brightness(E), frames)


def test_the_inverse_table_names_the_gap_of_each_sum() -> None:
    camera = EffectiveCamera.of(linear_response(2), (1, 2))
    # levels 1/8 1/4 1/4 3/8 1/2 3/4: the sum 2 cannot occur
    assert camera.levels.tolist() == [0.125, 0.25, 0.25, 0.375, 0.5, 0.75]
    table = camera.irradiance_table()
    assert table.tolist() == [0.0, 0.1875, 0.25, 0.3125, 0.4375, 0.625, 0.75]


def test_the_inverse_is_within_half_a_gap() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 1.003, 2.985))
    E = np.linspace(camera.levels[0], camera.levels[-1] * (1 - 1e-9), 9999)
    sums = camera.brightness(E)
    half_gap = (camera.levels[sums] - camera.levels[sums - 1]) / 2
    assert np.all(np.abs(camera.irradiance_table()[sums] - E) <= half_gap + 1e-15)


def test_predicted_standard_deviation_against_drawn_frames() -> None:
    """Two hundred thousand noisy pixels of three frames, read off the sum."""
    rng = np.random.default_rng(11)
    electrons, read = 12.0, 1.5
    exposures = (1.0, 3.3, 11.0)
    camera = EffectiveCamera.of(EIGHT_BIT, exposures)
    for E in (0.03, 0.2, 0.7):
        total = np.zeros(200_000, dtype=np.int64)
        for e in exposures:
            signal = rng.poisson(e * E * 256 * electrons, total.size) / electrons
            frame = np.floor(signal + rng.normal(0, read, total.size))
            total += np.clip(frame, 0, 255).astype(np.int64)
        measured = np.std(camera.irradiance_table()[total])
        predicted = camera.standard_deviation(
            E, electrons_per_level=electrons, read_noise_levels=read
        )
        assert measured == pytest.approx(predicted, rel=0.03)


def test_standard_deviation_is_infinite_where_all_is_saturated() -> None:
    camera = EffectiveCamera.of(EIGHT_BIT, (1, 2))
    deviation = camera.standard_deviation(
        [0.1, 0.999], electrons_per_level=[10, 5], read_noise_levels=1
    )
    assert np.isfinite(deviation[0])
    assert np.isinf(deviation[1])


@pytest.mark.parametrize("exposures", [(), (1, -2), (1, 0), (1, float("nan")), [1] * 17])
def test_exposures_that_cannot_be(exposures: tuple[float, ...]) -> None:
    with pytest.raises(UsageError, match="exposure"):
        EffectiveCamera.of(EIGHT_BIT, exposures)
