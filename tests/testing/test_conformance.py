"""The conformance suite on simulated cameras of every kind."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from camctl.testing.conformance import CameraConformance
from sim.camera import SimulatedCamera
from sim.scenes.scene import Scene
from sim.sensors.sensor import Sensor, load_sensor


class Steady(CameraConformance):
    sensor = "standard"
    changes: Mapping[str, object] = MappingProxyType({})

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.02)

    def open_camera(self):
        model = load_sensor(self.sensor)
        model = Sensor.model_validate({**model.model_dump(), **self.changes})
        controls = model.controls((24, 32), is_coloured=True, photons_per_unit=1.0)
        light = np.linspace(0.2, 0.7, 24 * 32 * 3, dtype=np.float32).reshape(24, 32, 3)
        # Full scale in the middle exposure lies at irradiance 1.2.
        scene = Scene("steady", light, photons_per_unit=1 / (controls.sensitivity * 0.02 * 1.2))
        return SimulatedCamera(scene, model, seed=3)


class TestStandard(Steady):
    pass


class TestNoDelay(Steady):
    changes = MappingProxyType({"delay_frames": 0})


class TestLongDelay(Steady):
    changes = MappingProxyType({"delay_frames": 5})


class TestUnsteadyDelay(Steady):
    changes = MappingProxyType({"delay_frames": 1, "delay_jitter_frames": 2})


class TestMosaicWithBlackLevel(Steady):
    sensor = "phone"


class TestTwelveBits(Steady):
    sensor = "machine-vision"


class TestFourBits(Steady):
    sensor = "ideal-4"


class TestNonLinear(Steady):
    sensor = "consumer"
