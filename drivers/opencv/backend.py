"""The backend `opencv`, for the entry point `camctl.cameras`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from camctl.drivers.opencv.camera import DRIVER, OpencvCamera, OpencvOptions
from camctl.drivers.opencv.video import Address, Video
from camctl.errors import CameraError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import RealClock

#: Indices that are tried with `probe`: opening one takes a second and lights the camera's lamp.
_PROBED = range(4)


class OpencvBackend:
    """Opens ``opencv:INDEX``, ``opencv:URL`` and ``opencv:PIPELINE``; see `OpencvOptions`."""

    about = "webcams on any system (looked for on request), network streams and GStreamer pipelines"
    local_address = r"\d+"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras with an index that can be opened; none without `probe`."""
        return [_info(index) for index in _PROBED if _opens(index)] if probe else []

    def open(self, address: str, options: Mapping[str, Any]) -> OpencvCamera:
        return OpencvCamera(address, OpencvOptions.parse(options)).open()


def _info(index: int) -> CameraInfo:
    return CameraInfo(f"{DRIVER}:{index}", "", f"camera {index}", "", DRIVER)


def _opens(index: int) -> bool:
    try:
        Video(Address(str(index), "index"), RealClock(), 0.01).close()
    except CameraError:
        return False
    return True
