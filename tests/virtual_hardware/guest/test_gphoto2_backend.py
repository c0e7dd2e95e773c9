"""Still cameras through libgphoto2, its own libusb, and usbfs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import gphoto2_client
import guest_processes as guest
import numpy as np
import pytest
import virtual_devices as rig
from device_conformance import DeviceConformance

from camctl.interface.camera import Camera, Frame
from camctl.profiles.calibrated import open_camera


def shoot(camera: Camera) -> list[Frame]:
    return list(camera.shoot([rig.setting(camera, time_s) for time_s in rig.EXPOSURES_S]))


def by_libgphoto2(device: rig.Device) -> Camera:
    """Return the opened camera of a device."""
    port = gphoto2_client.usb_port(rig.usb_device(device))
    with guest.clock_in_step():  # it reads a hundred libraries while the camera waits
        return open_camera(f"gphoto2:{port}", device.options)


def check_equal(frames: list[Frame], by_ptp: list[Frame]) -> None:
    for frame, other in zip(frames, by_ptp, strict=True):
        assert frame.applied == other.applied
        assert (frame.black, frame.white) == (other.black, other.white)
        assert np.array_equal(frame.pixels, other.pixels)


class TestStandard(DeviceConformance):
    """The suite, and the same frames as by `ptp`, with a few openings: each takes seconds.

    test_same_picture.py compares the frames of `ptp` with the simulated camera's.
    """

    device = rig.RAW
    run_length = range_length = 5
    _by_ptp: ClassVar[list[Frame]]

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _frames_by_ptp(cls, running_hub: rig.RecordingHub) -> None:
        with rig.open_device(cls.device) as camera:
            cls._by_ptp = shoot(camera)

    def open_anew(self) -> Camera:
        return by_libgphoto2(self.device)

    def test_frames_are_those_of_ptp_bit_for_bit(self, camera: Camera) -> None:
        check_equal(shoot(camera), self._by_ptp)


@pytest.fixture(scope="module")
def makes(running_hub: rig.RecordingHub) -> Iterator[None]:
    with rig.running_hub(rig.MAKES, rig.DIRECTORY / "makes"):
        yield
    guest.wait_for("end of the makes", lambda: not any(map(rig.is_connected, rig.MAKES)))


@pytest.mark.usefixtures("makes")
@pytest.mark.parametrize(
    "device",
    [
        rig.NIKON,
        *(pytest.param(each, marks=pytest.mark.proof) for each in (rig.CANON, rig.SONY)),
    ],
    ids=lambda device: device.name,
)
def test_frames_of_a_make_are_those_of_ptp_bit_for_bit(device: rig.Device) -> None:
    """tests/drivers/gphoto2 runs the suite on the makes, with the same library over TCP."""
    with rig.open_device(device) as camera:
        by_ptp = shoot(camera)
    with by_libgphoto2(device) as camera:
        check_equal(shoot(camera), by_ptp)
