"""Still cameras over PTP, through usbfs and libusb."""

import itertools
import subprocess
import sys
from contextlib import closing

import pytest
import virtual_devices as rig

from camctl import read_report
from camctl.controls import ExposureSetting
from camctl.errors import CameraError
from camctl.testing.conformance import CameraConformance

LONG = ("--ratios", "1,2,4,8,16", "--base", "0.002")


class OnPtp(CameraConformance):
    device = rig.STILL

    @pytest.fixture(autouse=True)
    def _devices(self, hub):
        self.hub = hub

    def open_camera(self):
        return rig.opened(self.device)

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.01)


class TestTiff(OnPtp):
    pass


class TestDng(OnPtp):
    device = rig.RAW


@pytest.mark.parametrize(
    ("device", "suffix"), [(rig.STILL, ".tif"), (rig.RAW, ".dng")], ids=["tiff", "dng"]
)
def test_whole_capture(hub, camctl, device, suffix):
    done = camctl("shoot", *rig.words_of(device), *rig.BRACKET, "-o", "bracket")
    assert done.status == 0, done.err
    report = read_report(rig.here() / "bracket")
    assert report.status == "complete"
    assert not rig.distrusted(report)
    assert all(frame.ratio.agrees for frame in report.frames[1:])
    # The camera's own files lie beside the frames.
    assert {
        (rig.here() / "bracket" / frame.original).suffix.lower() for frame in report.frames
    } == {suffix}
    assert len(hub.do(device.name, "log")["shots"]) >= 3


def test_the_next_exposure_starts_before_the_last_download_ended(hub):
    with rig.opened(rig.STILL) as camera:
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
    def _hub(self, hub):
        self.hub = hub

    def fault(self, verb, **arguments):
        if verb == "unplug":
            return rig.unplug(self.hub, self.device)
        return self.hub.do(self.device.name, verb, **arguments)

    def shoot(self, count=3):
        with rig.opened(self.device) as camera:
            control = camera.controls.time_s
            settings = [ExposureSetting(control.nearest(0.004 * 2**i)) for i in range(count)]
            with closing(camera.shoot(settings)) as frames:
                return list(frames)

    @pytest.mark.parametrize("verb", ["busy", "stall", "no_events"])
    def test_what_passes_is_waited_for(self, verb):
        self.fault(verb)
        frames = self.shoot()
        assert [frame.index for frame in frames] == [0, 1, 2]

    @pytest.mark.parametrize("verb", ["hang", "card_full", "battery_low"])
    def test_what_does_not_pass_is_one_line(self, camctl, verb):
        self.fault(verb)
        done = camctl("shoot", *rig.words_of(self.device), *rig.BRACKET, "-o", verb)
        assert done.status == 1
        assert done.err.count("\n") == 1, done.err
        assert "internal error" not in done.err
        expected = {"hang": "does not answer", "card_full": "card", "battery_low": "battery"}[verb]
        assert expected in done.err.lower()
        assert done.seconds < 60

    @pytest.mark.parametrize("verb", ["truncate", "garbage"])
    def test_a_spoilt_transfer_is_never_a_frame(self, camctl, verb):
        with rig.once_a_frame_is_kept(rig.here() / verb, lambda: self.fault(verb)):
            done = camctl("shoot", *rig.words_of(self.device), *LONG, "-o", verb)
        if done.status:
            assert done.err.count("\n") == 1, done.err
            assert "--resume" in done.err
            self.fault("ok")
            again = camctl("shoot", "--resume", verb)
            assert again.status == 0, again.err
        report = read_report(rig.here() / verb)
        assert report.status == "complete"
        assert all(frame.ratio.agrees for frame in report.frames[1:])

    def test_unplugged_in_a_capture_and_plugged_in_again(self, camctl):
        with rig.once_a_frame_is_kept(rig.here() / "cut", lambda: self.fault("unplug")):
            cut = camctl("shoot", *rig.words_of(self.device), *LONG, "-o", "cut")
        assert cut.status == 1
        assert cut.err.count("\n") == 1, cut.err
        assert "--resume" in cut.err
        kept = sorted((rig.here() / "cut" / "frames").glob("*.npy"))
        assert 1 <= len(kept) < 5
        stamps = [path.stat().st_mtime_ns for path in kept]
        self.fault("plug")
        rig.wait_for("camera", lambda: rig.is_there(self.device))
        done = camctl("shoot", "--resume", "cut")
        assert done.status == 0, done.err
        assert read_report(rig.here() / "cut").status == "complete"
        assert [path.stat().st_mtime_ns for path in kept] == stamps

    def test_silent_clamping_is_not_believed(self):
        self.fault("clamp", max_s=0.01)
        with pytest.raises(CameraError) as caught:
            self.shoot()
        rig.one_line(caught.value)

    def test_a_wrong_exposure_is_found_and_shot_again(self, camctl):
        with rig.once_a_frame_is_kept(
            rig.here() / "wrong", lambda: self.fault("wrong_exposure", factor=2.0)
        ):
            done = camctl("shoot", *rig.words_of(self.device), *LONG, "-o", "wrong")
        assert done.status == 0, done.err
        report = read_report(rig.here() / "wrong")
        assert report.rejected
        assert all(frame.ratio.agrees for frame in report.frames[1:])

    def test_an_exposure_that_stays_wrong_is_marked(self, camctl):
        def strike():
            self.fault("wrong_exposure", factor=2.0)

        folder = rig.here() / "marked"
        with rig.once_a_frame_is_kept(folder, strike), rig.once_a_frame_is_rejected(folder, strike):
            done = camctl("shoot", *rig.words_of(self.device), *LONG, "-o", "marked")
        assert done.status == 0, done.err
        report = read_report(folder)
        assert report.rejected
        assert rig.distrusted(report)

    def test_another_process_holds_the_interface(self, camctl):
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLD, self.device.serial],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        try:
            assert holder.stdout.readline().strip() == b"claimed"
            done = camctl("shoot", *rig.words_of(self.device), *rig.BRACKET, "-o", "busy")
        finally:
            holder.communicate()
        assert done.status == 1
        assert done.err.count("\n") == 1, done.err
        assert "another program" in done.err


HOLD = """
import sys, usb.core, usb.util
for device in usb.core.find(find_all=True):
    if device.bDeviceClass != 9 and device.serial_number == sys.argv[1]:
        usb.util.claim_interface(device, 0)
        print("claimed", flush=True)
        sys.stdin.read()
"""
