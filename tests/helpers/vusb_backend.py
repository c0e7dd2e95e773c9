"""A pyusb backend on libgphoto2's own virtual camera, `vusb` of the gphoto2 wheel.

It wraps libgphoto2_port, which loads vusb as a port library, with ctypes: neither kernel nor USB is
used.  vusb has a Nikon D750 that sends one canned picture whatever it is set to, which it reads
from the folder VCAMERADIR, and whose store is full after some pictures.
"""

from __future__ import annotations

import ctypes
import errno
import os
from array import array
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

from usb.core import USBError, USBTimeoutError
from virtual_usb_bus import DescribedBackend

from camctl.sim.devices.ptp.camera import configuration_descriptor, device_descriptor
from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.usb.endpoints import parse_configuration, parse_device

MODEL = Identity(0x04B0, 0x0437, "Nikon Corporation", "D750 (vusb)")
_GP_TIMEOUT = -10
_CONTROL_OK = bytes((4, 0, 0x01, 0x20))  # the status request of the still image class: OK
_STATUS = 0x67
_IN = 0x80


def missing() -> str | None:
    """Return why vusb cannot be used here; None if it can."""
    if find_spec("gphoto2") is None:
        return "the package gphoto2 is not installed"
    return None


def _folder() -> Path:
    spec = find_spec("gphoto2")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent / "libgphoto2"


class _Port:
    """A port of libgphoto2 with the virtual camera behind it."""

    def __init__(self, store: Path) -> None:
        os.environ["VCAMERADIR"] = f"{store}/"
        os.environ["IOLIBS"] = str(_folder() / "vusb")
        self._library = ctypes.CDLL(str(_folder() / "libgphoto2_port.so.12"))
        ports, info = ctypes.c_void_p(), ctypes.c_void_p()
        self._port = ctypes.c_void_p()
        self._call("info_list_new", ctypes.byref(ports))
        self._call("info_list_load", ports)
        self._call("info_list_get_info", ports, 0, ctypes.byref(info))
        self._call("new", ctypes.byref(self._port))
        self._call("set_info", self._port, info)
        self._call("usb_find_device", self._port, MODEL.vendor_id, MODEL.product_id)
        self._call("open", self._port)

    def _call(self, name: str, *arguments: Any) -> int:
        result = int(getattr(self._library, f"gp_port_{name}")(*arguments))
        if result == _GP_TIMEOUT:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        if result < 0:
            raise USBError(f"libgphoto2 error {result} of {name}", -1, errno.EIO)
        return result

    def write(self, data: bytes) -> int:
        """Write to the camera; return the number of bytes."""
        return self._call("write", self._port, data, len(data))

    def read(self, size: int) -> bytes:
        """Return what the camera has to send now, up to `size` bytes."""
        buffer = ctypes.create_string_buffer(size)
        count = self._call("read", self._port, buffer, size)
        return buffer.raw[:count]

    def event(self, size: int, timeout_ms: int) -> bytes:
        """Return the next event."""
        buffer = ctypes.create_string_buffer(size)
        self._call("set_timeout", self._port, timeout_ms)
        count = self._call("check_int", self._port, buffer, size)
        return buffer.raw[:count]

    def close(self) -> None:
        """Disconnect from the camera."""
        self._call("close", self._port)
        self._call("free", self._port)


class VusbBackend(DescribedBackend):
    """One virtual camera; `store` is the folder with its picture."""

    def __init__(self, store: Path) -> None:
        super().__init__()
        self._port = _Port(store)
        self.configuration = parse_configuration(configuration_descriptor())

    def enumerate_devices(self) -> Iterator[VusbBackend]:
        """Yield the only device: this object, which stands for its handle, too."""
        yield self

    def get_parent(self, dev: VusbBackend) -> None:
        """Return None: it is on no hub."""

    def get_device_descriptor(self, dev: VusbBackend) -> SimpleNamespace:
        """Return the device descriptor's fields, and bus and address; it has no strings."""
        fields = parse_device(device_descriptor(MODEL))
        fields |= {"iManufacturer": 0, "iProduct": 0, "iSerialNumber": 0}
        place = {"bus": 251, "address": 1, "speed": 3, "port_number": 1, "port_numbers": (1,)}
        return SimpleNamespace(**fields, **place)

    def open_device(self, dev: VusbBackend) -> VusbBackend:
        """Return the device as its own handle."""
        return dev

    def close_device(self, dev_handle: VusbBackend) -> None:
        """Do nothing: the port stays open until `close`."""

    def close(self) -> None:
        """Disconnect from the camera."""
        self._port.close()

    def get_configuration(self, dev_handle: VusbBackend) -> int:
        """Return the value of the only configuration."""
        return int(self.configuration.fields["bConfigurationValue"])

    def claim_interface(self, dev_handle: VusbBackend, intf: int) -> None:
        """Do nothing: nobody else has it."""

    release_interface = claim_interface

    def is_kernel_driver_active(self, dev_handle: VusbBackend, intf: int) -> bool:
        """Return False: the kernel does not see it."""
        return False

    def clear_halt(self, dev_handle: VusbBackend, ep: int) -> None:
        """Do nothing: it never halts."""

    def bulk_write(
        self, dev_handle: VusbBackend, ep: int, intf: int, data: array[int], timeout: int
    ) -> int:
        """Write to the camera; an empty packet is nothing to it."""
        raw = data.tobytes()
        return self._port.write(raw) if raw else 0

    def bulk_read(
        self, dev_handle: VusbBackend, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read into `buff`; a camera that has nothing to send now never will."""
        data = self._port.read(len(buff) * buff.itemsize)
        if not data:
            _fail_silent()
        memoryview(buff).cast("B")[: len(data)] = data
        return len(data)

    def intr_read(
        self, dev_handle: VusbBackend, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read an event into `buff`."""
        data = self._port.event(len(buff) * buff.itemsize, timeout)
        if not data:
            _fail_silent()
        memoryview(buff).cast("B")[: len(data)] = data
        return len(data)

    def ctrl_transfer(
        self,
        dev_handle: VusbBackend,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        """Answer the status request; other requests are accepted."""
        if not bmRequestType & _IN:
            return len(data) * data.itemsize
        if bRequest != _STATUS:
            raise USBError("Pipe error", -9, errno.EPIPE)
        memoryview(data).cast("B")[: len(_CONTROL_OK)] = _CONTROL_OK
        return len(_CONTROL_OK)


def _fail_silent() -> NoReturn:
    raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
