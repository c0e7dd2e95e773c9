"""Still cameras through libgphoto2, its own libusb, and usbfs."""

from __future__ import annotations

import gphoto2_client
import guest_processes as guest
import numpy as np
import virtual_devices as rig
from device_conformance import DeviceConformance

from camctl.backends import open_camera
from camctl.camera import Camera

DEVICE = rig.RAW


def open_by_libgphoto2() -> Camera:
    port = gphoto2_client.usb_port(rig.usb_device(DEVICE))
    with guest.clock_in_step():  # it reads a hundred libraries while the camera waits
        return open_camera(f"gphoto2:{port}", DEVICE.options)


def test_frames_are_those_of_ptp_bit_for_bit(hub: rig.RecordingHub) -> None:
    """test_same_picture.py compares those of ptp with the simulated camera's."""
    frames = []
    for opened in (rig.open_device, lambda _: open_by_libgphoto2()):
        with opened(DEVICE) as camera:
            settings = [rig.setting(camera, time_s) for time_s in rig.EXPOSURES_S]
            frames.append(list(camera.shoot(settings)))
    for by_ptp, by_libgphoto2 in zip(*frames, strict=True):
        assert by_libgphoto2.applied == by_ptp.applied
        assert (by_libgphoto2.black, by_libgphoto2.white) == (by_ptp.black, by_ptp.white)
        assert np.array_equal(by_libgphoto2.pixels, by_ptp.pixels)


class TestRaw(DeviceConformance):
    device = DEVICE

    def open_device(self) -> Camera:
        return open_by_libgphoto2()
