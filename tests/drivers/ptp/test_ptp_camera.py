"""A PTP camera beyond what every camera does: a virtual camera on a virtual bus, virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usb.core
from ptp_bench import bench, camera_on, settings_at, shoot, virtual_sensor

from camctl.drivers.ptp.backend import PtpBackend
from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    RefusedSettingError,
    StorageError,
    UsageError,
)
from camctl.interface.camera import OriginalFile
from camctl.interface.controls import Choices, Control, ExposureSetting, Layout, ResponseOrigin
from camctl.profiles.profile import StillRecord, change_profile, load_profile
from camctl.sim.devices.ptp.camera import PtpCamera as VirtualCamera
from camctl.sim.devices.ptp.protocol import Reply

pytestmark = pytest.mark.usefixtures("own_profiles")
VENDORS = ["none", "nikon", "canon", "sony", "fuji", "olympus", "panasonic"]
# Makers whose number for the position M of the mode dial is known.
WITH_MODE = VENDORS[:5]
DEVICE_BUSY = 0x2019
RELEASES = (0x100E, 0x9207)  # InitiateCapture, and Nikon's


def pictures(device: VirtualCamera) -> dict[str, bytes]:
    """Return the files on the virtual card by name."""
    card = device.responder.card
    return {item.name: item.data for item in card.objects.values() if item.data}


def original(file: OriginalFile | None) -> OriginalFile:
    assert file is not None
    return file


def choices(control: Control | None) -> tuple[float, ...]:
    assert isinstance(control, Choices)
    return control.values


class TestFiles:
    def test_original_is_the_cameras_file_byte_for_byte(self) -> None:
        with camera_on(files="tiff") as (camera, device):
            (frame,) = shoot(camera, settings_at(camera, 1 / 125))
            file = original(frame.original)
            assert file.data == pictures(device)[frame.details["object"]]
            assert frame.details["bytes"] == len(file.data)
            assert frame.details["iso"] == 100 * frame.applied.gain

    @pytest.mark.parametrize("vendor", VENDORS)
    def test_raw_samples_are_those_of_the_sensor(self, vendor: str) -> None:
        with camera_on("ideal-12", vendor=vendor, files="dng") as (camera, _):
            (frame,) = shoot(camera, settings_at(camera, 1 / 250))
            exposed = virtual_sensor(sensor="ideal-12").expose(frame.applied.time_s, 1.0, 0)
            assert np.array_equal(frame.pixels, exposed)
            assert camera.controls.response is None

    @pytest.mark.parametrize("vendor", ["none", "sony"])
    def test_raw_is_preferred_to_jpeg(self, vendor: str) -> None:
        with camera_on(vendor=vendor, files="dng+jpeg") as (camera, device):
            frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 60))
            assert [original(f.original).suffix for f in frames] == [".dng", ".dng"]
            if vendor == "none":  # both stay on the card
                assert len(pictures(device)) == 2 * device.body.taken

    @pytest.mark.parametrize("vendor", ["none", "sony"])
    def test_jpeg_of_raw_and_jpeg_can_be_requested(self, vendor: str) -> None:
        options = {"format": "jpeg"}
        with camera_on(vendor=vendor, files="dng+jpeg", options=options) as (camera, _):
            frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 60))
            assert [original(f.original).suffix for f in frames] == [".jpg", ".jpg"]
            assert frames[1].pixels.mean() > 1.5 * frames[0].pixels.mean()

    def test_a_format_that_the_camera_does_not_save_is_an_error(self) -> None:
        with (
            camera_on(files="jpeg", options={"format": "raw"}) as (camera, _),
            pytest.raises(CameraError, match=r"saved jpeg instead of raw; set its image quality"),
        ):
            _ = camera.controls

    def test_files_stay_on_the_card_by_default(self) -> None:
        with camera_on() as (camera, device):
            taken = len(shoot(camera, settings_at(camera, 1 / 125, 1 / 60)))
            assert len(pictures(device)) == taken + 1

    def test_option_delete_removes_the_files_of_frames_from_the_card(self) -> None:
        with camera_on(options={"delete": True}) as (camera, device):
            _ = camera.controls
            before = set(pictures(device))
            assert len(shoot(camera, settings_at(camera, 1 / 125, 1 / 60))) == 2
            assert set(pictures(device)) == before


class TestFileFormat:
    """The format of the frames is known before the first frame."""

    def test_a_new_camera_takes_one_test_picture_and_no_second_one(self) -> None:
        pair = bench()
        with pair.camera() as camera:
            assert any("one picture was taken" in note for note in camera.controls.notes)
            assert pair.device.body.taken == 1
            assert load_profile(camera.info).stills["jpeg"].rows == camera.controls.shape[0]
        with pair.camera() as camera:
            assert camera.controls.shape == (24, 32)
            assert not any("one picture was taken" in note for note in camera.controls.notes)
            assert pair.device.body.taken == 1

    def test_a_raw_file_on_the_card_replaces_the_test_picture(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        pair = bench("ideal-12", files="dng")
        with pair.camera() as camera:
            shoot(camera, settings_at(camera, 1 / 125))
            taken = pair.device.body.taken
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "other"))
        with pair.camera() as camera:
            assert camera.controls.shape == (24, 32)
            assert pair.device.body.taken == taken

    def test_a_jpeg_on_the_card_does_not_hide_that_raw_files_are_saved(self) -> None:
        """It was taken before the quality was set to raw, or its raw file was deleted."""
        pair = bench("ideal-12", files="dng+jpeg")
        card = pair.device.responder.card
        with pair.camera(format="jpeg") as camera:
            shoot(camera, settings_at(camera, 1 / 125))
            for each in [each for each, file in card.objects.items() if ".DNG" in file.name]:
                del card.objects[each]
            change_profile(camera.info, lambda profile: profile.stills.clear())
        with pair.camera() as camera:
            assert camera.controls.bits == 12
            assert camera.controls.response_origin is ResponseOrigin.STATED

    def test_a_wrong_profile_is_corrected_by_the_first_file(self) -> None:
        with camera_on() as (camera, _):
            record = StillRecord(rows=1, columns=2, layout=Layout.MONO, bits=8, black=0, white=255)
            change_profile(camera.info, lambda profile: profile.stills.update(jpeg=record))
            assert camera.controls.shape == (1, 2)
            with pytest.raises(CameraProtocolError, match=r"32 x 24 samples .* instead of 2 x 1 "):
                shoot(camera, settings_at(camera, 1 / 125))
            assert camera.controls.shape == (24, 32)
            assert load_profile(camera.info).stills["jpeg"].rows == 24
            assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1

    def test_a_profile_that_cannot_be_saved_is_noted(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail(*_: object) -> None:
            raise StorageError("the disk is full")

        monkeypatch.setattr("camctl.drivers.common.still_camera.change_profile", fail)
        with camera_on() as (camera, _):
            (note,) = [note for note in camera.controls.notes if "could not be saved" in note]
            assert note.endswith("its profile: the disk is full")

    @pytest.mark.parametrize("word", [None, "srgb", "power:2"])
    def test_the_response_of_jpeg_is_assumed_unless_it_is_given(self, word: str | None) -> None:
        pair, options = bench(), {} if word is None else {"response": word}
        given = PtpOptions.parse(options)
        with PtpCamera(pair.usb_device, given, clock=pair.device.clock).open() as camera:
            levels = camera.controls.levels.levels
            assert levels[127] < 0.3  # linear: 0.5
            assert camera.controls.has_assumed_response == (word is None)

    def test_the_response_of_raw_files_is_stated(self) -> None:
        pair = bench("ideal-12", files="dng")
        with PtpCamera(pair.usb_device, PtpOptions(), clock=pair.device.clock).open() as camera:
            assert camera.controls.response_origin is ResponseOrigin.STATED

    @pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
    def test_an_untested_dialect_is_noted(self, vendor: str) -> None:
        with camera_on(vendor=vendor) as (camera, _):
            assert any("not been tested on a real body" in n for n in camera.controls.notes)


class TestSettings:
    def test_exact_times_are_preferred_to_units_of_a_ten_thousandth(self) -> None:
        with camera_on(vendor="nikon") as (camera, device):
            assert camera.controls.time_s.minimum == 1 / 8000
            (frame,) = shoot(camera, [ExposureSetting(1 / 60)])
            assert frame.applied.time_s == 1 / 60
            assert device.do("state")["exposure"]["time_s"] == 1 / 60

    def test_times_too_short_for_their_unit_are_not_offered(self) -> None:
        with camera_on() as (camera, _):
            assert camera.controls.time_s.minimum == 0.0005

    @pytest.mark.parametrize("vendor", VENDORS)
    def test_gain_and_aperture_are_set(self, vendor: str) -> None:
        with camera_on(vendor=vendor) as (camera, device):
            controls = camera.controls
            setting = ExposureSetting(
                controls.time_s.nearest(0.01),
                choices(controls.gain)[1],
                choices(controls.f_number)[1],
            )
            (frame,) = shoot(camera, [setting])
            assert frame.applied == setting
            exposed = device.do("state")["exposure"]
            assert exposed["gain"] == pytest.approx(2.0, rel=0.01)
            assert exposed["light"] == pytest.approx(0.5, rel=0.05)

    def test_a_sony_that_ignores_numbers_is_stepped(self) -> None:
        with camera_on(vendor="sony", absolute=False) as (camera, _):
            frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 15, 1 / 250))
            assert [f.applied.time_s for f in frames] == [1 / 125, 1 / 15, 1 / 250]
            assert frames[1].pixels.mean() > frames[0].pixels.mean() > frames[2].pixels.mean()

    def test_a_silently_changed_time_is_refused_before_the_exposure(self) -> None:
        with camera_on() as (camera, device):
            long, short = settings_at(camera, 1 / 15, 1 / 125)
            taken = device.body.taken
            device.do("clamp", max_s=1 / 60)
            with pytest.raises(RefusedSettingError) as refusal:
                shoot(camera, [long])
            assert refusal.value.nearest <= 1 / 60 + 1e-4
            assert device.body.taken == taken
            assert len(shoot(camera, [short])) == 1

    @pytest.mark.parametrize("vendor", WITH_MODE)
    def test_an_automatic_mode_is_an_error_on_opening(self, vendor: str) -> None:
        pair = bench(vendor=vendor, mode="auto")
        with pytest.raises(CameraError, match="turn the mode dial to M"):
            pair.camera()

    @pytest.mark.parametrize("vendor", WITH_MODE)
    def test_an_automatic_mode_is_an_error_on_shooting(self, vendor: str) -> None:
        with camera_on(vendor=vendor) as (camera, device):
            first, second = settings_at(camera, 1 / 125, 1 / 60)
            shoot(camera, [first])
            device.do("mode", dial="auto")
            with pytest.raises(CameraError, match="turn the mode dial to M"):
                shoot(camera, [second])


class TestBulb:
    @pytest.mark.parametrize("vendor", ["none", "nikon", "sony"])
    def test_the_computer_holds_the_shutter(self, vendor: str) -> None:
        times = ["1/250", "1/125", "1/60", "1/2"]
        options = {"bulb": 2, "format": "jpeg"}
        with camera_on(vendor=vendor, bulb=True, times=times, options=options) as (camera, device):
            controls = camera.controls
            assert controls.time_s.maximum == 2.0
            short = ExposureSetting(controls.time_s.nearest(1 / 125))
            frames = shoot(camera, [short, ExposureSetting(1.0), short])
            assert frames[1].details["bulb_held_s"] == pytest.approx(1.0, abs=0.001)
            assert list(device.body.log)[-2]["time_s"] == pytest.approx(1.0, abs=0.001)
            assert np.array_equal(frames[0].pixels, frames[2].pixels)
            assert frames[1].pixels.mean() > frames[0].pixels.mean()

    def test_a_canon_holds_its_shutter_for_a_minute(self) -> None:
        with camera_on(vendor="canon", bulb=True, options={"bulb": 60}) as (camera, device):
            (frame,) = shoot(camera, [ExposureSetting(60.0)])
            assert frame.details["bulb_held_s"] == pytest.approx(60.0, abs=0.001)
            assert device.body.log[-1]["time_s"] == pytest.approx(60.0, abs=0.001)

    def test_a_camera_without_bulb_is_a_usage_error(self) -> None:
        pair = bench(bulb=False)
        with pytest.raises(UsageError, match="bulb"):
            pair.camera(bulb=60)


class TestOverlap:
    def test_the_next_exposure_starts_before_the_last_download_ends(self) -> None:
        with camera_on(object_bytes=8_000_000) as (camera, device):
            frames = shoot(camera, settings_at(camera, 0.1, 0.1, 0.1, 0.1))
            for before, after in pairwise(frames):
                assert after.details["released_s"] < before.details["fetched_s"]
            for earlier, later in pairwise(list(device.body.log)[-4:]):
                assert later["began_s"] < earlier["downloaded_s"]

    def test_a_camera_that_sends_nothing_while_exposing_is_served_in_turn(self) -> None:
        with camera_on(overlap=False) as (camera, device):
            shoot(camera, settings_at(camera, 0.1, 0.1, 0.1, 0.1))
            for earlier, later in pairwise(list(device.body.log)[-3:]):
                assert later["began_s"] > earlier["downloaded_s"]

    @pytest.mark.parametrize("vendor", ["none", "nikon"])
    def test_a_camera_that_is_busy_until_its_picture_is_fetched_is_served_in_turn(
        self, vendor: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with camera_on(vendor=vendor) as (camera, device):
            settings = settings_at(camera, 1 / 60, 1 / 125, 1 / 250)
            responder, log = device.responder, device.body.log
            execute = responder.execute

            def busy_while_a_picture_waits(code: int, *arguments: Any) -> Any:
                if code in RELEASES and log and log[-1]["downloaded_s"] is None:
                    return Reply(DEVICE_BUSY)
                return execute(code, *arguments)

            monkeypatch.setattr(responder, "execute", busy_while_a_picture_waits)
            frames = shoot(camera, settings)
            assert [frame.requested for frame in frames] == settings
            assert frames[0].pixels.mean() > frames[1].pixels.mean() > frames[2].pixels.mean()
            for earlier, later in pairwise(list(log)[-3:]):
                assert later["began_s"] >= earlier["downloaded_s"]


class TestOpening:
    def test_cameras_are_listed_without_a_session(self) -> None:
        pair = bench(serial="ABC123", vendor="nikon")
        (info,) = PtpBackend(pair.backend).discover()
        assert info.id == "ptp:ABC123"
        assert "Nikon" in info.make
        assert info.driver == "ptp"
        assert pair.device.do("state")["operations"] == {}

    def test_the_constructor_sends_nothing_and_open_can_be_repeated(self) -> None:
        pair = bench()
        camera = PtpCamera(pair.usb_device, PtpOptions(), clock=pair.device.clock)
        assert pair.device.do("state")["operations"] == {}
        with pytest.raises(CameraDisconnectedError, match="is not open"):
            _ = camera.controls
        for _ in range(2):
            with camera:
                assert len(shoot(camera, settings_at(camera, 1 / 125))) == 1
            assert not pair.device.do("state")["session"]

    def test_an_address_is_a_serial_number_or_a_place_on_the_bus(self) -> None:
        pair = bench(serial="ABC123")
        place = pair.usb_device
        for address in ("ABC123", f"{place.bus}:{place.address:03d}", ""):
            with PtpBackend(pair.backend).open(address, {"format": "jpeg"}) as camera:
                assert camera.info.id == "ptp:ABC123"
                assert camera.info.serial == "ABC123"

    def test_an_unknown_address_lists_the_connected_cameras(self) -> None:
        backend = PtpBackend(bench(serial="ABC123").backend)
        with pytest.raises(CameraNotFoundError, match=r"camera ptp:XYZ; connected: ptp:ABC123$"):
            backend.open("XYZ", {})

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"fromat": "raw"}, "unknown camera option 'fromat'; did you mean format?"),
            ({"format": "heif"}, "invalid camera option format=heif; input should be 'auto', "),
            ({"bulb": "long"}, "invalid camera option bulb=long; input should be a valid number"),
            ({"bulb": "nan"}, "invalid camera option bulb=nan; "),
            ({"bulb": "1e9"}, "invalid camera option bulb=1e9; .* less than or equal to 3600"),
            ({"delete": "maybe"}, "invalid camera option delete=maybe; .* valid boolean"),
            ({"response": "kodak"}, "unknown camera response 'kodak'; known: linear, "),
            ({"response": "power:0"}, "expected 0.05 to 20"),
        ],
    )
    def test_invalid_options_are_usage_errors(
        self, options: Mapping[str, str], message: str
    ) -> None:
        backend = PtpBackend(bench().backend)
        with pytest.raises(UsageError, match=message):
            backend.open("", options)

    def test_values_of_options_may_be_written_in_capitals(self) -> None:
        options = PtpOptions.parse({"format": "RAW", "response": "Power:2.4", "delete": "Yes"})
        assert (options.format, options.response, options.delete) == ("raw", "power:2.4", True)

    def test_a_camera_in_use_by_another_program_is_busy(self) -> None:
        pair = bench()
        with pair.camera(), pytest.raises(CameraBusyError, match=r"another program; .*gvfs"):
            pair.camera()

    def test_a_missing_libusb_is_one_line_with_the_remedy(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def find(*_: Any, **__: Any) -> None:
            raise usb.core.NoBackendError("No backend available")

        monkeypatch.setattr(usb.core, "find", find)
        with pytest.raises(CameraNotFoundError, match="apt-get install libusb"):
            PtpBackend().discover()
