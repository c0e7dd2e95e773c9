"""USB descriptors of a still camera: USB still image capture device class 1.0, section 4."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from camctl.controls import Layout
from camctl.errors import UsageError
from sim.devices.clock import DeviceClock
from sim.devices.ptp.canon import CanonResponder
from sim.devices.ptp.codes import Container, Operation, Response
from sim.devices.ptp.config import Identity, PtpConfig, WireFaults, WireVerbs
from sim.devices.ptp.datasets import HEADER, Reply, pack_container, pack_parameters
from sim.devices.ptp.nikon import NikonResponder
from sim.devices.ptp.responder import Responder
from sim.devices.ptp.sony import SonyResponder
from sim.devices.scenery import Exposer, checked, split_config
from sim.devices.still_body import BodyOptions, StillBody, StillVerbs
from sim.devices.usb.device import IN, STALL, Answer, UsbDevice

BULK_IN, BULK_OUT, EVENTS = 1, 2, 3  # numbers of the endpoints
PACKET = 512

_CLASS = (6, 1, 1)  # still image, capture, PTP
_BULK, _INTERRUPT = 2, 3


def device_descriptor(who: Identity) -> bytes:
    """Return 18 bytes; strings 1 to 3 are make, model and serial number."""
    head = struct.pack("<BBHBBBB", 18, 1, 0x200, 0, 0, 0, 64)
    return head + struct.pack("<HHHBBBB", who.vendor_id, who.product_id, 0x100, 1, 2, 3, 1)


def configuration_descriptor() -> bytes:
    """Return the configuration: one interface with three endpoints."""
    parts = struct.pack("<9B", 9, 4, 0, 0, 3, *_CLASS, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_IN | IN, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_OUT, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, EVENTS | IN, _INTERRUPT, 64, 6)
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(parts), 1, 1, 0, 0xC0, 1) + parts


_CANCEL, _RESET, _STATUS = 0x64, 0x66, 0x67  # class requests, section 5.2
_LARGEST_CONTAINER = 64 * 1024  # of what a host may send: no operation here takes more
_WAITING_EVENTS = 64  # that nobody reads; newer ones are dropped
_WAITING_REPLIES = 8
_PARAMETERS = 5
_UNREAD_S, _READ_POLL_S = 2.0, 0.005  # before the plug is pulled in the middle of an object

RESPONDERS: dict[str, type[Responder]] = {
    "none": Responder,
    "nikon": NikonResponder,
    "canon": CanonResponder,
    "sony": SonyResponder,
}
_OBJECTS = (
    Operation.GET_OBJECT,
    Operation.GET_PARTIAL_OBJECT,
    Operation.EOS_GET_OBJECT,
    Operation.EOS_GET_PARTIAL_OBJECT,
)


@dataclass(frozen=True)
class _Command:
    code: int
    transaction: int
    parameters: tuple[int, ...]


class PtpCamera(WireVerbs, StillVerbs, UsbDevice):
    """See the module; `config` says what camera it is, `exposer` what it sees."""

    def __init__(
        self, config: PtpConfig, exposer: Exposer, clock: DeviceClock | None = None
    ) -> None:
        kind = RESPONDERS[config.vendor]
        who = kind.identity
        self.strings = ("", who.make, who.model, config.serial)
        self.device_descriptor = device_descriptor(who)
        self.configuration_descriptor = configuration_descriptor()
        super().__init__(clock=clock)
        if config.zlp == "never":
            self.zero_length.discard(BULK_IN)
        self.body = StillBody(
            exposer,
            self.lock,
            self.clock,
            BodyOptions("VIRT", delay_s=config.delay_s, object_bytes=config.object_bytes),
        )
        self.responder = kind(self.body, config, self._send_event, self._answer_later)
        self.faults = WireFaults()
        self._config = config
        self._rubbish = random.Random(0)
        self._waiting = bytearray()
        self._command: _Command | None = None
        self._is_stalled = False
        self._late: _Command | None = None

    # What the host sends.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> Answer:
        """Answer the class requests."""
        if (request_type, request) == (0xA1, _STATUS):
            if self._is_stalled:
                halted = struct.pack("<II", BULK_IN | IN, BULK_OUT)
                return struct.pack("<HH", 12, Response.TRANSACTION_CANCELLED) + halted
            is_busy = self.body.is_exposing and not self._config.overlap
            return struct.pack("<HH", 4, Response.DEVICE_BUSY if is_busy else Response.OK)
        if (request_type, request) == (0x21, _RESET):
            self._forget()
            self.responder.close_session()
            return b""
        if (request_type, request) == (0x21, _CANCEL):
            self._forget()
            return b""
        return STALL

    def received(self, endpoint: int, data: bytes) -> None:
        """Take a piece of a container, or a whole one."""
        if endpoint != BULK_OUT:
            return
        self._waiting += data
        while len(self._waiting) >= HEADER.size:
            length, kind, code, transaction = HEADER.unpack_from(self._waiting)
            if not self._is_sound(length, kind):
                self._refuse()
                return
            if len(self._waiting) < length:
                return
            body = bytes(self._waiting[HEADER.size : length])
            del self._waiting[:length]
            if kind == Container.COMMAND:
                self._take_command(code, transaction, body)
            else:
                self._take_data(body)

    def halt_cleared(self, endpoint: int) -> None:
        """Work again."""
        self._is_stalled = False

    def detached(self) -> None:
        """Lose the session; what is exposed goes onto the card all the same."""
        with self.lock:
            self._forget()
            self.responder.close_session()

    def _is_sound(self, length: int, kind: int) -> bool:
        if kind == Container.COMMAND:
            return HEADER.size <= length <= HEADER.size + 4 * _PARAMETERS and length % 4 == 0
        return kind == Container.DATA and HEADER.size <= length <= _LARGEST_CONTAINER

    def _take_command(self, code: int, transaction: int, body: bytes) -> None:
        parameters = struct.unpack(f"<{len(body) // 4}I", body)
        self._command = _Command(code, transaction, parameters)
        if code not in self.responder.takes_data or code not in self.responder.operations:
            self._execute(b"")

    def _take_data(self, body: bytes) -> None:
        if self._command is not None:  # else it belongs to an operation that was refused
            self._execute(body)

    def _execute(self, data: bytes) -> None:
        command, self._command = self._command, None
        assert command is not None
        if self.faults.is_hanging:
            return
        if self.faults.stalls > 0:
            self.faults.stalls -= 1
            self._refuse()
            return
        if self.faults.busy and command.code not in (
            Operation.GET_DEVICE_INFO,
            Operation.OPEN_SESSION,
            Operation.CLOSE_SESSION,
        ):
            self.faults.busy -= self.faults.busy > 0
            self._reply(command, Reply(Response.DEVICE_BUSY))
            return
        self._late = command
        reply = self.responder.execute(command.code, command.transaction, command.parameters, data)
        if reply is not None:
            self._late = None
            self._reply(command, reply)

    def _refuse(self) -> None:
        """Stall both bulk endpoints: the host said, or is told, nonsense."""
        self._forget()
        self._is_stalled = True
        self.stall(BULK_IN | IN)
        self.stall(BULK_OUT)

    def _forget(self) -> None:
        self._waiting.clear()
        self._command = self._late = None
        self.flush(BULK_IN)

    # What the host gets.

    def _answer_later(self, reply: Reply) -> None:
        command, self._late = self._late, None
        if command is not None:  # else cancelled, or unplugged
            self._reply(command, reply)

    def _send_event(self, code: int, parameters: Sequence[int]) -> None:
        if self.pending(EVENTS) < _WAITING_EVENTS:
            body = pack_parameters(parameters)
            transaction = 0xFFFF_FFFF  # of no operation
            self.send(EVENTS, pack_container(Container.EVENT, code, transaction, body))

    def _reply(self, command: _Command, reply: Reply) -> None:
        if self.pending(BULK_IN) >= _WAITING_REPLIES:  # the host does not read: start afresh
            self.flush(BULK_IN)
        if self.faults.garbage > 0:
            self.faults.garbage -= 1
            self.send(BULK_IN, self._rubbish.randbytes(37))
            return
        if reply.data is not None and not self._send_data(command, reply.data):
            return
        body = pack_parameters(reply.parameters)
        self.send(
            BULK_IN, pack_container(Container.RESPONSE, reply.code, command.transaction, body)
        )
        if reply.sent is not None:
            reply.sent()

    def _send_data(self, command: _Command, data: bytes) -> bool:
        """Send a data phase; False where no response is to follow."""
        header = HEADER.pack(
            HEADER.size + len(data), Container.DATA, command.code, command.transaction
        )
        is_object = command.code in _OBJECTS
        if is_object and self.faults.unplug_after >= 0:
            self._send_and_unplug(header + data)
            return False
        if is_object and self.faults.truncations > 0:
            self.faults.truncations -= 1
            half = (HEADER.size + len(data)) // 2
            self.send(BULK_IN, (header + data)[: half - (half % PACKET == 0)])
            return self.faults.answers_truncated
        if self._config.split_header and data:
            self.send(BULK_IN, header)
            self.send(BULK_IN, data)
        else:
            self.send(BULK_IN, header + data)
        return True

    def _send_and_unplug(self, container: bytes) -> None:
        size = min(self.faults.unplug_after, len(container) - 1) // PACKET * PACKET
        self.faults.unplug_after = -1
        if size:
            endings, self.zero_length = self.zero_length, set()
            self.send(BULK_IN, container[:size])
            self.zero_length = endings
        self._unplug_once_read(self.clock.now() + _UNREAD_S)

    def _unplug_once_read(self, deadline_s: float) -> None:
        """Pull the plug when the host has read what was sent, or at `deadline_s`.

        By a scheduled call, since this thread may be the transport's own.
        """

        def look() -> None:
            if self.pending(BULK_IN) and self.clock.now() < deadline_s:
                self._unplug_once_read(deadline_s)
            else:
                self.detach()

        self.clock.call_at(self.clock.now() + _READ_POLL_S, look)

    # Verbs.

    def do_ok(self) -> None:
        """End all faults."""
        self.faults = WireFaults()
        self.body.mend()
        self.responder.is_silent = self._config.event_order == "never"

    def do_unplug(self, after_bytes: int | None = None) -> None:
        """Pull the plug, or do so once so many bytes of the next object have gone out."""
        if after_bytes is None:
            self.detach()
        elif after_bytes < 0:
            raise UsageError(f"unplug after {after_bytes} bytes", hint="give 0 or more")
        else:
            self.faults.unplug_after = after_bytes

    def do_no_events(self) -> None:
        """Send no event until ok."""
        self.responder.is_silent = True

    def do_mode(self, dial: Literal["manual", "auto"]) -> None:
        """Turn the mode dial."""
        with self.lock:
            self.responder.turn_dial(dial)

    def state(self) -> dict[str, Any]:
        """Return properties by code, session, pictures on the card, and what was asked."""
        with self.lock:
            responder = self.responder
            return {
                "session": responder.session,
                "properties": {f"{c:04X}": p.value for c, p in responder.properties.items()},
                "pictures": responder.card.count,
                "is_exposing": self.body.is_exposing,
                **self.body.state(),
                "operations": dict(responder.operations_seen),
            }

    def do_log(self) -> dict[str, Any]:
        """Return the last operations, and the last exposures."""
        with self.lock:
            return {"operations": list(self.responder.log), "shots": list(self.body.log)}


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> PtpCamera:
    """Return the camera that a configuration describes: `Scenery` and `PtpConfig` in one.

    Raises:
        UsageError, DataError: something in it is unknown or out of range
    """
    exposer, own = split_config(config)
    camera = checked(PtpConfig, own)
    if "dng" in "+".join(camera.files) and exposer.layout is Layout.RGB:
        raise UsageError("raw files of an RGB sensor", hint="take jpeg or tiff, or a Bayer sensor")
    return PtpCamera(camera, exposer, clock)
