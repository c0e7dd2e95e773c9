"""Sensors: built-in ones, files, contradictions, white level and response levels."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from camctl.errors import DataError, UsageError
from camctl.interface.controls import Layout
from camctl.sim.effects import effect_names
from camctl.sim.noise import largest_noise
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import Scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import ROUNDING_SHARE, Sensor, load_sensor, sensor_names

VALID: dict[str, Any] = {"name": "x", "bits": 8, "full_well_e": 10_000}


def test_sensor_names() -> None:
    assert set(sensor_names()) == {
        "ideal-4",
        "ideal-6",
        "ideal-8",
        "ideal-12",
        "standard",
        "complete",
        "mobile",
        "ccd",
        "webcam",
        "machine-vision",
        "phone",
        "consumer",
        "qcmos",
        "quanta-1",
        "quanta-3",
        "security",
    }
    for name in sensor_names():
        assert load_sensor(name).name == name


@pytest.mark.parametrize("bits", [4, 6, 8, 12])
def test_ideal_sensors_are_the_linear_cameras_of_the_paper(bits: int) -> None:
    sensor = load_sensor(f"ideal-{bits}")
    controls = sensor.controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    assert (controls.bits, controls.black, controls.white) == (bits, 0, 2**bits - 1)
    levels = np.arange(1, 2**bits) / 2**bits
    assert np.array_equal(controls.levels.levels, levels)
    assert (sensor.photon_noise, sensor.read_noise_e) == (False, 0.0)


def test_the_standard_sensor_has_the_levels_of_an_ideal_one() -> None:
    standard = load_sensor("standard").controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    ideal = load_sensor("ideal-8").controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    assert standard.levels.fingerprint == ideal.levels.fingerprint


def test_a_frame_has_the_effects_that_its_sensor_has() -> None:
    def ran(name: str) -> set[str]:
        sensor = load_sensor(name)
        renderer = Renderer(View.of(Scene("s", np.ones((4, 4), dtype=np.float32)), sensor), sensor)
        plan = renderer.plan(renderer.shot(0.01, 1.0, 0))
        assert [effect.name for effect in plan.effects] == list(effect_names())
        return {effect.name for effect in plan.effects if effect.ran}

    always = {"quantisation"}  # the full well is left out: this light does not reach it
    assert ran("ideal-8") == always
    assert ran("standard") == always | {"photon noise", "read noise"}
    assert ran("phone") == ran("standard") | {"colour mosaic", "black level"}
    assert ran("consumer") == ran("standard") | {"response curve"}


def test_the_layout_follows_the_scene_unless_the_sensor_has_one() -> None:
    assert load_sensor("standard").layout_for(True) is Layout.RGB
    assert load_sensor("standard").layout_for(False) is Layout.MONO
    assert load_sensor("phone").layout_for(False) is Layout.RGGB


def test_a_sensor_can_be_written_to_a_file_and_loaded(tmp_path: Path) -> None:
    sensor = load_sensor("phone")
    path = tmp_path / "mine.json"
    path.write_text(sensor.model_dump_json())
    assert load_sensor(path) == sensor


def test_the_error_for_an_unknown_name_suggests_a_similar_one() -> None:
    with pytest.raises(UsageError, match="unknown sensor 'ideal6'; did you mean ideal-6"):
        load_sensor("ideal6")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"electrons_per_dn": 1.0},
            "full_well_e 10000 contradicts electrons_per_dn 1 x 256 levels",
        ),
        ({"electrons_per_dn": 1000.0}, "full_well_e 10000 contradicts electrons_per_dn 1000 x 256"),
        ({"bits": 17}, "bits: input should be less than or equal to 16"),
        ({"black": 255}, "a black level of 255 leaves no room in 8 bits"),
        ({"full_well_e": float("nan")}, "full_well_e: input should be a finite number"),
        ({"read_noise_e": 5000.0}, "read noise and offsets are as large as the full well"),
        ({"time_minimum_s": 2.0, "time_maximum_s": 1.0}, "time_minimum_s is above time_maximum_s"),
        ({"time_minimum_s": 1.5e-5}, "time_minimum_s must be a whole number of line_s"),
        ({"curve": [], "electrons_per_dn": 30.0}, "curve of x: expected two or more rows"),
        ({"curve": "cubic"}, "curve: input should be 'linear' or 'srgb'"),
        (
            {"curve": "srgb", "full_well_e": 5000, "electrons_per_dn": 39.0},
            "a sensor with a curve needs a full well beyond the ADC's range",
        ),
        (
            {"curve": "srgb", "black": 8, "electrons_per_dn": 30.0},
            "a sensor with a curve has no black level",
        ),
        (
            {"curve": [[0, 0], [0.5, 0.9], [1, 0.2]], "electrons_per_dn": 30.0},
            "curve of x: ",
        ),
        ({"fullwell": 5}, "fullwell: unknown field"),
        ({"shape": [0, 5]}, "shape.0: input should be greater than or equal to 1"),
        ({"dark": {"current_e_s": float("nan")}}, "dark.current_e_s: input should be"),
        (
            {"dark": {"doubling_k": 0.1, "temperature_c": 90}},
            "dark: temperature_c is 650 doublings from reference_c: expected at most 60",
        ),
        ({"pixels": {"dsnu": 0.5}}, "pixels.dsnu: unknown field"),
        ({"pixels": {"dsnu_e": 3000}}, "read noise and offsets are as large as the full well"),
        (
            {"read_out": {"nonlinearity_dn": 60}},
            "read_out.nonlinearity_dn is more than an eighth of the ADC's range",
        ),
        (
            {"curve": "srgb", "electrons_per_dn": 30.0, "read_out": {"nonlinearity_dn": 1}},
            "a sensor with a curve has no other non-linearity: leave out read_out.nonlinearity_dn",
        ),
        ({"spectrum": [[1, 0, 0], [0, 1, 0]]}, "spectrum.2: field required"),
        ({"layout": "xtrans"}, "layout: input should be 'mono'"),
    ],
)
def test_an_invalid_sensor_file_is_one_line_of_error(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = tmp_path / "x.json"
    path.write_text(json.dumps({**VALID, **change}))
    with pytest.raises(DataError) as error:
        load_sensor(path)
    assert str(error.value).startswith(f"{path}: {message}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b'{"a":' * 60_000, "not JSON: recursion limit exceeded at line 1"),
        (b'{"bits": ' + b"9" * 5000 + b"}", "not JSON: number out of range at line 1"),
        (b"{", "not JSON: EOF while parsing an object at line 1"),
        (b"[]", "input should be a valid dictionary"),
        (b"\xff\xfe\x00", "it is not a text file"),
    ],
    ids=["missing", "nested", "long number", "not JSON", "a list", "binary"],
)
def test_a_file_that_is_no_sensor_is_refused(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    path = tmp_path / "bad.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DataError) as error:
        load_sensor(path)
    assert f"{path}: {message}" in str(error.value)


@st.composite
def sensors(draw: st.DrawFn) -> Sensor:
    bits = draw(st.integers(4, 14))
    black = draw(st.integers(0, 2**bits // 4))
    per_dn = draw(st.floats(0.5, 100))
    range_e = per_dn * (2**bits - black)
    return Sensor(
        name="any",
        bits=bits,
        black=black,
        phase=draw(st.sampled_from([0.0, 0.25, 0.5])),
        electrons_per_dn=per_dn,
        full_well_e=range_e * draw(st.floats(0.3, 2.0)),
        read_noise_e=draw(st.floats(0, range_e / 60)),
        gain_maximum=8.0,
    )


# A full well that is a whole number of DN in exact arithmetic, and may be less in float32.
BARELY_8_DN = Sensor(name="any", bits=4, electrons_per_dn=1.0, full_well_e=math.nextafter(8.0, 9.0))


@given(sensor=sensors(), gain=st.sampled_from([1.0, 1.7, 8.0]), seed=st.integers(0, 99))
@example(sensor=BARELY_8_DN, gain=1.0, seed=0)
def test_white_is_the_highest_level_that_each_full_pixel_reaches_for_certain(
    sensor: Sensor, gain: float, seed: int
) -> None:
    flood = View(np.full(50_000, 1e12, dtype=np.float32))
    full = Renderer(flood, sensor, seed=seed).frame(1.0, gain, 0)
    assert full.min() >= sensor.white
    top = 2**sensor.bits - 1
    assert sensor.black < sensor.white <= top
    # Below the top, noise and rounding can keep a full pixel under the next level.
    least_e = sensor.full_well_e - largest_noise() * sensor.read_noise_e
    least_dn = least_e / sensor.electrons_per_dn * (1 - ROUNDING_SHARE)
    assert sensor.white == top or sensor.black + sensor.phase + least_dn < sensor.white + 1


def test_a_full_pixel_of_machine_vision_varies_above_white() -> None:
    sensor = load_sensor("machine-vision")
    assert sensor.white < 2**sensor.bits - 1
    full = Renderer(View(np.full(50_000, 1e9, dtype=np.float32)), sensor).frame(1.0, 1.0, 0)
    assert full.min() >= sensor.white
    assert full.std() > 0.5


@given(sensors())
def test_brightness_is_the_number_of_response_levels_up_to_the_irradiance(sensor: Sensor) -> None:
    sensor = sensor.model_copy(update={"photon_noise": False, "read_noise_e": 0.0})
    assume(sensor.white - sensor.black > 3)
    controls = sensor.controls((1, 1), is_coloured=False, photons_per_unit=1.0)
    E = np.sort(np.random.default_rng(1).uniform(0, 1.2, 500))
    photons = (E * sensor.full_scale_e / sensor.quantum_efficiency).astype(np.float32)
    seen = Renderer(View(photons), sensor).frame(1.0, 1.0, 0)
    counted = np.searchsorted(controls.levels.levels, E, side="right")
    clipped = np.minimum(seen.astype(int), sensor.white) - sensor.black
    near_a_step = np.abs(E[:, None] - controls.levels.levels).min(axis=1) < 1e-6
    assert np.array_equal(clipped[~near_a_step], counted[~near_a_step])
