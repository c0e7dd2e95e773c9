"""The CoolPix 990 over a serial line of the kernel: cdc-acm at one end, a gadget at the other."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import guest_processes as guest
import pytest
import virtual_devices as rig
from device_conformance import DeviceConformance

CAMERA = r"the camera at /dev/serial/by-id/\S+"
LONG_BRACKET = ("--ratios", "1,2,4,5,62.5", "--base", "0.002")

HANG = (
    f"{CAMERA} has not answered for 12 s; check that it is on and the cable fits, "
    "switch it off and on, then try again"
)

RunCamctl = Callable[..., guest.CommandResult]


class TestTiff(DeviceConformance):
    device = rig.COOLPIX


class TestFaults:
    @pytest.fixture(autouse=True)
    def _hub(self, hub: rig.RecordingHub) -> None:
        self.hub = hub

    def fault(self, verb: str, **arguments: Any) -> None:
        self.hub.do(rig.COOLPIX.name, verb, **arguments)

    def test_a_camera_that_hangs_is_an_error(self, camctl: RunCamctl) -> None:
        self.fault("hang")
        done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", "hang")
        assert re.fullmatch(HANG, done.error), done.error
        assert done.seconds < 60

    @pytest.mark.parametrize("verb", ["truncate", pytest.param("garbage", marks=pytest.mark.proof)])
    def test_a_damaged_transfer_is_never_a_frame(self, camctl: RunCamctl, verb: str) -> None:
        with guest.once_a_frame_is_kept(Path(verb).absolute(), lambda: self.fault(verb)):
            done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", verb)
        assert done.status == 0, done.err
        rig.completed_frames(verb)

    def test_the_adapter_is_unplugged_in_a_capture_and_plugged_in_again(
        self, camctl: RunCamctl
    ) -> None:
        node = rig.serial_port()
        # What a person does with the cable, the kernel does with the port of the adapter.
        adapter = Path("/sys/class/tty", node.resolve().name, "device").resolve().parent
        authorized = adapter / "authorized"
        with guest.once_a_frame_is_kept(Path("cut").absolute(), lambda: authorized.write_text("0")):
            cut = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *LONG_BRACKET, "-o", "cut")
        try:
            # Which of both is said depends on the moment.
            message = (
                r"the line /dev/serial/by-id/\S+ was disconnected"
                r"(, or another process reads from it)?, and a picture of \S+ s that was not "
                r"downloaded may be on its card; plug the cable in, switch the camera on, then "
                r"try again; [1-4] of 5 frames are kept; shoot the others \(camctl resume cut\)"
            )
            assert re.fullmatch(message, cut.error), cut.error
            # Not before udev has seen the end, or it would remove the link that is wanted below.
            guest.wait_for("end of the adapter", lambda: not node.is_symlink())
        finally:
            self.fault("unplug")  # its end of the line has been hung up
            authorized.write_text("1")
            guest.wait_for("adapter", node.exists)
            self.fault("plug")
        done = camctl("resume", "cut")
        assert done.status == 0, done.err
        rig.completed_frames("cut")

    def test_another_process_holds_the_line(self, camctl: RunCamctl) -> None:
        with guest.held_by_another_process(guest.open_exclusively, rig.serial_port()):
            done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", "busy")
        message = (
            r"cannot open /dev/serial/by-id/\S+: another process holds it; close the other program "
            r"\(ModemManager, minicom, gphoto2\), then try again"
        )
        assert re.fullmatch(message, done.error), done.error
