"""USB devices through pyusb: identity, interfaces, and libusb's errors as typed errors."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias

import usb.core
import usb.util

from camctl.drivers.common.device_holders import holding
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.camera import CameraInfo

#: Gives the person at the machine access to still cameras, webcams and serial adapters; belongs in
#: /etc/udev/rules.d/70-camctl.rules.  ID_USB_INTERFACES, set by udev's own rules, lists the
#: interface classes of a device; 060101 is a still camera (PIMA 15740).
UDEV_RULES = """\
# Cameras for camctl: who sits at the machine may use them, and so may the group plugdev.
ACTION=="remove", GOTO="camctl_end"
SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ENV{ID_USB_INTERFACES}=="*:060101:*", \
MODE="0660", GROUP="plugdev", TAG+="uaccess"
SUBSYSTEM=="video4linux", MODE="0660", GROUP="video", TAG+="uaccess"
SUBSYSTEM=="tty", SUBSYSTEMS=="usb", MODE="0660", GROUP="dialout", TAG+="uaccess"
LABEL="camctl_end"
"""

_GRANT_PERMISSION = "install the udev rules, then plug it in again"
_RELEASE_IT = (
    "desktops mount cameras by themselves: unmount it there, or end gvfs-gphoto2-volume-monitor, "
    "gvfsd-gphoto2, gphoto2 or darktable, and try again"
)
_PLUG_IN_AGAIN = "plug it in and switch it on, then try again"
_SYSFS = Path("/sys/bus/usb/devices")

#: Makes whose own PTP operations the backend ptp knows, by USB vendor.
PTP_MAKES: Mapping[int, str] = {
    0x04B0: "Nikon",
    0x04A9: "Canon",
    0x054C: "Sony",
    0x04CB: "Fujifilm",
    0x07B4: "Olympus",
    0x33A2: "OM System",
    0x04DA: "Panasonic",
}

InterfaceKind: TypeAlias = tuple[int, int, int]
"""(class, subclass, protocol) of an interface."""


class StalledError(CameraProtocolError):
    """An endpoint is halted (EPIPE): the device refuses transfers until the halt is cleared."""


# errno: error type, what the device did, what to do.  Linux reports a device that is pulled out
# during a transfer as ENODEV, ESHUTDOWN, EPROTO or EIO, depending on what notices it first.
_MEANINGS: dict[int, tuple[type[CameraError], str, str]] = {
    errno.EACCES: (CameraNotFoundError, "cannot be opened: no permission", _GRANT_PERMISSION),
    errno.EPERM: (CameraNotFoundError, "cannot be opened: no permission", _GRANT_PERMISSION),
    errno.EBUSY: (CameraBusyError, "is in use by another program", _RELEASE_IT),
    errno.ENODEV: (CameraDisconnectedError, "was disconnected", _PLUG_IN_AGAIN),
    errno.ENOENT: (CameraDisconnectedError, "was disconnected", _PLUG_IN_AGAIN),
    errno.ENXIO: (CameraDisconnectedError, "was disconnected", _PLUG_IN_AGAIN),
    errno.ESHUTDOWN: (CameraDisconnectedError, "was disconnected", _PLUG_IN_AGAIN),
    errno.EPROTO: (CameraDisconnectedError, "lost its USB signal", _PLUG_IN_AGAIN),
    errno.EIO: (CameraDisconnectedError, "failed a USB transfer", _PLUG_IN_AGAIN),
    errno.ETIMEDOUT: (
        CameraTimeoutError,
        "does not answer",
        "switch it off and on again, then resume",
    ),
    errno.EPIPE: (StalledError, "refused a USB transfer (stall)", "try again"),
    errno.EOVERFLOW: (
        CameraProtocolError,
        "sent more than was requested",
        "try another cable or socket",
    ),
    errno.ENOMEM: (
        CameraBusyError,
        "cannot be used: the kernel has no memory for USB transfers",
        "close other programs that use USB, or raise usbcore.usbfs_memory_mb",
    ),
}


def usb_error(error: usb.core.USBError, name: str) -> CameraError:
    """Return the typed error for a pyusb error of the device `name`."""
    number = error.errno
    if number in _MEANINGS:
        kind, what, hint = _MEANINGS[number]
        remedies = {"udev_rules": None} if hint == _GRANT_PERMISSION else None
        return kind(f"{name} {what}", hint=hint, remedies=remedies)
    text = " ".join(str(error.strerror or error).split()) or f"error {number}"
    return CameraProtocolError(
        f"{name} failed a USB transfer: {text}", hint="plug it in again and try once more"
    )


@contextmanager
def typed_usb_errors(name: str) -> Iterator[None]:
    """Turn pyusb's errors into `camctl.errors`; `name` is the device's name in them."""
    try:
        yield
    except usb.core.NoBackendError:
        raise no_libusb() from None
    except usb.core.USBError as error:
        raise usb_error(error, name) from None


def no_libusb() -> CameraNotFoundError:
    """Return the error for a missing libusb."""
    return CameraNotFoundError(
        "libusb is not installed, so that no still camera can be reached",
        hint="install it: sudo apt-get install libusb-1.0-0",
    )


# ---- identity


def device_name(device: Any) -> str:
    """Return a device's name in error messages: product name if readable, bus and address."""
    name = usb_string(device, device.iProduct, "product") or "the camera"
    return f"{name} at USB {device.bus:03d}:{device.address:03d}"


def usb_identity(device: Any) -> CameraInfo:
    """Return the identity in a device's descriptors; the id is ptp:SERIAL or ptp:BUS:ADDRESS.

    Claims no interface and opens no session, so that a camera in use can be listed as well.
    """
    serial = usb_string(device, device.iSerialNumber, "serial")
    # A serial number with a colon would be taken for bus and address.
    address = serial if serial and ":" not in serial else f"{device.bus:03d}:{device.address:03d}"
    return CameraInfo(
        f"ptp:{address}",
        usb_string(device, device.iManufacturer, "manufacturer")
        or f"USB vendor {device.idVendor:04x}",
        usb_string(device, device.iProduct, "product") or f"product {device.idProduct:04x}",
        serial,
        "ptp",
    )


def usb_string(device: Any, index: int, attribute: str) -> str:
    """Return the printable part of a string descriptor; "" if there is none or it is unreadable.

    Reading a string descriptor needs permission to open the device; without it the string that the
    kernel read (`attribute` in sysfs) is used, so that the camera's id stays the same.  A device
    that stalls on the request can still be listed.
    """
    if not index:
        return ""
    try:
        text = usb.util.get_string(device, index)
    except (usb.core.USBError, NotImplementedError, UnicodeDecodeError):
        return ""
    except ValueError:  # pyusb's "no langid" for a device that may not be opened
        text = _sysfs_string(device, attribute)
    return "".join(c for c in (text or "") if c.isprintable()).strip()


def _sysfs_string(device: Any, attribute: str) -> str:
    ports = ".".join(map(str, device.port_numbers or ()))
    with suppress(OSError, UnicodeDecodeError):
        return (_SYSFS / f"{device.bus}-{ports}" / attribute).read_text()
    return ""


# ---- interfaces


def has_interface(device: Any, kind: InterfaceKind) -> bool:
    """Return whether a device's descriptors list an interface of `kind`; the device stays idle."""
    return any(_kind(interface) == kind for configuration in device for interface in configuration)


def find_interface(device: Any, kind: InterfaceKind) -> Any:
    """Return a device's interface of `kind` or None; sets a configuration if none is set.

    Raises:
        usb.core.USBError: from libusb
    """
    # Setting the configuration that is already set restarts the interfaces of some cameras.
    try:
        configuration = device.get_active_configuration()
    except usb.core.USBError as error:
        if error.errno in (errno.EACCES, errno.ENODEV):
            raise
        device.set_configuration()
        configuration = device.get_active_configuration()
    return next((each for each in configuration if _kind(each) == kind), None)


def _kind(interface: Any) -> InterfaceKind:
    return (
        interface.bInterfaceClass,
        interface.bInterfaceSubClass,
        interface.bInterfaceProtocol,
    )


def find_endpoint(interface: Any, kind: int, *, is_in: bool) -> Any:
    """Return an interface's first endpoint of a transfer type and direction, or None."""
    direction = usb.util.ENDPOINT_IN if is_in else usb.util.ENDPOINT_OUT
    for each in interface:
        if (
            usb.util.endpoint_type(each.bmAttributes) == kind
            and usb.util.endpoint_direction(each.bEndpointAddress) == direction
        ):
            return each
    return None


def claim_interface(device: Any, number: int, name: str) -> None:
    """Claim an interface for this process.

    Raises:
        CameraBusyError: another program holds it; lists the programs this user may see
        usb.core.USBError: from libusb
    """
    # A still-image interface has no kernel driver, but one may be left after a mode change.
    with suppress(NotImplementedError):
        if device.is_kernel_driver_active(number):
            device.detach_kernel_driver(number)
    try:
        usb.util.claim_interface(device, number)
    except usb.core.USBError as error:
        if error.errno != errno.EBUSY:
            raise
        busy = usb_error(error, name)
        holders = _holders(device)
        raise CameraBusyError(
            f"{busy.what}: {holders}" if holders else busy.what,
            hint=busy.hint,
            remedies=busy.remedies,
        ) from None


def _holders(device: Any) -> str:
    node = f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"
    found = (each for each in holding(node) if not each.is_us)
    return ", ".join(f"{each.program} (process {each.process})" for each in found)
