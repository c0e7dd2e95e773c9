"""A PTP still camera on USB: descriptors, containers and stalls.

USB still image capture device class 1.0: section 4 for descriptors, section 5 for requests.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.ptp.config import Identity, PtpConfig
from camctl.sim.devices.ptp.device import Command, PtpDevice, identity_of
from camctl.sim.devices.ptp.protocol import (
    HEADER,
    Container,
    Reply,
    Response,
    pack_container,
    pack_parameters,
)
from camctl.sim.devices.usb.device import IN, STALL, ControlReply, UsbDevice

BULK_IN, BULK_OUT, EVENTS = 1, 2, 3  # numbers of the endpoints
PACKET = 512  # bytes, bulk at high speed (USB 2.0, 5.8.3)
_CLASS = (6, 1, 1)  # still image, capture, PTP
_BULK, _INTERRUPT = 2, 3  # types of endpoints
_CANCEL, _RESET, _STATUS = 0x64, 0x66, 0x67  # class requests, section 5.2
_NO_TRANSACTION = 0xFFFF_FFFF  # of events

_LARGEST_CONTAINER = 64 * 1024  # from the host: no operation takes more
_MOST_EVENTS = 64  # queued for a host that reads none; newer ones are lost
_MOST_REPLIES = 8  # queued for a host that reads none; then all are discarded
_UNREAD_S, _READ_POLL_S = 2.0, 0.005  # time for the host to read before an unplugging


def device_descriptor(identity: Identity) -> bytes:
    """Return 18 bytes; strings 1 to 3 are make, model and serial number."""
    head = struct.pack("<BBHBBBB", 18, 1, 0x200, 0, 0, 0, 64)
    ids = identity.vendor_id, identity.product_id
    return head + struct.pack("<HHHBBBB", *ids, 0x100, 1, 2, 3, 1)


def configuration_descriptor() -> bytes:
    """Return the configuration: one interface with three endpoints."""
    parts = struct.pack("<9B", 9, 4, 0, 0, 3, *_CLASS, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_IN | IN, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, BULK_OUT, _BULK, PACKET, 0)
    parts += struct.pack("<BBBBHB", 7, 5, EVENTS | IN, _INTERRUPT, 64, 6)
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(parts), 1, 1, 0, 0xC0, 1) + parts


class PtpCamera(PtpDevice, UsbDevice):
    """The camera on USB; `make` builds one from a configuration.

    Args:
        config: see `PtpConfig`
        sensor: what is exposed
        clock: on which it times exposures; real time if not given
    """

    def __init__(
        self, config: PtpConfig, sensor: VirtualSensor, clock: DeviceClock | None = None
    ) -> None:
        identity = identity_of(config)
        self.strings = ("", identity.make, identity.model, config.serial)
        self.device_descriptor = device_descriptor(identity)
        self.configuration_descriptor = configuration_descriptor()
        UsbDevice.__init__(self, clock=clock)
        if config.zlp == "never":
            self.zero_length.discard(BULK_IN)
        self.make_body(config, sensor)
        self._buffer = bytearray()
        self._is_stalled = False

    # What the host sends.

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        if (request_type, request) == (0xA1, _STATUS):
            if self._is_stalled:
                halted = struct.pack("<II", BULK_IN | IN, BULK_OUT)
                return struct.pack("<HH", 12, Response.TRANSACTION_CANCELLED) + halted
            is_busy = self.body.is_exposing and not self.config.overlap
            return struct.pack("<HH", 4, Response.DEVICE_BUSY if is_busy else Response.OK)
        if (request_type, request) == (0x21, _RESET):
            self._cancel()
            self.responder.close_session()
            return b""
        if (request_type, request) == (0x21, _CANCEL):
            self._cancel()
            return b""
        return STALL

    def received(self, endpoint: int, data: bytes) -> None:
        if endpoint != BULK_OUT:
            return
        self._buffer += data
        while len(self._buffer) >= HEADER.size:
            length, kind, code, transaction = HEADER.unpack_from(self._buffer)
            if not self._is_valid(length, kind):
                self.refuse_transfers()
                return
            if len(self._buffer) < length:
                return
            body = bytes(self._buffer[HEADER.size : length])
            del self._buffer[:length]
            if kind == Container.COMMAND:
                self.begin_command(code, transaction, struct.unpack(f"<{len(body) // 4}I", body))
            else:
                self.take_data(body)

    def halt_cleared(self, endpoint: int) -> None:
        self._is_stalled = False

    def detached(self) -> None:
        """End the session; files of a running exposure are still put on the card."""
        with self.lock:
            self._cancel()
            self.responder.close_session()

    def _is_valid(self, length: int, kind: int) -> bool:
        if kind == Container.COMMAND:
            return HEADER.size <= length <= HEADER.size + 20 and length % 4 == 0
        return kind == Container.DATA and HEADER.size <= length <= _LARGEST_CONTAINER

    def refuse_transfers(self) -> None:
        self._cancel()
        self._is_stalled = True
        self.stall(BULK_IN | IN)
        self.stall(BULK_OUT)

    def _cancel(self) -> None:
        """Cancel the current operation and discard what has not been read."""
        self._buffer.clear()
        self.drop_command()
        self.flush(BULK_IN)

    # What the camera sends.

    def send_event(self, code: int, parameters: Sequence[int]) -> None:
        """Send an event; lost if the host reads none."""
        if self.pending(EVENTS) < _MOST_EVENTS:
            body = pack_parameters(parameters)
            self.send(EVENTS, pack_container(Container.EVENT, code, _NO_TRANSACTION, body))

    def send_bytes(self, data: bytes) -> None:
        self._make_room()
        self.send(BULK_IN, data)

    def _make_room(self) -> None:
        if self.pending(BULK_IN) >= _MOST_REPLIES:
            self.flush(BULK_IN)

    def send_reply(self, command: Command, reply: Reply) -> None:
        self._make_room()
        if reply.data is not None and not self._send_data(command, reply.data):
            return
        body = pack_parameters(reply.parameters)
        self.send(
            BULK_IN, pack_container(Container.RESPONSE, reply.code, command.transaction, body)
        )
        if reply.sent is not None:
            reply.sent()

    def _send_data(self, command: Command, data: bytes) -> bool:
        """Send a data phase; return whether a response follows."""
        header = HEADER.pack(
            HEADER.size + len(data), Container.DATA, command.code, command.transaction
        )
        if command.is_of_object and self.faults.unplug_after is not None:
            self._send_and_unplug(header + data, self.faults.unplug_after)
            return False
        half = self.cut_object(command, header + data)
        if half is not None:
            self.send(BULK_IN, half[: len(half) - (len(half) % PACKET == 0)])
            return self.faults.answers_truncated
        if self.config.split_header and data:
            self.send(BULK_IN, header)
            self.send(BULK_IN, data)
        else:
            self.send(BULK_IN, header + data)
        return True

    def _send_and_unplug(self, container: bytes, limit: int) -> None:
        size = min(limit, len(container) - 1) // PACKET * PACKET
        self.faults.unplug_after = None
        if size:
            endings, self.zero_length = self.zero_length, set()
            self.send(BULK_IN, container[:size])
            self.zero_length = endings
        self._unplug_once_read(self.clock.now() + _UNREAD_S)

    def _unplug_once_read(self, deadline_s: float) -> None:
        """Unplug the camera when the host has read what was sent, or at `deadline_s`.

        By a scheduled call, since this may be the transport's own thread.
        """

        def check() -> None:
            if self.pending(BULK_IN) and self.clock.now() < deadline_s:
                self._unplug_once_read(deadline_s)
            else:
                self.detach()

        self.clock.call_at(self.clock.now() + _READ_POLL_S, check)


def make(config: Mapping[str, Any], clock: DeviceClock | None = None) -> PtpCamera:
    """Return the camera of a configuration (`PtpConfig`)."""
    options = PtpConfig.parse(config)
    return PtpCamera(options, options.load_picture_sensor(), clock)
