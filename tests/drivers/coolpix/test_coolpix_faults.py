"""Faults of a CoolPix and its line, in virtual time: no frame is lost or wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coolpix_bench import (
    SETTINGS,
    check_unplugged,
    coolpix_on,
    data_of,
    do_once,
    learn_format,
    shoot,
    virtual_coolpix,
)
from error_lines import one_line

from camctl.drivers.coolpix.sierra.packets import Action, Register
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from camctl.sim.devices.sierra.camera import RefusedError
from camctl.sim.devices.sierra.device import SierraDevice

pytestmark = pytest.mark.usefixtures("own_profiles")
TIMEOUT_S = 12.0  # of the driver, unless it is given another


class TestFaults:
    @pytest.mark.parametrize("verb", ["nak", "garbage", "truncate"])
    @pytest.mark.parametrize("count", [1, 3])
    def test_a_passing_fault_loses_no_frame(
        self, device: SierraDevice, verb: str, count: int
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            first = next(frames)
            device.do(verb, count=count)
            second = next(frames)
            frames.close()
        assert [f.applied.time_s for f in (first, second)] == [0.002, 0.008]
        assert np.array_equal(second.pixels[..., 0], device.body.sensor.expose(0.008))
        assert len(device.camera.pictures) == 3

    def test_a_camera_that_hangs_is_reported_in_time(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("hang")
            began_s = device.clock.now()
            with pytest.raises(CameraTimeoutError, match="has not answered for 12 s") as caught:
                next(frames)
            assert TIMEOUT_S <= device.clock.now() - began_s < TIMEOUT_S + 1
        one_line(caught.value)

    @pytest.mark.parametrize(
        ("verb", "message"),
        [("card_full", "the card of .* is full; make room"), ("battery_low", r"low \(3 %\); ch")],
    )
    def test_the_reason_of_a_missing_picture_is_reported(
        self, device: SierraDevice, verb: str, message: str
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            device.do(verb)
            with pytest.raises(CameraError, match=message) as caught:
                shoot(camera)
            one_line(caught.value)
            device.do("ok")
            assert len(shoot(camera)) == 2

    def test_a_refusal_without_a_reason_refers_to_the_display(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def refuse() -> None:
            raise RefusedError

        with coolpix_on(device) as camera:
            learn_format(camera)
            monkeypatch.setattr(device.camera, "check_ready", refuse)
            with pytest.raises(CameraError, match="took no picture; look at its display") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_a_silently_changed_time_is_refused(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            device.do("clamp", max_s=0.005)
            with pytest.raises(RefusedSettingError, match=r"nearest it can do is 0\.004") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_a_file_with_another_exposure_time_is_an_error(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            release = device.body.release
            monkeypatch.setattr(
                device.body,
                "release",
                lambda exposure, done: release(replace(exposure, time_s=0.004), done),
            )
            with pytest.raises(CameraProtocolError, match=r"0\.004 s, but 0\.008 s was set"):
                shoot(camera, SETTINGS[1:])

    def test_an_automatic_mode_is_an_error_on_opening(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(device.camera, "_set_shutter", lambda value: None)
        with pytest.raises(CameraError, match=r"accepts no shutter time; turn its dial") as caught:
            coolpix_on(device)
        one_line(caught.value)

    def test_a_format_that_the_camera_does_not_have_is_an_error_on_opening(self) -> None:
        with (
            virtual_coolpix(files="jpeg") as device,
            pytest.raises(CameraError, match=r"cannot be set to tiff; .*HI is tiff"),
        ):
            coolpix_on(device)


class TestDisconnection:
    def test_an_unplugged_line_is_reported(self, device: SierraDevice) -> None:
        check_unplugged(device)

    def test_a_picture_taken_before_the_disconnection_is_downloaded_after(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            do_once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(
                CameraDisconnectedError, match=r"a picture of 0\.002 s that was not downloaded"
            ) as caught:
                shoot(camera, SETTINGS[:1])
            one_line(caught.value)
            taken = len(device.camera.pictures)
            device.do("plug")
            first, second = shoot(camera)
        assert data_of(first) == device.camera.pictures[taken - 1].data
        assert data_of(second) == device.camera.pictures[taken].data
        assert len(device.camera.pictures) == taken + 1

    def test_a_picture_with_another_setting_is_not_taken_for_the_next(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            do_once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(CameraDisconnectedError):
                shoot(camera, SETTINGS[:1])
            device.do("plug")
            (frame,) = shoot(camera, SETTINGS[1:])
        assert frame.applied.time_s == 0.008
        assert data_of(frame) == device.camera.pictures[-1].data

    @pytest.mark.parametrize(
        ("method", "argument"),
        [
            ("read", Register.PICTURE_NAME),
            ("get", Register.SHUTTER_US),
            ("get", Register.APERTURE),
            ("act", Action.TAKE_PICTURE),
            ("get", Register.PICTURE_BYTES),
            ("read", Register.PICTURE_DATA),
        ],
    )
    def test_switching_off_and_on_loses_no_frame(
        self, device: SierraDevice, method: str, argument: int
    ) -> None:
        def switch_off_and_on() -> None:
            with device.lock:
                device._end_session()
                device.camera._quality = 0x13
                device.camera._set_shutter(0)
                device.camera._aperture = 3
                device.camera._selected = 0

        with coolpix_on(device) as camera:
            learn_format(camera)
            taken = len(device.camera.pictures)
            do_once(camera, method, argument, switch_off_and_on)
            frames = shoot(camera)
        assert [frame.applied.time_s for frame in frames] == [0.002, 0.008]
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
        assert len(device.camera.pictures) == taken + 2

    def test_a_session_that_ends_before_the_exposure_loses_no_frame(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device, speed=19200) as camera:
            learn_format(camera)
            do_once(camera, "act", Action.TAKE_PICTURE, lambda: device.do("break"))
            assert len(shoot(camera)) == 2
        assert len(device.camera.pictures) == 3
