"""Opening a V4L2 camera: manual exposure, samples as the format defines them, one-line errors."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from v4l2_model import COLUMNS, PATH, ROWS, Model, Register, brightness, ticks_of

from camctl.camera import Frame, PreviewingCamera, StreamingCamera
from camctl.controls import Choices, ExposureSetting, Layout, Steps
from camctl.errors import (
    CamctlError,
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
from drivers.v4l2.camera import V4l2Camera, V4l2Options
from drivers.v4l2.system import camera_error, processes_using

NOBODY = 65534
#: Value of each automatic function that is turned off, and the default of the gain.
MANUAL = {
    ControlId.EXPOSURE_AUTO: 1,
    ControlId.EXPOSURE_AUTO_PRIORITY: 0,
    ControlId.AUTO_WHITE_BALANCE: 0,
    ControlId.AUTOGAIN: 0,
    ControlId.BACKLIGHT_COMPENSATION: 0,
    ControlId.GAIN: 16,
}


@pytest.fixture(autouse=True)
def profiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def open_model(model: Model, **options: Any) -> V4l2Camera:
    chosen = V4l2Options.parse(options)
    return V4l2Camera(PATH, chosen, kernel=model, clock=model.clock).open()


def opening_error(kind: type[CamctlError], model: Model, **options: Any) -> str:
    """Return the message with which opening fails; nothing is left open."""
    with pytest.raises(kind) as caught:
        open_model(model, **options)
    assert model.descriptors == 0
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.hint
    return message


def one_frame(camera: V4l2Camera, ticks: int = 100) -> Frame:
    return next(camera.shoot([ExposureSetting(ticks / 10_000)]))


class TestOpening:
    def test_camera_previews_and_streams(self) -> None:
        with open_model(Model()) as camera:
            assert isinstance(camera, PreviewingCamera)
            assert isinstance(camera, StreamingCamera)
            assert camera.mode == "yuyv-8x6-10"
            assert camera.info.model == "A webcam"

    def test_constructor_does_not_open(self) -> None:
        model = Model()
        camera = V4l2Camera(PATH, kernel=model, clock=model.clock)
        assert model.descriptors == 0
        with pytest.raises(CameraDisconnectedError, match="is not open; open it first"):
            camera.shoot([])
        with camera:
            assert model.descriptors == 1
        assert (model.descriptors, model.released) == (0, 1)

    def test_closed_camera_opens_again(self) -> None:
        model = Model()
        camera = open_model(model)
        camera.close()
        with camera.open():
            assert ticks_of(one_frame(camera, 40).pixels) == 40
        assert (model.descriptors, model.released) == (0, 2)

    def test_automatic_functions_are_off(self) -> None:
        model = Model()
        with open_model(model) as camera:
            assert {each: model.controls[each].value for each in MANUAL} == MANUAL
            assert not any("cannot be turned off" in note for note in camera.controls.notes)
            note = (
                "the gain is held at its default, 16, called gain 1: what its 255 steps add is not "
                "known; give it with -O gain"
            )
            assert note in camera.controls.notes
            assert camera.controls.gain == Choices((1.0,))

    @pytest.mark.parametrize(
        "control",
        [
            ControlId.AUTO_WHITE_BALANCE,
            ControlId.AUTOGAIN,
            ControlId.EXPOSURE_AUTO_PRIORITY,
            ControlId.BACKLIGHT_COMPENSATION,
        ],
    )
    def test_what_cannot_be_turned_off_is_noted(self, control: ControlId) -> None:
        model = Model()
        model.controls[control].stuck = True
        with open_model(model) as camera:
            assert sum("cannot be turned off" in note for note in camera.controls.notes) == 1

    def test_read_only_function_that_is_on_is_noted(self) -> None:
        model = Model()
        model.controls[ControlId.AUTOGAIN].flags = ControlFlag.READ_ONLY
        with open_model(model) as camera:
            note = "automatic gain cannot be turned off: frames with one exposure may differ"
            assert note in camera.controls.notes

    def test_power_line_filter_is_left_alone(self) -> None:
        model = Model()
        power_line = 0x00980900 + 24
        model.controls[power_line] = Register("50 Hz", ControlType.MENU, 0, 2, 1, 1, 2)
        with open_model(model):
            assert model.controls[power_line].value == 2

    @pytest.mark.parametrize("fault", ["stuck", "no menu entry", "no exposure time"])
    def test_camera_without_manual_exposure_is_refused(self, fault: str) -> None:
        model = Model()
        if fault == "stuck":
            model.controls[ControlId.EXPOSURE_AUTO].stuck = True
        elif fault == "no menu entry":
            model.controls[ControlId.EXPOSURE_AUTO].menu = (0, 3)
        else:
            del model.controls[ControlId.EXPOSURE_ABSOLUTE]
        assert "so that no exposure can be set" in opening_error(CameraError, model)
        assert model.released == 1

    def test_times_end_at_the_frame_interval(self) -> None:
        with open_model(Model()) as camera:
            times = camera.controls.time_s
            assert isinstance(times, Steps)
            assert (times.minimum, times.maximum) == pytest.approx((1e-4, 0.1))
            assert times.step == pytest.approx(1e-4)
            with pytest.raises(RefusedSettingError) as caught:
                camera.shoot([ExposureSetting(0.25)])
            assert caught.value.nearest == pytest.approx(0.1)

    @pytest.mark.parametrize(("minimum", "step", "first"), [(0, 3, 3), (-5, 2, 1), (-4, 2, 2)])
    def test_times_begin_above_zero(self, minimum: int, step: int, first: int) -> None:
        model = Model()
        control = model.controls[ControlId.EXPOSURE_ABSOLUTE]
        control.minimum, control.step = minimum, step
        with open_model(model) as camera:
            assert camera.controls.time_s.minimum == pytest.approx(first / 10_000)

    @pytest.mark.parametrize(("fps", "mode"), [(None, "10"), (30.0, "30")])
    def test_default_is_the_lowest_frame_rate(self, fps: float | None, mode: str) -> None:
        interval_s = 1 / (fps or 10)
        model = Model(interval_s=interval_s)
        with open_model(model, fps=fps) as camera:
            assert camera.mode.endswith(f"-{mode}")
            assert camera.controls.time_s.maximum == pytest.approx(interval_s, abs=1e-4)

    def test_clamped_exposure_is_refused(self) -> None:
        model = Model()
        with open_model(model) as camera:
            model.controls[ControlId.EXPOSURE_ABSOLUTE].clamp = 50
            with pytest.raises(RefusedSettingError) as caught:
                one_frame(camera, 100)
            assert caught.value.nearest == pytest.approx(0.005)

    def test_close_releases_the_device(self) -> None:
        model = Model()
        camera = open_model(model)
        camera.close()
        camera.close()
        assert (model.descriptors, model.released) == (0, 1)
        with pytest.raises(CameraDisconnectedError):
            camera.preview(ExposureSetting(0.01))

    def test_one_sequence_at_a_time(self) -> None:
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
    def test_default_is_the_format_of_highest_fidelity(
        self, offered: tuple[str, ...], name: str
    ) -> None:
        with open_model(Model(formats=offered)) as camera:
            assert camera.mode.startswith(f"{name}-")

    @pytest.mark.parametrize(
        ("code", "bits", "layout"),
        [
            ("Y16 ", 16, Layout.MONO),
            ("Y14P", 14, Layout.MONO),
            ("Y12 ", 12, Layout.MONO),
            ("Y12P", 12, Layout.MONO),
            ("Y10 ", 10, Layout.MONO),
            ("Y10P", 10, Layout.MONO),
            ("BYR2", 16, Layout.BGGR),
            ("RG14", 14, Layout.RGGB),
            ("pGEE", 14, Layout.GBRG),
            ("BA12", 12, Layout.GRBG),
            ("pRCC", 12, Layout.RGGB),
            ("RG10", 10, Layout.RGGB),
            ("pBAA", 10, Layout.BGGR),
            ("RGGB", 8, Layout.RGGB),
            ("GRBG", 8, Layout.GRBG),
            ("GBRG", 8, Layout.GBRG),
            ("BA81", 8, Layout.BGGR),
            ("GREY", 8, Layout.MONO),
            ("YUYV", 8, Layout.MONO),
        ],
    )
    def test_samples_are_not_changed(self, code: str, bits: int, layout: Layout) -> None:
        with open_model(Model(formats=(code,))) as camera:
            frame = one_frame(camera)
            assert (camera.controls.bits, camera.controls.layout) == (bits, layout)
            assert camera.controls.white == 2**bits - 1
            assert frame.pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
            assert np.array_equal(frame.pixels, brightness(100, bits))

    def test_loss_of_levels_in_jpeg_is_noted(self) -> None:
        with open_model(Model(formats=("MJPG",))) as camera:
            assert any("JPEG frames lose levels" in note for note in camera.controls.notes)
            assert np.abs(one_frame(camera).pixels - brightness(100)).max() < 8

    def test_bits_of_y16(self) -> None:
        model = Model(formats=("Y16 ",))
        with open_model(model, bits=14) as camera:
            assert (camera.controls.bits, camera.controls.white) == (14, 2**14 - 1)
            assert int(one_frame(camera, 10).pixels.max()) < 2**14
            with pytest.raises(CameraProtocolError, match="which has more than 14 bits"):
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
    def test_luma_range(self, quantization: int, range_: str, black: int, white: int) -> None:
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
    def test_response(self, code: str, response: str, is_linear: bool) -> None:
        with open_model(Model(formats=(code,)), response=response) as camera:
            assert (camera.controls.response is None) == is_linear
            note = "the response is assumed to be sRGB until it is measured: -O response=..."
            assert (note in camera.controls.notes) == (code == "YUYV" and response == "auto")

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"format": "y16"}, "does not offer the pixel format y16; it offers yuyv"),
            ({"format": "yuyw"}, "unknown pixel format 'yuyw'; did you mean yuyv"),
            ({"size": (480, 640)}, "does not offer frames of 640x480; it offers 8x6"),
            ({"fps": 25.0}, "does not offer 25 frames a second; it offers 10, 30"),
            ({"bits": 12}, "bits=12 does not apply to the pixel format yuyv"),
            ({"black": 255}, "invalid black level 255; give 0 to 254 DN"),
            ({"response": "gamma"}, "'gamma'"),
            ({"response": "power:x"}, "'power:x'"),
            ({"response": "srgb:2"}, "'srgb:2'"),
        ],
    )
    def test_options_that_the_camera_does_not_support(
        self, options: dict[str, Any], message: str
    ) -> None:
        assert message in opening_error(UsageError, Model(), **options)

    def test_limited_range_of_raw_samples_is_refused(self) -> None:
        model = Model(formats=("Y16 ",))
        message = opening_error(UsageError, model, range="limited")
        assert "range=limited does not apply to the pixel format y16" in message

    def test_black_of_raw_samples(self) -> None:
        with open_model(Model(formats=("Y12 ",)), black=60) as camera:
            assert (camera.controls.black, camera.controls.levels.M) == (60, 4095 - 60)
            assert one_frame(camera).black == 60
            assert not any("black" in note for note in camera.controls.notes)
        with open_model(Model(formats=("Y12 ",))) as camera:
            assert any("give it with -O black=..." in note for note in camera.controls.notes)

    @pytest.mark.parametrize("code", ["YUYV", "GREY", "Y16 ", "RG10", "pRAA", "pBCC"])
    def test_padding_of_lines_is_left_out(self, code: str) -> None:
        with open_model(Model(formats=(code,), bytesperline=64)) as camera:
            frame = one_frame(camera)
            assert np.array_equal(frame.pixels, brightness(100, camera.controls.bits))

    def test_unreadable_formats_are_refused(self) -> None:
        message = opening_error(CameraError, Model(formats=("H264", "\1\2\3\4")))
        assert "offers no pixel format that camctl can read, only H264, ????" in message

    def test_default_is_the_largest_size(self) -> None:
        model = Model(sizes=((4, 2), (COLUMNS, ROWS), (6, 4)))
        with open_model(model) as camera:
            assert camera.controls.shape == (ROWS, COLUMNS)


class TestErrors:
    @pytest.mark.parametrize(
        ("number", "kind", "message"),
        [
            (errno.ENOENT, CameraNotFoundError, "there is no such device"),
            (errno.EACCES, CameraError, "usermod -aG video"),
            (errno.EBUSY, CameraBusyError, f"another process is using {PATH}"),
            (errno.ENODEV, CameraDisconnectedError, "it was unplugged"),
        ],
    )
    def test_opening_fails(self, number: int, kind: type[CamctlError], message: str) -> None:
        assert message in opening_error(kind, Model(first_error=number))

    def test_metadata_node_is_refused(self) -> None:
        message = opening_error(CameraNotFoundError, Model(caps=Caps.STREAMING))
        assert "does not capture video" in message

    def test_device_without_video_ioctls_is_refused(self) -> None:
        model = Model(errors={Request.QUERYCAP: errno.ENOTTY})
        assert "it is not a video device" in opening_error(CameraNotFoundError, model)

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
    def test_controls_fail_during_a_sequence(self, number: int, kind: type[CamctlError]) -> None:
        model = Model()
        with open_model(model) as camera:
            model.errors[Request.S_CTRL] = number
            with pytest.raises(kind) as caught:
                one_frame(camera)
            assert "\n" not in str(caught.value)

    def test_stream_that_cannot_be_opened(self) -> None:
        message = opening_error(CameraProtocolError, Model(streams=False))
        assert f"{PATH} does not stream yuyv at 8x6" in message

    @pytest.mark.parametrize(
        ("request_", "number", "kind", "message"),
        [
            (Request.S_FMT, errno.EBUSY, CameraBusyError, f"another process is using {PATH}"),
            (Request.REQBUFS, errno.ENOMEM, CameraProtocolError, f"cannot stream from {PATH}"),
            (Request.STREAMON, errno.ENOSPC, CameraProtocolError, "has no bandwidth left"),
            (Request.DQBUF, errno.EIO, CameraProtocolError, "the USB transfer failed"),
        ],
        ids=lambda each: getattr(each, "name", None),
    )
    def test_stream_that_fails(
        self, request_: Request, number: int, kind: type[CamctlError], message: str
    ) -> None:
        assert message in opening_error(kind, Model(errors={request_: number}))

    def test_rate_that_cannot_be_set_is_measured(self) -> None:
        model = Model(errors={Request.S_PARM: errno.ENOTTY}, intervals=())
        with open_model(model) as camera:
            assert camera.controls.frame_interval_s == pytest.approx(0.1)

    @pytest.mark.parametrize("value", ["range", "step"])
    def test_contradictory_exposure_range(self, value: str) -> None:
        model = Model()
        control = model.controls[ControlId.EXPOSURE_ABSOLUTE]
        if value == "range":
            control.minimum, control.maximum = 100, 1
        else:
            control.step = 0
        message = opening_error(CameraProtocolError, model)
        assert "sent an invalid response: a range of 'Exposure'" in message

    def test_process_that_uses_the_node_is_named(self, tmp_path: Path) -> None:
        node = tmp_path / "video0"
        node.touch()
        script = "import sys; f = open(sys.argv[1]); print('open', flush=True); sys.stdin.read()"
        with subprocess.Popen(
            [sys.executable, "-c", script, str(node)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            (name,) = processes_using(str(node))
            assert name.startswith(f"process {process.pid} (")
            error = camera_error(OSError(errno.EBUSY, "busy"), str(node), "open")
            assert isinstance(error, CameraBusyError)
            assert f"{name} is using {node}" in str(error)
            process.communicate()
        assert processes_using(str(node)) == []

    def test_own_process_is_named_if_it_has_the_node_open_twice(self, tmp_path: Path) -> None:
        node = tmp_path / "video0"
        node.touch()
        with node.open():
            assert processes_using(str(node)) == []
            with node.open():
                (name,) = processes_using(str(node))
                assert name.startswith(f"process {os.getpid()} (")


class TestGain:
    def test_linear_steps(self) -> None:
        model = Model()
        with open_model(model, gain="linear:0.0625") as camera:
            gains = camera.controls.gain
            assert (gains.minimum, gains.maximum) == (1.0, 1 + 255 / 16)
            assert model.controls[ControlId.GAIN].value == 0
            for gain, register in ((2.0, 16), (1.0, 0), (16.9375, 255)):
                (frame,) = camera.shoot([ExposureSetting(0.01, gain)])
                assert frame.applied.gain == gain
                assert model.controls[ControlId.GAIN].value == register
            note = "the steps of the gain are as -O gain states, and its lowest, 0, is gain 1"
            assert note in camera.controls.notes

    def test_decibel_steps(self) -> None:
        with open_model(Model(), gain="db:0.1") as camera:
            gains = camera.controls.gain
            assert isinstance(gains, Choices)
            assert gains.values[200] == pytest.approx(10.0)

    def test_gain_between_two_steps_is_refused(self) -> None:
        with (
            open_model(Model(), gain="linear:0.0625") as camera,
            pytest.raises(RefusedSettingError) as caught,
        ):
            camera.shoot([ExposureSetting(0.01, 1.03)])
        assert caught.value.nearest in (1.0, 1.0625)

    def test_clamped_gain_is_refused(self) -> None:
        model = Model()
        with open_model(model, gain="linear:0.0625") as camera:
            model.controls[ControlId.GAIN].clamp = 32
            with pytest.raises(RefusedSettingError) as caught:
                list(camera.shoot([ExposureSetting(0.01, 9.0)]))
        assert caught.value.nearest == 3.0

    def test_camera_without_gain(self) -> None:
        model = Model()
        del model.controls[ControlId.GAIN]
        message = opening_error(UsageError, model, gain="db:1")
        assert f"{PATH} has no gain that can be set; leave out -O gain" in message


class TestImageSensor:
    """A sensor's own driver: exposure in lines of (columns + blanking) / pixel rate."""

    def sensor(self, *, blanking: int | None = 92, pixel_rate: int | None = 1_000_000) -> Model:
        model = Model(formats=("pRAA",), pixel_rate=pixel_rate, intervals=())
        for control in (ControlId.EXPOSURE_AUTO, ControlId.EXPOSURE_ABSOLUTE, ControlId.GAIN):
            del model.controls[control]
        integer = ControlType.INTEGER
        model.controls[ControlId.EXPOSURE] = Register("Exposure", integer, 4, 2000, 1, 100, 100)
        model.controls[ControlId.ANALOGUE_GAIN] = Register("Gain", integer, 0, 232, 1, 0, 7)
        if blanking is not None:
            model.controls[ControlId.HBLANK] = Register(
                "Blanking", integer, 92, 92, 1, 92, blanking
            )
        return model

    def test_exposure_in_lines_is_given_in_seconds(self) -> None:
        model = self.sensor()
        with open_model(model) as camera:
            times = camera.controls.time_s
            assert isinstance(times, Steps)
            assert (times.minimum, times.step) == (4e-4, 1e-4)  # 8 + 92 pixels at 1 MHz
            assert times.maximum == pytest.approx(0.1, rel=2e-3)
            (frame,) = camera.shoot([ExposureSetting(0.0123)])
            assert frame.applied.time_s == 0.0123
            assert model.controls[ControlId.EXPOSURE].value == 123
            assert np.array_equal(frame.pixels, brightness(123, 10))
            assert any("lines of 100 us" in note for note in camera.controls.notes)

    def test_analogue_gain_is_held_or_used(self) -> None:
        model = self.sensor()
        with open_model(model):
            assert model.controls[ControlId.ANALOGUE_GAIN].value == 0
        with open_model(self.sensor(), gain="db:0.1") as camera:
            assert camera.controls.gain.maximum == pytest.approx(10 ** (23.2 / 20))

    @pytest.mark.parametrize(
        ("blanking", "pixel_rate", "missing"),
        [
            (None, 1_000_000, "horizontal blanking"),
            (92, None, "pixel rate"),
            (92, 0, "pixel rate"),
            (None, None, "pixel rate and horizontal blanking"),
        ],
    )
    def test_lines_of_unknown_length_are_refused(
        self, blanking: int | None, pixel_rate: int | None, missing: str
    ) -> None:
        model = self.sensor(blanking=blanking, pixel_rate=pixel_rate)
        message = opening_error(CameraError, model)
        assert f"sets its exposure in lines, but does not report {missing}, by which" in message


@contextmanager
def unprivileged(folder: str) -> Iterator[None]:
    """Be a user who may write in `folder` and, unlike root, may not open every file."""
    if os.geteuid() != 0:
        yield
        return
    os.chown(folder, NOBODY, -1)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


class TestRealSystem:
    def test_no_such_node(self) -> None:
        with pytest.raises(CameraNotFoundError, match="there is no such device"):
            V4l2Camera("/dev/video-that-is-not-there").open()

    @pytest.mark.parametrize("path", ["/dev/null", "/", "a\0b", "/dev/null/x", ""])
    def test_path_that_is_not_a_camera(self, path: str) -> None:
        with pytest.raises(CameraNotFoundError) as caught:
            V4l2Camera(path).open()
        assert "\n" not in str(caught.value)

    def test_missing_permission(self) -> None:
        with tempfile.TemporaryDirectory() as folder, unprivileged(folder):
            node = Path(folder) / "video0"
            node.touch(mode=0)
            with pytest.raises(CameraError, match="you are not allowed to use it; join its group"):
                V4l2Camera(str(node)).open()


class TestBackend:
    def test_options_are_read_from_text(self) -> None:
        options = {
            "format": " Y16",
            "size": "640x480",
            "fps": "30",
            "bits": "12",
            "black": "64",
            "gain": "DB:0.1",
            "range": "Full",
            "response": "sRGB",
        }
        chosen = V4l2Options.parse(options)
        assert (chosen.format, chosen.range, chosen.response) == ("y16", "full", "srgb")
        assert chosen.size == (480, 640)
        assert (chosen.fps, chosen.bits, chosen.black) == (30.0, 12, 64)
        assert chosen.gain is not None
        assert chosen.gain.gain(200) == pytest.approx(10.0)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"fsp": "30"}, "unknown camera option 'fsp'; did you mean fps"),
            ({"size": "big"}, "size=big; write WIDTHxHEIGHT, such as 640x480"),
            ({"size": "0x5"}, "size=0x5; write WIDTHxHEIGHT, such as 640x480"),
            ({"fps": "fast"}, "fps=fast; input should be a valid number"),
            ({"fps": "-1"}, "fps=-1; input should be greater than 0"),
            ({"fps": "nan"}, "fps=nan; input should be"),
            ({"bits": "1.5"}, "bits=1.5; input should be a valid integer"),
            ({"bits": "8"}, "bits=8; input should be greater than or equal to 9"),
            ({"black": "²"}, "black=²; input should be a valid integer"),
            ({"black": "-1"}, "black=-1; input should be greater than or equal to 0"),
            ({"range": "half"}, "range=half; input should be 'auto', 'full' or 'limited'"),
        ],
    )
    def test_invalid_options(self, options: dict[str, str], message: str) -> None:
        with pytest.raises(UsageError) as caught:
            V4l2Backend().open("/dev/null", options)
        assert message in str(caught.value)

    @pytest.mark.parametrize("text", ["", "2", "linear", "db:", "db:0", "db:-1", "iso:100", "db:x"])
    def test_invalid_gain(self, text: str) -> None:
        with pytest.raises(UsageError, match=r"gain=.*; give what one step .* linear:0\.0625 or"):
            V4l2Backend().open("/dev/null", {"gain": text})
