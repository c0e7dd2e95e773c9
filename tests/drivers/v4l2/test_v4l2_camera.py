"""Opening a V4L2 camera: automatics off, pixels that are what they say, or one line why not."""

import errno
import os
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from v4l2_model import COLUMNS, PATH, ROWS, Model, Register, brightness, ticks_of

from camctl.camera import PreviewingCamera, StreamingCamera
from camctl.controls import ExposureSetting, Layout
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
    UsageError,
)
from drivers.v4l2.abi import Caps, ControlFlag, ControlId, ControlType, Request
from drivers.v4l2.backend import V4l2Backend
from drivers.v4l2.camera import V4l2Camera
from drivers.v4l2.capture import open_video
from drivers.v4l2.controls import parse_gain
from drivers.v4l2.errors import camera_error, holding

NOBODY = 65534
AUTOMATICS = {
    ControlId.EXPOSURE_AUTO: 1,
    ControlId.EXPOSURE_AUTO_PRIORITY: 0,
    ControlId.AUTO_WHITE_BALANCE: 0,
    ControlId.AUTOGAIN: 0,
    ControlId.BACKLIGHT_COMPENSATION: 0,
    ControlId.GAIN: 16,
}


@pytest.fixture(autouse=True)
def profiles(monkeypatch, tmp_path):
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def open_model(model, **options):
    return V4l2Camera(PATH, kernel=model, opener=model.video, clock=model.clock, **options)


def refused(kind, model, **options):
    with pytest.raises(kind) as caught:
        open_model(model, **options)
    assert model.descriptors == 0
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.hint
    return message


def one_frame(camera, ticks=100):
    return next(iter(camera.shoot([ExposureSetting(ticks / 10_000)])))


class TestOpening:
    def test_it_is_what_a_stream_has_to_be(self):
        with open_model(Model()) as camera:
            assert isinstance(camera, PreviewingCamera)
            assert isinstance(camera, StreamingCamera)
            assert camera.mode == "yuyv-8x6-10"
            assert camera.info.model == "A webcam"

    def test_automatics_are_off(self):
        model = Model()
        with open_model(model) as camera:
            assert {each: model.controls[each].value for each in AUTOMATICS} == AUTOMATICS
            assert not any("cannot be turned off" in note for note in camera.controls.notes)
            assert any("gain is held at its default, 16" in note for note in camera.controls.notes)
            assert camera.controls.gain.values == (1.0,)

    @pytest.mark.parametrize(
        "control",
        [
            ControlId.AUTO_WHITE_BALANCE,
            ControlId.AUTOGAIN,
            ControlId.EXPOSURE_AUTO_PRIORITY,
            ControlId.BACKLIGHT_COMPENSATION,
        ],
    )
    def test_what_cannot_be_turned_off_is_noted(self, control):
        model = Model()
        model.controls[control].stuck = True
        with open_model(model) as camera:
            assert sum("cannot be turned off" in note for note in camera.controls.notes) == 1

    def test_a_read_only_automatic_that_is_on_is_noted(self):
        model = Model()
        model.controls[ControlId.AUTOGAIN].flags = ControlFlag.READ_ONLY
        with open_model(model) as camera:
            assert any("automatic gain cannot" in note for note in camera.controls.notes)

    def test_the_power_line_filter_stays(self):
        model = Model()
        power_line = 0x00980900 + 24
        model.controls[power_line] = Register("50 Hz", ControlType.MENU, 0, 2, 1, 1, 2)
        with open_model(model):
            assert model.controls[power_line].value == 2

    @pytest.mark.parametrize("fault", ["stuck", "no entry", "no time"])
    def test_without_manual_exposure(self, fault):
        model = Model()
        if fault == "stuck":
            model.controls[ControlId.EXPOSURE_AUTO].stuck = True
        elif fault == "no entry":
            model.controls[ControlId.EXPOSURE_AUTO].menu = (0, 3)
        else:
            del model.controls[ControlId.EXPOSURE_ABSOLUTE]
        assert "no exposure can be set" in refused(CameraError, model)
        assert model.released == 1

    def test_times_end_at_the_frame_interval(self):
        with open_model(Model()) as camera:
            times = camera.controls.time_s
            assert (times.minimum, times.maximum) == pytest.approx((1e-4, 0.1))
            assert times.step == pytest.approx(1e-4)
            with pytest.raises(RefusedSettingError) as caught:
                camera.shoot([ExposureSetting(0.25)])
            assert caught.value.nearest == pytest.approx(0.1)

    @pytest.mark.parametrize(("minimum", "step", "first"), [(0, 3, 3), (-5, 2, 1), (-4, 2, 2)])
    def test_a_range_from_zero_begins_above_it(self, minimum, step, first):
        model = Model()
        control = model.controls[ControlId.EXPOSURE_ABSOLUTE]
        control.minimum, control.step = minimum, step
        with open_model(model) as camera:
            assert camera.controls.time_s.minimum == pytest.approx(first / 10_000)

    @pytest.mark.parametrize(("fps", "mode"), [(None, "10"), (30.0, "30")])
    def test_the_lowest_rate_unless_another_is_asked_for(self, fps, mode):
        rate = 1 / (fps or 10)
        model = Model(interval_s=rate)
        with open_model(model, fps=fps) as camera:
            assert camera.mode.endswith(f"-{mode}")
            assert camera.controls.time_s.maximum == pytest.approx(rate, abs=1e-4)

    def test_a_clamped_exposure_is_not_believed(self):
        model = Model()
        with open_model(model) as camera:
            model.controls[ControlId.EXPOSURE_ABSOLUTE].clamp = 50
            with pytest.raises(RefusedSettingError) as caught:
                one_frame(camera, 100)
            assert caught.value.nearest == pytest.approx(0.005)

    def test_a_closed_camera_has_let_go(self):
        model = Model()
        camera = open_model(model)
        camera.close()
        camera.close()
        assert (model.descriptors, model.released) == (0, 1)
        with pytest.raises(CameraDisconnectedError):
            camera.preview(ExposureSetting(0.01))

    def test_one_shot_at_a_time(self):
        with open_model(Model()) as camera:
            frames = camera.shoot([ExposureSetting(0.01)] * 2)
            next(frames)
            with pytest.raises(CameraBusyError):
                camera.preview(ExposureSetting(0.01))
            frames.close()
            assert ticks_of(camera.preview(ExposureSetting(0.02)).pixels) == 200


class TestFormats:
    @pytest.mark.parametrize(
        ("offered", "name"),
        [
            (("MJPG", "YUYV"), "yuyv"),
            (("MJPG", "YUYV", "GREY"), "grey"),
            (("YUYV", "RG10"), "bayer10"),
            (("RGGB", "Y10 ", "Y12 "), "y12"),
            (("Y12 ", "Y16 "), "y16"),
            (("MJPG", "H264"), "mjpg"),
        ],
    )
    def test_the_most_honest_is_taken(self, offered, name):
        with open_model(Model(formats=offered)) as camera:
            assert camera.mode.startswith(f"{name}-")

    @pytest.mark.parametrize(
        ("codes", "bits", "layout"),
        [
            (("Y16 ",), 16, Layout.MONO),
            (("Y12 ",), 12, Layout.MONO),
            (("Y10 ",), 10, Layout.MONO),
            (("RG10", "YUYV"), 10, Layout.RGGB),
            (("RGGB", "YUYV"), 8, Layout.RGGB),
            (("GRBG",), 8, Layout.GRBG),
            (("GBRG",), 8, Layout.GBRG),
            (("BA81",), 8, Layout.BGGR),
            (("GREY",), 8, Layout.MONO),
            (("YUYV",), 8, Layout.MONO),
        ],
    )
    def test_samples_come_as_they_are(self, codes, bits, layout):
        with open_model(Model(formats=codes)) as camera:
            frame = one_frame(camera)
            assert (camera.controls.bits, camera.controls.layout) == (bits, layout)
            assert camera.controls.white == 2**bits - 1
            assert frame.pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
            assert np.array_equal(frame.pixels, brightness(100, bits))

    def test_jpeg_loses_levels_and_says_so(self):
        with open_model(Model(formats=("MJPG",))) as camera:
            assert any("lose levels" in note for note in camera.controls.notes)
            assert np.abs(one_frame(camera).pixels - brightness(100)).max() < 8

    def test_bits_of_y16(self):
        model = Model(formats=("Y16 ",))
        with open_model(model, bits=14) as camera:
            assert (camera.controls.bits, camera.controls.white) == (14, 2**14 - 1)
            assert int(one_frame(camera, 10).pixels.max()) < 2**14
            with pytest.raises(CameraProtocolError, match="14 bits"):
                one_frame(camera, 200)

    @pytest.mark.parametrize(
        ("quantization", "range_", "black", "white"),
        [
            (0, "auto", 16, 235),
            (1, "auto", 0, 255),
            (2, "auto", 16, 235),
            (2, "full", 0, 255),
            (1, "limited", 16, 235),
        ],
    )
    def test_luma_range(self, quantization, range_, black, white):
        with open_model(Model(quantization=quantization), range=range_) as camera:
            controls = camera.controls
            assert (controls.black, controls.white) == (black, white)
            assert white - black == controls.levels.M
            frame = one_frame(camera)
            assert (frame.black, frame.white) == (black, white)

    @pytest.mark.parametrize(
        ("code", "response", "is_linear"),
        [
            ("YUYV", "auto", False),
            ("YUYV", "linear", True),
            ("Y16 ", "auto", True),
            ("Y16 ", "srgb", False),
            ("YUYV", "power:1.8", False),
            ("YUYV", "rec709", False),
        ],
    )
    def test_response(self, code, response, is_linear):
        with open_model(Model(formats=(code,)), response=response) as camera:
            assert (camera.controls.response is None) == is_linear
            is_assumed = any("assumed" in note for note in camera.controls.notes)
            assert is_assumed == (code == "YUYV" and response == "auto")

    @pytest.mark.parametrize(
        "options",
        [
            {"format": "y16"},
            {"format": "yuyw"},
            {"size": (640, 480)},
            {"fps": 25.0},
            {"fps": -1.0},
            {"bits": 12},
            {"range": "half"},
            {"black": 255},
            {"black": -1},
            {"response": "gamma"},
            {"response": "power:x"},
            {"response": "srgb:2"},
        ],
    )
    def test_options_that_do_not_fit(self, options):
        refused(UsageError, Model(), **options)

    def test_black_of_raw_samples(self):
        with open_model(Model(formats=("Y12 ",)), black=60) as camera:
            assert (camera.controls.black, camera.controls.levels.M) == (60, 4095 - 60)
            assert one_frame(camera).black == 60
            assert not camera.controls.notes[:-2]
        with open_model(Model(formats=("Y12 ",))) as camera:
            assert any("-O black=" in note for note in camera.controls.notes)

    def test_padded_lines_are_refused(self):
        assert "pads" in refused(CameraError, Model(bytesperline=2 * COLUMNS + 16))

    def test_a_format_that_nobody_reads(self):
        message = refused(CameraError, Model(formats=("H264", "\1\2\3\4")))
        assert "H264" in message

    def test_a_format_that_opencv_does_not_open(self):
        assert "OpenCV opens no camera" in refused(CameraError, Model(formats=("RGGB", "RG10")))

    def test_the_largest_size(self):
        model = Model(sizes=((4, 2), (COLUMNS, ROWS), (6, 4)))
        with open_model(model) as camera:
            assert camera.controls.shape == (ROWS, COLUMNS)


class TestTrouble:
    @pytest.mark.parametrize(
        ("number", "kind", "words"),
        [
            (errno.ENOENT, CameraNotFoundError, "no such device"),
            (errno.EACCES, CameraError, "usermod -aG video"),
            (errno.EBUSY, CameraBusyError, "using"),
            (errno.ENODEV, CameraDisconnectedError, "went away"),
        ],
    )
    def test_opening_fails(self, number, kind, words):
        assert words in refused(kind, Model(first_error=number))

    def test_a_metadata_node_is_no_camera(self):
        assert "captures no video" in refused(CameraNotFoundError, Model(caps=Caps.STREAMING))

    def test_a_node_that_answers_no_ioctl(self):
        model = Model(errors={Request.QUERYCAP: errno.ENOTTY})
        assert "not a video device" in refused(CameraNotFoundError, model)

    @pytest.mark.parametrize(
        ("number", "kind"),
        [
            (errno.EIO, CameraProtocolError),
            (errno.ENODEV, CameraDisconnectedError),
            (errno.ETIMEDOUT, CameraTimeoutError),
            (errno.EPIPE, CameraProtocolError),
            (errno.ENOMEM, CameraProtocolError),
        ],
    )
    def test_controls_fail_in_the_middle(self, number, kind):
        model = Model()
        with open_model(model) as camera:
            model.errors[Request.S_CTRL] = number
            with pytest.raises(kind) as caught:
                one_frame(camera)
            assert "\n" not in str(caught.value)

    def test_a_stream_that_cannot_be_opened(self):
        assert "cannot be opened" in refused(CameraProtocolError, Model(opens=False))

    def test_frames_that_fail_at_once(self, monkeypatch):
        monkeypatch.setattr("v4l2_model.Video.grab", lambda video: False)
        assert "gives no frames" in refused(CameraProtocolError, Model())

    @pytest.mark.parametrize("value", ["range", "step"])
    def test_an_exposure_range_of_nonsense(self, value):
        model = Model()
        control = model.controls[ControlId.EXPOSURE_ABSOLUTE]
        if value == "range":
            control.minimum, control.maximum = 100, 1
        else:
            control.step = 0
        assert "nonsense" in refused(CameraProtocolError, model)

    def test_who_holds_a_node_is_named(self, tmp_path):
        node = tmp_path / "video0"
        node.touch()
        script = "import sys; f = open(sys.argv[1]); print('open', flush=True); sys.stdin.read()"
        with subprocess.Popen(
            [sys.executable, "-c", script, str(node)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as process:
            process.stdout.readline()
            (name,) = holding(str(node))
            assert name.startswith(f"process {process.pid} (")
            error = camera_error(OSError(errno.EBUSY, "busy"), str(node), "open")
            assert isinstance(error, CameraBusyError)
            assert name in str(error)
            process.communicate()
        assert list(holding(str(node))) == []
        with node.open():
            assert list(holding(str(node))) == []
            with node.open():
                (name,) = holding(str(node))
                assert name.startswith(f"process {os.getpid()} (")


@contextmanager
def nobody_in_particular(folder):
    """Be a user who may write in `folder`, and may not open everything as root may."""
    if os.geteuid() != 0:
        yield
        return
    os.chown(folder, NOBODY, -1)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


class TestGain:
    def test_its_steps_do_what_the_user_says(self):
        model = Model()
        with open_model(model, gain=parse_gain("linear:0.0625")) as camera:
            gains = camera.controls.gain
            assert (gains.minimum, gains.maximum) == (1.0, 1 + 255 / 16)
            assert model.controls[ControlId.GAIN].value == 0
            for gain, register in ((2.0, 16), (1.0, 0), (16.9375, 255)):
                (frame,) = camera.shoot([ExposureSetting(0.01, gain)])
                assert frame.applied.gain == gain
                assert model.controls[ControlId.GAIN].value == register
            assert any("-O gain" in note for note in camera.controls.notes)

    def test_decibels(self):
        with open_model(Model(), gain=parse_gain("db:0.1")) as camera:
            assert camera.controls.gain.values[200] == pytest.approx(10.0)

    def test_between_its_steps_it_is_refused(self):
        with (
            open_model(Model(), gain=parse_gain("linear:0.0625")) as camera,
            pytest.raises(RefusedSettingError) as refused,
        ):
            camera.shoot([ExposureSetting(0.01, 1.03)])
        assert refused.value.nearest in (1.0, 1.0625)

    def test_one_that_the_camera_changes_silently_is_refused(self):
        model = Model()
        with open_model(model, gain=parse_gain("linear:0.0625")) as camera:
            model.controls[ControlId.GAIN].clamp = 32
            with pytest.raises(RefusedSettingError) as refused:
                list(camera.shoot([ExposureSetting(0.01, 9.0)]))
        assert refused.value.nearest == 3.0

    def test_a_camera_without_gain_says_so(self):
        model = Model()
        del model.controls[ControlId.GAIN]
        with pytest.raises(UsageError, match="no gain"):
            open_model(model, gain=parse_gain("db:1"))

    @pytest.mark.parametrize("text", ["", "2", "linear", "db:", "db:0", "db:-1", "iso:100", "db:x"])
    def test_what_is_no_unit(self, text):
        with pytest.raises(UsageError, match=r"linear:0\.0625"):
            parse_gain(text)


class TestRealSystem:
    def test_no_such_node(self):
        with pytest.raises(CameraNotFoundError):
            V4l2Camera("/dev/video-that-is-not-there")

    @pytest.mark.parametrize("path", ["/dev/null", "/", "a\0b", "/dev/null/x", ""])
    def test_what_is_no_camera(self, path):
        with pytest.raises(CameraError) as caught:
            V4l2Camera(path)
        assert "\n" not in str(caught.value)

    def test_permission(self):
        with tempfile.TemporaryDirectory() as folder, nobody_in_particular(folder):
            node = Path(folder) / "video0"
            node.touch(mode=0)
            with pytest.raises(CameraError, match="group"):
                V4l2Camera(str(node))

    def test_opencv_keeps_quiet(self, capfd):
        assert not open_video("/dev/video-that-is-not-there").isOpened()
        assert capfd.readouterr() == ("", "")


class TestRoad:
    def test_unknown_options(self):
        with pytest.raises(UsageError, match="did you mean fps"):
            V4l2Backend().open("/dev/null", {"fsp": "30"})

    @pytest.mark.parametrize(
        "options",
        [{"size": "big"}, {"fps": "fast"}, {"bits": "1.5"}, {"black": "²"}, {"size": "0x5"}],
    )
    def test_values_that_are_none(self, options):
        with pytest.raises(UsageError):
            V4l2Backend().open("/dev/null", options)
