"""The control protocol of GigE Vision (GVCP): packets, privilege and heartbeat.

Numbers are from "GigE Vision", version 2.0: packets from chapters 16 to 18, registers from 27.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from typing import Protocol, TypeAlias

from camctl.interface.clock import Clock

PORT = 3956
DISCOVERY, RESEND, READ_REGISTER, WRITE_REGISTER = 0x02, 0x40, 0x80, 0x82
READ_MEMORY, WRITE_MEMORY = 0x84, 0x86

#: Status of an acknowledgement.
OK, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0x0000, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, ACCESS_DENIED, BUSY = 0x8004, 0x8006, 0x8007

PRIVILEGE, HEARTBEAT = 0xA00, 0x938  # registers
_EXCLUSIVE, _CONTROL = 1, 2  # bits of the privilege
_COMMAND, _ACK_REQUIRED = 0x42, 0x01
_LARGEST_DATA = 536  # bytes of a command or an acknowledgement
_POLL_S = 0.02  # how often the heartbeat is looked at

Address: TypeAlias = tuple[str, int]


class ControlledDevice(Protocol):
    """What the control channel reads and writes."""

    def discovery(self) -> bytes:
        """Return the first 248 bytes of the bootstrap registers."""

    def read(self, address: int, size: int) -> bytes | int:
        """Return the bytes at an address, or the status of a refusal."""

    def write(self, address: int, data: bytes) -> int:
        """Write bytes at an address; return the status."""

    def resend(self, block: int, first: int, last: int) -> None:
        """Send packets of a frame again."""

    def control_lost(self) -> None:
        """Stop: the controller is gone."""


class ControlChannel:
    """Answers the commands that arrive at a device's control port, in a thread of its own.

    Args:
        device: what is controlled
        ip: address of the device, one of this machine
        clock: of the heartbeat

    Attributes:
        heartbeat_s: silence of the controller after which it has lost control
        counts: of commands that were answered, by command
    """

    def __init__(self, device: ControlledDevice, ip: str, clock: Clock) -> None:
        self._device = device
        self._ip = ip
        self._clock = clock
        self._controller: Address | None = None
        self._privilege = 0
        self._silent_s = 0.0
        self.heartbeat_s = 3.0
        self.is_silent = False
        self.counts: dict[int, int] = {}
        self._sockets: list[socket.socket] = []
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Listen at the device's address, and for discovery at the broadcast addresses.

        Raises:
            OSError: the port is taken
        """
        self._sockets = [_bound(self._ip)]
        for broadcast in ("255.255.255.255", "127.255.255.255"):
            with contextlib.suppress(OSError):  # another device may have it for itself
                self._sockets.append(_bound(broadcast))
        self._is_over.clear()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Answer nothing any more."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        for each in self._sockets:
            each.close()
        self._sockets.clear()
        self.release()

    def release(self) -> None:
        """Take control away from the controller."""
        had_control = self._controller is not None
        self._controller, self._privilege = None, 0
        if had_control:
            self._device.control_lost()

    @property
    def controller(self) -> Address | None:
        """The address of the application in control."""
        return self._controller

    def _run(self) -> None:
        before_s = self._clock.now()
        while not self._is_over.is_set():
            ready, _, _ = select.select(self._sockets, [], [], _POLL_S)
            now_s = self._clock.now()
            # A computer that stops everything for a while stops the controller, too.
            self._silent_s += min(now_s - before_s, 5 * _POLL_S)
            before_s = now_s
            for each in ready:
                packet, sender = each.recvfrom(_LARGEST_DATA + 8)
                if not self.is_silent:
                    self._handle(packet, sender)
            if self._controller is not None and self._silent_s > self.heartbeat_s:
                self.release()

    def _handle(self, packet: bytes, sender: Address) -> None:
        if len(packet) < 8 or packet[0] != _COMMAND:
            return
        flags, command, size, number = struct.unpack_from(">BHHH", packet, 1)
        data = packet[8 : 8 + size]
        if sender == self._controller:
            self._silent_s = 0.0
        self.counts[command] = self.counts.get(command, 0) + 1
        if command == RESEND:
            _, block, first, last = struct.unpack_from(">HHII", data)
            self._device.resend(block, first & 0xFFFFFF, last & 0xFFFFFF)
            return
        status, reply = self._reply(command, data, sender)
        if flags & _ACK_REQUIRED:
            header = struct.pack(">HHHH", status, command + 1, len(reply), number)
            with contextlib.suppress(OSError):
                self._sockets[0].sendto(header + reply, sender)

    def _reply(self, command: int, data: bytes, sender: Address) -> tuple[int, bytes]:
        """Return the status of a command, and the data of its acknowledgement."""
        if command == DISCOVERY:
            return OK, self._device.discovery()
        if command == READ_REGISTER:
            found = b""
            for (address,) in struct.iter_unpack(">I", data):
                value = self._read(address, 4)
                if isinstance(value, int):
                    return value, b""
                found += value
            return OK, found
        if command == READ_MEMORY:
            address, count = struct.unpack(">IxxH", data)
            memory = self._read(address, count)
            return (memory, b"") if isinstance(memory, int) else (OK, data[:4] + memory)
        if command == WRITE_REGISTER:
            done = 0
            for address, word in struct.iter_unpack(">I4s", data):
                status = self._write(address, word, sender)
                if status != OK:
                    return status, struct.pack(">HH", 0, done)
                done += 1
            return OK, struct.pack(">HH", 0, done)
        if command == WRITE_MEMORY:
            (address,) = struct.unpack_from(">I", data)
            return self._write(address, data[4:], sender), struct.pack(">HH", 0, len(data) - 4)
        return NOT_IMPLEMENTED, b""

    def _read(self, address: int, size: int) -> bytes | int:
        if address == PRIVILEGE:
            return struct.pack(">I", self._privilege)
        if address == HEARTBEAT:
            return struct.pack(">I", round(self.heartbeat_s * 1000))
        return self._device.read(address, size)

    def _write(self, address: int, data: bytes, sender: Address) -> int:
        if self._controller not in (None, sender):
            return ACCESS_DENIED
        if address == PRIVILEGE:
            (self._privilege,) = struct.unpack(">I", data)
            if self._privilege & (_EXCLUSIVE | _CONTROL):
                self._controller, self._silent_s = sender, 0.0
            else:
                self.release()
            return OK
        if self._controller is None:
            return ACCESS_DENIED
        if address == HEARTBEAT:
            self.heartbeat_s = struct.unpack(">I", data)[0] / 1000
            return OK
        return self._device.write(address, data)


def _bound(ip: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((ip, PORT))
    except OSError:
        made.close()
        raise
    return made
