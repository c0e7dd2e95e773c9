"""What libusb says, as typed errors with the next step; shared by all drivers on USB."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import usb.core
import usb.util

from camctl.camera import CameraInfo
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.common.device_holders import holding

#: Lets the person at the machine use still cameras, webcams and serial adapters; to be put into
#: /etc/udev/rules.d/70-camctl.rules.  Devices show the interface classes of a configuration in
#: ID_USB_INTERFACES, which udev's own rules fill in; 060101 is a still camera (PIMA 15740).
UDEV_RULES = """\
# Cameras for camctl: who sits at the machine may use them, and so may the group plugdev.
ACTION=="remove", GOTO="camctl_end"
SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ENV{ID_USB_INTERFACES}=="*:060101:*", \
MODE="0660", GROUP="plugdev", TAG+="uaccess"
SUBSYSTEM=="video4linux", MODE="0660", GROUP="video", TAG+="uaccess"
SUBSYSTEM=="tty", SUBSYSTEMS=="usb", MODE="0660", GROUP="dialout", TAG+="uaccess"
LABEL="camctl_end"
"""

_HOW_TO_PERMIT = (
    "run: camctl cameras --udev-rules | sudo tee /etc/udev/rules.d/70-camctl.rules"
    " && sudo udevadm control --reload, then plug it in again"
)
_WHO_HOLDS_IT = (
    "desktops mount cameras by themselves: unmount it there, or end gvfs-gphoto2-volume-monitor, "
    "gvfsd-gphoto2, gphoto2 or darktable, and try again"
)
_PLUG_AGAIN = "plug it in and switch it on, then try again"
_SYSFS = Path("/sys/bus/usb/devices")


class StalledError(CameraProtocolError):
    """An endpoint is halted (EPIPE): the device refuses what was sent until the halt is cleared."""


# errno: type, what, next step.  Linux reports a device that is pulled out in the middle of a
# transfer as ENODEV, ESHUTDOWN, EPROTO or EIO, depending on which of them notices first.
_MEANING: dict[int, tuple[type[CameraError], str, str]] = {
    errno.EACCES: (CameraNotFoundError, "no permission to use it", _HOW_TO_PERMIT),
    errno.EPERM: (CameraNotFoundError, "no permission to use it", _HOW_TO_PERMIT),
    errno.EBUSY: (CameraBusyError, "another program holds it", _WHO_HOLDS_IT),
    errno.ENODEV: (CameraDisconnectedError, "it went away", _PLUG_AGAIN),
    errno.ENOENT: (CameraDisconnectedError, "it went away", _PLUG_AGAIN),
    errno.ENXIO: (CameraDisconnectedError, "it went away", _PLUG_AGAIN),
    errno.ESHUTDOWN: (CameraDisconnectedError, "it went away", _PLUG_AGAIN),
    errno.EPROTO: (CameraDisconnectedError, "the cable's signals broke off", _PLUG_AGAIN),
    errno.EIO: (CameraDisconnectedError, "the transfer failed", _PLUG_AGAIN),
    errno.ETIMEDOUT: (
        CameraTimeoutError,
        "it does not answer",
        "switch it off and on again, then resume",
    ),
    errno.EPIPE: (StalledError, "it refuses the transfer (stall)", "try again"),
    errno.EOVERFLOW: (
        CameraProtocolError,
        "it sent more than was asked for",
        "try another cable or socket",
    ),
    errno.ENOMEM: (
        CameraBusyError,
        "the kernel has no memory for USB transfers",
        "close other programs that use USB, or raise usbcore.usbfs_memory_mb",
    ),
}


def usb_error(error: usb.core.USBError, who: str) -> CameraError:
    """Return the typed error for what libusb said of the device `who`."""
    number = error.errno
    if number in _MEANING:
        kind, what, hint = _MEANING[number]
        return kind(f"{who}: {what}", hint=hint)
    said = " ".join(str(error).split()) or f"error {number}"
    return CameraProtocolError(f"{who}: {said}", hint="plug it in again and try once more")


@contextmanager
def typed_usb_errors(who: str) -> Iterator[None]:
    """Turn what pyusb raises within into the tree of `camctl.errors`."""
    try:
        yield
    except usb.core.NoBackendError:
        raise no_libusb() from None
    except usb.core.USBError as error:
        raise usb_error(error, who) from None


def no_libusb() -> CameraNotFoundError:
    """The error where the library itself is missing."""
    return CameraNotFoundError(
        "libusb is not installed, so that no still camera can be reached",
        hint="install it: sudo apt-get install libusb-1.0-0",
    )


def device_name(device: Any) -> str:
    """Return how errors call a device: its name, where it can be read, bus and address."""
    name = usb_string(device, device.iProduct, "product") or "the camera"
    return f"{name} at USB {device.bus:03d}:{device.address:03d}"


def holders(device: Any) -> str:
    """Return which programs have a device open, as far as this user may see; "" where none."""
    node = f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"
    found = (each for each in holding(node) if not each.is_us)
    return ", ".join(f"{each.program} (process {each.process})" for each in found)


def usb_identity(device: Any, driver: str) -> CameraInfo:
    """Return who a device is by its descriptors; ids are DRIVER:SERIAL, or DRIVER:BUS:ADDRESS.

    Needs no claim and opens no session, so that a camera that is in use can be listed as well.
    """
    serial = usb_string(device, device.iSerialNumber, "serial")
    # A serial number with a colon would be taken for bus and address.
    address = serial if serial and ":" not in serial else f"{device.bus:03d}:{device.address:03d}"
    return CameraInfo(
        f"{driver}:{address}",
        usb_string(device, device.iManufacturer, "manufacturer")
        or f"USB vendor {device.idVendor:04x}",
        usb_string(device, device.iProduct, "product") or f"product {device.idProduct:04x}",
        serial,
        driver,
    )


def usb_string(device: Any, index: int, attribute: str) -> str:
    """Return a string descriptor in printable form; "" where there is none or it cannot be read.

    Reading one needs permission to open the device; whoever has none is told what the kernel read
    (`attribute` in sysfs), so that a camera keeps its id.  Broken devices stall on it, which is no
    reason not to list a camera.
    """
    if not index:
        return ""
    try:
        text = usb.util.get_string(device, index)
    except (usb.core.USBError, NotImplementedError, UnicodeDecodeError):
        return ""
    except ValueError:  # "no langid": what pyusb says of a device that may not be opened
        text = _as_the_kernel_read_it(device, attribute)
    return "".join(c for c in (text or "") if c.isprintable()).strip()


def _as_the_kernel_read_it(device: Any, attribute: str) -> str:
    ports = ".".join(map(str, device.port_numbers or ()))
    with suppress(OSError, UnicodeDecodeError):
        return (_SYSFS / f"{device.bus}-{ports}" / attribute).read_text()
    return ""
