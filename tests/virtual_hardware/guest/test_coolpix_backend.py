"""The CoolPix 990 over a serial line of the kernel: cdc-acm at one end, a gadget at the other."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import guest_processes as guest
import pytest
import virtual_devices as rig
from device_conformance import DeviceConformance

from camctl.camera import Frame
from camctl import read_report
from camctl.errors import CameraError

LONG_BRACKET = ("--ratios", "1,2,4,5,62.5", "--base", "0.002")

RunCamctl = Callable[..., guest.CommandResult]


class TestTiff(DeviceConformance):
    device = rig.COOLPIX


def test_whole_capture(hub: rig.RecordingHub, camctl: RunCamctl) -> None:
    done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", "bracket")
    assert done.status == 0, done.err
    assert all(frame.original for frame in rig.completed_frames("bracket"))
    assert not rig.distrust_warnings(read_report(Path("bracket")))


class TestFaults:
    @pytest.fixture(autouse=True)
    def _hub(self, hub: rig.RecordingHub) -> None:
        self.hub = hub

    def fault(self, verb: str, **arguments: Any) -> None:
        self.hub.do(rig.COOLPIX.name, verb, **arguments)

    def shoot(self) -> list[Frame]:
        with rig.open_device(rig.COOLPIX) as camera:
            settings = [rig.setting(camera, time_s) for time_s in (0.004, 0.008)]
            with closing(camera.shoot(settings)) as frames:
                return list(frames)

    def test_packets_that_are_not_acknowledged_are_sent_again(self) -> None:
        self.fault("nak", count=3)
        assert len(self.shoot()) == 2

    def test_a_speed_that_is_refused(self) -> None:
        self.fault("no_speed")
        assert len(self.shoot()) == 2

    @pytest.mark.parametrize(
        ("verb", "message"),
        [
            ("hang", "MESSAGE"),
            ("card_full", "MESSAGE"),
            ("battery_low", "MESSAGE"),
        ],
    )
    def test_a_lasting_fault_is_an_error(self, camctl: RunCamctl, verb: str, message: str) -> None:
        self.fault(verb)
        done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", verb)
        assert re.fullmatch(message, done.error), done.error
        assert done.seconds < 60

    @pytest.mark.parametrize("verb", ["truncate", "garbage"])
    def test_a_damaged_transfer_is_never_a_frame(self, camctl: RunCamctl, verb: str) -> None:
        with guest.once_a_frame_is_kept(Path(verb).absolute(), lambda: self.fault(verb)):
            done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", verb)
        if done.status:
            assert f"resume with camctl shoot --resume {verb}" in done.error
            self.fault("ok")
            again = camctl("shoot", "--resume", verb)
            assert again.status == 0, again.err
        rig.completed_frames(verb)

    def test_silent_clamping_is_detected(self) -> None:
        with rig.open_device(rig.COOLPIX) as camera:
            settings = [rig.setting(camera, time_s) for time_s in (0.002, 0.008)]
            self.fault("clamp", max_s=0.005)
            with pytest.raises(CameraError) as caught, closing(camera.shoot(settings)) as frames:
                list(frames)
        assert re.fullmatch(r"MESSAGE", rig.one_line(caught.value)), caught.value

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
            assert re.fullmatch(r"MESSAGE", cut.error), cut.error
            assert not node.exists()
        finally:
            self.fault("unplug")  # its end of the line has been hung up
            authorized.write_text("1")
            guest.wait_for("adapter", node.exists)
            self.fault("plug")
        done = camctl("shoot", "--resume", "cut")
        assert done.status == 0, done.err
        rig.completed_frames("cut")

    def test_another_process_holds_the_line(self, camctl: RunCamctl) -> None:
        with guest.held_by_another_process(guest.open_exclusively, rig.serial_port()):
            done = camctl("shoot", *rig.camera_arguments(rig.COOLPIX), *rig.BRACKET, "-o", "busy")
        assert re.fullmatch(r"MESSAGE", done.error), done.error
