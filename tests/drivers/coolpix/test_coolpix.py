"""Frames of the CoolPix driver on the virtual CoolPix, in virtual time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coolpix_bench import (
    SETTINGS,
    choices,
    coolpix_on,
    data_of,
    learn_format,
    shoot,
    virtual_coolpix,
)

from camctl.drivers.common import known_format
from camctl.drivers.coolpix.camera import CoolpixCamera
from camctl.drivers.coolpix.settings import CANDIDATES_US
from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.camera import Camera
from camctl.interface.colour import BT709
from camctl.interface.controls import ExposureSetting, Layout
from camctl.profiles.profile import StillRecord, change_profile, load_profile
from camctl.sim.devices.sierra.config import SHUTTER_US
from camctl.sim.devices.sierra.device import SierraDevice
from camctl.stills.decoding import read_still
from camctl.stills.exif import stated_exposure
from camctl.testing.conformance import CameraConformance

pytestmark = pytest.mark.usefixtures("own_profiles")


class TestConformanceTiff(CameraConformance):
    format = "tiff"

    @pytest.fixture(autouse=True)
    def _device(self, device: SierraDevice) -> None:
        self.device = device

    def open_camera(self) -> Camera:
        return coolpix_on(self.device, format=self.format)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.01)

    def silence(self, camera: Camera) -> None:
        self.device.do("hang")

    def in_force(self, camera: Camera) -> ExposureSetting:
        exposure = self.device.do("state")["exposure"]
        return ExposureSetting(exposure["time_s"], exposure["gain"])


class TestConformanceJpeg(TestConformanceTiff):
    format = "jpeg"
    run_length = 30


class TestPictures:
    def test_a_picture_in_another_folder_is_found(self) -> None:
        """Register 10 counts the first folder on; registers 4 and 79 tell the new picture."""
        settings = [ExposureSetting(t) for t in (0.002, 0.008, 0.002, 0.004, 0.008)]
        with virtual_coolpix(folder_pictures=2) as device, coolpix_on(device) as camera:
            learn_format(camera)
            frames = shoot(camera, settings)
            assert device.camera.read(10) == 2
            stored = device.camera.pictures[-len(settings) :]
        assert [data_of(frame) for frame in frames] == [picture.data for picture in stored]

    def test_the_first_pictures_of_an_empty_card_are_found_by_name_alone(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Register 4 may read back the 0 that selects the newest picture, whatever was taken."""
        with virtual_coolpix() as device:
            camera, read = device.camera, device.camera.read
            monkeypatch.setattr(
                camera, "read", lambda register: 0 if register == 4 else read(register)
            )
            with coolpix_on(device) as driver:
                assert not camera.pictures
                learn_format(driver)
                frames = shoot(driver, SETTINGS * 2)
            assert len(camera.pictures) == 1 + len(frames)  # one to learn the format, none lost
            stored = [picture.data for picture in camera.pictures[1:]]
        assert [data_of(frame) for frame in frames] == stored

    def test_tiff_samples_are_those_of_the_sensor_and_the_file_is_kept(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            frames = shoot(camera)
            assert camera.controls.colour is BT709  # the camera has developed it, as a JPEG
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
            assert frame.original is not None
            assert frame.original.suffix == ".tif"
            assert data_of(frame) in [picture.data for picture in device.camera.pictures]
            assert np.array_equal(read_still(data_of(frame), "x.tif").pixels, frame.pixels)

    def test_jpeg_is_the_default(self, device: SierraDevice) -> None:
        with CoolpixCamera(device.line.path, clock=device.clock) as camera:
            (frame,) = shoot(camera, SETTINGS[1:])
            notes = "\n".join(camera.controls.notes)
            assert camera.controls.has_assumed_response
            assert camera.controls.colour is BT709
        assert frame.original is not None
        assert frame.original.suffix == ".jpg"
        name = device.camera.pictures[-1].name
        steps = frame.details["brightness_steps"]
        assert len(steps) == 64
        known = {"few_chroma_samples": True, "brightness_steps": steps}
        assert frame.details == {"object": name, **known}
        assert "JPEG loses levels" in notes

    def test_a_file_may_state_another_aperture_than_the_assumed_one(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """With its zoom at the long end, f-numbers are 1.6 times as large as they are assumed."""
        monkeypatch.setattr(
            known_format,
            "stated_exposure",
            lambda data: replace(stated_exposure(data), f_number=1.6 * 4.0),
        )
        with coolpix_on(device) as camera:
            (frame,) = shoot(camera, [ExposureSetting(0.002, f_number=4.0)])
        assert frame.applied.f_number == 4.0

    def test_only_times_that_are_read_back_unchanged_are_offered(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            assert choices(camera.controls.time_s) == tuple(us / 1e6 for us in SHUTTER_US)

    def test_a_camera_that_accepts_all_times_offers_the_standard_ones(self) -> None:
        with virtual_coolpix(times_us=CANDIDATES_US) as device, coolpix_on(device) as camera:
            values = choices(camera.controls.time_s)
        assert values == tuple(us / 1e6 for us in CANDIDATES_US)

    def test_the_label_of_a_time_is_within_the_tolerance(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            (frame,) = shoot(camera, [ExposureSetting(1 / 60)])
        assert frame.requested.time_s == 1 / 60
        assert frame.applied.time_s == 0.016666

    def test_the_aperture_is_set_only_if_requested(self, device: SierraDevice) -> None:
        settings = [ExposureSetting(0.002), ExposureSetting(0.008, f_number=7.0), *SETTINGS[:1]]
        with coolpix_on(device) as camera:
            assert choices(camera.controls.f_number) == (2.5, 4.0, 7.0)
            plain, small, again = shoot(camera, settings)
            notes = "\n".join(camera.controls.notes)
        assert (plain.applied.f_number, small.applied.f_number) == (None, 7.0)
        assert np.array_equal(plain.pixels, again.pixels)
        light = device.body.sensor.expose(0.008 * (2.5 / 7.0) ** 2)
        assert np.array_equal(small.pixels[..., 0], light)
        assert "its apertures low, medium and high are assumed to be f/2.5, f/4, f/7" in notes
        assert "its aperture is set to f/2.5" in notes

    def test_notes_state_how_long_a_transfer_takes(self, device: SierraDevice) -> None:
        with coolpix_on(device, speed=9600) as camera:
            # 32 x 24 pixels of three bytes, 10 bits each on the line, at 9,600 bits a second
            assert "takes 2.4 s over the line at 9600 baud" in camera.controls.notes[0]
            record = StillRecord(
                rows=1536, columns=2048, layout=Layout.RGB, bits=8, black=0, white=255
            )
            change_profile(camera.info, lambda found: found.stills.update(tiff=record))
        with coolpix_on(device) as camera:
            assert "(tiff, about 9.4 MB) takes 14 minutes" in camera.controls.notes[0]

    def test_closing_restores_the_settings_of_the_camera(self, device: SierraDevice) -> None:
        before = device.do("state")
        with coolpix_on(device) as camera:
            shoot(camera)
        after = device.do("state")
        for what in ("shutter_us", "aperture", "quality", "speed", "session"):
            assert after[what] == before[what]


class TestFileFormat:
    """The format of the frames is known before the first frame."""

    def test_the_newest_picture_of_the_same_format_replaces_the_test_picture(
        self, device: SierraDevice, own_profiles: Path
    ) -> None:
        with coolpix_on(device) as camera:
            shoot(camera, SETTINGS[:1])
        taken = len(device.camera.pictures)
        for path in own_profiles.glob("*.json"):
            path.unlink()
        with coolpix_on(device) as camera:
            assert "was learnt from DSCN0002.TIF on its card" in "\n".join(camera.controls.notes)
        assert len(device.camera.pictures) == taken

    def test_a_picture_of_another_format_does_not(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            shoot(camera, SETTINGS[:1])
        with coolpix_on(device, format="jpeg") as camera:
            assert "was taken to learn" in "\n".join(camera.controls.notes)

    def test_a_wrong_profile_is_corrected_for_the_next_sequence(self, device: SierraDevice) -> None:
        record = StillRecord(rows=1, columns=2, layout=Layout.RGB, bits=8, black=0, white=255)
        with coolpix_on(device) as camera:
            info = camera.info
        change_profile(info, lambda found: found.stills.update(tiff=record))
        with coolpix_on(device) as camera:
            assert camera.controls.shape == (1, 2)
            with pytest.raises(CameraProtocolError, match="has 32 x 24 samples"):
                shoot(camera, SETTINGS[:1])
            assert camera.controls.shape == (24, 32)
            assert len(shoot(camera, SETTINGS)) == 2
        assert load_profile(info).stills["tiff"].rows == 24
        assert "tiff" in load_profile(info).timings

    def test_a_file_of_another_format_is_no_frame(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            assert isinstance(camera, CoolpixCamera)
            take = camera._body.take
            jpeg = b"\xff\xd8\xff"
            monkeypatch.setattr(camera._body, "take", lambda each: replace(take(each), data=jpeg))
            with pytest.raises(CameraError, match="is not tiff; choose the quality with"):
                shoot(camera, SETTINGS[:1])
