"""TCP connections to a camera in the network, and the packets of PTP/IP on them (CIPA DC-005)."""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from camctl.interface.clock import Clock

#: The port that IANA has registered for PTP/IP.
PORT = 15740

HEADER = struct.Struct("<II")  # length with this header, type
# Most bytes of a packet that is no data: the longest, Init_Command_Ack, has 24 and a name of 80
# (CIPA DC-005, 2.3.2); cameras fill up names.
_CONTROL_BYTES = 512
# Bytes of a packet of data before the data: the number of its transaction.
_NUMBER_BYTES = 4
# Bytes of one read, at least and at most: a response often follows in the same read.
_LEAST_READ_BYTES, _CHUNK_BYTES = 4096, 1 << 20
# How long a host may take to accept a connection, s.
_CONNECT_S = 5.0
# Shortest wait for bytes, s: 0 would not look for them at all.
_SHORTEST_WAIT_S = 1e-3
_SWITCH_ON = "switch its network (Wi-Fi or LAN) remote control on, and check the address"


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


class Link(Protocol):
    """A connection; its errors are `OSError`s: `TimeoutError` if nothing came in time."""

    def send(self, data: bytes, timeout_s: float) -> None:
        """Send all bytes."""

    def receive(self, size: int, timeout_s: float) -> bytes:
        """Return up to `size` bytes; b"" if the camera has closed the connection."""

    def close(self) -> None:
        """Close the connection."""


@dataclass(frozen=True)
class Address:
    """Where a camera listens; `str` is the part of the camera id after the colon."""

    host: str
    port: int = PORT

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == PORT else f"{host}:{self.port}"

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the address in ``HOST``, ``HOST:PORT`` or ``[IPV6]:PORT``.

        Raises:
            UsageError: it is none of these
        """
        match = re.fullmatch(r"(?:\[([0-9a-fA-F:.%\w]+)\]|([^\s:\[\]/]+))(?::(\d{1,5}))?", text)
        port = int(match[3] or PORT) if match else 0
        if match is None or not 0 < port <= 0xFFFF:
            raise UsageError(
                f"invalid address of a camera in the network '{text}'",
                hint=f"write ptpip:HOST or ptpip:HOST:PORT, such as ptpip:192.168.1.1:{PORT}",
            )
        return cls(match[1] or match[2], port)


#: Opens one more connection to a camera; its errors are `camctl.errors`.
Connect = Callable[[Address], Link]


class SocketLink:
    """A TCP connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def send(self, data: bytes, timeout_s: float) -> None:
        self._socket.settimeout(timeout_s)
        self._socket.sendall(data)

    def receive(self, size: int, timeout_s: float) -> bytes:
        self._socket.settimeout(max(timeout_s, _SHORTEST_WAIT_S))
        return self._socket.recv(size)

    def close(self) -> None:
        with suppress(OSError):
            self._socket.close()


def connect_socket(address: Address) -> SocketLink:
    """Return a TCP connection to an address.

    Raises:
        CameraNotFoundError: the host is unknown or unreachable, or refuses the connection
    """
    where = f"{address.host}:{address.port}"
    try:
        return SocketLink(socket.create_connection((address.host, address.port), _CONNECT_S))
    except (socket.gaierror, UnicodeError):
        raise CameraNotFoundError(
            f"there is no host '{address.host}' in the network",
            hint="check the name, or give the address that the camera shows in its network menu",
        ) from None
    except ConnectionRefusedError:
        raise CameraNotFoundError(
            f"{where} refuses the connection: no PTP/IP camera listens there", hint=_SWITCH_ON
        ) from None
    except TimeoutError:
        raise CameraNotFoundError(
            f"{where} does not answer for {_CONNECT_S:g} s", hint=_SWITCH_ON
        ) from None
    except OSError as error:
        raise CameraNotFoundError(
            f"{where} cannot be reached: {error.strerror or error}", hint=_SWITCH_ON
        ) from None


def link_error(error: OSError, name: str) -> CameraError:
    """Return the typed error for an error of a connection to the camera `name`."""
    if isinstance(error, TimeoutError):
        return CameraTimeoutError(
            f"{name} does not answer", hint="check its battery and the network, then resume"
        )
    return CameraDisconnectedError(
        f"{name} has ended the network connection ({error.strerror or 'reset'})",
        hint="switch it on and connect it to the network, then resume",
    )


class PacketLink:
    """Sends packets and reassembles received ones, however they are cut.

    Args:
        link: the connection
        name: name of the camera in error messages
        clock: for time-outs

    Attributes:
        heard_s: when the latest bytes came, on the clock
    """

    def __init__(self, link: Link, name: str, clock: Clock) -> None:
        self._link, self.name, self._clock = link, name, clock
        self.heard_s = clock.now()
        self._received = bytearray()

    def send(self, kind: Packet, body: bytes, timeout_s: float) -> None:
        try:
            self._link.send(HEADER.pack(HEADER.size + len(body), kind) + body, timeout_s)
        except OSError as error:
            raise link_error(error, self.name) from None

    def receive(self, silence_s: float, *, data_bytes: int = 0) -> tuple[int, memoryview]:
        """Return type and body of the next packet.

        What has arrived of a packet is kept when `CameraTimeoutError` is raised.

        Args:
            silence_s: how long nothing may come, s
            data_bytes: most bytes of data in a packet; no memory is used for more

        Raises:
            CameraTimeoutError: nothing came for `silence_s`
            CameraDisconnectedError: the camera has closed the connection
            CameraProtocolError: the bytes are no packet
        """
        self._fill(HEADER.size, silence_s)
        length, kind = HEADER.unpack_from(self._received)
        known = Packet.INIT_COMMAND <= kind <= Packet.PONG
        is_data = kind in (Packet.DATA, Packet.END_DATA)
        most = HEADER.size + (_NUMBER_BYTES + data_bytes if is_data else _CONTROL_BYTES)
        if not known or not HEADER.size <= length <= most:
            raise CameraProtocolError(
                f"{self.name} sent bytes that are no PTP/IP packet",
                hint="check that the address belongs to a camera, then try again",
            )
        self._fill(length, silence_s)
        body = bytes(memoryview(self._received)[HEADER.size : length])
        del self._received[:length]
        return kind, memoryview(body)

    def _fill(self, size: int, silence_s: float) -> None:
        while len(self._received) < size:
            missing = size - len(self._received)
            try:
                part = self._link.receive(
                    min(max(missing, _LEAST_READ_BYTES), _CHUNK_BYTES), silence_s
                )
            except OSError as error:
                raise link_error(error, self.name) from None
            if not part:
                raise link_error(ConnectionResetError(0, "closed"), self.name)
            self._received += part
            self.heard_s = self._clock.now()

    def close(self) -> None:
        self._link.close()
