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


class Gphoto2Conformance(DeviceConformance):
    """The suite, and the same frames as by `ptp`, with a few openings: each takes seconds.

    test_same_picture.py compares the frames of `ptp` with the simulated camera's.
    """

    run_length = range_length = 5
    _by_ptp: ClassVar[list[Frame]]

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _frames_by_ptp(cls, running_hub: rig.RecordingHub) -> None:
        with rig.open_device(cls.device) as camera:
            cls._by_ptp = shoot(camera)

    def open_device(self) -> Camera:
        port = gphoto2_client.usb_port(rig.usb_device(self.device))
        with guest.clock_in_step():  # it reads a hundred libraries while the camera waits
            return open_camera(f"gphoto2:{port}", self.device.options)

    def test_frames_are_those_of_ptp_bit_for_bit(self, camera: Camera) -> None:
        for by_libgphoto2, by_ptp in zip(shoot(camera), self._by_ptp, strict=True):
            assert by_libgphoto2.applied == by_ptp.applied
            assert (by_libgphoto2.black, by_libgphoto2.white) == (by_ptp.black, by_ptp.white)
            assert np.array_equal(by_libgphoto2.pixels, by_ptp.pixels)


class TestStandard(Gphoto2Conformance):
    device = rig.RAW


@pytest.mark.usefixtures("makes")
class MakeConformance(Gphoto2Conformance):
    """A camera with the operations of a make: what depends on them.

    The samples do not: they are those of `ptp` bit for bit, which tests/drivers/ptp proves of these
    makes, and `TestStandard` runs the whole suite through libgphoto2 and the kernel.
    """


_SHOWN_BY_EQUAL_SAMPLES = (
    "test_neighbouring_times_differ_in_light",
    "test_long_exposures_last_as_long_as_they_state",
    "test_frames_show_the_same_picture",
    "test_the_response_holds_near_black_and_near_white",
    "test_nothing_is_added_to_the_light",
    "test_white_is_exact_at_every_gain",
    "test_every_bit_of_the_samples_is_used",
    "test_gains_do_not_change_the_shading",
    "test_pixels_are_not_overwritten",
    "test_closed_camera_raises_a_camera_error",
)
for _name in _SHOWN_BY_EQUAL_SAMPLES:
    assert hasattr(Gphoto2Conformance, _name)
    setattr(MakeConformance, _name, None)


@pytest.fixture(scope="module")
def makes(running_hub: rig.RecordingHub) -> Iterator[None]:
    with rig.running_hub(rig.MAKES, rig.DIRECTORY / "makes"):
        yield
    guest.wait_for("end of the makes", lambda: not any(map(rig.is_connected, rig.MAKES)))


class TestNikon(MakeConformance):
    device = rig.NIKON


class TestCanon(MakeConformance):
    device = rig.CANON


class TestSony(MakeConformance):
    device = rig.SONY
