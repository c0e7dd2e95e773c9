"""The libraries that are installed, and the devices that they find."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from ipaddress import IPv4Address

from camctl.drivers.genicam import aravis_calls
from camctl.drivers.genicam.aravis import AravisLibrary
from camctl.drivers.genicam.port import FeatureError, FoundDevice, Kind, Library, OpenDevice
from camctl.drivers.genicam.viva import VivaLibrary
from camctl.errors import CameraError, CameraNotFoundError
from camctl.interface.camera import CameraInfo

DRIVER = "genicam"


def library(name: str = "auto") -> Library:
    """Return the library "aravis" or "viva"; "auto": the first of them that is installed.

    Raises:
        CameraError: it is not installed, or none of them is
    """
    if name in ("auto", "aravis") and (functions := aravis_calls.load()) is not None:
        return AravisLibrary(functions)
    if name in ("auto", "viva") and find_spec("viva_genicam") is not None:
        return VivaLibrary(import_module("viva_genicam"))
    what = {"aravis": "Aravis 0.8", "viva": "viva-genicam"}.get(name, "Aravis 0.8 or viva-genicam")
    raise CameraError(
        f"GenICam cameras need {what}, which is not installed",
        hint="install the package libaravis-0.8-0 of the system, or viva-genicam by pip",
    )


def is_installed() -> bool:
    """Return whether one of the libraries is installed."""
    return find_spec("viva_genicam") is not None or aravis_calls.load() is not None


def address_of(device: FoundDevice) -> str:
    """Return by what a device is named after ``genicam:``: its serial number, where it is known."""
    return device.serial or device.address or device.name


def find_device(using: Library, address: str) -> FoundDevice:
    """Return the device with a serial number, an address in the network, or a name.

    Without an address it is the only device.

    Raises:
        CameraNotFoundError: there is none, or several without an address
    """
    with suppress(ValueError):  # an address in the network needs no search
        ip = str(IPv4Address(address))
        return FoundDevice(ip, "", "", "", ip, "GigE Vision")
    found: Sequence[FoundDevice] = using.search()
    named = [each for each in found if address in (each.serial, each.address, each.name)]
    chosen = named if address else found
    if len(chosen) == 1:
        return chosen[0]
    listed = ", ".join(f"{DRIVER}:{address_of(each)}" for each in found)
    if chosen:
        raise CameraNotFoundError(
            f"{len(chosen)} GenICam cameras are connected", hint=f"name one of them: {listed}"
        )
    what = f"no GenICam camera {address} is connected" if address else "no GenICam camera answers"
    raise CameraNotFoundError(
        what,
        hint=f"there are {listed}"
        if found
        else "check cable, power, and that its address is in the network of this computer",
    )


def camera_info(found: FoundDevice, device: OpenDevice | None = None) -> CameraInfo:
    """Return the identity of a device, with what it states once it is open."""

    def stated(known: str, *names: str) -> str:
        for name in () if known or device is None else names:
            if device is not None and device.kind(name) is Kind.TEXT:
                with suppress(FeatureError):
                    return str(device.read(name)).strip()
        return known

    return CameraInfo(
        f"{DRIVER}:{address_of(found)}",
        stated(found.make, "DeviceVendorName"),
        stated(found.model, "DeviceModelName"),
        stated(found.serial, "DeviceSerialNumber", "DeviceID"),
        DRIVER,
        found.transport,
    )
