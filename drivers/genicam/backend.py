"""The backend `genicam`, for the entry point `camctl.cameras`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from camctl.drivers.genicam.camera import GenicamCamera
from camctl.drivers.genicam.libraries import camera_info, find_device, is_installed, library
from camctl.drivers.genicam.preparation import GenicamOptions
from camctl.drivers.genicam.recording import record
from camctl.interface.camera import CameraInfo


class GenicamBackend:
    """Opens ``genicam:SERIAL``, ``genicam:IP`` and ``genicam:``; see `GenicamOptions`."""

    about = (
        "machine-vision cameras on GigE Vision and USB3 Vision (apt install libaravis-0.8-0, or "
        "pip install 'camctl[genicam]')"
    )

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that answer in the networks of this computer and on USB."""
        return [camera_info(each) for each in library().search()] if is_installed() else ()

    def record(self, address: str) -> dict[str, Any]:
        """Return what the camera says of itself; see `CameraBackend`."""
        return record(library(), address)

    def open(self, address: str, options: Mapping[str, Any]) -> GenicamCamera:
        chosen = GenicamOptions.parse(options)
        using = library(chosen.library)
        return GenicamCamera(using, find_device(using, address), chosen).open()
