"""The effective camera is a camera: the conformance suite, a capture with it, its options."""

from __future__ import annotations

import numpy as np
import pytest

import camctl
from camctl.errors import CamctlError
from camctl.interface.camera import Camera
from camctl.livestream.camera import EffectiveCamera, EffectiveOptions
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.testing.conformance import CameraConformance


class TestEffective(CameraConformance):
    """Over a simulated camera; full scale of its planned exposure is at irradiance 1.2."""

    response = "log"
    sensor = "standard"
    simulated: SimulatedCamera

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_camera(self) -> Camera:
        model = load_sensor(self.sensor)
        controls = model.controls((24, 32), is_coloured=True, photons_per_unit=1.0)
        assert controls.sensitivity is not None
        rows, columns = np.mgrid[0:24, 0:32]
        light = 0.45 + 0.2 * np.sin(columns / 5.0) * np.cos(rows / 4.0)
        light = np.repeat(light[..., None], 3, axis=2).astype(np.float32)
        scene = Scene("steady", light, photons_per_unit=1 / (controls.sensitivity * 0.02 * 1.2))
        self.simulated = SimulatedCamera(scene, model, seed=3)
        options = EffectiveOptions(
            response=self.response,  # type: ignore[arg-type]
            range="medium",
            base=0.02,
            fps=0.2,
        )
        return EffectiveCamera(self.simulated, options)

    def unplug(self, camera: Camera) -> None:
        self.simulated.device.unplug()

    def silence(self, camera: Camera) -> None:
        self.simulated.device.freeze()


class TestEffectiveLinear(TestEffective):
    response = "linear"


def test_a_capture_with_it_has_the_light_of_the_scene() -> None:
    options = {"scene": "ramp", "size": "64x48", "range": "medium", "bits": "12", "fps": "5"}
    with camctl.open_camera("effective:sim", options) as camera:
        assert camera.info.id == "effective:sim"
        report = camctl.capture(camera, camctl.CaptureRequest(count=1, dynamic_range=256))
        one = report.radiance()
    with camctl.open_camera("sim", scene="ramp", size="64x48") as below:
        truth = below.scene.irradiance  # type: ignore[attr-defined]
    bright = truth > 0.05 * truth.max()
    assert np.median(one[bright] / truth[bright]) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    ("address", "options"),
    [
        ("effective:", {}),
        ("effective:none", {}),
        ("effective:sim", {"n": "0"}),
        ("effective:sim", {"response": "other"}),
        ("effective:sim", {"unknown_option": "1"}),
    ],
)
def test_what_cannot_be_opened_is_an_error(address: str, options: dict[str, str]) -> None:
    with pytest.raises(CamctlError):
        camctl.open_camera(address, options)
