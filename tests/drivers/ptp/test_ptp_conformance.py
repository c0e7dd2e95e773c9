"""The conformance suite on PTP cameras of all dialects, file formats and transfer variants."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from ptp_bench import Bench, bench, in_force

from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting, Layout
from camctl.testing.conformance import CameraConformance


@pytest.mark.usefixtures("profiles_of_class")
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


def dialect(
    kind: str = "jpeg",
    sensor: str = "ideal-8",
    run_length: int = PtpConformance.run_length,
    **config: Any,
) -> type[PtpConformance]:
    """Return the suite for cameras that save files of one kind."""
    saved = (kind, 12 if sensor == "ideal-12" else 8, Layout.MONO)
    fields: dict[str, Any] = {
        "config": {"files": kind, **config},
        "sensor": sensor,
        "saved": saved,
        "run_length": run_length,
        "__module__": __name__,
    }
    return type("Dialect", (PtpConformance,), fields)


# How a maker sets exposures does not depend on the format, nor how a file is read on the maker:
# each is here with some of the others, and `test_every_maker_saves_every_format` has all pairs.
TestPlainJpeg = dialect(run_length=100)
TestPlainRaw = pytest.mark.slow(dialect("dng", "ideal-12"))
TestTimesAsRange = pytest.mark.slow(dialect("tiff", time_form="range"))
TestNikonRaw = dialect("dng", vendor="nikon", run_length=100)
TestCanonTiff = dialect("tiff", vendor="canon")
TestSonyJpeg = dialect(vendor="sony")
TestFujiJpeg = dialect(vendor="fuji")
TestOlympusRaw = pytest.mark.slow(dialect("dng", vendor="olympus"))
TestPanasonicJpeg = pytest.mark.slow(dialect(vendor="panasonic"))


@pytest.mark.slow
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


@pytest.mark.usefixtures("own_profiles")
@pytest.mark.parametrize("kind", ["jpeg", "tiff", "dng"])
@pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
def test_every_maker_saves_every_format(vendor: str, kind: str) -> None:
    suite = dialect(kind, vendor=vendor)()
    for check in (
        suite.test_the_camera_saves_the_format_under_test,
        suite.test_light_is_proportional_to_the_exposure,
    ):
        with suite.open_camera() as camera:
            check(camera)
