"""The backend `ptp`: finds still cameras on USB, for the entry point `camctl.cameras`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import usb.core

from camctl.drivers.common.usb import (
    PTP_MAKES,
    has_interface,
    no_libusb,
    typed_usb_errors,
    usb_identity,
)
from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.drivers.ptp.recording import record
from camctl.drivers.ptp.usb_transport import STILL_IMAGE
from camctl.errors import CameraNotFoundError
from camctl.interface.camera import CameraInfo

# Device classes that can have a still-image interface: 0 (each interface states its class), still
# image itself, composite devices (EF) and vendor-specific ones (FF).
_DEVICE_CLASSES = (0, 6, 0xEF, 0xFF)


class PtpBackend:
    """Opens ``ptp:SERIAL`` and ``ptp:BUS:ADDRESS``, or ``ptp``; see `PtpOptions`.

    Args:
        backend: a pyusb backend; None: libusb
    """

    about = "still cameras on USB that speak PTP: DSLRs, mirrorless, compacts"
    local_address = r"[\w.-]*|\d+:\d+"

    def __init__(self, backend: Any = None) -> None:
        self._backend = backend

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the still cameras on the bus, from their descriptors alone.

        Raises:
            CameraNotFoundError: libusb is missing
        """
        return tuple(
            replace(usb_identity(device), remark=_remark(device.idVendor))
            for device in self._devices()
        )

    def record(self, address: str) -> dict[str, Any]:
        """Return what the camera says when it is opened; see `CameraBackend`."""
        return record(self._find(address))

    def open(self, address: str, options: Mapping[str, str]) -> PtpCamera:
        parsed = PtpOptions.parse(options)
        return PtpCamera(self._find(address), parsed).open()

    def _devices(self) -> Iterator[Any]:
        try:
            found = usb.core.find(find_all=True, backend=self._backend)
        except usb.core.NoBackendError:
            raise no_libusb() from None
        with typed_usb_errors("the USB bus"):
            for device in found:
                if _is_still_camera(device):
                    yield device

    def _find(self, address: str) -> Any:
        devices = list(self._devices())
        known = [usb_identity(device) for device in devices]
        place = re.fullmatch(r"0*(\d+):0*(\d+)", address)
        matching = [
            device
            for device, info in zip(devices, known, strict=True)
            if not address
            or info.serial == address
            or (place and (device.bus, device.address) == (int(place[1]), int(place[2])))
        ]
        if not matching:
            ids = ", ".join(info.id for info in known)
            raise CameraNotFoundError(
                f"there is no still camera ptp:{address}"
                if address
                else "no still camera is there",
                hint=f"connected: {ids}"
                if ids
                else "plug it in, switch it on, and set its USB mode to PTP",
            )
        if len(matching) > 1:
            ids = ", ".join(f"ptp:{d.bus:03d}:{d.address:03d}" for d in matching)
            raise CameraNotFoundError(
                f"several cameras match ptp:{address}" if address else "several cameras are there",
                hint=f"choose one of: {ids}",
            )
        return matching[0]


def _remark(vendor: int) -> str:
    """Return which of the two backends for still cameras to use for a make, and why."""
    make = PTP_MAKES.get(vendor)
    if make is None:
        return "by the standard alone; gphoto2: (pip install 'camctl[gphoto2]') knows more makes"
    return f"with {make}'s own operations; gphoto2: if its model is refused"


def _is_still_camera(device: Any) -> bool:
    if device.bDeviceClass not in _DEVICE_CLASSES:
        return False
    try:
        return has_interface(device, STILL_IMAGE)
    except usb.core.USBError:
        return False  # it was disconnected, or its descriptors are broken
