"""The conformance suite on virtual cameras of three makes, through libgphoto2 over TCP.

tests/virtual_hardware runs it on a camera of the standard, through libgphoto2 and the kernel's USB.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest
from kept_open import KeptOpenConformance
from network_bench import camera_on_tcp

import camctl
from camctl.interface.camera import Camera


class MakeConformance(KeptOpenConformance):
    """Time is real, so that exposures and sequences are short."""

    longest_s = 0.1
    run_length = range_length = 5

    vendor: ClassVar[str]
    _port: ClassVar[int]

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _virtual_camera(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("VCAMERADIR", raising=False)
            patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
            with camera_on_tcp(vendor=cls.vendor, files="dng") as (_, cls._port):
                yield
                cls._close()

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(1 / 125)

    def open_anew(self) -> Camera:
        return camctl.open_camera(f"gphoto2:ptpip:127.0.0.1:{self._port}", format="raw")


@pytest.mark.slow
class TestNikon(MakeConformance):
    vendor = "nikon"


@pytest.mark.slow
class TestCanon(MakeConformance):
    vendor = "canon"


@pytest.mark.slow
class TestSony(MakeConformance):
    vendor = "sony"
