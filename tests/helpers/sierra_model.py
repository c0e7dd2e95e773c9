"""A small model of a camera that speaks the Sierra protocol, and our session on it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, cast

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.interface.clock import VirtualClock

ACK, NAK, ENQ, DC1, END = b"\x06", b"\x15", b"\x05", b"\x11", b"\xff"
CODES = {1: 9600, 2: 19200, 3: 38400, 4: 57600, 5: 115200}


class Line:
    """A line in virtual time, in place of a `SerialLink`: silence passes at once."""

    url = "test://"
    has_speed = True

    def __init__(self, camera: Camera, clock: VirtualClock) -> None:
        self.camera, self.clock, self.speed = camera, clock, 19200
        self.buffer = bytearray()
        self.read_bytes = 0

    def write(self, data: bytes) -> None:
        self.buffer += self.camera.receive(data, self.speed)

    def read(self, count: int, silence_s: float) -> bytes:
        data = bytes(self.buffer[:count])
        del self.buffer[:count]
        self.read_bytes += len(data)
        if len(data) < count:
            self.clock.sleep_until(self.clock.now() + silence_s)
            self.camera.forget_incomplete()
        return data

    def read_waiting(self, limit: int) -> bytes:
        data = bytes(self.buffer[:limit])
        del self.buffer[:limit]
        return data


class Camera:
    """A camera of the protocol with integer registers and registers of data.

    Tests replace the methods `receive`, `command`, `packets` and `transmit`.
    """

    def __init__(self, speeds: Sequence[int] = (1, 2, 3, 4, 5)) -> None:
        self.speed, self.in_session = 19200, False
        self.numbers = {1: 0x13, 3: 0, 4: 0, 5: 0, 10: 0}
        self.data = {27: b"COOLPIX990\0"}
        self.speeds = speeds
        self.taken = 0
        self.outgoing: list[bytes] = []
        self.incoming = bytearray()
        self.commands: list[tuple[int, bytes]] = []
        self.receive: Callable[[bytes, int], bytes] = self._receive
        self.command: Callable[[int, bytes, bytes], bytes] = self._command
        self.packets: Callable[[bytes], bytes] = self._packets
        self.transmit: Callable[[bytes], bytes] = lambda answer: answer

    def forget_incomplete(self) -> None:
        self.incoming.clear()

    def restart(self) -> None:
        self.speed, self.in_session, self.outgoing = 19200, False, []

    def _receive(self, data: bytes, speed: int) -> bytes:
        if speed != self.speed:
            return b""
        self.incoming += data
        answer = b""
        while self.incoming:
            kind = self.incoming[0]
            if kind == 0x1B:
                if len(self.incoming) < 4:
                    break
                length = struct.unpack_from("<H", self.incoming, 2)[0]
                if len(self.incoming) < length + 6:
                    break
                packet = bytes(self.incoming[: length + 6])
                del self.incoming[: length + 6]
                answer += self.command(packet[1], packet[4:-2], packet[-2:])
                continue
            del self.incoming[0]
            if kind == 0x00 and not self.in_session:
                self.in_session = True
                answer += NAK
            elif kind == 0x06 and self.outgoing:
                self.outgoing.pop(0)
                answer += self.outgoing[0] if self.outgoing else b""
            elif kind == 0x15 and self.outgoing:
                answer += self.outgoing[0]
        return self.transmit(answer)

    def _command(self, subtype: int, payload: bytes, tail: bytes) -> bytes:
        if not self.in_session or int.from_bytes(tail, "little") != sum(payload):
            return NAK
        self.commands.append((subtype, payload))
        what, where = payload[0], payload[1]
        self.outgoing = []
        if what == 0:
            value = int.from_bytes(payload[2:], "little")
            if where == 17:
                if value not in self.speeds:
                    return DC1
                self.speed = CODES[value]
            elif where not in self.numbers:
                return DC1
            else:
                self.numbers[where] = value
            return ACK
        if what == 1 and where in self.numbers:
            return self.packets(struct.pack("<I", self.numbers[where]))
        if what == 4 and where in self.data:
            return self.packets(self.data[where])
        if what == 2 and where == 2:
            self.taken += 1
            return ACK + ENQ
        if what == 2 and where == 4:
            self.restart()
            return ACK
        return DC1

    def _packets(self, data: bytes) -> bytes:
        parts = [data[at : at + 2048] for at in range(0, len(data), 2048)] or [b""]
        for number, part in enumerate(parts):
            kind = 3 if number == len(parts) - 1 else 2
            head = struct.pack("<BBH", kind, number % 256, len(part))
            self.outgoing.append(head + part + struct.pack("<H", sum(part) & 0xFFFF))
        return self.outgoing[0]


def line_to(camera: Camera) -> tuple[Line, SerialLink, VirtualClock]:
    """Return a line, the same as the driver takes it, and its clock."""
    clock = VirtualClock()
    line = Line(camera, clock)
    return line, cast(SerialLink, line), clock


def closed_session(camera: Camera, **arguments: Any) -> tuple[Sierra, VirtualClock]:
    _, link, clock = line_to(camera)
    return Sierra(link, clock, **arguments), clock


def session(camera: Camera, **arguments: Any) -> tuple[Sierra, VirtualClock]:
    sierra, clock = closed_session(camera, **arguments)
    sierra.open()
    return sierra, clock


def line_of(sierra: Sierra) -> Line:
    return cast(Line, sierra.link)


PICTURE = bytes(range(256)) * 20
