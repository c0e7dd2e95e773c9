"""A Nikon CoolPix 990 on a serial line: packets of the Sierra protocol.

Written after the descriptions that photopc and libgphoto2 publish.  A packet is kind, subkind,
length, data, sum of the data; numbers are little endian.  A command is answered by ACK, NAK (send
it again), INVALID, or by data packets, each of which waits for the host's ACK.  An action is
acknowledged, and ENQ says that it is done.
"""

from __future__ import annotations

import math
import random
import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from camctl.errors import unknown_name
from sim.devices.clock import DeviceClock, RealDeviceClock, ScheduledCall
from sim.devices.scenery import Exposer, checked, split_config
from sim.devices.sierra.camera import Refused, SierraCamera
from sim.devices.sierra.config import LineFaults, SierraConfig
from sim.devices.sierra.line import Line, TerminalLine
from sim.devices.sierra.protocol_memory import MemoryLine
from sim.devices.sierra.registers import SPEEDS, START_SPEED, Action, Register
from sim.devices.still_body import BodyOptions, StillBody, StillVerbs

NUL, DATA, LAST, ENQ, ACK, NAK, COMMAND = 0x00, 0x02, 0x03, 0x05, 0x06, 0x15, 0x1B
INVALID, SESSION_ERROR = 0x11, 0xFC
FIRST, NEXT = 0x53, 0x43  # second byte of a command: of the first in a session, of others
PACKET = 2048  # bytes of data in one

_HEAD, _SUM = 4, 2
_SET_NUMBER, _GET_NUMBER, _ACTION, _SET_TEXT, _GET_TEXT = range(5)
_HALF_PACKET_S = 0.5  # silence after which the beginning of a packet is forgotten
_LATE_BYTES = 4096  # that may come while a picture is taken


class SierraDevice(StillVerbs):
    """See the module; `config` says what camera it is, `exposer` what it sees."""

    def __init__(
        self, config: SierraConfig, exposer: Exposer, clock: DeviceClock | None = None
    ) -> None:
        self.lock = threading.RLock()
        self.clock = clock if clock is not None else RealDeviceClock()
        self.config = config
        self.line: Line
        if config.line == "memory":
            self.line = MemoryLine(self.received, self.clock)
        else:
            self.line = TerminalLine(config.line, config.link, self.received)
        options = BodyOptions("DSCN", delay_s=config.delay_s, grey=False)
        self.body = StillBody(exposer, self.lock, self.clock, options)
        self.camera = SierraCamera(
            self.body, config.serial, config.files, config.times_us, config.card_bytes
        )
        self.faults = LineFaults()
        self.speed = START_SPEED
        self._rubbish = random.Random(0)
        self._is_open = False  # a session
        self._buffer = bytearray()
        self._outgoing: deque[bytes] = deque()
        self._heard_s = self.clock.now()
        self._timer: ScheduledCall | None = None  # of silence
        self._timer_s = math.inf
        self._packets = 0

    def attach(self) -> None:
        """Plug it in (CameraNotFoundError: the node cannot be opened)."""
        self.line.open()

    def detach(self) -> None:
        """Pull the plug."""
        self.line.close()
        with self.lock:
            self._end_session()

    # What the host sends.

    def received(self, data: bytes) -> None:
        """Take bytes as they come."""
        with self.lock:
            self._heard_s = self.clock.now()
            host_speed = self.line.host_speed
            if self.faults.is_hanging or (host_speed is not None and host_speed != self.speed):
                return  # at another speed all is noise
            if not self.body.is_exposing or len(self._buffer) < _LATE_BYTES:
                self._buffer += data
            self._work()
            self._watch_silence()

    def _work(self) -> None:
        """Take packets from the buffer, one after another, while no picture is taken."""
        while self._buffer and not self.body.is_exposing:
            kind = self._buffer[0]
            if kind not in (COMMAND, DATA, LAST):
                del self._buffer[0]
                self._take_byte(kind)
                continue
            if len(self._buffer) < _HEAD:
                return
            size = int.from_bytes(self._buffer[2:4], "little")
            if size > PACKET:
                self._buffer.clear()
                self._send(bytes([NAK]))
                return
            if len(self._buffer) < _HEAD + size + _SUM:
                return
            packet = bytes(self._buffer[: _HEAD + size + _SUM])
            del self._buffer[: len(packet)]
            self._take_packet(packet)

    def _take_byte(self, byte: int) -> None:
        if byte == NUL:
            self._outgoing.clear()
            self._is_open = True
            self._send(bytes([NAK]))
        elif byte == ACK and self._outgoing:
            self._outgoing.popleft()
            if not self._outgoing:
                self.camera.downloaded()
            self._send_next()
        elif byte == NAK:
            self._send_next()

    def _take_packet(self, packet: bytes) -> None:
        self._packets += 1
        data = packet[_HEAD:-_SUM]
        if self.faults.naks > 0:
            self.faults.naks -= 1
            self._send(bytes([NAK]))
        elif sum(data) & 0xFFFF != int.from_bytes(packet[-_SUM:], "little"):
            self._send(bytes([NAK]))
        elif packet[0] != COMMAND:
            self._send(bytes([INVALID]))  # nothing that a host sends here takes two packets
        elif packet[1] == FIRST or (packet[1] == NEXT and self._is_open):
            self._is_open = True
            self._outgoing.clear()
            self.camera.asked_for = None
            self._take_command(data)
        else:
            self._send(bytes([SESSION_ERROR]))

    def _take_command(self, data: bytes) -> None:
        try:
            code, number, rest = data[0], data[1], data[2:]
            _COMMANDS[code](self, number, rest)
        except (IndexError, KeyError, Refused):
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
        if self.faults.has_no_speed or speed is None or speed > self.config.speed_limit:
            raise Refused
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
        self._work()
        self._watch_silence()

    # What the host gets.

    def _answer(self, data: bytes) -> None:
        """Queue data packets; each but the first waits for an ACK."""
        parts = [data[at : at + PACKET] for at in range(0, len(data), PACKET)] or [b""]
        for place, part in enumerate(parts):
            kind = LAST if place == len(parts) - 1 else DATA
            head = struct.pack("<BBH", kind, place & 0xFF, len(part))
            self._outgoing.append(head + part + struct.pack("<H", sum(part) & 0xFFFF))
        self._send_next()

    def _send_next(self) -> None:
        """Send the packet that is due, for the first time or again."""
        if not self._outgoing:
            return
        packet = self._outgoing[0]
        if self.faults.truncations > 0 and len(packet) > _HEAD + 4 + _SUM:
            self.faults.truncations -= 1
            packet = packet[: len(packet) // 2]
        self._send(packet)

    def _send(self, data: bytes) -> None:
        if self.faults.garbage > 0:
            self.faults.garbage -= 1
            data = self._rubbish.randbytes(23)
        self.line.send(data, self.speed if self.config.is_paced else 0)

    def _silence_ends_s(self) -> float:
        """Return when something is given up if the host stays silent; infinite: nothing is."""
        if self.body.is_exposing:
            return math.inf
        if self._buffer:
            return self._heard_s + min(_HALF_PACKET_S, self.config.silence_s)
        if self._is_open or self.speed != START_SPEED:
            return self._heard_s + self.config.silence_s
        return math.inf

    def _watch_silence(self) -> None:
        """Schedule `_end_silence`, unless it is scheduled for an earlier time already."""
        ends_s = self._silence_ends_s()
        if ends_s < self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            self._timer_s = ends_s
            self._timer = self.clock.call_at(ends_s, self._end_silence)

    def _end_silence(self) -> None:
        """Forget half a packet, and the session, if the host has been silent for long enough."""
        with self.lock:
            self._timer, self._timer_s = None, math.inf
            now_s = self.clock.now()
            if now_s >= self._silence_ends_s():
                if self._buffer and now_s >= self._heard_s + _HALF_PACKET_S:
                    self._buffer.clear()
                    if not self.faults.is_hanging:
                        self._send(bytes([NAK]))
                if now_s >= self._heard_s + self.config.silence_s:
                    self._end_session()
            self._watch_silence()

    def _end_session(self) -> None:
        self.speed = START_SPEED
        self._is_open = False
        self._buffer.clear()
        self._outgoing.clear()

    # Verbs.

    def do(self, verb: str, **arguments: Any) -> dict[str, Any]:
        """Do what a verb says: unplug, plug, state, or one of its own (UsageError: no such)."""
        work = getattr(self, f"do_{verb}", None)
        if work is None:
            raise unknown_name("verb", verb, [n[3:] for n in dir(self) if n.startswith("do_")])
        result: dict[str, Any] | None = work(**arguments)
        return result or {}

    def do_unplug(self) -> None:
        """Pull the plug."""
        self.detach()

    def do_plug(self) -> None:
        """Plug it in again."""
        self.attach()

    def do_ok(self) -> None:
        """End all faults."""
        self.faults = LineFaults()
        self.body.mend()

    def do_nak(self, count: int = 1) -> None:
        """Answer the next packets NAK."""
        self.faults.naks = count

    def do_garbage(self, count: int = 1) -> None:
        """Answer rubbish."""
        self.faults.garbage = count

    def do_truncate(self, count: int = 1) -> None:
        """Send half of the next data packets."""
        self.faults.truncations = count

    def do_hang(self) -> None:
        """Answer nothing."""
        self.faults.is_hanging = True

    def do_no_speed(self) -> None:
        """Refuse to change the speed."""
        self.faults.has_no_speed = True

    def do_break(self) -> None:
        """Behave as after a break on the line: no session, 19,200 bits a second."""
        with self.lock:
            self._end_session()

    def do_state(self) -> dict[str, Any]:
        """Return settings in force and counters, ready for JSON."""
        with self.lock:
            return {
                "path": self.line.path,
                "speed": self.speed,
                "session": self._is_open,
                "packets": self._packets,
                "is_exposing": self.body.is_exposing,
                **self.body.state(),
                **self.camera.state(),
            }

    def do_log(self) -> dict[str, Any]:
        """Return the last exposures."""
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
    """Return the camera that a configuration describes: `Scenery` and `SierraConfig` in one.

    Raises:
        UsageError, DataError: something in it is unknown or out of range
    """
    exposer, own = split_config(config)
    return SierraDevice(checked(SierraConfig, own), exposer, clock)
