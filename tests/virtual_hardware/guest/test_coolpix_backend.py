"""The CoolPix 990 over a serial line of the kernel: cdc-acm at one end, a gadget at the other."""

import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import virtual_devices as rig

from camctl import read_report
from camctl.controls import ExposureSetting
from camctl.errors import CameraError
from camctl.testing.conformance import CameraConformance

LONG = ("--ratios", "1,2,4,5,62.5", "--base", "0.002")


class TestTiff(CameraConformance):
    @pytest.fixture(autouse=True)
    def _devices(self, hub):
        self.hub = hub

    def open_camera(self):
        return rig.opened(rig.COOLPIX)

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.01)


def test_whole_capture(hub, camctl):
    done = camctl("shoot", *rig.words_of(rig.COOLPIX), *rig.BRACKET, "-o", "bracket")
    assert done.status == 0, done.err
    report = read_report(rig.here() / "bracket")
    assert report.status == "complete"
    assert not rig.distrusted(report)
    assert all(frame.ratio.agrees for frame in report.frames[1:])
    assert all(frame.original for frame in report.frames)


class TestFaults:
    @pytest.fixture(autouse=True)
    def _hub(self, hub):
        self.hub = hub

    def fault(self, verb, **arguments):
        return self.hub.do(rig.COOLPIX.name, verb, **arguments)

    def shoot(self):
        with rig.opened(rig.COOLPIX) as camera:
            control = camera.controls.time_s
            settings = [ExposureSetting(control.nearest(t)) for t in (0.004, 0.008)]
            with closing(camera.shoot(settings)) as frames:
                return list(frames)

    def test_packets_that_are_not_acknowledged_are_sent_again(self):
        self.fault("nak", count=3)
        assert len(self.shoot()) == 2

    def test_a_speed_that_is_refused(self):
        self.fault("no_speed")
        assert len(self.shoot()) == 2

    @pytest.mark.parametrize("verb", ["hang", "card_full", "battery_low"])
    def test_what_does_not_pass_is_one_line(self, camctl, verb):
        self.fault(verb)
        done = camctl("shoot", *rig.words_of(rig.COOLPIX), *rig.BRACKET, "-o", verb)
        assert done.status == 1
        assert done.err.count("\n") == 1, done.err
        assert "internal error" not in done.err
        assert done.seconds < 60

    @pytest.mark.parametrize("verb", ["truncate", "garbage"])
    def test_a_spoilt_transfer_is_never_a_frame(self, camctl, verb):
        with rig.once_a_frame_is_kept(rig.here() / verb, lambda: self.fault(verb)):
            done = camctl("shoot", *rig.words_of(rig.COOLPIX), *rig.BRACKET, "-o", verb)
        if done.status:
            assert done.err.count("\n") == 1, done.err
            assert "--resume" in done.err
            self.fault("ok")
            again = camctl("shoot", "--resume", verb)
            assert again.status == 0, again.err
        report = read_report(rig.here() / verb)
        assert report.status == "complete"
        assert all(frame.ratio.agrees for frame in report.frames[1:])

    def test_silent_clamping_is_not_believed(self):
        with rig.opened(rig.COOLPIX) as camera:
            settings = [rig.setting(camera, time_s) for time_s in (0.002, 0.008)]
            self.fault("clamp", max_s=0.005)
            with pytest.raises(CameraError) as caught, closing(camera.shoot(settings)) as frames:
                list(frames)
        rig.one_line(caught.value)

    def test_the_adapter_is_unplugged_in_a_capture_and_plugged_in_again(self, camctl):
        node = rig.tty_node()
        # What a person does with the cable, the kernel does with the port of the adapter.
        device = Path("/sys/class/tty", node.resolve().name, "device").resolve().parent
        with rig.once_a_frame_is_kept(
            rig.here() / "cut", lambda: (device / "authorized").write_text("0")
        ):
            cut = camctl("shoot", *rig.words_of(rig.COOLPIX), *LONG, "-o", "cut")
        try:
            assert cut.status == 1
            assert cut.err.count("\n") == 1, cut.err
            assert "--resume" in cut.err
            assert not node.exists()
        finally:
            self.fault("unplug")  # its end of the line has been hung up
            (device / "authorized").write_text("1")
            rig.wait_for("adapter", node.exists)
            self.fault("plug")
        done = camctl("shoot", "--resume", "cut")
        assert done.status == 0, done.err
        assert read_report(rig.here() / "cut").status == "complete"

    def test_another_process_holds_the_line(self, camctl):
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLD, str(rig.tty_node())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        try:
            assert holder.stdout.readline().strip() == b"held"
            done = camctl("shoot", *rig.words_of(rig.COOLPIX), *rig.BRACKET, "-o", "busy")
        finally:
            holder.communicate()
        assert done.status == 1
        assert done.err.count("\n") == 1, done.err
        assert "process" in done.err


HOLD = """
import sys, serial
line = serial.Serial(sys.argv[1], exclusive=True)
print("held", flush=True)
sys.stdin.read()
"""
