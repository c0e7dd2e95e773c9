"""Manners of real bodies that lock a careless driver out, each on a virtual camera that has it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from ptp_bench import bench, camera_on, settings_at, shoot

from camctl.controls import Choices, ExposureSetting, Layout
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError
from camctl.profile import StillRecord, change_profile, load_profile
from drivers.ptp import makers
from drivers.ptp.camera import PtpCamera
from drivers.ptp.makers import NIKON, dialect_of
from drivers.ptp.shooting import Shooter
from sim.devices.ptp.camera import PtpCamera as VirtualCamera
from sim.devices.ptp.protocol import Format, Reply
from sim.devices.ptp.store import PICTURE_FOLDER, StoredObject
from sim.devices.still_files import RawImage, encode

pytestmark = pytest.mark.usefixtures("own_profiles")
BUSY = 0x2019


def file_on(device: VirtualCamera, data: bytes, name: str = "ZZZZ9999.JPG") -> None:
    """Put a file on the virtual card, newer than its others."""
    card = device.responder.card
    card.objects[0x3000_0001] = StoredObject(name, Format.JPEG, data, PICTURE_FOLDER)


def jpeg(shape: tuple[int, int] = (8, 16), model: str = "") -> bytes:
    """Return a JPEG of this size that states this model."""
    return encode(
        "jpeg", RawImage(np.full(shape, 99, np.uint8), Layout.MONO, 8, 0, 255, 0.1, model=model)
    )


def operations(device: VirtualCamera) -> list[int]:
    return [int(str(entry["operation"]), 16) for entry in device.responder.log]


class TestCards:
    @pytest.mark.parametrize("vendor", ["none", "nikon", "canon"])
    def test_a_card_that_is_read_only_with_deletion_takes_pictures(self, vendor: str) -> None:
        with camera_on(vendor=vendor, access=2) as (camera, _):
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1

    def test_a_card_that_is_read_only_is_noted_and_reported_by_the_release(self) -> None:
        pair = bench(access=1)
        with (
            pair.camera() as camera,
            pytest.raises(CameraError, match="its card is write-protected; unlock the card"),
        ):
            _ = camera.controls
        assert any("says that it is read-only" in note for note in camera._notes)

    @pytest.mark.parametrize("vendor", ["none", "nikon", "canon"])
    @pytest.mark.parametrize("files", ["jpeg", "dng+jpeg"])
    def test_names_and_handles_of_deleted_pictures_are_used_again(
        self, vendor: str, files: str
    ) -> None:
        config: dict[str, Any] = {"vendor": vendor, "files": files, "reuses_names": True}
        with camera_on(options={"delete": True}, **config) as (camera, device):
            times = [1 / 125, 1 / 60, 1 / 30, 1 / 125, 1 / 60]
            frames = shoot(camera, settings_at(camera, *times))
            frames += shoot(camera, settings_at(camera, *times))
            names = [frame.details["object"] for frame in frames]
            if files == "jpeg":
                assert len(set(names)) < len(names)
            exposures = [e["time_s"] for e in list(device.body.log)[-len(frames) :]]
            assert [f.applied.time_s for f in frames] == pytest.approx(exposures, rel=1e-9)
            assert frames[0].pixels.mean() == frames[3].pixels.mean()
            assert frames[1].pixels.mean() == frames[4].pixels.mean()

    @pytest.mark.parametrize("vendor", ["none", "nikon"])
    def test_names_and_handles_of_pictures_deleted_on_the_body_are_used_again(
        self, vendor: str
    ) -> None:
        with camera_on(vendor=vendor, reuses_names=True) as (camera, device):
            settings = settings_at(camera, 1 / 125, 1 / 60)
            before = shoot(camera, settings)
            card = device.responder.card
            card.delete([0xFFFF_FFFF], b"")
            after = shoot(camera, settings)
            assert {frame.details["object"] for frame in after} == {"VIRT0001.JPG", "VIRT0002.JPG"}
            assert [f.pixels.mean() for f in before] == [f.pixels.mean() for f in after]

    @pytest.mark.parametrize(
        "data",
        [jpeg()[:-60], b"", b"not a picture", jpeg(model="COOLPIX 990")],
        ids=["cut short", "empty", "no picture", "of another model"],
    )
    def test_a_foreign_or_damaged_newest_file_is_passed_over(self, data: bytes) -> None:
        pair = bench()
        file_on(pair.device, data)
        with pair.camera() as camera:
            assert camera.controls.shape == (24, 32)
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1

    def test_a_picture_size_that_was_changed_on_the_body_is_taken_over(self) -> None:
        with camera_on() as (camera, device):
            settings = settings_at(camera, 1 / 125)
            shoot(camera, settings)
            record = load_profile(camera.info).stills["jpeg"]
            small = record.model_copy(update={"rows": 12, "columns": 16})
            change_profile(camera.info, lambda profile: profile.stills.update(jpeg=small))
            camera._controls = camera._known = None
            file_on(device, jpeg((12, 16)))
            with pytest.raises(CameraProtocolError, match=r"32 x 24 samples .* of 16 x 12"):
                shoot(camera, settings)
            (frame,) = shoot(camera, settings)
            assert frame.pixels.shape == camera.controls.shape == (24, 32)

    def test_a_picture_size_that_the_body_states_is_believed_before_the_profile(self) -> None:
        """The size was changed since: neither profile nor the pictures on the card have it."""
        pair = bench(states_size=True)
        with pair.camera() as camera:
            shoot(camera, settings_at(camera, 1 / 125))
            record = load_profile(camera.info).stills["jpeg"]
            small = record.model_copy(update={"rows": 12, "columns": 16})
            change_profile(camera.info, lambda profile: profile.stills.update(jpeg=small))
        pair.device.responder.card.objects.clear()
        for name in ("ZZZZ9998.JPG", "ZZZZ9999.JPG"):
            file_on(pair.device, jpeg((12, 16)), name)
        with pair.camera() as camera:
            assert camera.controls.shape == (24, 32)
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1

    @pytest.mark.parametrize("vendor", ["none", "sony"])
    def test_a_format_that_was_changed_on_the_body_is_taken_over(self, vendor: str) -> None:
        with camera_on(vendor=vendor, files="jpeg") as (camera, _):
            settings = settings_at(camera, 1 / 125)
            raw = StillRecord(rows=9, columns=9, layout=Layout.MONO, bits=12, black=0, white=4095)
            change_profile(camera.info, lambda profile: profile.stills.update(raw=raw))
            camera._known, camera._controls = None, None
            if vendor == "sony":  # it lists no objects: the first picture shows the format
                with pytest.raises(CameraError, match="saved jpeg instead of raw"):
                    shoot(camera, settings)
            (frame,) = shoot(camera, settings)
            assert frame.pixels.shape == (24, 32)


class TestLongExposures:
    @pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony", "fuji", "olympus"])
    def test_noise_reduction_of_a_busy_camera_is_waited_for(self, vendor: str) -> None:
        """900 s of exposure, and as long a dark one, during which it answers "busy"."""
        times = ["900", "1/125"]
        config: dict[str, Any] = {"vendor": vendor, "overlap": False, "noise_reduction": True}
        if vendor not in ("canon", "fuji"):
            config["times"] = times
        with camera_on(sensor="ideal-12", **config) as (camera, device):
            longest = ExposureSetting(camera.controls.time_s.maximum)
            if vendor in ("canon", "fuji"):
                assert longest.time_s in (32.0, 64.0)
            began_s = camera.clock.now()
            frames = shoot(camera, [longest, *settings_at(camera, 1 / 125)])
            assert len(frames) == 2
            assert camera.clock.now() - began_s > 2 * longest.time_s
            assert list(device.body.log)[-2]["time_s"] == longest.time_s

    @pytest.mark.parametrize("vendor", ["none", "nikon", "fuji"])
    def test_noise_reduction_of_an_abandoned_exposure_is_waited_for(
        self, vendor: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        config: dict[str, Any] = {"vendor": vendor, "times": ["60", "1/250"]}
        with camera_on(overlap=False, noise_reduction=True, **config) as (camera, _):
            long, short = settings_at(camera, 60, 1 / 250)
            (reference,) = shoot(camera, [short])

            def interrupted(*_: object) -> None:
                raise CameraTimeoutError("interrupted")

            monkeypatch.setattr(Shooter, "wait", interrupted)
            with pytest.raises(CameraTimeoutError):
                shoot(camera, [long])
            monkeypatch.undo()
            (frame,) = shoot(camera, [short])
            assert np.array_equal(frame.pixels, reference.pixels)

    def test_a_camera_that_answers_and_has_no_picture_is_reported_after_the_noise_reduction(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with camera_on() as (camera, device):
            (setting,) = settings_at(camera, 30)
            monkeypatch.setattr(device.body, "release", lambda *_: None)
            began_s = camera.clock.now()
            with pytest.raises(CameraTimeoutError, match="has saved no picture in the 16"):
                shoot(camera, [setting])
            assert 160 <= camera.clock.now() - began_s < 165

    def test_a_camera_that_stays_busy_is_given_1000_seconds_more(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with camera_on(vendor="nikon") as (camera, device):
            (setting,) = settings_at(camera, 30)
            execute, released = device.responder.execute, []

            def busy(code: int, *arguments: Any) -> Any:
                released.append(code == 0x9207)
                return Reply(BUSY) if any(released[:-1]) else execute(code, *arguments)

            monkeypatch.setattr(device.responder, "execute", busy)
            began_s = camera.clock.now()
            with pytest.raises(CameraTimeoutError):
                shoot(camera, [setting])
            assert 1060 <= camera.clock.now() - began_s < 1070


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
