"""PTP containers over the bulk and interrupt pipes of a still camera.

The still image class (USB-IF PIMA 15740, class 6, subclass 1, protocol 1) packs each phase of a
transaction into a container: length u32, type u16, code u16, transaction u32, then parameters or
data.  Devices differ in how they cut containers into transfers; `UsbTransport.receive` lists what
is accepted.
"""

from __future__ import annotations

import errno
import struct
from array import array
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import usb.core
import usb.util

from camctl.drivers.common.usb import (
    InterfaceKind,
    claim_interface,
    find_endpoint,
    find_interface,
    typed_usb_errors,
)
from camctl.drivers.ptp.transport import (
    DATA,
    EVENT,
    MAX_PARAMETERS,
    MAX_STALE_CONTAINERS,
    NORMAL_S,
    RESPONSE,
    Container,
    IncompleteDataError,
)
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.clock import Clock

Bytes: TypeAlias = "bytes | memoryview | array[int]"

#: Class, subclass and protocol of a still-image interface.
STILL_IMAGE: InterfaceKind = (6, 1, 1)

_COMMAND = 1  # type of a container
HEADER = struct.Struct("<IHHI")

# Bytes of one read of a large object; usbfs has 16 MB for all transfers of the machine.
_CHUNK_BYTES = 1 << 20
# More than any camera is known to send in a row before the container that is expected.
_MAX_EMPTY_READS = 4
# Limits of reading what a camera still sends after a cancelled transaction.
_DRAIN_S, _DRAIN_BYTES = 2.0, 1 << 30
_MAX_EVENT_BYTES = HEADER.size + 4 * 3
# After an error of the event pipe, so that polling a halted pipe does not keep the bus busy.
_EVENT_RETRY_S = 0.05

# Class requests, PIMA 15740 annex D.5.2.
_TO_INTERFACE, _FROM_INTERFACE = 0x21, 0xA1
_CANCEL, _RESET, _STATUS = 0x64, 0x66, 0x67
_CANCELLED = 0x4001
_STATUS_OK = 0x2001
# How long a camera may report "busy" after a cancelled transaction, and the pause between requests.
_RECOVERY_S, _RECOVERY_POLL_S = 5.0, 0.05


class UsbTransport:
    """The claimed still-image interface of one camera.

    Args:
        device: a pyusb `Device` of any backend
        name: name of the camera in error messages
        clock: for pauses between requests; transfers wait in libusb

    Attributes:
        silence_s: time-out of a transfer

    Raises:
        CameraNotFoundError: it has no still-image interface, or there is no permission
        CameraBusyError: another program holds it
    """

    def __init__(self, device: Any, name: str, clock: Clock) -> None:
        self._device, self._name, self._clock = device, name, clock
        self.silence_s = NORMAL_S
        with typed_usb_errors(name):
            interface = find_interface(device, STILL_IMAGE)
            if interface is None:
                raise CameraNotFoundError(
                    f"{name} has no still-image interface",
                    hint="switch its USB mode to PTP (PC remote), not mass storage",
                )
            self._number = int(interface.bInterfaceNumber)
            self._in = find_endpoint(interface, usb.util.ENDPOINT_TYPE_BULK, is_in=True)
            self._out = find_endpoint(interface, usb.util.ENDPOINT_TYPE_BULK, is_in=False)
            self._events = find_endpoint(interface, usb.util.ENDPOINT_TYPE_INTR, is_in=True)
            if self._in is None or self._out is None:
                raise CameraNotFoundError(
                    f"{name} has a still-image interface without bulk endpoints",
                    hint="use another camera",
                )
            claim_interface(device, self._number, name)
        self._left_over = b""

    # ---- sending

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        body = struct.pack(f"<{len(parameters)}I", *parameters)
        self._write(HEADER.pack(HEADER.size + len(body), _COMMAND, operation, transaction) + body)
        if data is not None:
            size = HEADER.size + len(data)
            self._write(HEADER.pack(size, DATA, operation, transaction) + data)

    def _write(self, data: bytes) -> None:
        with typed_usb_errors(self._name):
            sent = self._out.write(data, self._milliseconds())
            # A transfer that ends with a full packet is closed with an empty one (USB 2.0, 5.8.3).
            if sent == len(data) and sent % self._out.wMaxPacketSize == 0:
                self._out.write(b"", self._milliseconds())
        if sent != len(data):
            raise CameraProtocolError(
                f"{self._name} accepted {sent} of {len(data)} bytes", hint="try again"
            )

    # ---- receiving

    def receive(self, transaction: int, *, limit: int) -> Container:
        """Return the next container of a transaction.

        Accepts empty packets before it; a header in a transfer of its own; data in several short
        transfers; no empty packet after a full last one; the next container in the same transfer
        as the end of this one; and containers of cancelled transactions, which are discarded.

        Args:
            transaction: number of the transaction
            limit: largest plausible payload, bytes

        Raises:
            CameraProtocolError: the bytes are no container, are too long, or belong to a later
                transaction; the pipe must then be recovered
            CameraTimeoutError: nothing came for `silence_s`
        """
        for _ in range(MAX_STALE_CONTAINERS):
            container = self._container(transaction, limit)
            if container.transaction == transaction:
                return container
            if container.transaction > transaction:
                break
        raise self._invalid(
            f"an answer to transaction {container.transaction} instead of {transaction}"
        )

    def _container(self, transaction: int, limit: int) -> Container:
        first, self._left_over = self._left_over, b""
        while len(first) < HEADER.size:
            first += bytes(self._read_transfer(self._in.wMaxPacketSize))
        length, kind, code, number = HEADER.unpack_from(first)
        if kind not in (DATA, RESPONSE) or length < HEADER.size:
            raise self._invalid(f"a container of type {kind} and {length} bytes")
        if length - HEADER.size > (limit if kind == DATA else 4 * MAX_PARAMETERS):
            raise self._invalid(f"a container of {length} bytes")
        if len(first) > length:
            self._left_over = first[length:]
        parts: list[Bytes] = [memoryview(first)[HEADER.size : length]]
        missing = length - len(first)
        while missing > 0:
            part = self._read_transfer(self._piece(missing))
            if len(part) == HEADER.size and self._is_response(part, transaction):
                self._left_over = bytes(part)
                raise IncompleteDataError(
                    f"{self._name} sent {length - missing} of {length} bytes of a container",
                    hint="try again",
                )
            if len(part) > missing:
                self._left_over = bytes(memoryview(part)[missing:])
                parts.append(memoryview(part)[:missing])
            else:
                parts.append(part)
            missing -= len(part)
        return Container(kind, code, number, b"".join(parts))

    def _is_response(self, part: Bytes, transaction: int) -> bool:
        length, kind, code, number = HEADER.unpack(part)
        return (length, kind, number) == (HEADER.size, RESPONSE, transaction) and code >> 12 in (
            0x2,
            0xA,
        )

    def _piece(self, missing: int) -> int:
        """Return the size of the next read: whole packets, so that none overflows."""
        packet = int(self._in.wMaxPacketSize)
        return min(_CHUNK_BYTES, -(-missing // packet) * packet)

    def _read_transfer(self, size: int) -> array[int]:
        """Return the bytes of the next transfer that is not empty."""
        for _ in range(_MAX_EMPTY_READS):
            with typed_usb_errors(self._name):
                part: array[int] = self._in.read(size, self._milliseconds())
            if len(part):
                return part
        raise self._invalid("empty packets only")

    def event(self, wait_s: float) -> Container | None:
        if self._events is None:
            self._pause(wait_s)
            return None
        try:
            with typed_usb_errors(self._name):
                size = max(int(self._events.wMaxPacketSize), _MAX_EVENT_BYTES)
                data = bytes(self._events.read(size, max(1, round(1000 * wait_s))))
        except CameraDisconnectedError:
            raise
        except CameraTimeoutError:
            return None
        except CameraError:  # not needed: object handles are compared too
            self._clear_halt(self._events)
            self._pause(min(wait_s, _EVENT_RETRY_S))
            return None
        if len(data) < HEADER.size:
            return None
        length, kind, code, number = HEADER.unpack_from(data)
        if kind != EVENT or not HEADER.size <= length <= len(data):
            return None
        return Container(kind, code, number, data[HEADER.size : length])

    # ---- recovery

    def recover(self, transaction: int) -> bool:
        """Cancel a transaction, clear halts and discard what is still sent.

        Returns whether the camera is ready again; if it is not, after 5 s, it needs `reset`.

        Raises:
            CameraDisconnectedError: the camera was disconnected
        """
        self._left_over = b""
        self._class_out(_CANCEL, struct.pack("<HI", _CANCELLED, transaction & 0xFFFFFFFF))
        deadline_s = self._clock.now() + _RECOVERY_S
        while True:
            self._clear_halts()
            self._drain()
            status = self._status()
            if status == _STATUS_OK or status is None:
                return status == _STATUS_OK
            if self._clock.now() > deadline_s:
                return False
            self._pause(_RECOVERY_POLL_S)

    def reset(self) -> None:
        """Reset the camera, which closes its session."""
        self._class_out(_RESET, b"")
        self._clear_halts()
        self._drain()

    def _clear_halts(self) -> None:
        self._clear_halt(self._in)
        self._clear_halt(self._out)

    def _drain(self) -> None:
        """Discard what the camera still sends, within limits of time and size."""
        deadline_s, total = self._clock.now() + _DRAIN_S, 0
        while self._clock.now() < deadline_s and total < _DRAIN_BYTES:
            try:
                part = self._in.read(_CHUNK_BYTES, 50)  # ms
            except usb.core.USBError as error:
                self._raise_if_disconnected(error)
                return
            total += len(part)

    def _status(self) -> int | None:
        """Return the device status; None if the camera does not report it."""
        try:
            answer = bytes(self._control(_FROM_INTERFACE, _STATUS, 4 + 2 * 4))
        except usb.core.USBError as error:
            self._raise_if_disconnected(error)
            return None
        return int.from_bytes(answer[2:4], "little") if len(answer) >= 4 else None

    def _class_out(self, request: int, data: bytes) -> None:
        try:
            self._control(_TO_INTERFACE, request, data)
        except usb.core.USBError as error:
            self._raise_if_disconnected(error)

    def _control(self, request_type: int, request: int, data: int | bytes) -> Any:
        return self._device.ctrl_transfer(request_type, request, 0, self._number, data, 1000)  # ms

    def _clear_halt(self, endpoint: Any) -> None:
        try:
            endpoint.clear_halt()
        except usb.core.USBError as error:
            self._raise_if_disconnected(error)

    def _raise_if_disconnected(self, error: usb.core.USBError) -> None:
        if error.errno in (errno.ENODEV, errno.ESHUTDOWN, errno.ENOENT, errno.ENXIO):
            with typed_usb_errors(self._name):
                raise error

    def close(self) -> None:
        with suppress(usb.core.USBError, NotImplementedError):
            usb.util.release_interface(self._device, self._number)
        usb.util.dispose_resources(self._device)

    def _pause(self, seconds: float) -> None:
        self._clock.sleep_until(self._clock.now() + seconds)

    def _milliseconds(self) -> int:
        return round(1000 * self.silence_s)

    def _invalid(self, what: str) -> CameraProtocolError:
        return CameraProtocolError(f"{self._name} sent {what}", hint="try again")
