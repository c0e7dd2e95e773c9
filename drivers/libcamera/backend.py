"""The backend `libcamera`, for the entry point `camctl.cameras`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from camctl.drivers.libcamera.camera import (
    LibcameraCamera,
    LibcameraOptions,
    cameras,
    is_installed,
)
from camctl.interface.camera import CameraInfo


class LibcameraBackend:
    """Opens ``libcamera:NUMBER`` and ``libcamera:ID``; see `LibcameraOptions`."""

    about = "cameras of the Raspberry Pi, raw (apt install python3-picamera2)"
    local_address = r"|\d+|/base/.+"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that libcamera knows; none where it is not installed."""
        return cameras() if is_installed() else []

    def open(self, address: str, options: Mapping[str, Any]) -> LibcameraCamera:
        return LibcameraCamera(address, LibcameraOptions.parse(options)).open()
