"""The road to still cameras on USB, for the entry point `camctl.cameras`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import usb.core

from camctl.camera import CameraInfo
from camctl.errors import CameraNotFoundError, UsageError, unknown_name
from drivers.common.usb import no_libusb, typed_usb_errors, usb_identity
from drivers.ptp.camera import PtpCamera
from drivers.ptp.usb_interface import still_interface_number

_OPTIONS = ("bulb", "delete", "format", "response")
_YES_NO = {"yes": True, "no": False}


class PtpBackend:
    """Opens ``ptp:SERIAL`` and ``ptp:BUS:ADDRESS``; ``ptp`` alone where there is one camera.

    Options: format (raw, tiff, jpeg, auto), response (of JPEG and TIFF: srgb, rec709, linear,
    power), bulb (longest time to hold the shutter open, s), delete (yes: from the card once
    fetched).

    Args:
        backend: a pyusb backend; None: libusb
    """

    about = "still cameras on USB that speak PTP: DSLRs, mirrorless, compacts"

    def __init__(self, backend: Any = None) -> None:
        self._backend = backend

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the still cameras that are plugged in, from their descriptors alone.

        Raises:
            CameraNotFoundError: libusb is missing
        """
        return tuple(usb_identity(device, "ptp") for device in self._devices())

    def open(self, address: str, options: Mapping[str, str]) -> PtpCamera:
        """Return an open camera.

        Raises:
            CameraNotFoundError: no such camera, libusb missing, or no permission
            UsageError: an unknown option, or one with a value that makes no sense
            CameraError: see `PtpCamera`
        """
        for option in options:
            if option not in _OPTIONS:
                raise unknown_name("option of a PTP camera", option, _OPTIONS)
        words = dict(options)
        bulb = _seconds(words["bulb"]) if "bulb" in words else None
        delete = words.get("delete", "no")
        if delete not in _YES_NO:
            raise UsageError(f"delete={delete}", hint="say yes or no")
        return PtpCamera(
            self._find(address),
            format=words.get("format", "auto"),
            response=words.get("response", "srgb"),
            bulb_s=bulb,
            delete=_YES_NO[delete],
        )

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
        known = [usb_identity(device, "ptp") for device in devices]
        place = re.fullmatch(r"0*(\d+):0*(\d+)", address)
        matching = [
            device
            for device, info in zip(devices, known, strict=True)
            if not address
            or info.serial == address
            or (place and (device.bus, device.address) == (int(place[1]), int(place[2])))
        ]
        if not matching:
            there = ", ".join(info.id for info in known)
            raise CameraNotFoundError(
                f"no still camera ptp:{address}".rstrip(":"),
                hint=f"there are: {there}"
                if there
                else "plug it in, switch it on, and set its USB mode to PTP",
            )
        if len(matching) > 1:
            there = ", ".join(f"ptp:{d.bus:03d}:{d.address:03d}" for d in matching)
            raise CameraNotFoundError(f"several cameras are ptp:{address}", hint=f"choose: {there}")
        return matching[0]


def _is_still_camera(device: Any) -> bool:
    # Class 0: each interface says its own; anything else than that and 6 has no such interface,
    # but for composite devices (EF).
    if device.bDeviceClass not in (0, 6, 0xEF, 0xFF):
        return False
    try:
        return still_interface_number(device) is not None
    except usb.core.USBError:
        return False  # it went away, or its descriptors are broken


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"a bulb time of '{text}'", hint="give seconds, such as 120") from None
