"""The conformance suite on a virtual device."""

from __future__ import annotations

from typing import ClassVar

import pytest
import virtual_devices as rig
from kept_open import KeptOpenConformance

from camctl.interface.camera import Camera


@pytest.mark.usefixtures("running_hub")
class DeviceConformance(KeptOpenConformance):
    """The suite on a device of the guest.

    Exposures are short and sequences shorter than usual: time is real here, and the same drivers
    take all of them in virtual time.

    Attributes:
        device: the virtual device
    """

    longest_s = 0.5
    run_length = 12
    range_length = 6

    device: ClassVar[rig.Device]

    def open_anew(self) -> Camera:
        """Return the camera of the device, opened by the backend that is tested."""
        return rig.open_device(self.device)

    def middle_s(self, camera: Camera) -> float:
        """Return a shutter time at which the ramp is neither black nor white."""
        return camera.controls.time_s.nearest(0.01)
