"""Lines that came twice are found by their noise; equal lines without noise are the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camctl.evidence.damage import Repeat, repeated_lines
from camctl.interface.camera import Pixels
from camctl.interface.controls import ExposureSetting
from camctl.model.noise import FrameNoise
from camctl.model.sensor import SensorModel
from camctl.sim.camera import SimulatedCamera
from camctl.sim.damage import damaged
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

MODES = [("standard", 0.02), ("standard", 2.0), ("machine-vision", 0.3), ("phone", 0.02)]


def taken(sensor: str, time_s: float) -> tuple[Pixels, SensorModel, FrameNoise]:
    camera = SimulatedCamera(load_scene("tile-floor", (120, 160)), load_sensor(sensor), seed=1)
    setting = [ExposureSetting(time_s)]
    (frame,) = camera.shoot(setting)
    controls = camera.controls
    scale = SensorModel(controls.levels, controls.black)
    return frame.pixels, scale, controls.frame_noise(setting)[0]


@pytest.mark.parametrize(("sensor", "time_s"), MODES)
def test_lines_that_came_twice_are_found_and_no_others(sensor: str, time_s: float) -> None:
    pixels, scale, noise = taken(sensor, time_s)
    assert not repeated_lines(pixels, scale, noise)
    found = repeated_lines(damaged(pixels, "double", 8, scale.white), scale, noise)
    first = min(found).line
    assert 36 <= first < 84  # it begins in 30 to 70 % of the height
    assert found == {Repeat(line, line - 12) for line in range(first, first + 12)}


@pytest.mark.parametrize("times", [3, 8])
def test_what_compression_and_enlargement_make_equal_came_once(times: int) -> None:
    pixels, scale, noise = taken("standard", 0.02)
    assert not repeated_lines(np.repeat(pixels[::times], times, axis=0), scale, noise)


@pytest.mark.parametrize("factor", [2, 1.5, 1.2, 1.37])
@pytest.mark.parametrize("is_dark", [False, True])
def test_lines_that_come_twice_all_over_a_frame_are_how_it_is_made(
    factor: float, is_dark: bool
) -> None:
    pixels, scale, noise = taken("standard", 0.3)
    if is_dark:
        pixels[:90] = 0
    lines = (np.arange(pixels.shape[0]) / factor).astype(np.intp)
    assert not repeated_lines(pixels[lines], scale, noise)
    single = np.arange(pixels.shape[0])
    single[100:] -= 1
    assert repeated_lines(pixels[single], scale, noise) == {Repeat(100, 99)}


def test_without_noise_equal_lines_are_the_scene() -> None:
    pixels, scale, noise = taken("standard", 0.02)
    twice = damaged(pixels, "double", 8, scale.white)
    none = replace(noise, electrons_per_level=float("inf"), read_noise_levels=0.0)
    assert not repeated_lines(twice, scale, none)
    dark = np.zeros_like(pixels)
    assert not repeated_lines(dark, scale, noise)
    assert not repeated_lines(dark + np.uint8(scale.white), scale, noise)
    few = np.arange(pixels.shape[0])[:, None] + np.zeros_like(pixels)
    few[1] = few[0]
    assert not repeated_lines(few[:, :1], scale, noise)  # one sample may be equal by chance
