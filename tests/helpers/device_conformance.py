"""The conformance suite on a virtual device."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest
import virtual_devices as rig

from camctl.interface.camera import Camera
from camctl.testing.conformance import CameraConformance


class DeviceConformance(CameraConformance):
    """The suite on one camera that stays open: opening it takes seconds in the guest.

    Exposures are short and sequences shorter than usual: time is real here, and the same drivers
    take all of them in virtual time.

    Attributes:
        device: the virtual device
    """

    longest_s = 0.5
    run_length = 12
    range_length = 6

    device: ClassVar[rig.Device]
    _shared: ClassVar[Camera | None] = None

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _closed_at_the_end(cls, running_hub: rig.RecordingHub) -> Iterator[None]:
        yield
        cls._close()

    @pytest.fixture
    def camera(self) -> Camera:
        """The camera that stays open."""
        kind = type(self)
        if kind._shared is None:
            kind._shared = self.open_device()
        return kind._shared

    def open_camera(self) -> Camera:
        """Return a camera opened anew; only one can be open, so that the other is closed."""
        self._close()
        return self.open_device()

    def open_device(self) -> Camera:
        """Return the camera of the device, opened by the backend that is tested."""
        return rig.open_device(self.device)

    def middle_s(self, camera: Camera) -> float:
        """Return a shutter time at which the ramp is neither black nor white."""
        return camera.controls.time_s.nearest(0.01)

    @classmethod
    def _close(cls) -> None:
        camera, cls._shared = cls._shared, None
        if camera is not None:
            camera.close()
