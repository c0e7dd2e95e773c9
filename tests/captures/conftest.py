"""A small simulated camera for the tests of the capture."""

import numpy as np
import pytest

from sim.camera import Faults, SimulatedCamera
from sim.scenes.scene import Scene
from sim.sensors.sensor import Sensor, load_sensor


def gradient(rows=60, columns=80, low=1e-3, colours=1):
    """A scene whose light falls from 1 to `low` evenly in its logarithm."""
    light = np.geomspace(1, low, rows * columns, dtype=np.float32).reshape(rows, columns)
    if colours == 3:
        light = np.stack([light, 0.7 * light, 0.5 * light], axis=-1)
    return light


@pytest.fixture
def make_camera():
    def make(sensor="standard", light=None, faults=None, seed=0, clock=None, **changes):
        model = load_sensor(sensor) if isinstance(sensor, str) else sensor
        model = Sensor.model_validate({**model.model_dump(), **changes})
        scene = Scene("test", gradient() if light is None else light, photons_per_unit=1e6)
        return SimulatedCamera(scene, model, faults=faults or Faults(), seed=seed, clock=clock)

    return make
