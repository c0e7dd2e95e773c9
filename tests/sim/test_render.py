"""Frames are reproducible, monotone in exposure, and within the range of the ADC."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import some

from camctl.errors import UsageError
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.sim.effects.budget import plan_frame
from camctl.sim.noise import TILE
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import RELATIVE, Scene, load_scene
from camctl.sim.scenes.view import View, photons_per_unit
from camctl.sim.sensors import parts
from camctl.sim.sensors.sensor import Sensor, load_sensor, sensor_names

STANDARD = load_sensor("standard")
LEFT_OUT = ((), ("veiling glare", "PRNU"), ("point spread", "DSNU"))


def frame_of(
    scene: Scene, sensor: Sensor, time_s: float = 0.01, *, seed: int = 0, number: int = 0
) -> Pixels:
    return Renderer(View.of(scene, sensor), sensor, seed=seed).frame(time_s, 1.0, number)


@pytest.mark.parametrize("name", some(sensor_names(), every=3))
def test_a_frame_depends_on_seed_and_number_but_not_on_threads(name: str) -> None:
    scene, sensor = load_scene("ball", (390, 700)), load_sensor(name)
    view = View.of(scene, sensor)
    assert view.light.size > TILE  # one tile has one thread
    time_s = min(0.01, sensor.full_well_e * 1e-6)
    one, two = (Renderer(view, sensor, seed=5, threads=n).frame(time_s, 1.0, 0) for n in (1, 2))
    assert np.array_equal(one, two)
    assert np.array_equal(one, frame_of(scene, sensor, time_s, seed=5))
    other_seed = frame_of(scene, sensor, time_s, seed=6)
    other_frame = frame_of(scene, sensor, time_s, seed=5, number=1)
    assert np.array_equal(one, other_seed) is not sensor.photon_noise
    assert np.array_equal(one, other_frame) is not sensor.photon_noise


@given(
    st.sampled_from(sensor_names()),
    st.sampled_from([1.0, 4.0]),
    st.integers(0, 2**64 - 1),
    st.integers(100, 100_000),
)
def test_samples_stay_within_the_adc(name: str, gain: float, seed: int, lines: int) -> None:
    sensor = load_sensor(name)
    light = np.geomspace(1e-3, 1e25, 4001, dtype=np.float32)
    light[0] = 0
    frame = Renderer(View(light), sensor, seed=seed).frame(lines * sensor.line_s, gain, 0)
    assert frame.dtype == (np.uint8 if sensor.bits <= 8 else np.uint16)
    assert frame.max() <= 2**sensor.bits - 1
    assert frame[-1] >= sensor.white or sensor.read_out.reset_s > 0  # then the sun is black


@given(st.sampled_from(sensor_names()), st.floats(1e-4, 5), st.floats(1, 50), st.floats(1, 8))
def test_more_exposure_is_never_darker(name: str, time: float, factor: float, gain: float) -> None:
    plain = {"photon_noise": False, "read_noise_e": 0.0}
    absent = {
        "lens": parts.Lens(),
        "dark": parts.Dark(),
        "pixels": parts.Pixels(),
        "read_out": parts.ReadOut(),
    }
    sensor = load_sensor(name).model_copy(update=plain | absent)
    light = np.geomspace(1, 1e9, 4001, dtype=np.float32)
    renderer = Renderer(View(light), sensor)
    first = renderer.frame(time, 1.0, 0)
    assert np.all(np.diff(first.astype(int)) >= 0)
    assert np.all(renderer.frame(time * factor, 1.0, 0) >= first)
    assert np.all(renderer.frame(time, gain, 0) >= first)


@pytest.mark.parametrize("name", ["consumer", "gamma", "table"])
def test_brightness_of_a_curve_is_exactly_the_levels_of_its_response(name: str) -> None:
    curves = {
        "gamma": 0.45,
        "table": ((0.0, 0.0), (1e-4, 0.3), (0.5, 0.6), (1.0, 1.0)),
        "consumer": "srgb",
    }
    base = load_sensor("consumer").model_dump() | {"curve": curves[name], "photon_noise": False}
    sensor = Sensor.model_validate(base | {"read_noise_e": 0.0})
    response = sensor.response
    assert response is not None
    E = np.concatenate([np.linspace(0, 1.05, 20_011), np.geomspace(1e-7, 1, 5000)])
    photons = (E * sensor.full_scale_e / sensor.quantum_efficiency).astype(np.float32)
    seen = Renderer(View(photons), sensor).frame(1.0, 1.0, 0)
    counted = np.searchsorted(response.levels, E, side="right")
    distance = np.abs(np.log((E[:, None] + 1e-300) / (response.levels + 1e-300))).min(axis=1)
    clear = distance > 1e-6
    assert clear.mean() > 0.99
    assert np.array_equal(seen[clear], counted[clear])


def with_layout(layout: Layout) -> Sensor:
    return STANDARD.model_copy(update={"layout": layout})


def test_a_mono_sensor_sees_luminance() -> None:
    scene = Scene("s", np.array([[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]]), photons_per_unit=1e4)
    light = View.of(scene, with_layout(Layout.MONO)).light
    assert light[0] == pytest.approx([2126, 7152, 722])


def test_an_rgb_sensor_sees_a_grey_scene_in_three_equal_channels() -> None:
    light = View.of(Scene("s", np.array([[1.0, 2.0]])), with_layout(Layout.RGB)).light
    assert light.tolist() == [[[1, 1, 1], [2, 2, 2]]]


@pytest.mark.parametrize("layout", [layout for layout in Layout if layout.is_mosaic])
@pytest.mark.parametrize("shape", [(4, 6), (5, 3), (1, 1)])
def test_each_pixel_of_a_mosaic_sees_its_own_colour(layout: Layout, shape: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).random((*shape, 3)).astype(np.float32) + 1
    light = View.of(Scene("s", picture), with_layout(layout)).light
    for row in range(shape[0]):
        for column in range(shape[1]):
            letter = layout.value[2 * (row % 2) + column % 2]
            assert light[row, column] == picture[row, column, "rgb".index(letter)]


@pytest.mark.parametrize("unit", [1e-43, 1e-30, 1e30, 3e38])
def test_the_unit_of_a_radiance_map_does_not_matter(unit: float, tmp_path: Path) -> None:
    light = np.float32(unit) * np.linspace(0, 1, 200, dtype=np.float32).reshape(10, 20)
    np.save(tmp_path / "map.npy", light)
    np.save(tmp_path / "plain.npy", np.linspace(0, 1, 200, dtype=np.float32).reshape(10, 20))
    seen, plain = (
        frame_of(load_scene(tmp_path / name), load_sensor("ideal-8")).astype(int)
        for name in ("map.npy", "plain.npy")
    )
    # Below 1e-38 float32 itself has fewer digits.
    assert np.abs(seen - plain).max() <= (4 if unit < 1e-40 else 1)


def test_rendering_does_not_change_the_scene() -> None:
    scene = load_scene("ramp", (40, 50))
    before = scene.irradiance.copy()
    frame_of(scene, STANDARD)
    assert np.array_equal(scene.irradiance, before)


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(UsageError, match=rf"invalid seed {seed}; expected 0 to 2\^64 - 1"):
        Renderer(View(np.ones(4, dtype=np.float32)), STANDARD, seed=seed)


def test_sensitivity_converts_frames_to_the_units_of_the_map() -> None:
    scene = Scene("map", np.full((100, 200), 0.037), RELATIVE, photons_per_unit=5e3)
    for name in ("standard", "machine-vision", "phone", "consumer", "qcmos"):
        sensor = load_sensor(name)
        photons = photons_per_unit(scene, sensor)
        assert photons == 5e3 * sensor.photons_per_candela
        controls = sensor.controls(scene.shape, is_coloured=False, photons_per_unit=photons)
        frame = frame_of(scene, sensor)
        levels = np.concatenate([[0.0], controls.levels.levels])
        E = levels[np.minimum(frame, sensor.white).astype(int) - sensor.black].mean()
        half_a_step = 0.5 / controls.levels.M if not sensor.phase else 0.0
        assert controls.sensitivity is not None
        estimate = (E + half_a_step) / (controls.sensitivity * 0.01)
        assert estimate == pytest.approx(0.037, rel=0.02), name


def test_the_well_clips_before_the_gain() -> None:
    sensor = load_sensor("machine-vision").model_copy(
        update={"photon_noise": False, "read_noise_e": 0.0, "gain_step": 0.0}
    )
    photons = np.array([2.0, 1000.0]) * sensor.full_well_e / sensor.quantum_efficiency
    for gain in (1.0, 1.01):
        frame = Renderer(View(photons.astype(np.float32)), sensor).frame(1.0, gain, 0)
        expected = int(
            sensor.black + sensor.phase + sensor.full_well_e * gain / sensor.electrons_per_dn
        )
        assert frame.tolist() == [expected, expected]


@pytest.mark.parametrize(
    ("scene", "sensor"),
    some(
        product(
            ("ball", "moving-target", "night-street"), ("complete", "mobile", "ccd", "security")
        ),
        every=3,
    ),
)
def test_frames_are_the_same_whatever_is_kept_between_them(scene: str, sensor: str) -> None:
    """With no cache, with one that is full before all is kept, and with all kept."""
    chosen = load_sensor(sensor)
    view = View.of(load_scene(scene, (60, 90)), chosen)
    frames = []
    for cache_bytes in (0, 30_000, 1 << 28):
        renderer = Renderer(view, chosen, seed=3, threads=1, cache_bytes=cache_bytes)
        taken = []
        for number, time_s in enumerate((0.002, 0.02, 0.5, 0.02)):
            shot = renderer.shot(time_s, 1.0, number, start_s=number / 30)
            plans = [plan_frame(shot, 0.0, left_out=names) for names in LEFT_OUT]
            taken += [renderer.expose(shot, plan) for plan in plans]
        frames.append(taken)
        assert renderer._cache.used_bytes <= cache_bytes
    for others in frames[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(frames[0], others, strict=True))


def test_the_light_of_a_scene_at_rest_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = load_sensor("complete")
    calls = []
    blur = cv2.sepFilter2D

    def counted(*args: Any, **kwargs: Any) -> Any:
        calls.append(args)
        return blur(*args, **kwargs)

    monkeypatch.setattr(cv2, "sepFilter2D", counted)
    for name, computed in (("ball", 1), ("moving-target", 3)):
        calls.clear()
        renderer = Renderer(View.of(load_scene(name, (40, 60)), sensor), sensor)
        for number in range(3):
            renderer.frame(0.01, 1.0, number)
        assert len(calls) == 2 * computed  # glare and point spread
