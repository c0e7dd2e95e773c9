"""The conformance suite on a virtual GigE Vision camera, behind both libraries."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from gige_bench import LEVELS, found, installed, virtual_camera

from camctl.drivers.genicam import GenicamCamera, GenicamOptions
from camctl.interface.camera import Camera, MeasuredDelay
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.gige.camera import GigeCamera
from camctl.testing import CameraConformance

pytestmark = pytest.mark.slow


class GenicamConformance(CameraConformance):
    """Time is real here: exposures are short, and sequences shorter than usual."""

    longest_s = 0.1
    run_length = 60
    range_length = 8

    library = "aravis"
    delay = 0
    config: dict[str, object] = {}  # noqa: RUF012  # each class has its own
    options: dict[str, str] = {}  # noqa: RUF012
    device: GigeCamera
    limit_s: float

    @pytest.fixture(autouse=True)
    def _device(self, request: pytest.FixtureRequest) -> Iterator[None]:
        # Frames come later on a busy computer: only tests of silence have a short limit.
        name = request.node.name
        self.limit_s = 4.0 if "silent" in name or "unplugged" in name else 20.0
        with virtual_camera(delay=self.delay, **self.config) as self.device:
            yield

    def open_camera(self) -> Camera:
        camera = self._camera().open()
        camera.use_delay(MeasuredDelay(self.delay, self.delay))
        return camera

    def open_second(self, camera: Camera) -> Camera:
        return self._camera().open()

    def _camera(self) -> GenicamCamera:
        options = GenicamOptions.parse({**LEVELS, **self.options})
        library, device = installed(self.library), found(self.device)
        return GenicamCamera(library, device, options, silence_s=self.limit_s)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.005)

    def unplug(self, camera: Camera) -> None:
        self.device.detach()

    def silence(self, camera: Camera) -> None:
        self.device.do("freeze")

    def in_force(self, camera: Camera) -> ExposureSetting:
        state = self.device.state()
        return ExposureSetting(state["time_s"], state["gain"])


class TriggeredConformance(GenicamConformance):
    """Each exposure is released, so that the device's own frames can be counted."""

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        before = len(self.device.do("log")["frames"])
        wanted = self.times(camera, [1, 0.5, 1, 0.5, 1, 0.5])
        self.shoot(camera, wanted)
        taken = len(self.device.do("log")["frames"]) - before
        assert taken == len(wanted) + self.delay


class TestTriggeredThroughViva(TriggeredConformance):
    library = "viva"


class TestTriggeredInALossyNetwork(TriggeredConformance):
    delay = 2
    config = {"loss": 0.01, "chunk_delay": 1}  # noqa: RUF012


@pytest.mark.serial
class TestFreeRunWithTheRunningFrame(GenicamConformance):
    delay = -1
    options = {"trigger": "off", "fps": "15"}  # noqa: RUF012

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        """By the camera's own numbers."""
        wanted = self.times(camera, [1, 0.5, 1, 0.5, 1, 0.5])
        numbers = [frame.details["frame_id"] for frame in self.shoot(camera, wanted)]
        assert numbers == list(range(numbers[0], numbers[0] + len(wanted)))
