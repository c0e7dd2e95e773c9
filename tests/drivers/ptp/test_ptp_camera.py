"""What a PTP camera does beyond what every camera does; a virtual camera on a virtual bus."""

import time
from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest
import usb.core
from ptp_bench import camera_on, exposer, open_quick, settings_at, usb_device, virtual

from camctl.controls import ExposureSetting
from camctl.errors import (
    CameraBusyError,
    CameraError,
    CameraNotFoundError,
    RefusedSettingError,
    UsageError,
)
from camctl.profile import load_profile
from drivers.ptp.backend import PtpBackend


@pytest.fixture(autouse=True)
def own_profile(tmp_path, monkeypatch):
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))


def shoot(camera, settings):
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def pictures(device):
    """Return the files on the virtual card by name."""
    card = device.responder.card
    return {item.name: item.data for item in card.objects.values() if item.data}


# ---- files


def test_a_frame_has_the_cameras_file_byte_for_byte():
    with camera_on(files="tiff") as (camera, device):
        (frame,) = shoot(camera, settings_at(camera, 1 / 125))
        assert frame.original.data == pictures(device)[frame.details["object"]]
        assert frame.details["bytes"] == len(frame.original.data)


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
def test_raw_samples_are_the_sensors_own(vendor):
    with camera_on("ideal-12", vendor=vendor, files="dng") as (camera, _):
        (frame,) = shoot(camera, settings_at(camera, 1 / 250))
        seen = exposer(sensor="ideal-12").expose(frame.applied.time_s, 1.0, 0)
        assert np.array_equal(frame.pixels, seen)
        assert camera.controls.response is None


@pytest.mark.parametrize("vendor", ["none", "sony"])
def test_of_raw_and_jpeg_the_raw_file_is_the_frame(vendor):
    with camera_on(vendor=vendor, files="dng+jpeg") as (camera, device):
        frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 60))
        assert [f.original.suffix for f in frames] == [".dng", ".dng"]
        if vendor == "none":  # both stay on the card
            assert len(pictures(device)) == 2 * device.body.taken


@pytest.mark.parametrize("vendor", ["none", "sony"])
def test_of_raw_and_jpeg_the_jpeg_can_be_asked_for(vendor):
    options = {"format": "jpeg"}
    with camera_on(vendor=vendor, files="dng+jpeg", options=options) as (camera, _):
        frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 60))
        assert [f.original.suffix for f in frames] == [".jpg", ".jpg"]
        assert frames[1].pixels.mean() > 1.5 * frames[0].pixels.mean()


def test_a_format_that_the_camera_does_not_make_is_told():
    with (
        camera_on(files="jpeg", options={"format": "raw"}) as (camera, _),
        pytest.raises(CameraError, match=r"made jpeg where raw was wanted.*image quality"),
    ):
        _ = camera.controls


def test_files_stay_on_the_card_unless_told_otherwise():
    with camera_on() as (camera, device):
        taken = len(shoot(camera, settings_at(camera, 1 / 125, 1 / 60)))
        assert len(pictures(device)) == taken + 1
    with camera_on(options={"delete": True}) as (camera, device):
        _ = camera.controls
        before = set(pictures(device))
        assert len(shoot(camera, settings_at(camera, 1 / 125, 1 / 60))) == 2
        assert set(pictures(device)) == before


# ---- what its files are, before the first frame


def test_a_new_camera_takes_one_picture_and_says_so_and_then_never_again():
    device, backend = virtual()
    with open_quick(backend) as camera:
        assert any("one picture was taken" in note for note in camera.controls.notes)
        assert device.body.taken == 1
        assert load_profile(camera.info).stills["jpeg"].rows == camera.controls.shape[0]
    with open_quick(backend) as camera:
        assert camera.controls.shape == (24, 32)
        assert not any("one picture was taken" in note for note in camera.controls.notes)
        assert device.body.taken == 1


def test_what_lies_on_the_card_is_looked_at_rather_than_shot(tmp_path, monkeypatch):
    device, backend = virtual(files="tiff")
    with open_quick(backend) as camera:
        shoot(camera, settings_at(camera, 1 / 125))
        taken = device.body.taken
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "other"))
    with open_quick(backend) as camera:
        assert camera.controls.shape == (24, 32)
        assert device.body.taken == taken


def test_jpeg_is_taken_for_srgb_and_a_note_says_so():
    with camera_on(options={"response": "srgb"}) as (camera, _):
        levels = camera.controls.levels.levels
        assert levels[127] < 0.3  # linear would be a half
        assert any("srgb is assumed" in note for note in camera.controls.notes)


@pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
def test_a_makers_dialect_is_said_to_be_unproven(vendor):
    with camera_on(vendor=vendor) as (camera, _):
        assert any("unproven on real bodies" in note for note in camera.controls.notes)


# ---- settings


def test_exact_times_are_preferred_to_units_of_a_ten_thousandth():
    with camera_on(vendor="nikon") as (camera, device):
        assert camera.controls.time_s.minimum == 1 / 8000
        (frame,) = shoot(camera, [ExposureSetting(1 / 60)])
        assert frame.applied.time_s == 1 / 60
        assert device.do("state")["exposure"]["time_s"] == 1 / 60


def test_times_too_short_for_their_unit_are_not_offered():
    with camera_on() as (camera, _):
        assert camera.controls.time_s.minimum == 0.0005


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
def test_sensitivity_and_aperture_are_set(vendor):
    with camera_on(vendor=vendor) as (camera, device):
        controls = camera.controls
        wanted = ExposureSetting(
            controls.time_s.nearest(0.01), controls.gain.values[1], controls.f_number.values[1]
        )
        (frame,) = shoot(camera, [wanted])
        assert frame.applied == wanted
        exposed = device.do("state")["exposure"]
        assert exposed["gain"] == pytest.approx(2.0, rel=0.01)
        assert exposed["light"] == pytest.approx(0.5, rel=0.05)


def test_a_sony_that_can_only_be_stepped_is_stepped():
    with camera_on(vendor="sony", absolute=False) as (camera, _):
        frames = shoot(camera, settings_at(camera, 1 / 125, 1 / 15, 1 / 250))
        assert [f.applied.time_s for f in frames] == [1 / 125, 1 / 15, 1 / 250]
        assert frames[1].pixels.mean() > frames[0].pixels.mean() > frames[2].pixels.mean()


def test_a_time_that_is_clamped_silently_is_refused_and_nothing_is_shot():
    with camera_on() as (camera, device):
        long, short = settings_at(camera, 1 / 15, 1 / 125)
        taken = device.body.taken
        device.do("clamp", max_s=1 / 60)
        with pytest.raises(RefusedSettingError) as refusal:
            shoot(camera, [long])
        assert refusal.value.nearest <= 1 / 60 + 1e-4
        assert device.body.taken == taken
        assert len(shoot(camera, [short])) == 1


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
def test_the_wrong_mode_is_told_before_anything_is_shot(vendor):
    _, backend = virtual(vendor=vendor, mode="auto")
    with pytest.raises(CameraError, match="turn the mode dial to M"):
        open_quick(backend)


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
def test_a_dial_turned_in_between_is_told(vendor):
    with camera_on(vendor=vendor) as (camera, device):
        first, second = settings_at(camera, 1 / 125, 1 / 60)
        shoot(camera, [first])
        device.do("mode", dial="auto")
        with pytest.raises(CameraError, match="turn the mode dial to M"):
            shoot(camera, [second])


# ---- bulb


@pytest.mark.parametrize("vendor", ["none", "nikon", "sony"])
def test_bulb_times_are_held_from_here(vendor):
    times = ["1/250", "1/125", "1/60", "1/2"]
    with camera_on(
        scene="ramp", vendor=vendor, bulb=True, times=times, options={"bulb_s": 2, "format": "jpeg"}
    ) as (camera, _):
        controls = camera.controls
        assert controls.time_s.maximum == 2.0
        first, held = ExposureSetting(controls.time_s.nearest(1 / 125)), ExposureSetting(1.0)
        frames = shoot(camera, [first, held, first])
        assert frames[1].details["bulb_held_s"] == pytest.approx(1.0, abs=0.2)
        assert np.array_equal(frames[0].pixels, frames[2].pixels)
        assert frames[1].pixels.mean() > frames[0].pixels.mean()


def test_a_canon_holds_its_shutter_too():
    with camera_on(vendor="canon", bulb=True, options={"bulb_s": 60}) as (camera, device):
        # Its own dial goes to 32 s: longer than a test may take, so that the body is asked itself.
        assert camera.controls.time_s.maximum == 60
        body, dial = camera._body, camera._dials.time_s
        body.open_bulb(dial)
        time.sleep(0.3)
        body.close_bulb()
        device.body.wait()
        assert device.body.log[-1]["time_s"] == pytest.approx(0.3, abs=0.15)


def test_bulb_where_there_is_none_is_a_usage_error():
    _, backend = virtual(bulb=False)
    with pytest.raises(UsageError, match="bulb"):
        open_quick(backend, bulb_s=60)


# ---- speed


def test_the_next_exposure_starts_before_the_last_download_ends():
    with camera_on(object_bytes=8_000_000) as (camera, device):
        frames = shoot(camera, settings_at(camera, 0.1, 0.1, 0.1, 0.1))
        for before, after in pairwise(frames):
            assert after.details["released_s"] < before.details["fetched_s"]
        seen = list(device.body.log)[-4:]  # and by the camera's own word
        for before, after in pairwise(seen):
            assert after["began_s"] < before["downloaded_s"]


def test_a_camera_that_serves_nothing_while_it_exposes_is_served_in_turn():
    with camera_on(overlap=False) as (camera, device):
        shoot(camera, settings_at(camera, 0.1, 0.1, 0.1, 0.1))
        for before, after in pairwise(list(device.body.log)[-3:]):
            assert after["began_s"] > before["downloaded_s"]


# ---- finding and opening


def test_cameras_are_listed_without_a_session():
    device, backend = virtual(serial="ABC123", vendor="nikon")
    (info,) = PtpBackend(backend).discover()
    assert info.id == "ptp:ABC123"
    assert "Nikon" in info.make
    assert info.driver == "ptp"
    assert device.do("state")["operations"] == {}


def test_a_camera_is_opened_by_serial_number_and_by_place():
    _, backend = virtual(serial="ABC123")
    place = usb_device(backend)
    for address in ("ABC123", f"{place.bus}:{place.address:03d}", ""):
        with PtpBackend(backend).open(address, {"format": "jpeg"}) as camera:
            assert camera.info.id == "ptp:ABC123"
            assert camera.info.serial == "ABC123"


def test_an_unknown_camera_is_told_with_those_there_are():
    _, backend = virtual(serial="ABC123")
    with pytest.raises(CameraNotFoundError, match=r"ptp:XYZ.*there are: ptp:ABC123"):
        PtpBackend(backend).open("XYZ", {})


@pytest.mark.parametrize(
    "options",
    [
        {"fromat": "raw"},
        {"format": "heif"},
        {"bulb": "long"},
        {"bulb": "nan"},
        {"bulb": "1e9"},
        {"delete": "maybe"},
        {"response": "kodak"},
    ],
)
def test_options_that_make_no_sense_are_usage_errors(options):
    _, backend = virtual()
    with pytest.raises(UsageError):
        PtpBackend(backend).open("", options)


def test_a_camera_that_another_program_holds_says_who_it_may_be():
    _, backend = virtual()
    with open_quick(backend), pytest.raises(CameraBusyError, match="gvfs"):
        open_quick(backend)


def test_without_libusb_there_is_one_clear_line(monkeypatch):
    def nothing(*_, **__):
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", nothing)
    with pytest.raises(CameraNotFoundError, match="apt-get install libusb"):
        PtpBackend().discover()
