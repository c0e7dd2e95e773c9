"""The still-image interface of a USB device: found in its descriptors, claimed for us."""

from __future__ import annotations

import errno
from contextlib import suppress
from typing import Any

import usb.core
import usb.util

from camctl.errors import CameraBusyError, CameraNotFoundError
from drivers.common.usb import holders, usb_error

STILL_IMAGE = (6, 1, 1)  # class, subclass, protocol


def still_interface_number(device: Any) -> int | None:
    """Return the number of a device's still-image interface, read from its descriptors alone."""
    for configuration in device:
        for interface in configuration:
            if _kind(interface) == STILL_IMAGE:
                return int(interface.bInterfaceNumber)
    return None


def _kind(interface: Any) -> tuple[int, int, int]:
    return (
        interface.bInterfaceClass,
        interface.bInterfaceSubClass,
        interface.bInterfaceProtocol,
    )


def still_interface(device: Any, who: str) -> Any:
    """Return the still-image interface of a device, which gets a configuration if it has none.

    Raises:
        CameraNotFoundError: it has no such interface
        usb.core.USBError: what libusb says else
    """
    # Setting the configuration that is set already restarts the interfaces of some cameras.
    try:
        configuration = device.get_active_configuration()
    except usb.core.USBError as error:
        if error.errno in (errno.EACCES, errno.ENODEV):
            raise
        device.set_configuration()
        configuration = device.get_active_configuration()
    for interface in configuration:
        if _kind(interface) == STILL_IMAGE:
            return interface
    raise CameraNotFoundError(
        f"{who} is not a still camera",
        hint="switch its USB mode to PTP (PC remote), not mass storage",
    )


def endpoint(interface: Any, kind: int, *, is_in: bool) -> Any:
    """Return the first endpoint of a kind and direction; None where there is none."""
    wanted = usb.util.ENDPOINT_IN if is_in else usb.util.ENDPOINT_OUT
    for each in interface:
        if (
            usb.util.endpoint_type(each.bmAttributes) == kind
            and usb.util.endpoint_direction(each.bEndpointAddress) == wanted
        ):
            return each
    return None


def claim(device: Any, number: int, who: str) -> None:
    """Claim an interface for this process.

    Raises:
        CameraBusyError: another program holds it; names it where it can be seen
        usb.core.USBError: what libusb says else
    """
    # No kernel driver drives class 6, but one may sit there on a camera that changed its mode.
    with suppress(NotImplementedError):
        if device.is_kernel_driver_active(number):
            device.detach_kernel_driver(number)
    try:
        usb.util.claim_interface(device, number)
    except usb.core.USBError as error:
        if error.errno != errno.EBUSY:
            raise
        busy = usb_error(error, who)
        names = holders(device)
        raise CameraBusyError(
            f"{busy.what}: {names}" if names else busy.what, hint=busy.hint
        ) from None
