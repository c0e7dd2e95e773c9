"""Sensors: presets, files, contradictions, and what white means."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camctl.controls import Layout
from camctl.errors import DataError, UsageError
from sim.effects import effect_names
from sim.noise import largest_noise
from sim.render import Renderer
from sim.scenes.scene import Scene
from sim.scenes.view import View
from sim.sensors.sensor import Sensor, load_sensor, read_sensor, sensor_names

PLAIN: dict[str, Any] = {"name": "x", "bits": 8, "full_well_e": 10_000}


def test_presets() -> None:
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
    }
    for name in sensor_names():
        assert load_sensor(name).name == name


@pytest.mark.parametrize("bits", [4, 6, 8, 12])
def test_ideal_sensors_are_the_papers_linear_cameras(bits: int) -> None:
    sensor = load_sensor(f"ideal-{bits}")
    controls = sensor.controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    assert (controls.bits, controls.black, controls.white) == (bits, 0, 2**bits - 1)
    levels = np.arange(1, 2**bits) / 2**bits
    assert np.array_equal(controls.levels.levels, levels)
    assert (sensor.photon_noise, sensor.read_noise_e) == (False, 0.0)


def test_the_standard_sensor_has_the_levels_of_the_shipped_table() -> None:
    standard = load_sensor("standard").controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    ideal = load_sensor("ideal-8").controls((2, 2), is_coloured=False, photons_per_unit=1.0)
    assert standard.levels.fingerprint == ideal.levels.fingerprint
    assert load_sensor("standard").noise.electrons_per_level == pytest.approx(10_000 / 256)
    assert load_sensor("standard").noise.read_noise_levels == pytest.approx(3 * 256 / 10_000)


def test_noise_grows_with_gain_in_levels() -> None:
    plain, high = load_sensor("phone").noise_at(1.0), load_sensor("phone").noise_at(4.0)
    assert high.electrons_per_level == pytest.approx(plain.electrons_per_level / 4)
    assert high.read_noise_levels == pytest.approx(plain.read_noise_levels * 4)


def test_effects_are_told_as_they_are() -> None:
    def ran(name: str) -> set[str]:
        sensor = load_sensor(name)
        renderer = Renderer(View.of(Scene("s", np.ones((4, 4))), sensor), sensor)
        plan = renderer.plan(renderer.shot(0.01, 1.0, 0))
        assert [effect.name for effect in plan.effects] == list(effect_names())
        return {effect.name for effect in plan.effects if effect.ran}

    always = {"full well", "quantisation"}
    assert ran("ideal-8") == always
    assert ran("standard") == always | {"photon noise", "read noise"}
    assert ran("phone") == ran("standard") | {"colour mosaic", "black level"}
    assert ran("consumer") == ran("standard") | {"response curve"}


def test_layout_follows_the_scene_unless_the_sensor_says() -> None:
    assert load_sensor("standard").layout_for(True) is Layout.RGB
    assert load_sensor("standard").layout_for(False) is Layout.MONO
    assert load_sensor("phone").layout_for(False) is Layout.RGGB


def test_a_file_is_a_sensor_too(tmp_path: Path) -> None:
    sensor = load_sensor("phone")
    path = tmp_path / "mine.json"
    path.write_text(sensor.model_dump_json())
    assert load_sensor(path) == sensor


def test_unknown_names_are_told_the_near_ones() -> None:
    with pytest.raises(UsageError, match="did you mean ideal-6"):
        load_sensor("ideal6")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"electrons_per_dn": 1.0}, "contradicts.*1 x 256 levels = 256 electrons"),
        ({"electrons_per_dn": 1000.0}, "contradicts"),
        ({"bits": 3}, "bits: "),
        ({"bits": 17}, "bits: "),
        ({"bits": 10**9}, "bits: "),
        ({"bits": "many"}, "bits: "),
        ({"black": 255}, "black"),
        ({"black": 300, "electrons_per_dn": 40}, "leaves no room"),
        ({"phase": 1.0}, "phase: "),
        ({"full_well_e": 0}, "full_well_e: "),
        ({"full_well_e": float("nan")}, "full_well_e: "),
        ({"full_well_e": None}, "full_well_e: "),
        ({"read_noise_e": 5000.0}, "as large as the well"),
        ({"time_minimum_s": 2.0, "time_maximum_s": 1.0}, "above time_maximum_s"),
        ({"time_minimum_s": 1.5e-5}, "whole number of line_s"),
        ({"time_minimum_s": 1e-6}, "whole number of line_s"),
        ({"gain_maximum": 0.5}, "gain_maximum: "),
        ({"delay_frames": -1}, "delay_frames: "),
        ({"curve": "cubic"}, "curve: "),
        ({"curve": "srgb", "full_well_e": 5000, "electrons_per_dn": 39.0}, "beyond the ADC"),
        ({"curve": "srgb", "black": 8, "electrons_per_dn": 30.0}, "no black level"),
        ({"curve": [[0, 0], [0.5, 0.9], [1, 0.2]], "electrons_per_dn": 30.0}, "x"),
        ({"fullwell": 5}, "fullwell: "),
        ({"lens": {"vignetting": 1.0}}, "lens.vignetting: "),
        ({"lens": {"f_number": -2}}, "lens.f_number: "),
        ({"dark": {"temperature_c": 900}}, "dark.temperature_c: "),
        ({"dark": {"current_e_s": float("nan")}}, "dark.current_e_s: "),
        ({"dark": {"doubling_k": 0.1, "temperature_c": 90}}, "more than 100 doublings"),
        ({"pixels": {"prnu": 0.5}}, "pixels.prnu: "),
        ({"pixels": {"dsnu": 0.5}}, "pixels.dsnu: "),
        ({"pixels": {"dsnu_e": 3000}}, "noise of reading is as large as the well"),
        ({"read_out": {"nonlinearity_dn": 60}}, "more than an eighth"),
        (
            {"curve": "srgb", "electrons_per_dn": 30.0, "read_out": {"nonlinearity_dn": 1}},
            "nonlinearity in the curve",
        ),
        ({"spectrum": [[1, 0, 0], [0, 1, 0]]}, "spectrum: "),
        ({"spectrum": [[1, 0, 0], [0, 1, 0], [0, -1, 1]]}, "spectrum: "),
        ({"layout": "xtrans"}, "layout: "),
    ],
)
def test_contradictions_and_nonsense_are_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message) as error:
        read_sensor(json.dumps({**PLAIN, **change}), source="x.json")
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("x.json: ")


def test_files_that_are_no_sensor(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        load_sensor(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(DataError, match="not JSON, line 1"):
        load_sensor(tmp_path / "bad.json")
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(DataError):
        load_sensor(tmp_path / "list.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="cannot be read"):
        load_sensor(tmp_path / "binary.json")


def a_sensor(draw: Any) -> Sensor:
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


@settings(max_examples=60)
@given(st.data(), st.sampled_from([1.0, 1.7, 8.0]))
def test_a_full_well_reads_at_least_white_and_white_is_within_reach(
    data: st.DataObject, gain: float
) -> None:
    sensor = a_sensor(data.draw)
    flood = np.full(50_000, 1e12, dtype=np.float32)
    full = Renderer(flood, sensor, seed=data.draw(st.integers(0, 99))).frame(1.0, gain, 0)
    assert full.min() >= sensor.white
    assert sensor.black < sensor.white <= 2**sensor.bits - 1
    # The well without its read noise is not many noises above white.
    slack = (2 * largest_noise() * sensor.read_noise_e) / sensor.electrons_per_dn + 1
    well = sensor.black + sensor.phase + sensor.full_well_e / sensor.electrons_per_dn
    assert sensor.white >= min(2**sensor.bits - 1, well - slack)


def test_machine_vision_saturates_below_its_adc_and_still_varies_there() -> None:
    sensor = load_sensor("machine-vision")
    assert sensor.white < 2**sensor.bits - 1
    full = Renderer(np.full(50_000, 1e9, dtype=np.float32), sensor).frame(1.0, 1.0, 0)
    assert full.min() >= sensor.white
    assert full.std() > 0.5


@given(st.data())
def test_levels_lie_where_the_adc_steps(data: st.DataObject) -> None:
    """Brightness is how many levels are <= the irradiance, also with a black level and a phase."""
    sensor = a_sensor(data.draw).model_copy(update={"photon_noise": False, "read_noise_e": 0.0})
    assume(sensor.white - sensor.black > 3)
    controls = sensor.controls((1, 1), is_coloured=False, photons_per_unit=1.0)
    E = np.sort(np.random.default_rng(1).uniform(0, 1.2, 500))
    photons = (E * sensor.full_scale_e / sensor.quantum_efficiency).astype(np.float32)
    seen = Renderer(photons, sensor).frame(1.0, 1.0, 0)
    counted = np.searchsorted(controls.levels.levels, E, side="right")
    clipped = np.minimum(seen.astype(int), sensor.white) - sensor.black
    near_a_step = np.abs(E[:, None] - controls.levels.levels).min(axis=1) < 1e-6
    assert np.array_equal(clipped[~near_a_step], counted[~near_a_step])
