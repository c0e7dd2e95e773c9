"""Virtual devices behind pyusb, in this process: no kernel, no libusb, no privileges.

::

    backend = VirtualBackend([device])
    found = usb.core.find(backend=backend)

Errors are those that pyusb's libusb backend raises: `USBTimeoutError` with ETIMEDOUT, and
`USBError` with EPIPE (stall), ENODEV (unplugged), EBUSY (claimed by another), EACCES (no
permission), EOVERFLOW (a packet larger than the buffer).  A read that times out in the middle of
a transfer returns what it has got, as with libusb.  Time-outs are counted on the device's clock
(`sim.devices.clock`).
"""

from __future__ import annotations

import errno
import math
import threading
from array import array
from collections.abc import Iterable, Iterator
from itertools import count
from types import SimpleNamespace
from typing import NoReturn

import usb.backend
from usb.core import USBError, USBTimeoutError

from sim.devices.usb.device import IN, Refusal, UsbDevice
from sim.devices.usb.endpoints import Read, parse_configuration, parse_device

BUS = 250  # beyond what a machine has

# libusb's error codes and texts for what can happen here.
_LIBUSB_ERRORS = {
    errno.EACCES: (-3, "Access denied (insufficient permissions)"),
    errno.ENODEV: (-4, "No such device (it may have been disconnected)"),
    errno.ENOENT: (-5, "Entity not found"),
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
    """Return when a time-out given in ms ends, 0 for none, on the device's clock."""
    return device.clock.now() + timeout / 1000 if timeout else math.inf


class _Stay:
    """A device from one plugging in to the unplugging: after it all is ENODEV."""

    def __init__(self, device: UsbDevice, address: int) -> None:
        self.device = device
        self.address = address
        self.gone = threading.Event()
        self.claims: dict[int, object] = {}  # interface -> handle


class _Handle:
    def __init__(self, stay: _Stay) -> None:
        self.stay = stay


class BackendPort:
    """A place of a `VirtualBackend` that one device is plugged into."""

    def __init__(self, backend: VirtualBackend) -> None:
        self._backend = backend
        self._stay: _Stay | None = None

    def attach(self, device: UsbDevice) -> None:
        """Plug the device in, at an address of its own."""
        self.detach()
        self._stay = self._backend.add(device)
        device.connect()

    def detach(self) -> None:
        """Pull the plug."""
        if self._stay is not None:
            self._backend.remove(self._stay)
            self._stay.gone.set()
            self._stay.device.disconnect()
            self._stay = None


class VirtualBackend(usb.backend.IBackend):  # type: ignore[misc]  # pyusb has no types
    """The devices that `usb.core.find` finds with it.

    Args:
        devices: plugged in at once; each gets a port of its own, so that its `detach` and `attach`
            unplug it and plug it in again

    Attributes:
        forbidden: devices that the user may not open (EACCES)
    """

    def __init__(self, devices: Iterable[UsbDevice] = ()) -> None:
        super().__init__()
        self.forbidden: set[UsbDevice] = set()
        self._stays: list[_Stay] = []
        self._addresses = count(1)
        for device in devices:
            device.port = BackendPort(self)
            device.attach()

    def add(self, device: UsbDevice) -> _Stay:
        """List a device at the next address."""
        stay = _Stay(device, next(self._addresses) % 127 + 1)
        self._stays.append(stay)
        return stay

    def remove(self, stay: _Stay) -> None:
        """List it no longer."""
        self._stays.remove(stay)

    def hold(self, device: UsbDevice) -> None:
        """Claim all interfaces of a device as another process would (EBUSY for all others)."""
        stay = next(s for s in self._stays if s.device is device)
        another = object()
        parsed = parse_configuration(device.configuration_descriptor)
        stay.claims = dict.fromkeys(range(parsed.fields["bNumInterfaces"]), another)

    def let_go(self, device: UsbDevice) -> None:
        """End `hold`."""
        next(s for s in self._stays if s.device is device).claims.clear()

    # What pyusb calls.

    def enumerate_devices(self) -> Iterator[_Stay]:
        """Yield what is plugged in."""
        yield from tuple(self._stays)

    def get_parent(self, dev: _Stay) -> None:
        """Return the hub: there is none."""

    def get_device_descriptor(self, dev: _Stay) -> SimpleNamespace:
        """Return the device descriptor's fields and where the device is."""
        return SimpleNamespace(
            **parse_device(dev.device.device_descriptor),
            bus=BUS,
            address=dev.address,
            speed=int(dev.device.speed),
            port_number=dev.address,
            port_numbers=(dev.address,),
        )

    def get_configuration_descriptor(self, dev: _Stay, config: int) -> SimpleNamespace:
        """Return the configuration's fields."""
        if config:
            raise IndexError(config)
        return parse_configuration(dev.device.configuration_descriptor).as_namespace()

    def get_interface_descriptor(
        self, dev: _Stay, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return an interface's fields."""
        parsed = parse_configuration(dev.device.configuration_descriptor)
        return parsed.alternate(intf, alt).as_namespace()

    def get_endpoint_descriptor(
        self, dev: _Stay, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return an endpoint's fields."""
        parsed = parse_configuration(dev.device.configuration_descriptor)
        return parsed.alternate(intf, alt).parts[ep].as_namespace()

    def open_device(self, dev: _Stay) -> _Handle:
        """Open it."""
        if dev.gone.is_set():
            _fail(errno.ENODEV)
        if dev.device in self.forbidden:
            _fail(errno.EACCES)
        return _Handle(dev)

    def close_device(self, dev_handle: _Handle) -> None:
        """Close it; its claims end."""
        stay = dev_handle.stay
        stay.claims = {n: owner for n, owner in stay.claims.items() if owner is not dev_handle}

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Set the configuration; EBUSY while an interface is claimed, as under Linux."""
        if dev_handle.stay.claims:
            _fail(errno.EBUSY)
        self._ask(dev_handle, 0, 9, config_value, 0, 0, b"", 1000)

    def get_configuration(self, dev_handle: _Handle) -> int:
        """Return the only configuration's value: the host has set it when it was plugged in."""
        if dev_handle.stay.gone.is_set():
            _fail(errno.ENODEV)
        parsed = parse_configuration(dev_handle.stay.device.configuration_descriptor)
        return parsed.fields["bConfigurationValue"]

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        """Set an alternate setting."""
        self._ask(dev_handle, 1, 11, altsetting, intf, 0, b"", 1000)

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Claim it for this handle."""
        stay = dev_handle.stay
        if stay.gone.is_set():
            _fail(errno.ENODEV)
        if stay.claims.setdefault(intf, dev_handle) is not dev_handle:
            _fail(errno.EBUSY)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Release it."""
        if dev_handle.stay.gone.is_set():
            _fail(errno.ENODEV)
        if dev_handle.stay.claims.get(intf) is not dev_handle:
            _fail(errno.ENOENT)
        del dev_handle.stay.claims[intf]

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """Return False: no kernel driver knows of these devices."""
        if dev_handle.stay.gone.is_set():
            _fail(errno.ENODEV)
        return False

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        """Fail: there is none."""
        _fail(errno.ENOENT)

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        """Fail: there is none."""
        _fail(errno.ENOENT)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """Clear an endpoint's halt."""
        self._ask(dev_handle, 2, 1, 0, ep, 0, b"", 1000)

    def reset_device(self, dev_handle: _Handle) -> None:
        """Reset the device: it keeps its address, and forgets what it was sending."""
        stay = dev_handle.stay
        if stay.gone.is_set():
            _fail(errno.ENODEV)
        stay.device.disconnect()
        stay.device.connect()

    def bulk_write(
        self, dev_handle: _Handle, ep: int, intf: int, data: array[int], timeout: int
    ) -> int:
        """Write to an OUT endpoint; return the bytes written."""
        self._check_claim(dev_handle, intf)
        raw = data.tobytes()
        if error := dev_handle.stay.device.write(ep, raw):
            _fail(error)
        return len(raw)

    def bulk_read(
        self, dev_handle: _Handle, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Read from an IN endpoint into `buff`; `timeout` in ms, 0 for none."""
        self._check_claim(dev_handle, intf)
        ended = threading.Event()
        result: list[tuple[int, bytes]] = []

        def done(error: int, data: bytes) -> None:
            result.append((error, data))
            ended.set()

        device = dev_handle.stay.device
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
        return len(data)

    intr_write = bulk_write
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
        """Send a control request; return the bytes moved."""
        size = len(data) * data.itemsize
        sent = b"" if bmRequestType & IN else data.tobytes()
        setup = (bmRequestType, bRequest, wValue, wIndex, size)
        answer = self._ask(dev_handle, *setup, sent, timeout)
        if not bmRequestType & IN:
            return size
        memoryview(data).cast("B")[: len(answer)] = answer
        return len(answer)

    def _ask(
        self,
        handle: _Handle,
        request_type: int,
        request: int,
        value: int,
        index: int,
        length: int,
        data: bytes,
        timeout: int,
    ) -> bytes:
        stay = handle.stay
        if stay.gone.is_set():
            _fail(errno.ENODEV)
        answer = stay.device.request(request_type, request, value, index, length, data)
        if answer is Refusal.SILENCE:
            is_gone = stay.device.clock.wait_for(stay.gone, _deadline_s(stay.device, timeout))
            _fail(errno.ENODEV if is_gone else errno.ETIMEDOUT)
        if isinstance(answer, Refusal):
            _fail(errno.EPIPE)
        return answer

    def _check_claim(self, handle: _Handle, intf: int) -> None:
        if handle.stay.gone.is_set():
            _fail(errno.ENODEV)
        if handle.stay.claims.get(intf, handle) is not handle:
            _fail(errno.EBUSY)
