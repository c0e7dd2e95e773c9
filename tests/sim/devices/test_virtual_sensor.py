"""The pictures of a virtual device's sensor are those of the simulated camera, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

TIMES = (0.001, 0.004, 0.0001, 0.001, 0.0123)


@pytest.mark.parametrize("sensor_name", ["standard", "machine-vision", "webcam", "complete"])
@pytest.mark.parametrize("scene_name", ["ramp", "moving-target", "colour-chart"])
def test_pictures_are_those_of_the_simulated_camera(sensor_name: str, scene_name: str) -> None:
    scene, model = load_scene(scene_name, (30, 40)), load_sensor(sensor_name)
    sensor = VirtualSensor(scene, model, seed=5, repeat_noise=True)
    with SimulatedCamera(scene, model, seed=5, repeat_noise=True) as camera:
        frames = list(camera.shoot([ExposureSetting(time_s) for time_s in TIMES]))
        assert camera.controls.shape == sensor.shape
        assert camera.controls.layout is sensor.layout
    assert len({frame.pixels.sum() for frame in frames}) > 1
    for frame in frames:
        pixels = sensor.expose(frame.applied.time_s, frame.applied.gain)
        assert np.array_equal(pixels, frame.pixels)
        assert pixels.dtype == frame.pixels.dtype


def test_each_frame_has_its_own_noise_unless_it_is_repeated() -> None:
    scene, model = load_scene("ramp", (30, 40)), load_sensor("standard")
    sensor = VirtualSensor(scene, model, seed=5)
    first, again, second = (sensor.expose(0.004, 1.0, number) for number in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, second)
    repeating = VirtualSensor(scene, model, seed=5, repeat_noise=True)
    assert np.array_equal(repeating.expose(0.004, 1.0, 1), first)


def test_a_cached_picture_is_read_only() -> None:
    scene, model = load_scene("ramp", (30, 40)), load_sensor("standard")
    sensor = VirtualSensor(scene, model, repeat_noise=True)
    assert sensor.expose(0.004) is sensor.expose(0.004)
    with pytest.raises(ValueError, match="read-only"):
        sensor.expose(0.004)[0, 0] = 1
