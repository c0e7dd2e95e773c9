"""The picture behind virtual devices is that of the simulated camera, bit for bit."""

import numpy as np
import pytest

from camctl.controls import ExposureSetting
from sim.camera import SimulatedCamera
from sim.devices.scenery import Exposer
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

TIMES = (0.001, 0.004, 0.0001, 0.001, 0.0123)


@pytest.mark.parametrize("sensor_name", ["standard", "machine-vision", "webcam", "complete"])
@pytest.mark.parametrize("scene_name", ["ramp", "moving-target", "colour-chart"])
def test_camera_and_exposer_show_the_same(sensor_name, scene_name):
    scene, sensor = load_scene(scene_name, (30, 40)), load_sensor(sensor_name)
    exposer = Exposer(scene, sensor, seed=5, repeat_noise=True)
    with SimulatedCamera(scene, sensor, seed=5, repeat_noise=True) as camera:
        frames = list(camera.shoot([ExposureSetting(time_s) for time_s in TIMES]))
        assert camera.controls.shape == exposer.shape
        assert camera.controls.layout is exposer.layout
    assert len({frame.pixels.sum() for frame in frames}) > 1
    for frame in frames:
        pixels = exposer.expose(frame.applied.time_s, frame.applied.gain)
        assert np.array_equal(pixels, frame.pixels)
        assert pixels.dtype == frame.pixels.dtype


def test_without_repeating_each_number_has_its_own_noise():
    scene, sensor = load_scene("ramp", (30, 40)), load_sensor("standard")
    exposer = Exposer(scene, sensor, seed=5)
    first, again, second = (exposer.expose(0.004, 1.0, number) for number in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, second)
    repeating = Exposer(scene, sensor, seed=5, repeat_noise=True)
    assert np.array_equal(repeating.expose(0.004, 1.0, 1), first)


def test_a_kept_picture_cannot_be_spoilt():
    exposer = Exposer(load_scene("ramp", (30, 40)), load_sensor("standard"), repeat_noise=True)
    assert exposer.expose(0.004) is exposer.expose(0.004)
    with pytest.raises(ValueError, match="read-only"):
        exposer.expose(0.004)[0, 0] = 1
