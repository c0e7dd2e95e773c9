"""V4L2 cameras through the kernel's uvcvideo."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from statistics import fmean
from typing import Any

import guest_processes as guest
import numpy as np
import pytest
import virtual_devices as rig
from device_conformance import DeviceConformance
from error_lines import one_line

from camctl import CaptureReport, CaptureRequest, capture, read_report
from camctl.calibration.delay import measure_delay
from camctl.errors import CameraError
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import Sensor
from camctl.studies.scene_errors import scene_truth

LONG_BRACKET = ("--ratios", "1,1.5,2,3,4,6,8,12", "--base", "0.002")
LONGER_BRACKET = ("--ratios", "1,1.5,2,3,4,6,8,12,16,20,24,30", "--base", "0.002")

# The error that a fault leads to.
FAULTS_OF_A_STREAM = {
    "freeze": r"no frame from /dev/v4l/by-id/\S+ for \d+ s; unplug it, plug it in again and resume",
    "unplug": r"/dev/v4l/by-id/\S+ was unplugged; plug it in and open it again",
    "hang": (
        r"cannot set a control of /dev/v4l/by-id/\S+: the camera does not respond; unplug it, plug "
        r"it in again and try again"
    ),
}

RunCamctl = Callable[..., guest.CommandResult]


class TestYuyv(DeviceConformance):
    device = rig.WEB


@pytest.mark.proof  # `TestWholeCapture` has a capture of it, test_v4l2_formats.py its colours
class TestMosaic(DeviceConformance):
    """A camera with nothing but Bayer frames, of 16-bit words like those of `rig.MACHINE`."""

    device = rig.MOSAIC


class TestUnsteadyDelay(DeviceConformance):
    device = rig.UNSTEADY


class TestWholeCapture:
    @pytest.mark.parametrize("device", [rig.WEB, rig.MOSAIC], ids=lambda device: device.name)
    def test_frames_have_what_the_device_exposed_them_with(
        self, hub: rig.RecordingHub, camctl: RunCamctl, device: rig.Device
    ) -> None:
        """test_same_picture.py has all samples of `rig.MACHINE`."""
        done = camctl("shoot", *rig.camera_arguments(device), *rig.SHORT_BRACKET, "-o", "bracket")
        assert done.status == 0, done.err
        frames = rig.completed_frames("bracket")
        assert [frame.applied_s for frame in frames] == pytest.approx(rig.SHORT_EXPOSURES_S)
        assert not rig.distrust_warnings(read_report(Path("bracket")))
        exposed = [frame["time_s"] for frame in hub.do(device.name, "log")["frames"]]
        assert set(rig.SHORT_EXPOSURES_S) <= {round(time_s, 6) for time_s in exposed}

    def test_metered_and_looked_up(self, hub: rig.RecordingHub, camctl: RunCamctl) -> None:
        done = camctl(
            *("shoot", *rig.camera_arguments(rig.WEB), "-n", "2", "--response", "linear"),
            *("-o", "m"),
        )
        assert done.status == 0, done.err
        # Metering puts the highlights of the shortest exposure just below white.
        assert 0 <= rig.completed_frames("m")[0].saturated_fraction < 0.02
        achieved = read_report(Path("m")).achieved
        assert achieved is not None
        assert achieved.effective_levels > 100

    def test_gain_makes_up_for_time(self, hub: rig.RecordingHub) -> None:
        """The virtual webcam's gain is 1 + register / 16."""
        with rig.open_device(rig.WEB, gain="linear:0.0625") as camera:
            times = camera.controls.time_s
            settings = [
                ExposureSetting(times.nearest(0.016 / gain), float(gain)) for gain in (1, 2, 4, 1)
            ]
            means = [float(frame.pixels.mean()) for frame in camera.shoot(settings)]
        assert means == pytest.approx([means[0]] * 4, rel=0.02)
        assert 20 < means[0] < 235

    def test_without_a_measured_delay_it_settles_and_reports_that(
        self,
        hub: rig.RecordingHub,
        camctl: RunCamctl,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "none"))
        done = camctl("shoot", *rig.camera_arguments(rig.WEB), *rig.SHORT_BRACKET, "-o", "unknown")
        assert done.status == 0, done.err
        rig.completed_frames("unknown")
        with rig.open_device(rig.WEB) as camera:
            assert camera.controls.delay_frames is None
            remedies = [each.remedies for each in camera.controls.findings]
        assert {"calibrate_delay": rig.camera_id(rig.WEB)} in remedies


class TestDelay:
    def test_calibrate_finds_the_delay_of_the_device(
        self,
        hub: rig.RecordingHub,
        camctl: RunCamctl,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
        done = camctl("calibrate", "delay", *rig.camera_arguments(rig.WEB), "--trials", 6)
        assert done.status == 0, done.err
        with rig.open_device(rig.WEB) as camera:
            record = rig.recorded_delay(camera)
            assert (record.frames, record.smallest, record.largest) == (2, 2, 2)
            assert camera.controls.delay_frames == 2

    def test_calibrate_finds_that_a_delay_is_not_constant(
        self,
        hub: rig.RecordingHub,
        camctl: RunCamctl,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
        done = camctl("calibrate", "delay", *rig.camera_arguments(rig.UNSTEADY), "--trials", 8)
        assert done.status == 0, done.err
        with rig.open_device(rig.UNSTEADY) as camera:
            record = rig.recorded_delay(camera)
            assert record.frames is None
            assert 1 <= record.smallest < record.largest <= 3
            assert camera.controls.delay_frames is None
            notes = camera.controls.notes
        assert (
            f"the control delay is not constant ({record.smallest} to {record.largest} frames): "
            "the stream settles after each exposure"
        ) in notes

    @pytest.mark.parametrize(
        ("time", "gain"), [(-1, 2), pytest.param(2, 0, marks=pytest.mark.proof)]
    )
    def test_delays_of_time_and_gain_are_measured_and_used_apart(
        self, hub: rig.RecordingHub, time: int, gain: int
    ) -> None:
        with (
            rig.control_delay(hub, rig.WEB, time, gain),
            rig.open_device(rig.WEB, gain="linear:0.0625") as camera,
        ):
            record = measure_delay(camera, trials=4)
            assert (record.time, record.gain) == ((time, time), (gain, gain))
            times = camera.controls.time_s
            for gains in ((1, 1, 1), (1, 2, 4), (4, 4, 1)):
                settings = [
                    ExposureSetting(times.nearest(0.004 / 2**step), float(gain))
                    for step, gain in enumerate(gains)
                ]
                means = [
                    float(frame.pixels.mean()) / frame.applied.exposure
                    for frame in camera.shoot(settings)
                ]
                # Another setting than its own is a factor of 2 away, or more.
                assert means == pytest.approx([means[0]] * 3, rel=0.2)

    @pytest.mark.parametrize("delay", range(-1, 6))
    def test_n_exposures_cost_n_plus_d_frames(self, hub: rig.RecordingHub, delay: int) -> None:
        with rig.control_delay(hub, rig.WEB, delay):
            cost = rig.frame_cost(hub, rig.WEB)
        assert cost.frames == cost.settings + delay
        assert cost.by_timestamps == cost.settings + delay
        assert cost.slots == list(range(cost.slots[0], cost.slots[0] + cost.settings))

    def test_captures_take_the_predicted_time(self, hub: rig.RecordingHub) -> None:
        """Within 10 % on average: one capture begins at any time within a frame."""
        with rig.open_device(rig.WEB) as camera:
            request = CaptureRequest(ratios=(1.0, 2.0, 3.0, 4.0, 6.0, 8.0), base_s=0.002)
            timings = [capture(camera, request).timing for _ in range(3)]
        errors = [each["planned_wall_s"] / each["actual_wall_s"] - 1 for each in timings]
        print("planned / actual - 1 =", *(f"{error:+.3f}" for error in errors))
        assert abs(fmean(errors)) <= 0.1


class TestCalibration:
    @pytest.mark.proof  # computes for three quarters of a minute
    def test_a_calibrated_webcam_makes_the_linear_picture_that_it_promises(
        self,
        hub: rig.RecordingHub,
        camctl: RunCamctl,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        """Within 1 % of full scale on a ramp, by a webcam that says nothing of its response.

        The other calibrations compute for a minute here, of frames like these:
        tests/calibration/test_steps.py has all of them on the simulated camera, and `TestDelay`
        that of the delay.
        """
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
        rig.record_delay(rig.CURVED, *rig.CURVED.delays)
        arguments = rig.camera_arguments(rig.CURVED)
        for words in (
            ("calibrate", "response", *arguments),
            ("shoot", *arguments, "--response", "linear", "-n", "3", "-o", "linear"),
        ):
            done = camctl(*words)
            assert done.status == 0, done.err
        assert "using the profile" in done.err
        report = read_report(Path("linear"))
        assert isinstance(report, CaptureReport)
        picture = report.image() / 65535
        scene = load_scene(rig.CURVED.model["scene"], shape=picture.shape)
        with SimulatedCamera(scene, Sensor.model_validate(rig.CURVED_SENSOR)) as camera:
            light = scene_truth(camera) * min(frame.applied.exposure for frame in report.frames)
        promised = report.plan.desired.u(np.clip(light, 0, 1)).mean(axis=0)
        inside = light.mean(axis=0) < 0.98  # of what saturates the shortest exposure
        assert inside.sum() > 100
        assert np.abs(picture.mean(axis=0) - promised)[inside].max() <= 0.01


class TestFaults:
    @pytest.fixture(autouse=True)
    def _hub(self, hub: rig.RecordingHub) -> None:
        self.hub = hub
        self.node = rig.video_node(rig.WEB)

    def fault(self, verb: str, **arguments: Any) -> None:
        if verb == "unplug":
            rig.unplug(self.hub, rig.WEB)
        else:
            self.hub.do(rig.WEB.name, verb, **arguments)

    def error_after_first_frame(self, verb: str) -> str:
        """Return the error of a camera that has this fault from its first frame on."""
        with rig.open_device(rig.WEB) as camera:
            settings = [rig.setting(camera, 0.01 * (1 + i % 2)) for i in range(12)]
            with closing(camera.shoot(settings)) as frames:
                next(frames)
                self.fault(verb)
                with pytest.raises(CameraError) as caught:
                    list(frames)
        return one_line(caught.value)

    @pytest.mark.parametrize("verb", FAULTS_OF_A_STREAM)
    def test_fault_after_the_first_frame(self, verb: str) -> None:
        found = self.error_after_first_frame(verb)
        assert re.fullmatch(FAULTS_OF_A_STREAM[verb], found), found

    def test_unplugged_in_a_capture_and_plugged_in_again(self, camctl: RunCamctl) -> None:
        with guest.once_a_frame_is_kept(Path("cut").absolute(), lambda: self.fault("unplug")):
            cut = camctl("shoot", *rig.camera_arguments(rig.WEB), *LONGER_BRACKET, "-o", "cut")
        message = (
            rf"{self.node} was unplugged; plug it in and open it again; \d+ of 12 frames are kept; "
            r"shoot the others \(camctl resume cut\)"
        )
        assert re.fullmatch(message, cut.error), cut.error
        kept = {path: path.stat().st_mtime_ns for path in Path("cut/frames").glob("*.npy")}
        assert kept
        self.fault("plug")
        guest.wait_for("camera", lambda: rig.is_connected(rig.WEB))
        done = camctl("resume", "cut")
        assert done.status == 0, done.err
        assert len(rig.completed_frames("cut")) == 12
        # What had been shot was not shot again.
        assert {path: path.stat().st_mtime_ns for path in kept} == kept

    def test_another_process_streams_from_it(self, camctl: RunCamctl) -> None:
        with guest.held_by_another_process(guest.stream_video, self.node) as holder:
            done = camctl("shoot", *rig.camera_arguments(rig.WEB), *rig.SHORT_BRACKET, "-o", "busy")
        message = (
            rf"process {holder.pid} \(\w+\) is using {self.node}; close it there and try again"
        )
        assert re.fullmatch(message, done.error), done.error

    @pytest.mark.parametrize("is_delivered", [False, True])
    def test_an_erroneous_frame_is_not_summed(self, is_delivered: bool) -> None:
        """Whether uvcvideo drops it, as before Linux 6.12, or delivers it with the error flag."""
        Path("/sys/module/uvcvideo/parameters/nodrop").write_text(str(int(is_delivered)))
        try:
            with rig.open_device(rig.WEB) as camera:
                settings = [rig.setting(camera, 0.002 * 2**i) for i in (0, 4, 1, 3, 2, 4, 0, 3)]
                undisturbed = [frame.pixels for frame in camera.shoot(settings)]
                found = []
                for frame in camera.shoot(settings):
                    found.append(frame.pixels)
                    if frame.index == 1:
                        self.fault("erroneous")
        finally:
            Path("/sys/module/uvcvideo/parameters/nodrop").write_text("0")
        pairs = enumerate(zip(undisturbed, found, strict=True))
        different = {i: (a.mean(), b.mean()) for i, (a, b) in pairs if not np.array_equal(a, b)}
        assert not different

    @pytest.mark.parametrize(
        "verb",
        [
            "truncate",
            *(pytest.param(verb, marks=pytest.mark.proof) for verb in ("garbage", "erroneous")),
        ],
    )
    def test_a_damaged_frame_is_not_delivered(self, camctl: RunCamctl, verb: str) -> None:
        with guest.once_a_frame_is_kept(Path(verb).absolute(), lambda: self.fault(verb)):
            done = camctl("shoot", *rig.camera_arguments(rig.WEB), *LONG_BRACKET, "-o", verb)
        assert done.status == 0, done.err
        rig.completed_frames(verb)
