"""Opening a V4L2 camera: manual exposure, and errors of one line."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from v4l2_bench import one_frame, open_model, opening_error
from v4l2_model import PATH, Model, Register, ticks_of

from camctl.drivers.v4l2.abi import (
    Caps,
    ControlFlag,
    ControlId,
    ControlType,
    ControlValue,
    Request,
    StreamParameters,
)
from camctl.drivers.v4l2.camera import V4l2Camera
from camctl.drivers.v4l2.system import camera_error, processes_using
from camctl.errors import (
    CamctlError,
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from camctl.interface.controls import Choices, ExposureSetting, Layout, Steps
from camctl.messages.plain import sentence

pytestmark = pytest.mark.usefixtures("own_profiles")
#: Value of each automatic function that is turned off, and the default of the gain.
MANUAL = {
    ControlId.EXPOSURE_AUTO: 1,
    ControlId.EXPOSURE_AUTO_PRIORITY: 0,
    ControlId.AUTO_WHITE_BALANCE: 0,
    ControlId.AUTOGAIN: 0,
    ControlId.BACKLIGHT_COMPENSATION: 0,
    ControlId.GAIN: 16,
}


class TestOpening:
    def test_constructor_does_not_open(self) -> None:
        model = Model()
        camera = V4l2Camera(PATH, kernel=model, clock=model.clock)
        assert model.descriptors == 0
        with pytest.raises(CameraDisconnectedError, match="is not open; open it first"):
            camera.shoot([])
        with camera:
            assert model.descriptors == 1
        assert (model.descriptors, model.released) == (0, 1)

    def test_automatic_functions_are_off(self) -> None:
        model = Model()
        with open_model(model) as camera:
            assert {each: model.controls[each].value for each in MANUAL} == MANUAL
            assert not any("cannot be turned off" in note for note in camera.controls.notes)
            (held,) = (each for each in camera.controls.findings if "option:gain" in each.remedies)
            assert "held at its default, 16, called gain 1" in sentence(held)
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

    def test_all_that_changes_pixels_is_turned_off_and_stated(self) -> None:
        model = Model()
        added = {
            ControlId.POWER_LINE_FREQUENCY: 2,
            ControlId.HUE_AUTO: 1,
            ControlId.SCENE_MODE: 3,
            ControlId.IMAGE_STABILIZATION: 1,
            ControlId.HDR_SENSOR_MODE: 1,
            ControlId.WIDE_DYNAMIC_RANGE: 1,
            ControlId.AUTO_N_PRESET_WHITE_BALANCE: 1,
            ControlId.FOCUS_AUTO: 1,
            # By their numbers in videodev2.h and v4l2-controls.h: the classes begin at these.
            0x00980900 + 29: 1,  # V4L2_CID_CHROMA_AGC
            0x00980900 + 32: 1,  # V4L2_CID_AUTOBRIGHTNESS
            0x009A0900 + 24: 1,  # V4L2_CID_ISO_SENSITIVITY_AUTO
        }
        for control, value in added.items():
            model.controls[control] = Register("x", ControlType.MENU, 0, 3, 1, 1, value)
        with open_model(model) as camera:
            assert {model.controls[control].value for control in added} == {0}
            (stated,) = (each for each in camera.controls.notes if each.startswith("turned off: "))
        names = ("the power-line filter", "automatic hue", "continuous autofocus")
        more = ("automatic chroma gain", "automatic brightness", "automatic sensitivity")
        for name in (*names, *more):
            assert name in stated

    def test_focus_is_fixed_where_it_was(self) -> None:
        class Jumping(Model):
            """Its focus goes to its default when the autofocus ends."""

            def s_ctrl(self, found: ControlValue) -> None:
                super().s_ctrl(found)
                if found.id == ControlId.FOCUS_AUTO and not found.value:
                    self.controls[ControlId.FOCUS_ABSOLUTE].value = 0

        model = Jumping()
        model.controls[ControlId.FOCUS_AUTO] = Register("AF", ControlType.BOOLEAN, 0, 1, 1, 1, 1)
        integer = ControlType.INTEGER
        model.controls[ControlId.FOCUS_ABSOLUTE] = Register("F", integer, 0, 250, 5, 0, 120)
        with open_model(model) as camera:
            assert model.controls[ControlId.FOCUS_AUTO].value == 0
            assert model.controls[ControlId.FOCUS_ABSOLUTE].value == 120
            assert "the focus is fixed where it was, at 120" in camera.controls.notes

    @pytest.mark.parametrize("header_bytes", [0, 64])
    @pytest.mark.parametrize("code", ["YUYV", "NV12", "Y10 "])
    def test_multi_planar_node_is_a_camera(self, code: str, header_bytes: int) -> None:
        model = Model(planes=1, formats=(code,), header_bytes=header_bytes)
        with open_model(model) as camera:
            for ticks in (40, 160, 11):
                bits = camera.controls.bits
                assert ticks_of(one_frame(camera, ticks).pixels, bits) == ticks

    def test_multi_planar_node_with_planes_apart_is_refused(self) -> None:
        message = opening_error(CameraProtocolError, Model(planes=2))
        assert "sends its frames in 2 planes apart" in message

    @pytest.mark.parametrize("code", ["RGB3", "BGR3"])
    def test_frames_of_three_colours(self, code: str) -> None:
        with open_model(Model(formats=(code,))) as camera:
            assert camera.controls.layout is Layout.RGB
            pixels = one_frame(camera, 160).pixels
            assert ticks_of(pixels[..., 0]) == 160
            assert (pixels[..., 1] == pixels[..., 0] // 2).all()
            assert (pixels[..., 2] == pixels[..., 0] // 4).all()

    @pytest.mark.parametrize(
        ("options", "mode"),
        [
            ({}, "yuyv-8x6-20"),  # the largest with 15 frames a second or more, at its lowest
            ({"size": "32x24"}, "yuyv-32x24-10"),
            ({"fps": 5.0}, "yuyv-64x48-5"),
            ({"fps": 30.0}, "yuyv-8x6-30"),
        ],
    )
    def test_default_mode_is_the_largest_that_is_fast_enough(
        self, options: dict[str, Any], mode: str
    ) -> None:
        rates = {
            (64, 48): ((1, 5),),
            (32, 24): ((1, 5), (1, 10)),
            (8, 6): ((1, 20), (1, 30)),
            (4, 3): ((1, 60),),
        }

        class Obedient(Model):
            def s_parm(self, found: StreamParameters) -> None:
                """Leave the interval as it was requested."""

        rate = float(mode.rpartition("-")[2])
        model = Obedient(interval_s=1 / rate, sizes=tuple(rates), size_intervals=rates)
        with open_model(model, **options) as camera:
            assert camera.mode == mode

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
