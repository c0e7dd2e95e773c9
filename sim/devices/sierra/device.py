"""A Nikon CoolPix 990 on a serial line: packets and commands of the Sierra protocol.

Written after the descriptions that photopc and libgphoto2 publish.  A packet has type, subtype,
length, data and the sum of the data; numbers are little endian.  A command is answered by ACK, by
NAK (send it again), by INVALID, or by data packets, each of which waits for the host's ACK.  An
action is acknowledged, and ENQ follows when it is done.
"""

from __future__ import annotations

import math
import random
import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from camctl.sim.devices.clock import DeviceClock, RealDeviceClock, ScheduledCall
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.sierra.camera import RefusedError, SierraCamera
from camctl.sim.devices.sierra.config import (
    SPEEDS,
    START_SPEED,
    Action,
    LineFaultCommands,
    LineFaults,
    Register,
    SierraConfig,
)
from camctl.sim.devices.sierra.line import Line, TerminalLine
from camctl.sim.devices.sierra.protocol_memory import MemoryLine
from camctl.sim.devices.still_body import BodyOptions, StillBody, StillFaultCommands

NUL, DATA, LAST, ENQ, ACK, NAK, COMMAND = 0x00, 0x02, 0x03, 0x05, 0x06, 0x15, 0x1B
INVALID, SESSION_ERROR = 0x11, 0xFC  # answers
FIRST, NEXT = 0x53, 0x43  # subtype of the first command of a session, and of the others
PACKET = 2048  # most data bytes of a packet

_HEADER, _SUM = 4, 2  # bytes
_SET_NUMBER, _GET_NUMBER, _ACTION, _SET_TEXT, _GET_TEXT = range(5)  # first byte of a command
_PARTIAL_PACKET_S = 0.5  # silence after which the beginning of a packet is discarded
_MOST_QUEUED_BYTES = 4096  # that are kept of what a host sends during an exposure


class SierraDevice(LineFaultCommands, StillFaultCommands):
    """The camera on its line; `make` builds one from a configuration.

    Args:
        config: see `SierraConfig`
        sensor: what is exposed
        clock: on which it times exposures, silence and bytes; real time if not given
    """

    def __init__(
        self, config: SierraConfig, sensor: VirtualSensor, clock: DeviceClock | None = None
    ) -> None:
        self.config = config
        self.lock = threading.RLock()
        self.clock = clock if clock is not None else RealDeviceClock()
        self.line: Line
        if config.line == "memory":
            self.line = MemoryLine(self.received, self.clock)
        else:
            self.line = TerminalLine(config.line, config.link, self.received)
        options = BodyOptions("DSCN", delay_s=config.delay_s, grey=False)
        self.body = StillBody(sensor, self.lock, self.clock, options)
        self.camera = SierraCamera(self.body, config)
        self.faults = LineFaults()
        self.speed = START_SPEED
        self._random = random.Random(0)
        self._is_session_open = False
        self._buffer = bytearray()
        self._outgoing: deque[bytes] = deque()  # data packets; the first one waits for its ACK
        self._packets = 0
        self._heard_s = self.clock.now()
        self._timer: ScheduledCall | None = None
        self._timer_s = math.inf

    def attach(self) -> None:
        self.line.open()

    def detach(self) -> None:
        self.line.close()
        with self.lock:
            self._end_session()

    # What the host sends.

    def received(self, data: bytes) -> None:
        """Process bytes from the host."""
        with self.lock:
            self._heard_s = self.clock.now()
            host_speed = self.line.host_speed
            if self.faults.is_hanging or (host_speed is not None and host_speed != self.speed):
                return  # at another speed no byte can be recognised
            if not self.body.is_exposing or len(self._buffer) < _MOST_QUEUED_BYTES:
                self._buffer += data
            self._process_buffer()
            self._watch_silence()

    def _process_buffer(self) -> None:
        """Process packets one after another, unless a picture is being taken."""
        while self._buffer and not self.body.is_exposing:
            first = self._buffer[0]
            if first not in (COMMAND, DATA, LAST):
                del self._buffer[0]
                self._process_byte(first)
                continue
            if len(self._buffer) < _HEADER:
                return
            size = int.from_bytes(self._buffer[2:4], "little")
            if size > PACKET:
                self._buffer.clear()
                self._send(bytes([NAK]))
                return
            if len(self._buffer) < _HEADER + size + _SUM:
                return
            packet = bytes(self._buffer[: _HEADER + size + _SUM])
            del self._buffer[: len(packet)]
            self._process_packet(packet)

    def _process_byte(self, byte: int) -> None:
        if byte == NUL:
            self._outgoing.clear()
            self._is_session_open = True
            self._send(bytes([NAK]))
        elif byte == ACK and self._outgoing:
            self._outgoing.popleft()
            if not self._outgoing:
                self.camera.downloaded()
            self._send_data_packet()
        elif byte == NAK:
            self._send_data_packet()

    def _process_packet(self, packet: bytes) -> None:
        self._packets += 1
        data = packet[_HEADER:-_SUM]
        if self.faults.naks > 0:
            self.faults.naks -= 1
            self._send(bytes([NAK]))
        elif sum(data) & 0xFFFF != int.from_bytes(packet[-_SUM:], "little"):
            self._send(bytes([NAK]))
        elif packet[0] != COMMAND:
            self._send(bytes([INVALID]))  # no command here takes more than one packet
        elif packet[1] == FIRST or (packet[1] == NEXT and self._is_session_open):
            self._is_session_open = True
            self._outgoing.clear()
            self.camera.downloading = None
            self._execute(data)
        else:
            self._send(bytes([SESSION_ERROR]))

    def _execute(self, data: bytes) -> None:
        try:
            code, number, rest = data[0], data[1], data[2:]
            _COMMANDS[code](self, number, rest)
        except (IndexError, KeyError, RefusedError):
            self._send(bytes([INVALID]))

    # Commands.

    def _set_number(self, number: int, rest: bytes) -> None:
        value = int.from_bytes(rest, "little") if len(rest) == 4 else None
        if number == Register.SPEED:
            self._set_speed(value)
            return
        self.camera.write(number, value)
        self._send(bytes([ACK]))

    def _set_speed(self, value: int | None) -> None:
        speed = SPEEDS.get(value or 0)
        if self.faults.is_speed_fixed or speed is None or speed > self.config.speed_limit:
            raise RefusedError
        self._send(bytes([ACK]))  # at the old speed
        self.speed = speed

    def _get_number(self, number: int, rest: bytes) -> None:
        self._answer(struct.pack("<I", self.camera.read(number) & 0xFFFF_FFFF))

    def _set_text(self, number: int, rest: bytes) -> None:
        self.camera.write_text(number, rest)
        self._send(bytes([ACK]))

    def _get_text(self, number: int, rest: bytes) -> None:
        self._answer(self.camera.read_text(number))

    def _act(self, number: int, rest: bytes) -> None:
        if number == Action.CAPTURE:
            self.camera.check_ready()
            self._send(bytes([ACK]))
            self.camera.capture(self._captured)
            return
        self.camera.act(number)
        self._send(bytes([ACK]))
        self._send(bytes([ENQ]))
        if number == Action.END:
            self._end_session()

    def _captured(self) -> None:
        self._heard_s = self.clock.now()
        self._send(bytes([ENQ]))
        self._process_buffer()
        self._watch_silence()

    # What the camera sends.

    def _answer(self, data: bytes) -> None:
        """Queue data packets; each but the first is sent after an ACK."""
        parts = [data[at : at + PACKET] for at in range(0, len(data), PACKET)] or [b""]
        for place, part in enumerate(parts):
            kind = LAST if place == len(parts) - 1 else DATA
            head = struct.pack("<BBH", kind, place & 0xFF, len(part))
            self._outgoing.append(head + part + struct.pack("<H", sum(part) & 0xFFFF))
        self._send_data_packet()

    def _send_data_packet(self) -> None:
        """Send the first queued packet, for the first time or again."""
        if not self._outgoing:
            return
        packet = self._outgoing[0]
        if self.faults.truncations > 0 and len(packet) > _HEADER + 4 + _SUM:
            self.faults.truncations -= 1
            packet = packet[: len(packet) // 2]
        self._send(packet)

    def _send(self, data: bytes) -> None:
        if self.faults.garbage > 0:
            self.faults.garbage -= 1
            data = self._random.randbytes(23)
        self.line.send(data, self.speed if self.config.is_paced else 0)

    # Silence of the host.

    def _silence_ends_s(self) -> float:
        """Return when the device stops waiting for the host; infinite: it does not wait."""
        if self.body.is_exposing:
            return math.inf
        if self._buffer:
            return self._heard_s + min(_PARTIAL_PACKET_S, self.config.silence_s)
        if self._is_session_open or self.speed != START_SPEED:
            return self._heard_s + self.config.silence_s
        return math.inf

    def _watch_silence(self) -> None:
        """Schedule `_end_silence`, unless it is scheduled for that time or an earlier one."""
        ends_s = self._silence_ends_s()
        if ends_s < self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            self._timer_s = ends_s
            self._timer = self.clock.call_at(ends_s, self._end_silence)

    def _end_silence(self) -> None:
        """Discard part of a packet, and the session, if the host has been silent for too long."""
        with self.lock:
            self._timer, self._timer_s = None, math.inf
            now_s = self.clock.now()
            if now_s >= self._silence_ends_s():
                if self._buffer and now_s >= self._heard_s + _PARTIAL_PACKET_S:
                    self._buffer.clear()
                    if not self.faults.is_hanging:
                        self._send(bytes([NAK]))
                if now_s >= self._heard_s + self.config.silence_s:
                    self._end_session()
            self._watch_silence()

    def _end_session(self) -> None:
        self.speed = START_SPEED
        self._is_session_open = False
        self._buffer.clear()
        self._outgoing.clear()

    # Control commands.

    def do_ok(self) -> None:
        self.faults = LineFaults()
        self.body.clear_faults()

    def do_break(self) -> None:
        """Behave as after a break on the line: no session, 19,200 bits per second."""
        with self.lock:
            self._end_session()

    def state(self) -> dict[str, Any]:
        with self.lock:
            return {
                "path": self.line.path,
                "speed": self.speed,
                "session": self._is_session_open,
                "packets": self._packets,
                "is_exposing": self.body.is_exposing,
                **self.body.state(),
                **self.camera.state(),
            }

    def do_log(self) -> dict[str, Any]:
        with self.lock:
            return {"shots": list(self.body.log)}


_COMMANDS: Mapping[int, Callable[[SierraDevice, int, bytes], None]] = {
    _SET_NUMBER: SierraDevice._set_number,
    _GET_NUMBER: SierraDevice._get_number,
    _ACTION: SierraDevice._act,
    _SET_TEXT: SierraDevice._set_text,
    _GET_TEXT: SierraDevice._get_text,
}


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> SierraDevice:
    """Return the camera of a configuration (`SierraConfig`)."""
    options = SierraConfig.parse(config)
    return SierraDevice(options, options.load_sensor(), clock)
