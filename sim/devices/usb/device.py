"""A USB device without a transport: descriptors, endpoint 0, and what waits on its other endpoints.

Endpoints behave as on the bus: a transfer is cut into packets of the endpoint's size, a short or
empty packet ends the host's read, and a read that asks for more than a device sent goes on
waiting where the last packet was a full one.  All of that is in `UsbDevice`; a transport
(`sim.devices.usb.backend`, `sim.devices.usb.vhci`) passes reads, writes and control requests to it.
"""

from __future__ import annotations

import errno
import struct
import threading
from enum import Enum, IntEnum
from typing import Any, Protocol

from camctl.errors import UsageError, unknown_name
from sim.devices.clock import DeviceClock, RealDeviceClock
from sim.devices.usb.endpoints import Pipe, Read, Transfer, endpoints

IN = 0x80


class Speed(IntEnum):
    """Speed of a device, in the numbers of the kernel's `enum usb_device_speed`."""

    LOW = 1
    FULL = 2
    HIGH = 3
    SUPER = 5


class Refusal(Enum):
    """What a control request can be answered with instead of bytes.

    Attributes:
        STALL: the request is refused
        SILENCE: no answer at all, until the host gives up
    """

    STALL = "stall"
    SILENCE = "silence"


STALL = Refusal.STALL
SILENCE = Refusal.SILENCE

Answer = bytes | Refusal


class Port(Protocol):
    """Where a device is plugged in: one side of a transport."""

    def attach(self, device: UsbDevice) -> None:
        """Plug the device in."""

    def detach(self) -> None:
        """Pull the plug; what the host waits for fails with ENODEV."""


class UsbDevice:
    """A USB device; subclasses say what it is and answer what it is asked.

    A subclass sets the four descriptions before `__init__` of this class runs or passes over to
    it, overrides `control`, `received`, `halt_cleared`, `attached` and `detached`, calls `send`,
    `stall` and `flush` from any thread, and defines each of its verbs as a method `do_VERB`.

    Attributes:
        speed: see `Speed`
        device_descriptor: 18 bytes
        configuration_descriptor: with all interfaces and endpoints
        strings: string descriptors from index 1 on are strings[1:]; strings[0] is not used
        zero_length: numbers of the IN endpoints that end a transfer of whole packets with an
            empty one; all of them unless a subclass takes some out
        clock: on which it schedules what it does by itself, and hosts in this process wait
        lock: held while the device is asked or sends; a subclass may use it for its own state
        port: where it is plugged in by `attach`
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
        self.endpoints = tuple(endpoints(self.configuration_descriptor))
        self._pipes = {e.address & 15: Pipe(e.packet) for e in self.endpoints if e.address & IN}
        self.zero_length = set(self._pipes)
        self._halted_out: set[int] = set()
        self._configuration = 0

    # For subclasses to override.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> Answer:
        """Answer a class or vendor request; b"" where the host sends data and it was taken."""
        return STALL

    def received(self, endpoint: int, data: bytes) -> None:
        """Take an OUT transfer; long ones may come in pieces, all but the last of whole packets."""

    def halt_cleared(self, endpoint: int) -> None:
        """Hear that the host has cleared the halt of an endpoint (bit 7 set: IN)."""

    def attached(self) -> None:
        """Hear that it has been plugged in."""

    def detached(self) -> None:
        """Hear that it has been unplugged; queues and halts have been cleared."""

    def state(self) -> dict[str, Any]:
        """Return the settings in force and counters, ready for JSON."""
        return {}

    # For subclasses to call.

    def send(self, endpoint: int, data: bytes) -> None:
        """Queue an IN transfer; empty data is a zero-length packet.  Lost while unplugged."""
        with self.lock:
            if not self.is_attached:
                return
            pipe = self._pipes[endpoint]
            tail = not data or (endpoint in self.zero_length and len(data) % pipe.packet == 0)
            pipe.transfers.append(Transfer(memoryview(data), tail))
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
        """Return how many IN transfers the host has not read to their end."""
        with self.lock:
            return len(self._pipes[endpoint & 15].transfers)

    def flush(self, endpoint: int) -> None:
        """Forget what waits to be read from an IN endpoint."""
        with self.lock:
            self._pipes[endpoint & 15].transfers.clear()

    # For people and tests.

    def attach(self) -> None:
        """Plug it in where it was or is meant to be."""
        if self.port is None:
            raise UsageError("a device without a port", hint="give it one")
        self.port.attach(self)

    def detach(self) -> None:
        """Pull the plug."""
        if self.port is not None:
            self.port.detach()

    def do(self, verb: str, **arguments: Any) -> dict[str, Any]:
        """Do what a verb says: unplug, plug, state, or one of the device's own.

        Raises:
            UsageError: it has no such verb
        """
        work = getattr(self, f"do_{verb}", None)
        if work is None:
            verbs = [name[3:] for name in dir(self) if name.startswith("do_")]
            raise unknown_name("verb", verb, verbs)
        result: dict[str, Any] | None = work(**arguments)
        return result or {}

    def do_unplug(self) -> None:
        """Pull the plug."""
        self.detach()

    def do_plug(self) -> None:
        """Plug it in again."""
        self.attach()

    def do_state(self) -> dict[str, Any]:
        """Return `state`."""
        return self.state()

    # For transports.

    def connect(self) -> None:
        """Say that the host can see the device."""
        with self.lock:
            self.is_attached = True
            self._configuration = 0
        self.attached()

    def disconnect(self) -> None:
        """Say that the host is gone: waiting reads end with ENODEV."""
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
        """Take a read of the host; its `done` is called now or later, once."""
        with self.lock:
            pipe = self._pipes.get(read.endpoint)
            if pipe is None or not self.is_attached:
                read.finish(errno.EPIPE if self.is_attached else errno.ENODEV)
                return
            pipe.reads.append(read)
            pipe.pump()

    def cancel(self, read: Read) -> None:
        """End a read with ECONNRESET and what it has got, unless it is done already."""
        with self.lock:
            pipe = self._pipes.get(read.endpoint)
            if pipe is not None and read in pipe.reads:
                pipe.reads.remove(read)
                read.finish(errno.ECONNRESET)

    def write(self, endpoint: int, data: bytes) -> int:
        """Hand over an OUT transfer; return an errno, 0 for success."""
        with self.lock:
            if not self.is_attached:
                return errno.ENODEV
            if endpoint in self._halted_out:
                return errno.EPIPE
            self.received(endpoint, data)
            return 0

    def request(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> Answer:
        """Answer a control request: standard ones here, all others by `control`.

        For a request with data for the host, at most `length` bytes.
        """
        with self.lock:
            if request_type & 0x60:
                answer = self.control(request_type, request, value, index, length, data)
            else:
                answer = self._standard(request_type, request, value, index)
        return answer[:length] if isinstance(answer, bytes) and request_type & IN else answer

    def _standard(self, request_type: int, request: int, value: int, index: int) -> Answer:
        """Answer a request of USB 2.0, table 9-4."""
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

    def _descriptor(self, kind: int, index: int) -> Answer:
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
