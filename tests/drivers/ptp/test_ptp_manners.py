"""Manners of real bodies that lock a careless driver out, each on a virtual camera that has it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ptp_bench import bench, camera_on, settings_at, shoot
from sampling import some

from camctl.drivers.ptp.shooting import Shooter
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError
from camctl.interface.controls import ExposureSetting, Layout
from camctl.profiles.profile import StillRecord, change_profile, load_profile
from camctl.sim.devices.ptp.camera import PtpCamera as VirtualCamera
from camctl.sim.devices.ptp.protocol import Format, Reply
from camctl.sim.devices.ptp.store import PICTURE_FOLDER, StoredObject
from camctl.sim.devices.still_files import RawImage, encode

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
            for handle in [h for h, item in card.objects.items() if item.data]:
                card.delete([handle], b"")
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
    @pytest.mark.parametrize(
        "vendor", some(["none", "nikon", "canon", "sony", "fuji", "olympus"], every=2)
    )
    def test_noise_reduction_of_a_busy_camera_is_waited_for(self, vendor: str) -> None:
        """300 s of exposure, and as long a dark one, during which it answers "busy"."""
        times = ["300", "1/125"]
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

    @pytest.mark.parametrize(
        "vendor",
        ["fuji", *(pytest.param(each, marks=pytest.mark.slow) for each in ("none", "nikon"))],
    )
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
        self, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        with camera_on() as (camera, device), caplog.at_level("INFO"):
            (setting,) = settings_at(camera, 30)
            monkeypatch.setattr(device.body, "release", lambda *_: None)
            began_s = camera.clock.now()
            with pytest.raises(CameraTimeoutError, match="has saved no picture in the 16"):
                shoot(camera, [setting])
            assert 160 <= camera.clock.now() - began_s < 165
        assert "picture of 30 s yet: waiting for it for up to 125 s more" in caplog.text

    @pytest.mark.slow
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
