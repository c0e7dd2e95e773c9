"""Manners of single makers' bodies: modes, dials, releases and sessions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from ptp_bench import bench, camera_on, operations, settings_at, shoot

from camctl.drivers.ptp import makers, sequence
from camctl.drivers.ptp.camera import PtpCamera
from camctl.drivers.ptp.makers import NIKON, dialect_of
from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.controls import Choices, ExposureSetting
from camctl.sim.devices.ptp.protocol import Reply

pytestmark = pytest.mark.usefixtures("own_profiles")


class TestNikon:
    def test_properties_that_only_90ca_lists_are_found(self) -> None:
        with camera_on(vendor="nikon", hides_properties=True) as (camera, device):
            assert 0xD100 not in device.responder.listed_properties()
            assert camera.controls.time_s.minimum == 1 / 8000
            (frame,) = shoot(camera, [ExposureSetting(1 / 3200)])
            assert frame.applied.time_s == 1 / 3200

    def test_control_is_taken_if_the_time_cannot_be_set_and_given_back(self) -> None:
        pair = bench(vendor="nikon", mode="auto", needs_control=True)
        pair.device.responder.properties[0x500E].value = 1  # the mode dial is at M
        with pair.camera() as camera:
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1
        modes = [e["parameters"] for e in pair.device.responder.log if e["operation"] == "90C2"]
        assert modes == [[1], [0]]

    def test_a_body_that_90ca_crashes_is_not_asked(self) -> None:
        operations = frozenset({0x90C7, 0x90C8, 0x90CA})
        for model, is_crashed in (("V1", True), ("J1", True), ("J2", True), ("J4", False)):
            dialect = dialect_of(0x0A, "Nikon Corporation", operations, model)
            assert (0x90CA in dialect.unreliable) is is_crashed

    def test_an_operation_that_does_not_work_is_not_used(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(makers, "_MODELS", ((NIKON, ".*", {"unreliable": {0x90CA}}),))
        with camera_on(vendor="nikon", crashes_on=(0x90CA,)) as (camera, device):
            assert len(shoot(camera, settings_at(camera, 1 / 3200))) == 1
            assert 0x90CA not in operations(device)

    def test_automatic_iso_is_switched_off(self) -> None:
        with camera_on(vendor="nikon", auto_iso=True, hides_properties=True) as (camera, device):
            (frame,) = shoot(camera, settings_at(camera, 1 / 125))
            assert device.do("state")["exposure"]["gain"] == frame.applied.gain == 1.0

    def test_automatic_iso_that_stays_on_is_an_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        pair = bench(vendor="nikon", auto_iso=True)
        execute = pair.device.responder.execute

        def ignore(code: int, number: int, parameters: Sequence[int], data: bytes) -> Any:
            is_setting = code == 0x1016 and tuple(parameters[:1]) == (0xD054,)
            return Reply() if is_setting else execute(code, number, parameters, data)

        monkeypatch.setattr(pair.device.responder, "execute", ignore)
        with pytest.raises(CameraError, match="chooses its sensitivity itself; switch automatic"):
            pair.camera()

    def test_a_body_that_takes_one_parameter_is_released(self) -> None:
        with camera_on(vendor="nikon", parameters_9207=1) as (camera, device):
            shoot(camera, settings_at(camera, 1 / 125, 1 / 60))
            released = [e for e in device.responder.log if e["operation"] == "9207"]
            assert [len(e["parameters"]) for e in released] == [2, 2, 1, 1, 1]  # type: ignore[arg-type]

    def test_a_body_that_refuses_to_release_without_focusing_is_released_with_it(self) -> None:
        with camera_on(vendor="nikon", needs_focus=True) as (camera, device):
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1
            assert device.body.taken == 2

    def test_the_time_that_can_be_set_is_preferred_to_the_exact_one(self) -> None:
        pair = bench(vendor="nikon")
        pair.device.responder.properties[0xD100].is_writable = False
        with pair.camera() as camera:
            assert isinstance(camera.controls.time_s, Choices)
            assert len(camera.controls.time_s.values) > 1


class TestCanon:
    def test_thirds_of_a_stop_are_exact(self) -> None:
        with camera_on(vendor="canon", isos=(100, 125, 160), f_numbers=(400, 450, 500)) as (c, d):
            times = c.controls.time_s
            assert isinstance(times, Choices)
            assert np.allclose(np.diff(np.log2(times.values)), 1 / 3, atol=1e-12)
            setting = ExposureSetting(times.nearest(0.8), 2 ** (2 / 3), 2 ** (13 / 6))
            (frame,) = shoot(c, [setting])
            assert frame.applied == setting
            exposed = d.do("state")["exposure"]
            assert exposed["time_s"] == pytest.approx(2 ** (-1 / 3), rel=1e-12)
            assert exposed["gain"] == pytest.approx(2 ** (2 / 3), rel=1e-12)

    def test_empty_first_polls_are_repeated(self) -> None:
        with camera_on(vendor="canon", empty_polls=3) as (camera, _):
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1

    @pytest.mark.parametrize(
        ("body", "mode"),
        [
            ("canon-eos-m3", 0x15),
            ("canon-eos-m6-mark2", 1),
            ("canon-powershot-g5x", 0x11),
            ("canon-eos6d", 1),
        ],
    )
    def test_the_remote_mode_is_the_one_of_the_model(self, body: str, mode: int) -> None:
        with camera_on(body=body) as (camera, device):
            sent = [e["parameters"] for e in device.responder.log if e["operation"] == "9114"]
            assert sent == [[mode]]
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1


class TestSony:
    def test_a_dial_is_stepped_no_faster_than_it_moves(self) -> None:
        """An SLT takes 0.7 s for a step and loses those before."""
        with camera_on(vendor="sony", absolute=False, step_s=0.7) as (camera, device):
            frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 15, 1 / 250))
            assert [f.applied.time_s for f in frames] == [1 / 125, 1 / 15, 1 / 250]
            steps = [e for e in device.responder.log if e["operation"] == "9207"]
            # Test picture, then three settings: no step but those on the way, and one to learn
            # the direction; and four for each release.
            assert len(steps) < 60

    def test_the_computer_takes_priority_over_the_dials(self) -> None:
        with camera_on(vendor="sony") as (camera, device):
            assert device.responder.properties.number(0xD25A) == 1
            (frame,) = shoot(camera, settings_at(camera, 1 / 500))
            assert device.do("state")["exposure"]["time_s"] == frame.applied.time_s == 1 / 500

    def test_the_property_that_sets_the_time_at_once_is_used(self) -> None:
        with camera_on(body="sony-a7r4") as (camera, device):
            shoot(camera, settings_at(camera, 1 / 500))
            log = device.responder.log
            assert not [e for e in log if (e["operation"], e["parameters"]) == ("9207", [0xD20D])]
            assert [e for e in log if (e["operation"], e["parameters"]) == ("9205", [0xD229])]

    def test_no_picture_is_asked_for_during_the_start_up(self) -> None:
        with camera_on(body="sony-ilce1") as (camera, _):
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1
            assert camera.clock.now() > 3.0

    def test_a_picture_that_waits_in_memory_is_not_the_one_that_is_shot(self) -> None:
        """A person has pressed the button of the camera; its pictures are served in order."""
        with camera_on(vendor="sony") as (camera, device):
            dim, bright = settings_at(camera, 1 / 500, 1 / 60)
            (one,) = shoot(camera, [dim])
            device.responder.release(is_bulb=False)
            camera.clock.sleep_until(camera.clock.now() + 5)
            assert device.responder.card.memory
            (other,) = shoot(camera, [bright])
            assert other.pixels.mean() > 2 * one.pixels.mean()
            assert not device.responder.card.memory

    def test_objects_of_all_stores_are_not_listed(self) -> None:
        with camera_on(vendor="sony") as (camera, device):
            shoot(camera, settings_at(camera, 1 / 125))
            assert 0x1007 not in operations(device)


class TestFuji:
    def test_times_are_the_powers_of_two_that_its_numbers_stand_for(self) -> None:
        with camera_on(vendor="fuji") as (camera, device):
            (frame,) = shoot(camera, settings_at(camera, 1 / 60))
            assert frame.applied.time_s == device.do("state")["exposure"]["time_s"] == 1 / 64

    def test_a_camera_out_of_focus_is_reported(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with camera_on(vendor="fuji") as (camera, device):
            settings = settings_at(camera, 1 / 60)
            state = device.responder.properties[0xD209]
            monkeypatch.setattr(
                device.responder, "_focus_found", lambda: setattr(state, "value", 3)
            )
            with pytest.raises(CameraError, match="it cannot focus; set the lens to manual"):
                shoot(camera, settings)

    def test_the_dials_have_priority_again_after_closing(self) -> None:
        pair = bench(vendor="fuji")
        priority = pair.device.responder.properties[0xD207]
        with pair.camera():
            assert priority.value == 2
        assert priority.value == 1


class TestStatedExposure:
    @pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
    @pytest.mark.parametrize(
        ("method", "value", "message"),
        [
            ("gain", 4.0, "states a sensitivity of 4 x ISO 100, but 1 x ISO 100 was set"),
            ("f_number", 11.0, "states an aperture of f/11, but f/4 was set"),
        ],
    )
    def test_a_file_with_another_sensitivity_or_aperture_is_an_error(
        self, vendor: str, method: str, value: float, message: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        if vendor != "none":  # three may be of an exposure before, and their own are waited for
            monkeypatch.setattr(sequence, "_MOST_STALE", 1)
        with camera_on(vendor=vendor) as (camera, device):
            (setting,) = settings_at(camera, 1 / 125)
            f_number = camera.controls.f_number
            assert f_number is not None
            setting = ExposureSetting(setting.time_s, setting.gain, f_number.nearest(4.0))
            monkeypatch.setattr(device.responder, method, lambda: value)
            with pytest.raises(CameraProtocolError, match=re.escape(message)):
                shoot(camera, [setting])


class TestPanasonic:
    def test_a_body_that_lists_no_times_is_set_by_numbers_and_read_back(self) -> None:
        with camera_on(vendor="panasonic") as (camera, device):
            frames = shoot(camera, settings_at(camera, 1 / 125, 2.5))
            assert [f.applied.time_s for f in frames] == [1 / 125, 2.5]
            assert device.do("state")["exposure"]["time_s"] == 2.5

    def test_the_session_of_the_maker_is_closed(self) -> None:
        pair = bench(vendor="panasonic")
        with closing(pair.camera()) as camera:
            assert isinstance(camera, PtpCamera)
        assert operations(pair.device)[-2:] == [0x9103, 0x1003]


@pytest.mark.parametrize(
    ("config", "lens", "mode"),
    [
        ({"vendor": "nikon"}, "18-55 mm f/3.5-5.6", "M"),
        ({"vendor": "nikon", "hides_properties": True}, "18-55 mm f/3.5-5.6", "M"),
        ({"vendor": "canon"}, "EF50mm f/1.8 STM", "M"),
        ({"vendor": "sony"}, None, "M"),
        ({"vendor": "none"}, None, "M"),
        ({"vendor": "olympus"}, None, None),
    ],
)
def test_lens_and_mode_dial_are_stated(
    config: dict[str, Any], lens: str | None, mode: str | None
) -> None:
    with camera_on(**config) as (camera, _):
        stated = camera.condition()
    assert (stated.lens, stated.mode) == (lens, mode)


def test_a_mode_that_has_no_name_is_not_stated() -> None:
    with camera_on(vendor="nikon") as (camera, device):
        for number, mode in ((0x8013, "close-up"), (0x8051, None), (3, "A")):
            device.responder.properties[0x500E].value = number
            assert camera.condition().mode == mode
