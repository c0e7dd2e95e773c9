"""A pyusb backend for virtual devices in this process: no kernel, no libusb, no privileges.

::

    backend = VirtualBackend([device])
    found = usb.core.find(backend=backend)

Errors are those that pyusb's libusb backend raises: `USBTimeoutError` with ETIMEDOUT, and
`USBError` with EPIPE (stall), ENODEV (unplugged), EBUSY (claimed by another program), EOVERFLOW (a
packet larger than the buffer).  A read that times out in the middle of a transfer returns the bytes
it has, as with libusb.  Time-outs are counted on the device's clock (`camctl.sim.devices.clock`).
"""

from __future__ import annotations

import errno
import math
import threading
from array import array
from collections.abc import Iterable, Iterator
from itertools import count
from types import SimpleNamespace
from typing import NoReturn, Protocol

import usb.backend
from usb.core import USBError, USBTimeoutError

from camctl.sim.devices.usb.device import IN, ControlFailure, UsbDevice
from camctl.sim.devices.usb.endpoints import Descriptor, Read, parse_configuration, parse_device

BUS = 250  # no machine has so many

# libusb's error codes and texts.
_LIBUSB_ERRORS = {
    errno.ENODEV: (-4, "No such device (it may have been disconnected)"),
    errno.EBUSY: (-6, "Resource busy"),
    errno.ETIMEDOUT: (-7, "Operation timed out"),
    errno.EOVERFLOW: (-8, "Overflow"),
    errno.EPIPE: (-9, "Pipe error"),
}


def _fail(number: int) -> NoReturn:
    code, text = _LIBUSB_ERRORS[number]
    kind = USBTimeoutError if number == errno.ETIMEDOUT else USBError
    raise kind(text, code, number)


def _deadline_s(device: UsbDevice, timeout: int) -> float:
    """Return when a time-out in ms ends on the device's clock; 0 is no time-out."""
    return device.clock.now() + timeout / 1000 if timeout else math.inf


class _Connection:
    """A device from being plugged in to being unplugged."""

    def __init__(self, device: UsbDevice, address: int) -> None:
        self.device = device
        self.address = address
        self.unplugged = threading.Event()
        self.claims: dict[int, _Handle] = {}  # by interface

    @property
    def configuration(self) -> Descriptor:
        return parse_configuration(self.device.configuration_descriptor)


class _Handle:
    """A connection that a host has opened."""

    def __init__(self, connection: _Connection) -> None:
        self.connection = connection

    def device(self) -> UsbDevice:
        """Return the device (ENODEV: it has been unplugged)."""
        if self.connection.unplugged.is_set():
            _fail(errno.ENODEV)
        return self.connection.device


class BackendPort:
    """A port of a `VirtualBackend`."""

    def __init__(self, backend: VirtualBackend) -> None:
        self._backend = backend
        self._connection: _Connection | None = None

    def attach(self, device: UsbDevice) -> None:
        self.detach()
        self._connection = self._backend.add(device)
        device.connect()

    def detach(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            self._backend.remove(connection)
            connection.unplugged.set()
            connection.device.disconnect()


class Described(Protocol):
    """A device with its configuration."""

    @property
    def configuration(self) -> Descriptor:
        """The configuration descriptor, parsed."""


class DescribedBackend(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """A backend that reads descriptors of its devices' configurations."""

    # pyusb calls these; parameters have the names of its interface.

    def get_configuration_descriptor(self, dev: Described, config: int) -> SimpleNamespace:
        if config:
            raise IndexError(config)
        return dev.configuration.as_namespace()

    def get_interface_descriptor(
        self, dev: Described, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        return dev.configuration.alternate(intf, alt).as_namespace()

    def get_endpoint_descriptor(
        self, dev: Described, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        return dev.configuration.alternate(intf, alt).children[ep].as_namespace()


class VirtualBackend(DescribedBackend):
    """The devices that `usb.core.find` finds with it.

    Args:
        devices: plugged in at once, each into a port of its own, so that its `detach` and `attach`
            unplug it and plug it in again
        bytes_per_s: speed of reads from IN endpoints, counted on the device's clock
    """

    def __init__(self, devices: Iterable[UsbDevice] = (), *, bytes_per_s: float = math.inf) -> None:
        super().__init__()
        self._bytes_per_s = bytes_per_s
        self._connections: list[_Connection] = []
        self._addresses = count(1)
        for device in devices:
            device.port = BackendPort(self)
            device.attach()

    def add(self, device: UsbDevice) -> _Connection:
        connection = _Connection(device, next(self._addresses) % 127 + 1)
        self._connections.append(connection)
        return connection

    def remove(self, connection: _Connection) -> None:
        self._connections.remove(connection)

    # pyusb calls these; parameters have the names of its interface.

    def enumerate_devices(self) -> Iterator[_Connection]:
        yield from tuple(self._connections)

    def get_parent(self, dev: _Connection) -> None:
        """Return None: there is no hub between host and device."""

    def get_device_descriptor(self, dev: _Connection) -> SimpleNamespace:
        return SimpleNamespace(
            **parse_device(dev.device.device_descriptor),
            bus=BUS,
            address=dev.address,
            speed=int(dev.device.speed),
            port_number=dev.address,
            port_numbers=(dev.address,),
        )

    def open_device(self, dev: _Connection) -> _Handle:
        handle = _Handle(dev)
        handle.device()
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        claims = dev_handle.connection.claims
        for interface in [each for each, owner in claims.items() if owner is dev_handle]:
            del claims[interface]

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        self._request(dev_handle, (0, 9, config_value, 0, 0))

    def get_configuration(self, dev_handle: _Handle) -> int:
        """Return the value of the only configuration, which a host sets when it finds a device."""
        dev_handle.device()
        return dev_handle.connection.configuration.fields["bConfigurationValue"]

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        dev_handle.device()
        if dev_handle.connection.claims.setdefault(intf, dev_handle) is not dev_handle:
            _fail(errno.EBUSY)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        dev_handle.device()
        del dev_handle.connection.claims[intf]

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        dev_handle.device()
        return False

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        self._request(dev_handle, (2, 1, 0, ep, 0))

    def bulk_write(
        self, dev_handle: _Handle, ep: int, intf: int, data: array[int], timeout: int
    ) -> int:
        device = dev_handle.device()
        raw = data.tobytes()
        if error := device.write(ep, raw):
            _fail(error)
        return len(raw)

    def bulk_read(
        self, dev_handle: _Handle, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read from an IN endpoint into `buff`; `timeout` in ms, 0 for none."""
        device = dev_handle.device()
        ended = threading.Event()
        result: list[tuple[int, bytes]] = []

        def done(error: int, data: bytes) -> None:
            result.append((error, data))
            ended.set()

        read = Read(ep & 15, len(buff) * buff.itemsize, done)
        device.read(read)
        if not device.clock.wait_for(ended, _deadline_s(device, timeout)):
            device.cancel(read)
        error, data = result[0]
        memoryview(buff).cast("B")[: len(data)] = data
        if error == errno.ECONNRESET:
            error = 0 if data else errno.ETIMEDOUT
        if error:
            _fail(error)
        device.clock.sleep_until(device.clock.now() + len(data) / self._bytes_per_s)
        return len(data)

    intr_read = bulk_read

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        size = len(data) * data.itemsize
        sent = b"" if bmRequestType & IN else data.tobytes()
        setup = (bmRequestType, bRequest, wValue, wIndex, size)
        reply = self._request(dev_handle, setup, sent, timeout)
        if not bmRequestType & IN:
            return size
        memoryview(data).cast("B")[: len(reply)] = reply
        return len(reply)

    def _request(
        self,
        handle: _Handle,
        setup: tuple[int, int, int, int, int],
        data: bytes = b"",
        timeout: int = 1000,
    ) -> bytes:
        device = handle.device()
        reply = device.request(*setup, data)
        if reply is ControlFailure.NO_REPLY:
            unplugged = handle.connection.unplugged
            is_unplugged = device.clock.wait_for(unplugged, _deadline_s(device, timeout))
            _fail(errno.ENODEV if is_unplugged else errno.ETIMEDOUT)
        if isinstance(reply, ControlFailure):
            _fail(errno.EPIPE)
        return reply
