"""PTP/IP (CIPA DC-005-2005): the transactions of PTP over two TCP connections to one port.

The first connection carries commands, data and responses; the second carries events, pings and
cancellations.  Either side may ask with a ping whether the other is there.
"""

from __future__ import annotations

import logging
import struct
import uuid
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from socket import gethostname

from camctl.drivers.ptp.network_link import Address, Connect, Packet, PacketLink
from camctl.drivers.ptp.transport import (
    DATA,
    EVENT,
    MAX_STALE_CONTAINERS,
    NORMAL_S,
    RESPONSE,
    Container,
    IncompleteDataError,
)
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.clock import Clock

_GUID_BYTES = 16  # of a computer and of a camera
_HAS_NO_DATA_OUT, _HAS_DATA_OUT = 1, 2  # of a command
_UNKNOWN_SIZE = 0xFFFF_FFFF_FFFF_FFFF  # of a data phase
_OUT_BYTES = 1 << 16  # of one data packet from here
# After so long without a byte the camera is asked whether it is still there, and it counts as
# disconnected after as long without an answer, if it has answered before.
_PING_S = 5.0
# How long a camera may take to answer the cancellation of a transaction.
_RECOVERY_S = 5.0
_POLL_S = 1e-3
# Reasons of a refused connection.
_REJECTED, _BUSY = 1, 2

_log = logging.getLogger(__name__)


def guid_of_this_computer() -> bytes:
    """Return the number by which cameras recognise this computer: always the same."""
    return uuid.uuid5(uuid.NAMESPACE_DNS, f"camctl.{gethostname()}").bytes


@dataclass(frozen=True)
class Caller:
    """How this computer introduces itself to a camera: number and name."""

    guid: bytes
    name: str = "camctl"


class NetworkTransport:
    """The two connections to one camera.

    Args:
        address: where it listens
        connect: opens a connection
        caller: who this computer is
        clock: for time-outs; reads wait in the system

    Attributes:
        silence_s: how long the camera may send nothing
        name: name of the camera in error messages

    Raises:
        CameraNotFoundError: nothing listens there
        CameraBusyError: another computer uses the camera
        CameraError: it refuses this computer, or is no PTP/IP camera
    """

    def __init__(self, address: Address, connect: Connect, caller: Caller, clock: Clock) -> None:
        self._address, self._connect = address, connect
        self._caller, self._clock = caller, clock
        self.silence_s = NORMAL_S
        self.name = f"the camera at {address.host}:{address.port}"
        self._open()

    # ---- the connections

    def _open(self) -> None:
        self._queue: deque[Container] = deque()
        self._is_valid = True
        self._limit = 0  # bytes of data that the transaction in progress may bring
        # A missing answer to a ping means something only if the camera answers pings at all.
        self._pongs = self._unanswered = 0
        self._commands = self._link()
        try:
            number = self._introduce()
            self._events = self._link()
            try:
                self._events.send(Packet.INIT_EVENT, number, self.silence_s)
                self._answer(self._events, Packet.INIT_EVENT_ACK)
                self._events.send(Packet.PING, b"", self.silence_s)
            except BaseException:
                self._events.close()
                raise
        except BaseException:
            self._commands.close()
            raise

    def _link(self) -> PacketLink:
        return PacketLink(self._connect(self._address), self.name, self._clock)

    def _introduce(self) -> bytes:
        """Begin the first connection; return its number, which the second one must state."""
        name = self._caller.name.encode("utf-16-le") + b"\0\0"
        body = self._caller.guid + name + 0x0001_0000.to_bytes(4, "little")
        self._commands.send(Packet.INIT_COMMAND, body, self.silence_s)
        answer = self._answer(self._commands, Packet.INIT_COMMAND_ACK)
        model = bytes(answer[4 + _GUID_BYTES :]).decode("utf-16-le", "replace").partition("\0")[0]
        model = "".join(each for each in model if each.isprintable()).strip()
        if model:
            self.name = f"{model} at {self._address.host}:{self._address.port}"
            self._commands.name = self.name
        return bytes(answer[:4])

    def _answer(self, link: PacketLink, expected: Packet) -> memoryview:
        """Return the body of the answer to the first packet on a connection."""
        where = f"{self._address.host}:{self._address.port}"
        try:
            try:
                kind, body = link.receive(min(_PING_S, self.silence_s))
            except CameraTimeoutError:
                if self.silence_s <= _PING_S:
                    raise
                self._say_silent(_PING_S)
                kind, body = link.receive(self.silence_s - _PING_S)
        except CameraTimeoutError:
            raise CameraTimeoutError(
                f"{where} accepts the connection and sends no PTP/IP answer",
                hint="accept the connection on the camera's display, if it asks; else no camera "
                "listens there",
            ) from None
        except (CameraDisconnectedError, CameraProtocolError):
            raise CameraProtocolError(
                f"{where} is not a PTP/IP camera: its first answer is none of that protocol",
                hint="check the address and the port",
            ) from None
        if kind == Packet.INIT_FAIL:
            reason = int.from_bytes(body[:4], "little")
            if reason == _BUSY:
                raise CameraBusyError(
                    f"{self.name} is in use by another computer or program",
                    hint="disconnect that one, and try again",
                )
            known = reason == _REJECTED
            raise CameraError(
                f"{self.name} refuses this computer"
                + (f" (GUID {self._caller.guid.hex()})" if known else f" (reason {reason})"),
                hint="pair this computer in the camera's network menu, or give the GUID of one "
                "that is paired, 32 hexadecimal digits",
                remedies={"option:guid": None},
            )
        if kind != expected:
            raise CameraProtocolError(
                f"{where} answers with a packet of type {kind}", hint="check the address"
            )
        return body

    def close(self) -> None:
        self._events.close()
        self._commands.close()

    # ---- sending

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        phase = _HAS_NO_DATA_OUT if data is None else _HAS_DATA_OUT
        body = struct.pack(f"<IHI{len(parameters)}I", phase, operation, transaction, *parameters)
        self._commands.send(Packet.COMMAND, body, self.silence_s)
        if data is None:
            return
        number = transaction.to_bytes(4, "little")
        size = len(data).to_bytes(8, "little")
        self._commands.send(Packet.START_DATA, number + size, self.silence_s)
        for at in range(0, max(len(data), 1), _OUT_BYTES):
            is_last = at + _OUT_BYTES >= len(data)
            kind = Packet.END_DATA if is_last else Packet.DATA
            self._commands.send(kind, number + data[at : at + _OUT_BYTES], self.silence_s)

    # ---- receiving

    def receive(self, transaction: int, *, limit: int) -> Container:
        for _ in range(MAX_STALE_CONTAINERS):
            container = self._container(limit)
            if container.transaction == transaction:
                return container
            if container.transaction > transaction:
                break
        raise self._invalid(f"an answer to transaction {container.transaction}")

    def _container(self, limit: int) -> Container:
        self._limit = limit
        kind, body = self._packet()
        if kind == Packet.RESPONSE and len(body) >= 6:
            code, number = struct.unpack_from("<HI", body)
            return Container(RESPONSE, code, number, bytes(body[6:]))
        if kind != Packet.START_DATA or len(body) < 8:
            raise self._invalid(f"a packet of type {kind}")
        number = int.from_bytes(body[:4], "little")
        size = int.from_bytes(body[4:12], "little")  # of 8 bytes, in some cameras of 4
        if size > limit and size not in (_UNKNOWN_SIZE, 0xFFFF_FFFF):
            raise self._invalid(f"{size} bytes of data")
        parts: list[memoryview] = []
        received = 0
        while kind != Packet.END_DATA:
            kind, body = self._packet(limit - received)
            if kind == Packet.RESPONSE and len(body) >= 6:
                return self._incomplete(received, size)
            if kind not in (Packet.DATA, Packet.END_DATA) or len(body) < 4:
                raise self._invalid(f"a packet of type {kind} among data")
            parts.append(body[4:])
            received += len(body) - 4
        if size not in (received, _UNKNOWN_SIZE, 0xFFFF_FFFF):
            self._incomplete(received, size)
        return Container(DATA, 0, number, b"".join(parts))

    def _incomplete(self, received: int, size: int) -> Container:
        raise IncompleteDataError(
            f"{self.name} sent {received} of {size} bytes of data", hint="try again"
        )

    def _packet(self, data_bytes: int = 0) -> tuple[int, memoryview]:
        """Return the next packet of commands; meanwhile ask whether the camera is still there."""
        began_s, is_said = self._clock.now(), False
        while True:
            silent_s = self._clock.now() - max(began_s, self._commands.heard_s)
            try:
                wait_s = max(min(_PING_S, self.silence_s - silent_s), _POLL_S)
                return self._commands.receive(wait_s, data_bytes=data_bytes)
            except CameraTimeoutError:
                silent_s = self._clock.now() - max(began_s, self._commands.heard_s)
                if silent_s >= self.silence_s:
                    raise
                if not is_said:
                    self._say_silent(silent_s)
                    is_said = True
                self._check_presence()
            except CameraProtocolError:
                self._is_valid = False
                raise

    def _say_silent(self, silent_s: float) -> None:
        _log.info(
            "%s has sent nothing for %.0f s: waiting for its answer for up to %.0f s more",
            self.name,
            silent_s,
            self.silence_s - silent_s,
        )

    def _check_presence(self) -> None:
        """Send a ping.

        Raises:
            CameraDisconnectedError: the last one was not answered, and earlier ones were
        """
        while (event := self._next_event(_POLL_S)) is not None:
            self._queue.append(event)
        if self._pongs and self._unanswered > 1:
            raise CameraDisconnectedError(
                f"{self.name} has not answered in the network for {2 * _PING_S:g} s",
                hint="check its battery and its distance, then resume",
            )
        self._unanswered += 1
        self._events.send(Packet.PING, b"", self.silence_s)

    def event(self, wait_s: float) -> Container | None:
        return self._queue.popleft() if self._queue else self._next_event(wait_s)

    def _next_event(self, wait_s: float) -> Container | None:
        deadline_s = self._clock.now() + wait_s
        while True:
            try:
                left_s = deadline_s - self._clock.now()
                kind, body = self._events.receive(max(left_s, _POLL_S))
            except CameraTimeoutError:
                return None
            if kind == Packet.EVENT and len(body) >= 6:
                code, number = struct.unpack_from("<HI", body)
                return Container(EVENT, code, number, bytes(body[6:]))
            if kind == Packet.PING:
                self._events.send(Packet.PONG, b"", self.silence_s)
            elif kind == Packet.PONG:
                self._pongs, self._unanswered = self._pongs + 1, 0

    def _invalid(self, what: str) -> CameraProtocolError:
        self._is_valid = False  # where the next packet begins is not known for certain
        return CameraProtocolError(f"{self.name} sent {what}", hint="try again")

    # ---- recovery

    def recover(self, transaction: int) -> bool:
        """Cancel a transaction and discard what is still sent up to its response.

        Returns whether the response came; without it, the connections need `reset`.

        Raises:
            CameraDisconnectedError: the camera has closed a connection
        """
        if not self._is_valid:
            return False
        number = transaction.to_bytes(4, "little")
        self._events.send(Packet.CANCEL, number, self.silence_s)
        deadline_s = self._clock.now() + _RECOVERY_S
        with suppress(CameraTimeoutError, CameraProtocolError):
            while (left_s := deadline_s - self._clock.now()) > 0:
                kind, body = self._commands.receive(left_s, data_bytes=self._limit)
                if kind == Packet.RESPONSE and body[2:6] == number:
                    return True
        return False

    def reset(self) -> None:
        self.close()
        try:
            self._open()
        except CameraError as error:
            raise CameraDisconnectedError(
                f"{self.name} cannot be reached any more",
                hint="check its battery and the network, then resume",
            ) from error
