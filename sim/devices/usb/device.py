"""A USB device without a transport: descriptors, control requests, bulk and interrupt endpoints.

Endpoints behave as on the bus: a transfer is cut into packets of the endpoint's size, and a short
or empty packet ends the host's read.  A read for more bytes than the device has sent goes on
waiting if the last packet was a full one.  A transport such as `camctl.sim.devices.usb.vhci` passes
the host's reads, writes and control requests to the device.
"""

from __future__ import annotations

import errno
import struct
import threading
from enum import Enum, IntEnum
from typing import Protocol

from camctl.errors import UsageError
from camctl.sim.devices.clock import DeviceClock, RealDeviceClock
from camctl.sim.devices.common import Controllable
from camctl.sim.devices.usb.endpoints import Pipe, Read, Transfer, parse_configuration

IN = 0x80  # bit of an address: to the host (USB 2.0, 9.6.6)


class Speed(IntEnum):
    """Speed of a device, as numbered by the kernel's `enum usb_device_speed`."""

    LOW = 1
    FULL = 2
    HIGH = 3
    SUPER = 5


class ControlFailure(Enum):
    """How a control request fails.

    Attributes:
        STALL: the device refuses the request
        NO_REPLY: the device does not reply until the host gives up
    """

    STALL = "stall"
    NO_REPLY = "no reply"


STALL = ControlFailure.STALL
NO_REPLY = ControlFailure.NO_REPLY

ControlReply = bytes | ControlFailure


class Port(Protocol):
    """A port of a transport, which one device is plugged into."""

    def attach(self, device: UsbDevice) -> None:
        """Plug the device in."""

    def detach(self) -> None:
        """Unplug the device; what the host waits for fails with ENODEV."""


class UsbDevice(Controllable):
    """A USB device; a subclass adds its descriptors and its behaviour.

    A subclass sets `speed`, both descriptors and `strings` before it calls `__init__` of this
    class.  It overrides `control`, `received`, `halt_cleared`, `attached` and `detached`, and may
    call `send`, `stall` and `flush` from any thread.

    Args:
        port: where `attach` plugs it in
        clock: on which it schedules what it does by itself, and on which a host in this process
            waits; real time if not given

    Attributes:
        port, clock: as given
        speed: see `Speed`
        device_descriptor: 18 bytes
        configuration_descriptor: with all interfaces and endpoints
        strings: string descriptors by index; index 0 is not used
        zero_length: numbers of the IN endpoints that end a transfer of whole packets with an
            empty packet; a subclass may remove some
        lock: held in each call from a transport and while the device sends; a subclass may use it
            for its own state
    """

    speed: Speed = Speed.HIGH
    device_descriptor: bytes
    configuration_descriptor: bytes
    strings: tuple[str, ...] = ("",)

    def __init__(self, port: Port | None = None, clock: DeviceClock | None = None) -> None:
        self.lock = threading.RLock()
        self.clock = clock if clock is not None else RealDeviceClock()
        self.port = port
        self.is_attached = False
        self._pipes = {
            each["bEndpointAddress"] & 15: Pipe(each["wMaxPacketSize"] & 0x7FF)
            for each in parse_configuration(self.configuration_descriptor).endpoints()
            if each["bEndpointAddress"] & IN
        }
        self.zero_length = set(self._pipes)
        self._halted_out: set[int] = set()
        self._configuration = 0

    # A subclass overrides these.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        """Return the reply to a class or vendor request; b"" accepts data from the host."""
        return STALL

    def received(self, endpoint: int, data: bytes) -> None:
        """Process an OUT transfer; a long one may come in pieces of whole packets."""

    def halt_cleared(self, endpoint: int) -> None:
        """Called when the host has cleared the halt of an endpoint (bit 7 set: IN)."""

    def attached(self) -> None:
        """Called when the device has been plugged in."""

    def detached(self) -> None:
        """Called when the device has been unplugged; queues and halts are cleared already."""

    # A subclass calls these.

    def send(self, endpoint: int, data: bytes) -> None:
        """Queue an IN transfer; empty data is an empty packet.  Lost while unplugged."""
        with self.lock:
            if not self.is_attached:
                return
            pipe = self._pipes[endpoint]
            is_whole = len(data) % pipe.packet == 0
            has_empty_packet = not data or (endpoint in self.zero_length and is_whole)
            pipe.transfers.append(Transfer(memoryview(data), has_empty_packet))
            pipe.pump()

    def stall(self, endpoint: int) -> None:
        """Halt an endpoint (bit 7 set: IN) until the host clears it."""
        with self.lock:
            if endpoint & IN:
                pipe = self._pipes[endpoint & 15]
                pipe.is_halted = True
                pipe.pump()
            else:
                self._halted_out.add(endpoint)

    def pending(self, endpoint: int) -> int:
        """Return how many IN transfers the host has not read completely."""
        with self.lock:
            return len(self._pipes[endpoint & 15].transfers)

    def flush(self, endpoint: int) -> None:
        """Discard what has been sent to an IN endpoint and not been read."""
        with self.lock:
            self._pipes[endpoint & 15].transfers.clear()

    def attach(self) -> None:
        if self.port is None:
            raise UsageError("the virtual device has no port", hint="set device.port")
        self.port.attach(self)

    def detach(self) -> None:
        if self.port is not None:
            self.port.detach()

    # A transport calls these.

    def connect(self) -> None:
        """Begin to answer a host."""
        with self.lock:
            self.is_attached = True
            self._configuration = 0
        self.attached()

    def disconnect(self) -> None:
        """End all waiting reads with ENODEV: the host is no longer connected."""
        with self.lock:
            if not self.is_attached:
                return
            self.is_attached = False
            self._halted_out.clear()
            for pipe in self._pipes.values():
                pipe.transfers.clear()
                pipe.is_halted = False
                while pipe.reads:
                    pipe.reads.popleft().finish(errno.ENODEV)
        self.detached()

    def read(self, read: Read) -> None:
        """Begin a read of the host; its `done` is called once, now or later."""
        with self.lock:
            pipe = self._pipes.get(read.endpoint)
            if pipe is None or not self.is_attached:
                read.finish(errno.EPIPE if self.is_attached else errno.ENODEV)
                return
            pipe.reads.append(read)
            pipe.pump()

    def cancel(self, read: Read) -> None:
        """End a read with ECONNRESET and the bytes it has, unless it has ended already."""
        with self.lock:
            pipe = self._pipes.get(read.endpoint)
            if pipe is not None and read in pipe.reads:
                pipe.reads.remove(read)
                read.finish(errno.ECONNRESET)

    def write(self, endpoint: int, data: bytes) -> int:
        """Pass an OUT transfer to the device; return an errno, 0 for success."""
        with self.lock:
            if not self.is_attached:
                return errno.ENODEV
            if endpoint in self._halted_out:
                return errno.EPIPE
            self.received(endpoint, data)
            return 0

    def request(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        """Return the reply to a control request; at most `length` bytes of data for the host."""
        with self.lock:
            if request_type & 0x60:
                reply = self.control(request_type, request, value, index, length, data)
            else:
                reply = self._standard(request_type, request, value, index)
        return reply[:length] if isinstance(reply, bytes) and request_type & IN else reply

    def _standard(self, request_type: int, request: int, value: int, index: int) -> ControlReply:
        match request_type, request:
            case (0x80, 6):
                return self._descriptor(value >> 8, value & 0xFF)
            case (0x80 | 0x81, 0):
                return b"\0\0"
            case (0x82, 0):
                return bytes([self._is_halted(index), 0])
            case (0x80, 8):
                return bytes([self._configuration])
            case (0x81, 10):
                return b"\0"
            case (0, 9):
                self._configuration = value
                return b""
            case (0x02, 1):
                self._clear_halt(index)
                return b""
            case (0x02, 3):
                self.stall(index)
                return b""
            case (0 | 1, 1 | 3 | 11):
                return b""
        return STALL

    def _is_halted(self, endpoint: int) -> bool:
        if endpoint & IN and endpoint & 15 in self._pipes:
            return self._pipes[endpoint & 15].is_halted
        return endpoint in self._halted_out

    def _clear_halt(self, endpoint: int) -> None:
        if endpoint & IN and endpoint & 15 in self._pipes:
            self._pipes[endpoint & 15].is_halted = False
        self._halted_out.discard(endpoint)
        self.halt_cleared(endpoint)

    def _descriptor(self, kind: int, index: int) -> ControlReply:
        match kind:
            case 1:
                return self.device_descriptor
            case 2 if index == 0:
                return self.configuration_descriptor
            case 3 if index == 0:
                return b"\x04\x03\x09\x04"  # English (United States)
            case 3 if index < len(self.strings):
                text = self.strings[index].encode("utf-16-le")[:252]
                return struct.pack("<BB", 2 + len(text), 3) + text
        return STALL
