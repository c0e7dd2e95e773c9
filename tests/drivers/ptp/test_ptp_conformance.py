"""The conformance suite on PTP cameras of all dialects, kinds of files and manners on the wire."""

from typing import ClassVar

import pytest
from ptp_bench import open_quick, virtual

from camctl.controls import Layout
from camctl.testing.conformance import CameraConformance


class PtpConformance(CameraConformance):
    config: ClassVar[dict[str, object]] = {}
    sensor = "ideal-8"
    made = ("jpeg", 8, Layout.MONO)

    @pytest.fixture(autouse=True)
    def own_profile(self, tmp_path, monkeypatch):
        monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))

    def open_camera(self):
        _, backend = virtual(self.sensor, **self.config)
        return open_quick(backend)

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(1 / 125)

    def test_it_makes_the_files_that_this_is_about(self, camera):
        (frame,) = self.shoot(camera, self.times(camera, [1]))
        kind, bits, layout = self.made
        suffix = {"jpeg": ".jpg", "tiff": ".tif", "dng": ".dng"}[kind]
        assert frame.original.suffix == suffix
        assert (camera.controls.bits, camera.controls.layout) == (bits, layout)


class TestPlainJpeg(PtpConformance):
    pass


class TestPlainTiff(PtpConformance):
    config: ClassVar = {"files": "tiff"}
    made = ("tiff", 8, Layout.MONO)


class TestPlainRaw(PtpConformance):
    config: ClassVar = {"files": "dng"}
    sensor = "ideal-12"
    made = ("dng", 12, Layout.MONO)


class TestRange(PtpConformance):
    config: ClassVar = {"time_form": "range"}


class TestNikonRaw(PtpConformance):
    config: ClassVar = {"vendor": "nikon", "files": "dng"}
    made = ("dng", 8, Layout.MONO)


class TestNikonJpeg(PtpConformance):
    config: ClassVar = {"vendor": "nikon"}


class TestNikonTiff(PtpConformance):
    config: ClassVar = {"vendor": "nikon", "files": "tiff"}
    made = ("tiff", 8, Layout.MONO)


class TestCanonRaw(PtpConformance):
    config: ClassVar = {"vendor": "canon", "files": "dng"}
    made = ("dng", 8, Layout.MONO)


class TestCanonJpeg(PtpConformance):
    config: ClassVar = {"vendor": "canon"}


class TestCanonTiff(PtpConformance):
    config: ClassVar = {"vendor": "canon", "files": "tiff"}
    made = ("tiff", 8, Layout.MONO)


class TestSonyRaw(PtpConformance):
    config: ClassVar = {"vendor": "sony", "files": "dng"}
    made = ("dng", 8, Layout.MONO)


class TestSonyJpeg(PtpConformance):
    config: ClassVar = {"vendor": "sony"}


class TestSonyTiff(PtpConformance):
    config: ClassVar = {"vendor": "sony", "files": "tiff"}
    made = ("tiff", 8, Layout.MONO)


class TestAwkward(PtpConformance):
    """Header split from data, no empty packets, folders announced, no event ever."""

    config: ClassVar = {
        "files": "dng+jpeg",
        "split_header": True,
        "zlp": "never",
        "folder_event": True,
        "event_order": "never",
    }
    made = ("dng", 8, Layout.MONO)


class TestSlow(PtpConformance):
    """Events before the response, and nothing served while it exposes."""

    config: ClassVar = {
        "files": "tiff",
        "event_order": "before",
        "folder_event": True,
        "overlap": False,
    }
    made = ("tiff", 8, Layout.MONO)
