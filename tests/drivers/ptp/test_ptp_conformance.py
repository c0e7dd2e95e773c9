"""The conformance suite on PTP cameras of all dialects, file formats and transfer variants."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from ptp_bench import Bench, bench, in_force

from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting, Layout
from camctl.testing.conformance import CameraConformance


@pytest.mark.usefixtures("own_profiles")
class PtpConformance(CameraConformance):
    """A camera of the standard that saves JPEG; subclasses change the configuration."""

    config: ClassVar[dict[str, Any]] = {}
    sensor = "ideal-8"
    pair: Bench
    saved: ClassVar[tuple[str, int, Layout]] = ("jpeg", 8, Layout.MONO)
    run_length = 30  # the plain JPEG camera and the raw one of Nikon take a hundred

    def open_camera(self) -> Camera:
        self.pair = bench(self.sensor, **self.config)
        return self.pair.camera()

    def open_second(self, camera: Camera) -> Camera:
        return self.pair.camera()

    def unplug(self, camera: Camera) -> None:
        self.pair.device.detach()

    def silence(self, camera: Camera) -> None:
        self.pair.device.do("hang")

    def in_force(self, camera: Camera) -> ExposureSetting:
        return in_force(self.pair.device)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(1 / 125)

    def test_the_camera_saves_the_format_under_test(self, camera: Camera) -> None:
        (frame,) = self.shoot(camera, self.times(camera, [1]))
        kind, bits, layout = self.saved
        assert frame.original is not None
        assert frame.original.suffix == {"jpeg": ".jpg", "tiff": ".tif", "dng": ".dng"}[kind]
        assert (camera.controls.bits, camera.controls.layout) == (bits, layout)


class TestPlainJpeg(PtpConformance):
    run_length = 100


class TestPlainTiff(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"files": "tiff"}
    saved = ("tiff", 8, Layout.MONO)


class TestPlainRaw(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"files": "dng"}
    sensor = "ideal-12"
    saved = ("dng", 12, Layout.MONO)


class TestTimesAsRange(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"time_form": "range"}


class TestNikonRaw(PtpConformance):
    run_length = 100
    config: ClassVar[dict[str, Any]] = {"vendor": "nikon", "files": "dng"}
    saved = ("dng", 8, Layout.MONO)


class TestNikonJpeg(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "nikon"}


class TestNikonTiff(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "nikon", "files": "tiff"}
    saved = ("tiff", 8, Layout.MONO)


class TestCanonRaw(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "canon", "files": "dng"}
    saved = ("dng", 8, Layout.MONO)


class TestCanonJpeg(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "canon"}


class TestCanonTiff(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "canon", "files": "tiff"}
    saved = ("tiff", 8, Layout.MONO)


class TestSonyRaw(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "sony", "files": "dng"}
    saved = ("dng", 8, Layout.MONO)


class TestSonyJpeg(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "sony"}


class TestSonyTiff(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "sony", "files": "tiff"}
    saved = ("tiff", 8, Layout.MONO)


class TestFujiJpeg(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "fuji"}


class TestOlympusRaw(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "olympus", "files": "dng"}
    saved = ("dng", 8, Layout.MONO)


class TestPanasonicJpeg(PtpConformance):
    config: ClassVar[dict[str, Any]] = {"vendor": "panasonic"}


class TestUnusualTransfers(PtpConformance):
    """Header in a transfer of its own, no empty packets, events for folders, none for files."""

    config: ClassVar[dict[str, Any]] = {
        "files": "dng+jpeg",
        "split_header": True,
        "zlp": "never",
        "folder_event": True,
        "event_order": "never",
    }
    saved = ("dng", 8, Layout.MONO)


class TestNoOverlap(PtpConformance):
    """Events before the response, and no transfers during an exposure."""

    config: ClassVar[dict[str, Any]] = {
        "files": "tiff",
        "event_order": "before",
        "folder_event": True,
        "overlap": False,
    }
    saved = ("tiff", 8, Layout.MONO)
