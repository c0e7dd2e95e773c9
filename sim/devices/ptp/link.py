"""PTP/IP packets (CIPA DC-005-2005), and a virtual camera's end of a connection."""

from __future__ import annotations

import struct
import threading
from collections import deque
from enum import IntEnum
from typing import Protocol

from pydantic import Field

from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.ptp.config import PtpConfig

PORT = 15740  # of PTP/IP
HEADER = struct.Struct("<II")  # length with this header, type
GUID_BYTES = 16  # of a host and of a camera
_LARGEST_PACKET = 64 * 1024 + 64  # from the host: no operation takes more
DATA_BYTES = 32 * 1024  # of one data packet


class Packet(IntEnum):
    """Types of packets."""

    INIT_COMMAND = 1
    INIT_COMMAND_ACK = 2
    INIT_EVENT = 3
    INIT_EVENT_ACK = 4
    INIT_FAIL = 5
    COMMAND = 6
    RESPONSE = 7
    EVENT = 8
    START_DATA = 9
    DATA = 10
    CANCEL = 11
    END_DATA = 12
    PING = 13
    PONG = 14


class Failure(IntEnum):
    """Reasons of `Packet.INIT_FAIL`."""

    REJECTED = 1
    BUSY = 2
    UNSPECIFIED = 3


class NetworkConfig(PtpConfig):
    """The options of a virtual camera in the network.

    Attributes:
        port: where it listens on 127.0.0.1; 0: at any free port
        guid: the only host that it accepts, 32 hexadecimal digits; "": any
        chunk_bytes: it sends its bytes in pieces of this size; 0: whole packets
        bytes_per_s: speed of what it sends; 0: unlimited
        ping_s: it sends pings so often, and ends the session if one is not answered; 0: never
    """

    port: int = Field(default=0, ge=0, le=0xFFFF)
    guid: str = Field(default="", pattern=r"^([0-9a-f]{32})?$")
    chunk_bytes: int = Field(default=0, ge=0)
    bytes_per_s: float = Field(default=0.0, ge=0)
    ping_s: float = Field(default=0.0, ge=0)


class Wire(Protocol):
    """The host's end of a connection."""

    def deliver(self, data: bytes) -> None:
        """Pass bytes to the host."""

    def end(self, *, is_reset: bool) -> None:
        """Close the connection, properly or by a reset."""


class Listener(Protocol):
    """What a connection needs of its camera; see `camctl.sim.devices.ptp.network.NetworkCamera`."""

    lock: threading.RLock
    clock: DeviceClock
    config: NetworkConfig
    is_silent: bool
    is_attached: bool

    def accept(self, wire: Wire) -> Connection:
        """Return the camera's end of a new connection."""

    def process(self, connection: Connection, kind: int, body: bytes) -> None:
        """Process a packet of the host."""

    def connection_lost(self, connection: Connection) -> None:
        """Process the end of a connection."""


class Connection:
    """One connection of a host, at the camera's end."""

    def __init__(self, camera: Listener, wire: Wire) -> None:
        self.camera, self.wire = camera, wire
        self.kind: Packet | None = None  # INIT_COMMAND or INIT_EVENT
        self.is_open = True
        self._received = bytearray()
        self._waiting: deque[bytes] = deque()

    def received(self, data: bytes) -> None:
        """Process bytes of the host."""
        with self.camera.lock:
            self._received += data
            while self.is_open and len(self._received) >= HEADER.size:
                length, kind = HEADER.unpack_from(self._received)
                if not HEADER.size <= length <= _LARGEST_PACKET:
                    self.close(is_reset=True)
                    return
                if len(self._received) < length:
                    return
                body = bytes(self._received[HEADER.size : length])
                del self._received[:length]
                if not self.camera.is_silent:
                    self.camera.process(self, kind, body)

    def send(self, kind: Packet, body: bytes = b"") -> None:
        self.send_bytes(HEADER.pack(HEADER.size + len(body), kind) + body)

    def send_bytes(self, data: bytes) -> None:
        """Send bytes, in pieces and slowly if the camera's options say so."""
        config = self.camera.config
        if self.camera.is_silent or not self.is_open:
            return
        if not config.chunk_bytes and not config.bytes_per_s:
            self.wire.deliver(data)
            return
        size = config.chunk_bytes or DATA_BYTES
        is_idle = not self._waiting
        self._waiting += [data[at : at + size] for at in range(0, len(data), size)]
        if is_idle:
            self._send_next()

    def _send_next(self) -> None:
        """Send the first waiting piece, and the next one when that has been transferred."""
        with self.camera.lock:
            if not self._waiting or not self.is_open:
                return
            piece, config = self._waiting[0], self.camera.config
            self.wire.deliver(piece)
            duration_s = len(piece) / config.bytes_per_s if config.bytes_per_s else 0.0
            self.camera.clock.call_at(self.camera.clock.now() + duration_s, self._sent)

    def _sent(self) -> None:
        with self.camera.lock:
            if self._waiting:
                self._waiting.popleft()
        self._send_next()

    def close(self, *, is_reset: bool = False) -> None:
        """Close the connection from the camera's side."""
        if self.is_open:
            self.is_open = False
            self.wire.end(is_reset=is_reset)

    def lost(self) -> None:
        with self.camera.lock:
            self.is_open = False
            self.camera.connection_lost(self)
