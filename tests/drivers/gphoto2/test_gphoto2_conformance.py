"""The conformance suite on virtual cameras of three makes, through libgphoto2 over TCP.

tests/virtual_hardware runs it on a camera of the standard, through libgphoto2 and the kernel's USB.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest
from network_bench import camera_on_tcp

import camctl
from camctl.interface.camera import Camera
from camctl.testing.conformance import CameraConformance


class MakeConformance(CameraConformance):
    """One camera that stays open; time is real, so that exposures and sequences are short."""

    longest_s = 0.1
    run_length = range_length = 5

    vendor: ClassVar[str]
    _port: ClassVar[int]
    _shared: ClassVar[Camera | None] = None

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _virtual_camera(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("VCAMERADIR", raising=False)
            patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
            with camera_on_tcp(vendor=cls.vendor, files="dng") as (_, cls._port):
                yield
                cls._close()

    @pytest.fixture
    def camera(self) -> Camera:
        """The camera that stays open."""
        kind = type(self)
        if kind._shared is None:
            kind._shared = self._open()
        return kind._shared

    def open_camera(self) -> Camera:
        """Return the camera opened anew: the one that stays open is closed before."""
        self._close()
        return self._open()

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(1 / 125)

    def _open(self) -> Camera:
        return camctl.open_camera(f"gphoto2:ptpip:127.0.0.1:{self._port}", format="raw")

    @classmethod
    def _close(cls) -> None:
        camera, cls._shared = cls._shared, None
        if camera is not None:
            camera.close()


@pytest.mark.slow
class TestNikon(MakeConformance):
    vendor = "nikon"


@pytest.mark.slow
class TestCanon(MakeConformance):
    vendor = "canon"


@pytest.mark.slow
class TestSony(MakeConformance):
    vendor = "sony"
