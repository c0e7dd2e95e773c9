"""A PTP still camera in the network: PTP/IP, the packets of CIPA DC-005-2005.

A host opens two connections to one port: the first for commands and data, the second for events,
pings and cancellations.  `TcpPort` has the sockets.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from camctl.errors import UsageError
from camctl.sim.devices.clock import DeviceClock, RealDeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.ptp.device import Command, PtpDevice, identity_of
from camctl.sim.devices.ptp.link import (
    DATA_BYTES,
    GUID_BYTES,
    HEADER,
    Connection,
    Failure,
    NetworkConfig,
    Packet,
    Wire,
)
from camctl.sim.devices.ptp.protocol import Reply, Response, pack_parameters

HOST = "127.0.0.1"
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: closing a socket resets its connection


class NetworkCamera(PtpDevice):
    """The camera in the network; `make` builds one from a configuration.

    Args:
        config: see `NetworkConfig`
        sensor: what is exposed
        clock: on which it times exposures and transfers; real time if not given

    Attributes:
        is_silent: it receives and answers nothing, and keeps its connections open
        port: where it listens while it is switched on; None: hosts are in this process alone
    """

    config: NetworkConfig

    def __init__(
        self, config: NetworkConfig, sensor: VirtualSensor, clock: DeviceClock | None = None
    ) -> None:
        self.lock = threading.RLock()
        self.clock = clock if clock is not None else RealDeviceClock()
        self.make_body(config, sensor)
        self.is_silent = False
        self.is_attached = True
        self.port: TcpPort | None = None
        self._commands: Connection | None = None
        self._events: Connection | None = None
        self._data = bytearray()
        self._number = 0
        self._pongs = 0

    def listen(self) -> TcpPort:
        """Make its port, which the next attaching opens; until then the camera is switched off."""
        self.port, self.is_attached = TcpPort(self.config.port, self.accept), False
        return self.port

    def accept(self, wire: Wire) -> Connection:
        return Connection(self, wire)

    # What the host sends.

    def process(self, connection: Connection, kind: int, body: bytes) -> None:
        if connection.kind is None:
            self._initialise(connection, kind, body)
        elif kind == Packet.PING:
            connection.send(Packet.PONG)
        elif kind == Packet.PONG:
            self._pongs += 1
        elif kind == Packet.CANCEL and len(body) >= 4:
            self._cancel(int.from_bytes(body[:4], "little"))
        elif connection is not self._commands:
            connection.close(is_reset=True)
        elif kind == Packet.COMMAND and len(body) >= 10:
            _, code, transaction = struct.unpack_from("<IHI", body)
            self._data.clear()
            count = (len(body) - 10) // 4
            self.begin_command(code, transaction, struct.unpack_from(f"<{count}I", body, 10))
        elif kind == Packet.START_DATA:
            self._data.clear()
        elif kind in (Packet.DATA, Packet.END_DATA) and len(body) >= 4:
            self._data += body[4:]
            if kind == Packet.END_DATA:
                self.take_data(bytes(self._data))
        else:
            connection.close(is_reset=True)

    def _initialise(self, connection: Connection, kind: int, body: bytes) -> None:
        if kind == Packet.INIT_COMMAND and len(body) >= GUID_BYTES + 2 + 4:
            if self.config.guid and body[:GUID_BYTES].hex() != self.config.guid:
                self._refuse(connection, Failure.REJECTED)
            elif self._commands is not None:
                self._refuse(connection, Failure.BUSY)
            else:
                self._commands, connection.kind = connection, Packet.INIT_COMMAND
                self._number += 1
                name = identity_of(self.config).model.encode("utf-16-le") + b"\0\0"
                head = self._number.to_bytes(4, "little") + bytes(range(GUID_BYTES))
                version = 0x0001_0000.to_bytes(4, "little")
                connection.send(Packet.INIT_COMMAND_ACK, head + name + version)
        elif kind == Packet.INIT_EVENT and body[:4] == self._number.to_bytes(4, "little"):
            self._events, connection.kind = connection, Packet.INIT_EVENT
            connection.send(Packet.INIT_EVENT_ACK)
            self._ping_later()
        else:
            self._refuse(connection, Failure.UNSPECIFIED)

    def _refuse(self, connection: Connection, reason: Failure) -> None:
        connection.send(Packet.INIT_FAIL, reason.to_bytes(4, "little"))
        connection.close()

    def _cancel(self, transaction: int) -> None:
        command = self.drop_command()
        if command is not None and self._commands is not None:
            body = struct.pack("<HI", Response.TRANSACTION_CANCELLED, transaction)
            self._commands.send(Packet.RESPONSE, body)

    def _ping_later(self) -> None:
        if not self.config.ping_s:
            return
        events, pongs = self._events, self._pongs

        def check() -> None:
            with self.lock:
                if events is not self._events or events is None:
                    return
                if pongs == self._pongs:
                    self.end_session(is_reset=False)
                else:
                    self._ping_later()

        if events is not None:
            events.send(Packet.PING)
            self.clock.call_at(self.clock.now() + self.config.ping_s, check)

    def connection_lost(self, connection: Connection) -> None:
        """End the session if one of its connections was closed."""
        if connection in (self._commands, self._events):
            self.end_session(is_reset=False)

    def end_session(self, *, is_reset: bool) -> None:
        """Close both connections and the session; a running exposure continues."""
        self.drop_command()
        self.responder.close_session()
        connections, self._commands, self._events = (self._commands, self._events), None, None
        for each in connections:
            if each is not None:
                each.close(is_reset=is_reset)

    # What the camera sends.

    def send_event(self, code: int, parameters: Sequence[int]) -> None:
        if self._events is not None:
            body = struct.pack("<HI", code, 0) + pack_parameters(parameters)
            self._events.send(Packet.EVENT, body)

    def send_bytes(self, data: bytes) -> None:
        if self._commands is not None:
            self._commands.send_bytes(data)

    def refuse_transfers(self) -> None:
        """Reset the connections: a network has no stalls."""
        self.end_session(is_reset=True)

    def send_reply(self, command: Command, reply: Reply) -> None:
        if self._commands is None:
            return
        if reply.data is not None and not self._send_data(self._commands, command, reply.data):
            return
        if self._commands is not None:
            body = struct.pack("<HI", reply.code, command.transaction)
            self._commands.send(Packet.RESPONSE, body + pack_parameters(reply.parameters))
        if reply.sent is not None:
            reply.sent()

    def _send_data(self, connection: Connection, command: Command, data: bytes) -> bool:
        """Send a data phase; return whether a response follows."""
        number = command.transaction.to_bytes(4, "little")
        connection.send(Packet.START_DATA, number + len(data).to_bytes(8, "little"))
        if command.is_of_object and self.faults.unplug_after is not None:
            limit, self.faults.unplug_after = self.faults.unplug_after, None
            packet = HEADER.pack(HEADER.size + 4 + len(data), Packet.END_DATA) + number + data
            connection.send_bytes(packet[:limit])
            self.clock.call_at(self.clock.now(), self.detach)
            return False
        half = self.cut_object(command, data)
        if half is not None:
            data = half
        for at in range(0, max(len(data), 1), DATA_BYTES):
            part = data[at : at + DATA_BYTES]
            is_last = at + DATA_BYTES >= len(data) and (
                half is None or self.faults.answers_truncated
            )
            connection.send(Packet.END_DATA if is_last else Packet.DATA, number + part)
        return half is None or self.faults.answers_truncated

    # Control commands.

    def attach(self) -> None:
        self.is_attached = True
        if self.port is not None:
            self.port.open()

    def detach(self) -> None:
        """Switch it off: its connections are reset, and new ones refused."""
        with self.lock:
            self.is_attached = False
            self.end_session(is_reset=True)
        if self.port is not None:
            self.port.close()

    def state(self) -> dict[str, Any]:
        return {"port": self.port.number if self.port else 0, **super().state()}

    def do_reset(self) -> None:
        """Reset the connections; the camera stays in the network."""
        with self.lock:
            self.end_session(is_reset=True)

    def do_silence(self, is_silent: bool = True) -> None:
        """Leave the connections open and let nothing pass through them, as without radio."""
        self.is_silent = is_silent

    def do_ok(self) -> None:
        super().do_ok()
        self.is_silent = False


class TcpPort:
    """Where a camera listens on 127.0.0.1 while it is switched on.

    Args:
        number: of the port; 0: the first opening chooses a free one
        accept: returns the camera's end of a new connection
    """

    def __init__(self, number: int, accept: Callable[[Wire], Connection]) -> None:
        self.number, self._accept_wire = number, accept
        self._listener: socket.socket | None = None

    def open(self) -> None:
        """Listen.

        Raises:
            UsageError: the port is in use
        """
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, self.number))
        except OSError as error:
            listener.close()
            raise UsageError(
                f"port {self.number} of {HOST} cannot be opened: {error.strerror}",
                hint="choose another port, or 0 for any",
            ) from None
        listener.listen()
        self.number = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def close(self) -> None:
        """Refuse new connections."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
            listener.close()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                link, _ = listener.accept()
            except OSError:
                return
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection = self._accept_wire(_Socket(link))
            threading.Thread(target=_read, args=(link, connection), daemon=True).start()


class _Socket:
    def __init__(self, link: socket.socket) -> None:
        self._link = link

    def deliver(self, data: bytes) -> None:
        with suppress(OSError):  # the thread that reads notices it, too
            self._link.sendall(data)

    def end(self, *, is_reset: bool) -> None:
        with suppress(OSError):
            if is_reset:
                self._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            # The thread that reads is woken by this, and closes the socket.
            self._link.shutdown(socket.SHUT_RD if is_reset else socket.SHUT_RDWR)


def _read(link: socket.socket, connection: Connection) -> None:
    """Pass on what a host sends until it closes the connection."""
    with link, suppress(OSError):
        while data := link.recv(1 << 16):
            connection.received(data)
    connection.lost()


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> NetworkCamera:
    """Return the camera of a configuration (`NetworkConfig`); `attach` lets it listen."""
    options = NetworkConfig.parse(config)
    camera = NetworkCamera(options, options.load_picture_sensor(), clock)
    camera.listen()
    return camera
