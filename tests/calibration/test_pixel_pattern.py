"""The pattern of the pixels from two views of a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camctl.calibration.noise.pattern import View, sensitivity_pattern
from camctl.calibration.steps import PatternSteps, StepOptions
from camctl.errors import DataError
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureControls, Layout
from camctl.model.response.camera import FloatArray, linear_response
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.noise import DarkRecord, Figure, GainNoise, NoiseRecord
from camctl.profiles.profile import Profile, change_profile
from camctl.sim.camera import SimulatedCamera
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.scenes.view import View as SceneView
from camctl.sim.sensors.sensor import load_sensor

SHAPE = (200, 240)


def controls(layout: Layout = Layout.MONO) -> ExposureControls:
    with SimulatedCamera(Scene("even", np.ones(SHAPE, np.float32)), load_sensor("ideal-12")) as sim:
        found = sim.controls
    return replace(found, layout=layout, response=linear_response(12), black=0, white=4095)


def texture(rng: np.random.Generator) -> FloatArray:
    """Return light with contrast at all sizes, larger than a frame by 20 rows and columns."""
    rows, columns = SHAPE[0] + 20, SHAPE[1] + 20
    light = np.zeros((rows, columns))
    for size in (1, 4, 16, 64):
        blocks = rng.normal(0, 0.01 * size**0.5, (rows // size + 1, columns // size + 1))
        light += np.kron(blocks, np.ones((size, size)))[:rows, :columns]
    return np.asarray(np.exp(light - light.max()))


def view(
    light: FloatArray,
    pattern: FloatArray,
    rng: np.random.Generator,
    kind: Layout,
    dark_e: FloatArray | float = 0.0,
) -> View:
    """Return a view of frames of 1 s with a dark signal, at 20,000 electrons of full scale."""
    found = View(controls(kind))
    for _ in range(4):
        charge = 20_000 * light[: SHAPE[0], : SHAPE[1]] * pattern
        noisy = (rng.normal(charge, np.sqrt(charge)) + dark_e) / 20_000 * 4096
        found.add(np.clip(noisy, 0, 4095).astype(np.uint16), 1.0)
    return found


def noise_record(full_e: float, dark: DarkRecord | None = None) -> NoiseRecord:
    one = Figure(value=1.0, low=1.0, high=1.0)
    gain = GainNoise(gain=1.0, conversion_e_per_dn=one, read_noise_e=one, patches=1, misfit=1.0)
    return NoiseRecord(
        gains=(gain,),
        full_well_e=one.scaled(full_e),
        saturates=True,
        dark=dark,
        measured_at="today",
    )


@pytest.mark.parametrize("prnu", [0.0, 0.005, 0.02])
@pytest.mark.parametrize("layout", [Layout.MONO, Layout.RGGB])
def test_the_pattern_is_found_before_a_scene_with_contrast(prnu: float, layout: Layout) -> None:
    rng = np.random.default_rng(1)
    light, pattern = texture(rng), 1 + prnu * rng.normal(size=SHAPE)
    first, second = (view(light[by:, by:], pattern, rng, layout) for by in (0, 14))
    found = sensitivity_pattern(first, second)
    assert found.low <= prnu <= found.high
    assert found.value == pytest.approx(prnu, rel=0.1, abs=0.002)


@pytest.mark.parametrize("layout", [Layout.MONO, Layout.RGGB])
def test_the_patterns_of_the_dark_signal_are_no_part_of_it(layout: Layout) -> None:
    rng = np.random.default_rng(1)
    light, pattern = texture(rng), 1 + 0.005 * rng.normal(size=SHAPE)
    dark_e = rng.normal(0, 80, SHAPE) + rng.normal(0, 120, SHAPE)
    first, second = (view(light[by:, by:], pattern, rng, layout, dark_e) for by in (0, 14))
    one = Figure(value=1.0, low=1.0, high=1.0)
    dark = DarkRecord(
        gain=1.0,
        times_s=(0.0, 2.0),
        dark_current_e_s=one,
        dsnu_e=one.scaled(80),
        dcnu_e_s=one.scaled(120),
        black_dn=0.0,
        hot_pixels=(),
        measured_at="today",
    )
    assert sensitivity_pattern(first, second).low > 0.006
    found = sensitivity_pattern(first, second, noise_record(20_000, dark))
    assert found.low <= 0.005 <= found.high < 0.006


def test_two_equal_views_are_refused() -> None:
    rng = np.random.default_rng(1)
    light, pattern = texture(rng), np.ones(SHAPE)
    first, second = (view(light, pattern, rng, Layout.MONO) for _ in range(2))
    with pytest.raises(DataError, match="both views show the same"):
        sensitivity_pattern(first, second)


def test_dark_views_are_refused() -> None:
    rng = np.random.default_rng(1)
    first, second = (view(np.full(SHAPE, 0.01), np.ones(SHAPE), rng, Layout.MONO) for _ in range(2))
    with pytest.raises(DataError, match="only 0 of"):
        sensitivity_pattern(first, second)


@pytest.mark.parametrize("is_turned", [True, False])
def test_the_step_keeps_what_the_turned_camera_shows(
    is_turned: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))
    sensor = load_sensor("ccd")
    light = load_scene("tile-floor", (SHAPE[0] + 20, SHAPE[1] + 20)).irradiance
    light = (light / np.quantile(light, 0.99) * 1e6).astype(np.float32)
    scenes = [
        Scene("tiles", np.ascontiguousarray(light[by : by + SHAPE[0], by : by + SHAPE[1]]))
        for by in (0, 13)
    ]
    record = noise_record(1.0)
    camera: Camera
    with SimulatedCamera(scenes[0], sensor) as camera:
        mode = exposure_mode(camera.controls)
        change_profile(camera.info, lambda profile: profile.noises.update({mode: record}))

        def turn() -> bool:
            camera._renderer = Renderer(SceneView.of(scenes[1], sensor), sensor)
            return is_turned

        steps, options = PatternSteps(), StepOptions(longest_s=0.5, turn=turn)
        steps.first_view(camera, options, None)
        found = steps.second_view(camera, options, None)
    assert (found is not None) == is_turned
    if found is not None:
        profile = Profile.model_construct(noises={mode: record})
        found.keep(profile)
        kept = profile.noises[mode].prnu
        assert kept is not None
        assert kept.value == pytest.approx(sensor.pixels.prnu, rel=0.1)
