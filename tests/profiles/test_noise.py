"""The record of a measured noise, its products, and the noise model that is made from it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from camctl.profiles.noise import DarkRecord, Figure, GainNoise, NoiseRecord


def figure(value: float, share: float = 0.01) -> Figure:
    return Figure(value=value, low=value * (1 - share), high=value * (1 + share))


def at_gain(gain: float, conversion: float = 6.0, read_noise: float = 5.0) -> GainNoise:
    return GainNoise(
        gain=gain,
        conversion_e_per_dn=figure(conversion),
        read_noise_e=figure(read_noise),
        patches=1000,
        misfit=1.0,
    )


def record(*gains: GainNoise, **more: Any) -> NoiseRecord:
    return NoiseRecord(
        gains=gains, full_well_e=figure(6000.0), saturates=True, measured_at="2026-11-22", **more
    )


DARK = DarkRecord(
    gain=1.0,
    times_s=(0.1, 1.0),
    dark_current_e_s=figure(3.0),
    dsnu_e=figure(1.5),
    black_dn=64.0,
    hot_pixels=(),
    measured_at="2026-11-22",
)


def test_levels_of_the_model_are_those_measured_where_a_gain_is_not_as_stated() -> None:
    # The gain that is stated as 4 is 3.8: a level there has 6 / 3.8 electrons.
    model = record(at_gain(1.0), at_gain(4.0, 6.0 / 3.8, 4.0), dark=DARK).noise_model()
    assert model.conversion_e_per_dn == 6.0
    assert model.frame(gain=4.0, time_s=0.0).read_noise_levels == pytest.approx(4.0 * 3.8 / 6.0)
    assert (model.dark_current_e_s, model.dsnu_e, model.full_well_e) == (3.0, 1.5, 6000.0)


def test_conversion_of_the_model_is_at_gain_1_where_that_was_not_measured() -> None:
    model = record(at_gain(2.0, 3.0)).noise_model()
    assert model.conversion_e_per_dn == 6.0
    assert model.frame(gain=2.0, time_s=0.0).electrons_per_level == 3.0


def test_figures_of_the_standard() -> None:
    emva = record(at_gain(1.0), at_gain(4.0, 1.5)).emva()
    least = math.hypot(5.0, 6.0 / math.sqrt(12)) + 0.5
    assert emva["sensitivity_threshold_e"].value == pytest.approx(least)
    assert emva["dynamic_range"].value == pytest.approx(6000 / least)
    assert emva["snr_max"].value == pytest.approx(math.sqrt(6000))


def test_later_measurement_keeps_what_it_lacks() -> None:
    earlier = record(at_gain(1.0, 7.0), at_gain(8.0, 0.75), dark=DARK, prnu=figure(0.01))
    joined = record(at_gain(1.0)).joined(earlier)
    assert [each.gain for each in joined.gains] == [1.0, 8.0]
    assert joined.reference.conversion_e_per_dn.value == 6.0
    assert joined.dark == DARK
    assert joined.prnu == figure(0.01)


@given(st.floats(0, 1e6), st.floats(0, 1e6), st.floats(0, 0.5), st.floats(0, 0.5))
def test_product_of_figures_contains_its_value(a: float, b: float, s: float, t: float) -> None:
    found = figure(a, s).times(figure(b, t))
    assert found.value == a * b
    assert found.low <= found.value <= found.high


@pytest.mark.parametrize(
    "changes",
    [
        {"gains": []},
        {"gains": [at_gain(2.0).model_dump(), at_gain(1.0).model_dump()]},
        {"gains": [at_gain(1.0, 0.0).model_dump()]},
        {"full_well_e": {"value": 1.0, "low": 2.0, "high": 3.0}},
        {"version": 2},
        {"sepia": 1},
    ],
)
def test_contradicting_records_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        NoiseRecord.model_validate({**record(at_gain(1.0)).model_dump(), **changes})
