"""Frames: reproducible, monotone in exposure, and measured as EMVA 1288 measures a camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.controls import Layout
from camctl.errors import RefusedSettingError, UsageError
from sim.noise import TILE
from sim.render import Renderer, simulate_frame
from sim.scenes.scene import Scene, load_scene
from sim.scenes.view import light_on
from sim.sensors.parts import Dark, Lens, Pixels, ReadOut
from sim.sensors.sensor import Sensor, load_sensor, sensor_names


@pytest.mark.parametrize("name", sensor_names())
def test_one_seed_one_frame_whatever_the_threads(name: str) -> None:
    scene, sensor = load_scene("ball", (201, 307)), load_sensor(name)
    one, two = (simulate_frame(scene, sensor, 0.01, seed=5, threads=n) for n in (1, 2))
    assert np.array_equal(one.pixels, two.pixels)
    again = simulate_frame(scene, sensor, 0.01, seed=5)
    assert np.array_equal(one.pixels, again.pixels)
    noisy = sensor.photon_noise
    other_seed = simulate_frame(scene, sensor, 0.01, seed=6)
    other_frame = simulate_frame(scene, sensor, 0.01, seed=5, number=1)
    assert np.array_equal(one.pixels, other_seed.pixels) is not noisy
    assert np.array_equal(one.pixels, other_frame.pixels) is not noisy


def test_a_tile_is_the_same_in_a_larger_frame() -> None:
    sensor = load_sensor("standard")
    light = np.full(3 * TILE + 17, 3e5, dtype=np.float32)
    large = Renderer(light, sensor, seed=1).frame(0.01, 1.0, 4)
    small = Renderer(light[: TILE + 5], sensor, seed=1).frame(0.01, 1.0, 4)
    assert np.array_equal(large[: TILE + 5], small)


def test_what_a_seed_means_does_not_change() -> None:
    """The frame of a seed is part of what this program promises: reports name only the seed."""
    frame = simulate_frame(load_scene("ramp", (3, 4)), load_sensor("machine-vision"), 0.01, seed=1)
    assert frame.pixels.tolist() == [
        [343, 893, 1438, 2067],
        [355, 890, 1468, 2054],
        [333, 904, 1499, 2037],
    ]


@settings(max_examples=40)
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
    frame = Renderer(light, sensor, seed=seed).frame(lines * sensor.line_s, gain, 0)
    assert frame.dtype == (np.uint8 if sensor.bits <= 8 else np.uint16)
    assert frame.max() <= 2**sensor.bits - 1
    assert frame[-1] >= sensor.white


@settings(max_examples=40)
@given(st.sampled_from(sensor_names()), st.floats(1e-4, 5), st.floats(1, 50), st.floats(1, 8))
def test_more_exposure_is_never_darker(name: str, time: float, factor: float, gain: float) -> None:
    plain = {"photon_noise": False, "read_noise_e": 0.0}
    parts = {"lens": Lens(), "dark": Dark(), "pixels": Pixels(), "read_out": ReadOut()}
    sensor = load_sensor(name).model_copy(update=plain | parts)
    light = np.geomspace(1, 1e9, 4001, dtype=np.float32)
    renderer = Renderer(light, sensor)
    first = renderer.frame(time, 1.0, 0)
    assert np.all(np.diff(first.astype(int)) >= 0)
    assert np.all(renderer.frame(time * factor, 1.0, 0) >= first)
    assert np.all(renderer.frame(time, gain, 0) >= first)


@pytest.mark.parametrize("name", ["consumer", "gamma", "table"])
def test_a_curve_gives_exactly_the_levels_it_announces(name: str) -> None:
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
    seen = Renderer(photons, sensor).frame(1.0, 1.0, 0)
    counted = np.searchsorted(response.levels, E, side="right")
    distance = np.abs(np.log((E[:, None] + 1e-300) / (response.levels + 1e-300))).min(axis=1)
    clear = distance > 1e-6
    assert clear.mean() > 0.99
    assert np.array_equal(seen[clear], counted[clear])


def test_mono_sees_luminance() -> None:
    scene = Scene("s", np.array([[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]]), photons_per_unit=1e4)
    light = light_on(scene, Layout.MONO)
    assert light[0] == pytest.approx([2126, 7152, 722])


def test_rgb_sees_a_grey_scene_three_times() -> None:
    scene = Scene("s", np.array([[1.0, 2.0]]))
    assert light_on(scene, Layout.RGB).tolist() == [[[1, 1, 1], [2, 2, 2]]]


@pytest.mark.parametrize("layout", [layout for layout in Layout if layout.is_mosaic])
@pytest.mark.parametrize("shape", [(4, 6), (5, 3), (1, 1)])
def test_a_mosaic_samples_its_own_colour(layout: Layout, shape: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).random((*shape, 3)).astype(np.float32) + 1
    light = light_on(Scene("s", picture), layout)
    for row in range(shape[0]):
        for column in range(shape[1]):
            letter = layout.value[2 * (row % 2) + column % 2]
            assert light[row, column] == picture[row, column, "rgb".index(letter)]


@pytest.mark.parametrize("unit", [1e-43, 1e-30, 1e30, 3e38])
def test_a_map_may_be_in_any_unit(unit: float, tmp_path: Path) -> None:
    light = np.float32(unit) * np.linspace(0, 1, 200, dtype=np.float32).reshape(10, 20)
    np.save(tmp_path / "map.npy", light)
    np.save(tmp_path / "plain.npy", np.linspace(0, 1, 200, dtype=np.float32).reshape(10, 20))
    seen, plain = (
        simulate_frame(load_scene(tmp_path / name), load_sensor("ideal-8"), 0.01).pixels.astype(int)
        for name in ("map.npy", "plain.npy")
    )
    # Where float32 itself is that coarse the map is, too.
    assert np.abs(seen - plain).max() <= (4 if unit < 1e-40 else 1)


def test_rendering_leaves_the_scene_alone() -> None:
    scene = load_scene("ramp", (40, 50))
    before = scene.irradiance.copy()
    simulate_frame(scene, load_sensor("standard"), 0.01)
    assert np.array_equal(scene.irradiance, before)


def test_a_frame_says_what_it_had() -> None:
    frame = simulate_frame(load_scene("ball", (4, 6)), load_sensor("phone"), 0.01, gain=2.0)
    assert (frame.applied.gain, frame.black, frame.white) == (2.0, 64, 1023)
    assert frame.applied.time_s == pytest.approx(0.01)
    assert frame.pixels.shape == (4, 6)


def test_exposures_the_sensor_has_not_are_refused() -> None:
    scene, sensor = load_scene("ramp", (4, 4)), load_sensor("standard")
    with pytest.raises(RefusedSettingError, match="time_s"):
        simulate_frame(scene, sensor, 0.0100049)
    with pytest.raises(RefusedSettingError, match="gain"):
        simulate_frame(scene, sensor, 0.01, gain=2.0)
    with pytest.raises(UsageError, match="time_s"):
        simulate_frame(scene, sensor, -1.0)
    with pytest.raises(UsageError, match="seed"):
        simulate_frame(scene, sensor, 0.01, seed=-1)


@pytest.mark.parametrize(
    ("name", "gain"), [("machine-vision", 1.0), ("machine-vision", 4.0), ("phone", 1.0)]
)
def test_photon_transfer_gives_back_gain_and_read_noise(name: str, gain: float) -> None:
    """EMVA 1288: variance against mean of pairs of flat frames; slope 1/K, offset read noise."""
    sensor = load_sensor(name)
    means, variances = [], []
    for step, filled in enumerate([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5]):
        photons = filled * sensor.full_scale_e / sensor.quantum_efficiency / gain
        flat = Renderer(np.full(400_000, photons, dtype=np.float32), sensor, seed=step)
        first, second = (flat.frame(1.0, gain, number).astype(np.float64) for number in (0, 1))
        means.append((first.mean() + second.mean()) / 2)
        variances.append((first - second).var() / 2)
    slope, offset = np.polyfit(means, variances, 1)
    # The variance of a pair is known to sqrt(2 / 400,000) = 0.22 %; the fit does a little better.
    assert 1 / slope == pytest.approx(sensor.electrons_per_dn / gain, rel=0.007)
    quantisation = 1 / 12
    dark = variances[0] - quantisation
    assert np.sqrt(dark) == pytest.approx(
        sensor.read_noise_e * gain / sensor.electrons_per_dn, rel=0.01
    )
    # The ADC floors after its phase of 1/2: it rounds, and black is where it says.
    assert means[0] == pytest.approx(sensor.black, abs=0.02)
    assert offset == pytest.approx(variances[0] - slope * means[0], abs=0.02 * variances[-1])


def test_sensitivity_turns_frames_back_into_the_maps_own_units() -> None:
    scene = Scene("map", np.full((100, 200), 0.037), "arbitrary units", photons_per_unit=2.2e7)
    for name in ("standard", "machine-vision", "phone", "consumer"):
        sensor = load_sensor(name)
        controls = sensor.controls(scene.shape, is_coloured=False, photons_per_unit=2.2e7)
        frame = simulate_frame(scene, sensor, 0.01)
        levels = np.concatenate([[0.0], controls.levels.levels])
        E = levels[np.minimum(frame.pixels, frame.white).astype(int) - frame.black].mean()
        half_a_step = 0.5 / controls.levels.M if not sensor.phase else 0.0
        assert controls.sensitivity is not None
        estimate = (E + half_a_step) / (controls.sensitivity * frame.applied.time_s)
        assert estimate == pytest.approx(0.037, rel=0.02), name


def test_the_well_clips_before_the_gain() -> None:
    sensor = load_sensor("machine-vision").model_copy(
        update={"photon_noise": False, "read_noise_e": 0.0, "gain_step": 0.0}
    )
    photons = np.array([2.0, 1000.0]) * sensor.full_well_e / sensor.quantum_efficiency
    for gain in (1.0, 1.01):
        frame = Renderer(photons.astype(np.float32), sensor).frame(1.0, gain, 0)
        expected = int(
            sensor.black + sensor.phase + sensor.full_well_e * gain / sensor.electrons_per_dn
        )
        assert frame.tolist() == [expected, expected]
