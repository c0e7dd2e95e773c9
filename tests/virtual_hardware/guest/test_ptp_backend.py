"""Still cameras over PTP, through usbfs and libusb."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import guest_processes as guest
import pytest
import virtual_devices as rig
from device_conformance import DeviceConformance

from camctl.interface.camera import Frame

CAMERA = r"Virtual PTP camera at USB \d+:\d+"
LONG_BRACKET = ("--ratios", "1,2,4,8,16", "--base", "0.002")

HANG = f"{CAMERA} does not answer; switch it off and on again, then resume"

RunCamctl = Callable[..., guest.CommandResult]


class TestTiff(DeviceConformance):
    """Raw files: test_gphoto2_backend.py has the suite, on frames equal to those of this driver."""

    device = rig.STILL


def test_the_next_exposure_starts_before_the_last_download_ended(hub: rig.RecordingHub) -> None:
    with rig.open_device(rig.STILL) as camera:
        settings = [rig.setting(camera, time_s) for time_s in (0.1, 0.2, 0.1, 0.2)]
        with closing(camera.shoot(settings)) as frames:
            details = [frame.details for frame in frames]
    assert all(
        later["released_s"] < earlier["fetched_s"] for earlier, later in itertools.pairwise(details)
    )
    # By the camera's own clock, too.
    shots = hub.do(rig.STILL.name, "log")["shots"][-4:]
    assert all(
        later["began_s"] < earlier["downloaded_s"] for earlier, later in itertools.pairwise(shots)
    )


class TestFaults:
    device = rig.STILL

    @pytest.fixture(autouse=True)
    def _hub(self, hub: rig.RecordingHub) -> None:
        self.hub = hub

    def fault(self, verb: str, **arguments: Any) -> None:
        if verb == "unplug":
            rig.unplug(self.hub, self.device)
        else:
            self.hub.do(self.device.name, verb, **arguments)

    def shoot(self) -> list[Frame]:
        with rig.open_device(self.device) as camera:
            settings = [rig.setting(camera, 0.004 * 2**i) for i in range(3)]
            with closing(camera.shoot(settings)) as frames:
                return list(frames)

    @pytest.mark.parametrize("verb", ["busy", "stall", "no_events"])
    def test_a_passing_fault_is_waited_for(self, verb: str) -> None:
        self.fault(verb)
        assert [frame.index for frame in self.shoot()] == [0, 1, 2]

    def test_a_camera_that_hangs_is_an_error(self, camctl: RunCamctl) -> None:
        self.fault("hang")
        done = camctl("shoot", *rig.camera_arguments(self.device), *rig.BRACKET, "-o", "hang")
        assert re.fullmatch(HANG, done.error), done.error
        assert done.seconds < 60

    @pytest.mark.parametrize("verb", ["truncate", pytest.param("garbage", marks=pytest.mark.proof)])
    def test_a_damaged_transfer_is_never_a_frame(self, camctl: RunCamctl, verb: str) -> None:
        with guest.once_a_frame_is_kept(Path(verb).absolute(), lambda: self.fault(verb)):
            done = camctl("shoot", *rig.camera_arguments(self.device), *LONG_BRACKET, "-o", verb)
        if done.status != 0:  # the fault hit a command between two transfers
            assert done.error.endswith(f"shoot the others (camctl resume {verb})"), done.error
            done = camctl("resume", verb)
        assert done.status == 0, done.err
        rig.completed_frames(verb)

    def test_unplugged_in_a_capture_and_plugged_in_again(self, camctl: RunCamctl) -> None:
        with guest.once_a_frame_is_kept(Path("cut").absolute(), lambda: self.fault("unplug")):
            cut = camctl("shoot", *rig.camera_arguments(self.device), *LONG_BRACKET, "-o", "cut")
        message = (
            f"{CAMERA} was disconnected; (taken and not fetched: [^;]*; )?plug it in and switch it "
            "on, then try again; [1-4] of 5 frames are kept; shoot the others "
            r"\(camctl resume cut\)"
        )
        assert re.fullmatch(message, cut.error), cut.error
        kept = {path: path.stat().st_mtime_ns for path in Path("cut/frames").glob("*.npy")}
        assert 1 <= len(kept) < 5
        self.fault("plug")
        guest.wait_for("camera", lambda: rig.is_connected(self.device))
        done = camctl("resume", "cut")
        assert done.status == 0, done.err
        rig.completed_frames("cut")
        # What had been shot was not shot again.
        assert {path: path.stat().st_mtime_ns for path in kept} == kept

    def test_another_process_holds_the_interface(self, camctl: RunCamctl) -> None:
        with guest.held_by_another_process(guest.claim_interface, self.device.serial) as holder:
            done = camctl("shoot", *rig.camera_arguments(self.device), *rig.BRACKET, "-o", "busy")
        message = (
            rf"{CAMERA} is in use by another program: \w+ \(process {holder.pid}\); desktops mount "
            "cameras by themselves: unmount it there, or end gvfs-gphoto2-volume-monitor, "
            "gvfsd-gphoto2, gphoto2 or darktable, and try again"
        )
        assert re.fullmatch(message, done.error), done.error
