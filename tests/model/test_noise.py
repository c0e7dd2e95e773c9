"""The noise model of a camera."""

from __future__ import annotations

import math

import pytest

from camctl import NoiseModel, UsageError
from camctl.sim.sensors.sensor import Sensor, load_sensor, sensor_names


def test_read_noise_between_gains_is_interpolated_over_the_logarithm() -> None:
    noise = NoiseModel(10.0, ((1.0, 8.0), (4.0, 4.0)))
    assert noise.read_noise(2.0) == pytest.approx(6.0)
    assert noise.read_noise(0.5) == 8.0
    assert noise.read_noise(16.0) == 4.0


def test_dark_current_adds_its_shot_noise() -> None:
    noise = NoiseModel(2.0, ((1.0, 3.0),), dark_current_e_s=8.0)
    assert noise.frame(gain=1.0, time_s=2.0).read_noise_levels == pytest.approx(5 / 2)


def test_the_pattern_of_the_dark_current_grows_with_time() -> None:
    noise = NoiseModel(2.0, dsnu_e=3.0, dcnu_e_s=8.0)
    assert noise.frame(gain=1.0, time_s=0.0).dsnu_levels == 3.0 / 2
    assert noise.frame(gain=4.0, time_s=0.5).dsnu_levels == pytest.approx(5.0 / 0.5)
    assert not NoiseModel(2.0, dcnu_e_s=1.0, photon_noise=False).is_none


def test_no_photon_noise_and_no_read_noise() -> None:
    frame = NoiseModel(1.0, photon_noise=False).frame(gain=2.0, time_s=1.0)
    assert (frame.electrons_per_level, frame.read_noise_levels) == (math.inf, 0.0)


@pytest.mark.parametrize(
    "values",
    [
        {"conversion_e_per_dn": 0.0},
        {"conversion_e_per_dn": math.nan},
        {"conversion_e_per_dn": math.inf},
        {"read_noise_e": ()},
        {"read_noise_e": ((2.0, 1.0), (1.0, 1.0))},
        {"read_noise_e": ((1.0, -1.0),)},
        {"full_well_e": 0.0},
        {"prnu": math.inf},
        {"dark_current_e_s": -1.0},
    ],
)
def test_impossible_values_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        NoiseModel(**{"conversion_e_per_dn": 1.0, **values})  # type: ignore[arg-type]


def test_an_ideal_sensor_keeps_its_read_noise() -> None:
    ideal = Sensor(name="x", bits=8, full_well_e=2560, photon_noise=False, read_noise_e=5.0)
    frame = ideal.noise_model.frame(gain=1.0, time_s=1.0)
    assert frame.read_noise_levels == pytest.approx(0.5)


@pytest.mark.parametrize("name", sensor_names())
def test_each_sensor_states_its_noise(name: str) -> None:
    sensor = load_sensor(name)
    frame = sensor.noise_model.frame(gain=2.0, time_s=0.0)
    expected = sensor.electrons_per_dn / 2 if sensor.photon_noise else math.inf
    assert frame.electrons_per_level == expected
