"""V4L2 cameras through the kernel's uvcvideo."""

import subprocess
import sys
from contextlib import closing

import pytest
import virtual_devices as rig

from camctl import read_report
from camctl.controls import ExposureSetting
from camctl.errors import CameraError
from camctl.profile import load_profile
from camctl.testing.conformance import CameraConformance


class OnV4l2(CameraConformance):
    device = rig.WEB

    @pytest.fixture(autouse=True)
    def _devices(self, hub):
        self.hub = hub

    @pytest.fixture(scope="class")
    @classmethod
    def streaming(cls, running, measured):
        """One camera for the whole suite: to learn how a stream runs takes seconds."""
        with rig.opened(cls.device) as camera:
            yield camera

    @pytest.fixture
    def camera(self, streaming):
        return streaming

    def open_camera(self):
        return rig.opened(self.device)

    def test_closed_camera_raises_a_camera_error(self, streaming):
        streaming.close()  # nobody else may stream from the node meanwhile
        super().test_closed_camera_raises_a_camera_error()

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.01)


class TestYuyv(OnV4l2):
    pass


class TestY16(OnV4l2):
    device = rig.MACHINE


class TestUnsteadyDelay(OnV4l2):
    device = rig.SHAKY


class TestWholeCapture:
    @pytest.mark.parametrize("device", [rig.WEB, rig.MACHINE], ids=lambda device: device.name)
    def test_frames_have_what_the_device_exposed_them_with(self, hub, camctl, device):
        done = camctl("shoot", *rig.words_of(device), *rig.SHORT_BRACKET, "-o", "bracket")
        assert done.status == 0, done.err
        report = read_report(rig.here() / "bracket")
        assert report.status == "complete"
        assert [frame.applied_s for frame in report.frames] == pytest.approx(rig.SHORT_EXPOSURES_S)
        assert not rig.distrusted(report)
        assert all(frame.ratio.agrees for frame in report.frames[1:])
        exposed = [frame["time_s"] for frame in hub.do(device.name, "log")["frames"]]
        assert set(rig.SHORT_EXPOSURES_S) <= {round(time_s, 6) for time_s in exposed}

    def test_metered_and_looked_up(self, hub, camctl):
        done = camctl("shoot", *rig.words_of(rig.WEB), "-n", "2", "--response", "linear", "-o", "m")
        assert done.status == 0, done.err
        report = read_report(rig.here() / "m")
        assert report.status == "complete"
        # Metering puts the highlights of the shortest exposure just below white.
        assert 0 <= report.frames[0].saturated_fraction < 0.02
        assert report.achieved.effective_levels > 100

    def test_gain_makes_up_for_time(self, hub):
        """The virtual webcam's gain is 1 + register / 16."""
        with rig.opened(rig.WEB, gain="linear:0.0625") as camera:
            times = camera.controls.time_s
            settings = [
                ExposureSetting(times.nearest(0.016 / gain), float(gain)) for gain in (1, 2, 4, 1)
            ]
            means = [float(frame.pixels.mean()) for frame in camera.shoot(settings)]
        assert means == pytest.approx([means[0]] * 4, rel=0.02)
        assert 20 < means[0] < 235

    def test_without_a_measured_delay_it_settles_and_says_so(
        self, hub, camctl, monkeypatch, tmp_path
    ):
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "none"))
        done = camctl("shoot", *rig.words_of(rig.WEB), *rig.SHORT_BRACKET, "-o", "unknown")
        assert done.status == 0, done.err
        assert all(frame.ratio.agrees for frame in read_report(rig.here() / "unknown").frames[1:])
        with rig.opened(rig.WEB) as camera:
            assert camera.controls.delay_frames is None
            assert any("camctl calibrate delay" in note for note in camera.controls.notes)


class TestDelay:
    def test_calibrate_finds_the_delay_of_the_device(self, hub, camctl, monkeypatch, tmp_path):
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
        done = camctl("calibrate", "delay", *rig.words_of(rig.WEB), "--trials", 6)
        assert done.status == 0, done.err
        with rig.opened(rig.WEB) as camera:
            record = load_profile(camera.info).delays[camera.mode]
            assert (record.frames, record.smallest, record.largest) == (2, 2, 2)
            assert camera.controls.delay_frames == 2

    def test_calibrate_finds_that_a_delay_is_not_constant(self, hub, camctl, monkeypatch, tmp_path):
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
        done = camctl("calibrate", "delay", *rig.words_of(rig.SHAKY), "--trials", 8)
        assert done.status == 0, done.err
        with rig.opened(rig.SHAKY) as camera:
            record = load_profile(camera.info).delays[camera.mode]
            assert record.frames is None
            assert 1 <= record.smallest < record.largest <= 3
            assert camera.controls.delay_frames is None
            assert any("constant" in note for note in camera.controls.notes)

    @pytest.mark.parametrize("delay", range(6))
    def test_n_exposures_cost_n_plus_d_frames(self, hub, delay):
        with rig.delayed(hub, rig.WEB, delay):
            used = rig.frames_used(hub, rig.WEB)
        assert used.frames / (used.settings + delay) == 1.0
        assert used.by_timestamps / (used.settings + delay) == 1.0
        assert used.slots == list(range(used.slots[0], used.slots[0] + used.settings))


class TestFaults:
    @pytest.fixture(autouse=True)
    def _delay(self, hub):
        self.hub = hub

    def fault(self, verb, **arguments):
        if verb == "unplug":
            return rig.unplug(self.hub, rig.WEB)
        return self.hub.do(rig.WEB.name, verb, **arguments)

    def strike_after_first_frame(self, strike, count=12):
        """Shoot, let `strike` happen after the first frame; return what the camera then raises."""
        time_s = 0.01
        with rig.opened(rig.WEB) as camera:
            control = camera.controls.time_s
            settings = [
                ExposureSetting(control.nearest(time_s * (1 + i % 2))) for i in range(count)
            ]
            with closing(camera.shoot(settings)) as frames:
                next(frames)
                strike()
                with pytest.raises(CameraError) as caught:
                    for _ in frames:
                        pass
        return rig.one_line(caught.value)

    def test_frozen(self):
        message, seconds = rig.timed(
            lambda: self.strike_after_first_frame(lambda: self.fault("freeze"))
        )
        assert "no frame" in message
        assert " s" in message
        assert seconds < 40

    def test_unplugged(self):
        message, seconds = rig.timed(
            lambda: self.strike_after_first_frame(lambda: self.fault("unplug"))
        )
        assert "unplugged" in message or "gone" in message or "went away" in message
        assert seconds < 30

    def test_controls_hang(self):
        message, seconds = rig.timed(
            lambda: self.strike_after_first_frame(lambda: self.fault("hang"))
        )
        assert seconds < 60
        assert message

    def test_unplugged_in_a_capture_and_plugged_in_again(self, camctl):
        with rig.once_a_frame_is_kept(rig.here() / "cut", lambda: self.fault("unplug")):
            cut = camctl(
                "shoot",
                *rig.words_of(rig.WEB),
                "--ratios",
                "1,1.5,2,3,4,6,8,12,16,20,24,30",
                "--base",
                "0.002",
                "-o",
                "cut",
            )
        assert cut.status == 1
        assert cut.err.count("\n") == 1
        assert "camctl shoot --resume" in cut.err
        kept = sorted(path.name for path in (rig.here() / "cut" / "frames").glob("*.npy"))
        assert kept
        stamps = {name: (rig.here() / "cut" / "frames" / name).stat().st_mtime_ns for name in kept}
        self.fault("plug")
        rig.wait_for("camera", lambda: rig.is_there(rig.WEB))
        done = camctl("shoot", "--resume", "cut")
        assert done.status == 0, done.err
        report = read_report(rig.here() / "cut")
        assert report.status == "complete"
        assert len(report.frames) == 12
        # What had been shot was not shot again.
        for name, stamp in stamps.items():
            assert (rig.here() / "cut" / "frames" / name).stat().st_mtime_ns == stamp

    def test_another_process_streams_from_it(self, camctl):
        node = rig.video_node(rig.WEB)
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLD, str(node)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        try:
            assert holder.stdout.readline().strip() == b"streaming"
            done = camctl("shoot", *rig.words_of(rig.WEB), *rig.SHORT_BRACKET, "-o", "busy")
        finally:
            holder.communicate()
        assert done.status == 1
        assert done.err.count("\n") == 1
        assert "process" in done.err
        assert done.seconds < 30

    def test_silent_clamping_is_not_believed(self):
        self.fault("clamp", max_s=0.02)
        with rig.opened(rig.WEB) as camera:
            setting = ExposureSetting(camera.controls.time_s.nearest(0.04))
            with pytest.raises(CameraError) as caught, closing(camera.shoot([setting])) as frames:
                list(frames)
        rig.one_line(caught.value)

    def test_a_wrong_exposure_is_found_and_shot_again(self, camctl):
        with rig.once_a_frame_is_kept(
            rig.here() / "wrong", lambda: self.fault("wrong_exposure", factor=2.0)
        ):
            done = camctl("shoot", *rig.words_of(rig.WEB), *LONG_BRACKET, "-o", "wrong")
        assert done.status == 0, done.err
        report = read_report(rig.here() / "wrong")
        assert report.rejected
        assert 2 in [frame.attempts for frame in report.frames]
        assert all(frame.ratio.agrees for frame in report.frames[1:])
        assert not rig.distrusted(report)

    @pytest.mark.parametrize("fault", ["truncate", "garbage"])
    def test_a_spoilt_frame_is_not_handed_over(self, camctl, fault):
        with rig.once_a_frame_is_kept(rig.here() / fault, lambda: self.fault(fault)):
            done = camctl("shoot", *rig.words_of(rig.WEB), *LONG_BRACKET, "-o", fault)
        if done.status:  # a typed error, and what was shot is kept
            assert done.err.count("\n") == 1
            assert "--resume" in done.err
            self.fault("ok")
            assert camctl("shoot", "--resume", fault).status == 0
        report = read_report(rig.here() / fault)
        assert report.status == "complete"
        assert all(frame.ratio.agrees for frame in report.frames[1:])

    def test_lens_cap(self, camctl):
        self.fault("wrong_exposure", factor=0.0, count=1000)
        done = camctl("shoot", *rig.words_of(rig.WEB), "-o", "cap")
        assert done.status == 1
        assert done.err.count("\n") == 1
        assert "cap" in done.err or "dark" in done.err


LONG_BRACKET = ("--ratios", "1,1.5,2,3,4,6,8,12", "--base", "0.002")

HOLD = """
import sys, cv2
capture = cv2.VideoCapture(sys.argv[1], cv2.CAP_V4L2)
assert capture.read()[0]
print("streaming", flush=True)
sys.stdin.read()
"""
