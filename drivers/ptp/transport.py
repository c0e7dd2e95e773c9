"""PTP containers over USB: the bulk and interrupt pipes of a still camera, and nothing above.

The still image class (USB-IF PIMA 15740, class 6, subclass 1, protocol 1) packs each phase of a
transaction into a container: length u32, type u16, code u16, transaction u32, then parameters or
data.  Devices differ in how they cut containers into transfers; see `UsbTransport.receive` for
what is put up with.
"""

from __future__ import annotations

import errno
import struct
import time
from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import usb.core
import usb.util

from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.common.usb import typed_usb_errors
from drivers.ptp.usb_interface import claim, endpoint, still_interface

Bytes: TypeAlias = "bytes | memoryview | array[int]"

COMMAND, DATA, RESPONSE, EVENT = 1, 2, 3, 4
HEADER = struct.Struct("<IHHI")

#: Seconds of silence after which a camera counts as gone; seen to be enough in the field.
NORMAL_S, CAPTURE_S = 20.0, 100.0

# One read of a large object.  usbfs lends 16 MB to all transfers of the machine together.
_CHUNK = 1 << 20
_EMPTY_READS = 4
_STALE_CONTAINERS = 8
_DRAIN_S, _DRAIN_BYTES = 2.0, 1 << 30
_PARAMETERS = 5
_MOST_EVENT_BYTES = HEADER.size + 4 * 3

# Class requests, PIMA 15740 annex D.5.2.
_TO_INTERFACE, _FROM_INTERFACE = 0x21, 0xA1
_CANCEL, _RESET, _STATUS = 0x64, 0x66, 0x67
_CANCELLED = 0x4001
_STATUS_OK, _STATUS_BUSY = 0x2001, 0x2019
_RECOVERY_S = 5.0


@dataclass(frozen=True)
class Container:
    """A container that has arrived; `payload` is what follows its header."""

    kind: int
    code: int
    transaction: int
    payload: bytes

    @property
    def parameters(self) -> tuple[int, ...]:
        """The payload as 32-bit numbers."""
        count = min(len(self.payload) // 4, _PARAMETERS)
        return struct.unpack_from(f"<{count}I", self.payload)


class UsbTransport:
    """The three pipes of one still camera, claimed.

    Args:
        device: a pyusb `Device` of any backend
        who: how errors call it

    Raises:
        CameraNotFoundError: it has no still-image interface, or there is no permission
        CameraBusyError: another program holds it
    """

    def __init__(self, device: Any, who: str) -> None:
        self.device, self._who = device, who
        self.silence_s = NORMAL_S
        with typed_usb_errors(who):
            self._interface = still_interface(device, who)
            self._number = int(self._interface.bInterfaceNumber)
            self._in = endpoint(self._interface, usb.util.ENDPOINT_TYPE_BULK, is_in=True)
            self._out = endpoint(self._interface, usb.util.ENDPOINT_TYPE_BULK, is_in=False)
            self._events = endpoint(self._interface, usb.util.ENDPOINT_TYPE_INTR, is_in=True)
            if self._in is None or self._out is None:
                raise CameraNotFoundError(
                    f"{who} has a still-image interface without bulk pipes", hint="use another"
                )
            claim(device, self._number, who)
        self._left_over = b""

    # ---- sending

    def send_command(self, code: int, transaction: int, parameters: Sequence[int]) -> None:
        """Send the first phase of a transaction."""
        body = struct.pack(f"<{len(parameters)}I", *parameters)
        self._write(HEADER.pack(HEADER.size + len(body), COMMAND, code, transaction) + body)

    def send_data(self, code: int, transaction: int, data: bytes) -> None:
        """Send the data phase of a transaction."""
        self._write(HEADER.pack(HEADER.size + len(data), DATA, code, transaction) + data)

    def _write(self, data: bytes) -> None:
        with typed_usb_errors(self._who):
            sent = self._out.write(data, self._milliseconds())
            # A transfer that ends with a full packet is closed with an empty one (USB 2.0, 5.8.3).
            if sent == len(data) and sent % self._out.wMaxPacketSize == 0:
                self._out.write(b"", self._milliseconds())
        if sent != len(data):
            raise CameraProtocolError(
                f"{self._who} took {sent} of {len(data)} bytes", hint="try again"
            )

    # ---- receiving

    def receive(self, transaction: int, *, limit: int) -> Container:
        """Return the next container of a transaction.

        Put up with: empty packets before it; a header in a transfer of its own; data in several
        short transfers; no empty packet after a full last one; the next container in the same
        transfer as the end of this one; containers of transactions that were given up.

        Args:
            transaction: whose container is wanted; older ones are read and forgotten
            limit: payload bytes above which its header is not believed

        Raises:
            CameraProtocolError: not a container, too long, or of a transaction yet to come; the
                pipe must then be recovered
            CameraTimeoutError: silence for longer than `silence_s`
        """
        for _ in range(_STALE_CONTAINERS):
            container = self._container(transaction, limit)
            if container.transaction == transaction:
                return container
            if container.transaction > transaction:
                break
        raise self._nonsense(
            f"an answer to transaction {container.transaction}, {transaction} is open"
        )

    def _container(self, transaction: int, limit: int) -> Container:
        first = self._left_over or self._read_something(self._in.wMaxPacketSize)
        self._left_over = b""
        while len(first) < HEADER.size:
            more = self._read_something(self._in.wMaxPacketSize)
            first += more
        length, kind, code, number = HEADER.unpack_from(first)
        if kind not in (DATA, RESPONSE) or length < HEADER.size:
            raise self._nonsense(f"a container of type {kind} and {length} bytes")
        if length - HEADER.size > (limit if kind == DATA else 4 * _PARAMETERS):
            raise self._nonsense(f"a container of {length} bytes")
        if len(first) > length:
            self._left_over = first[length:]
        parts: list[Bytes] = [memoryview(first)[HEADER.size : length]]
        missing = length - len(first)
        while missing > 0:
            part = self._read_some(self._piece(missing))
            if len(part) == HEADER.size and self._is_response(part, transaction):
                self._left_over = bytes(part)
                raise HalfSentError(
                    f"{self._who} broke off {missing} bytes before the end of {length}",
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
        """Return how much the next read asks for: whole packets, so that none is too large."""
        packet = int(self._in.wMaxPacketSize)
        return min(_CHUNK, -(-missing // packet) * packet)

    def _read_something(self, size: int) -> bytes:
        return bytes(self._read_some(size))

    def _read_some(self, size: int) -> array[int]:
        """Return what one transfer brings, which is more than nothing."""
        for _ in range(_EMPTY_READS):
            with typed_usb_errors(self._who):
                part: array[int] = self._in.read(size, self._milliseconds())
            if len(part):
                return part
        raise self._nonsense("nothing but empty packets")

    def event(self, wait_s: float) -> Container | None:
        """Return the next event, or None where none came within `wait_s`.

        Raises `CameraDisconnectedError`; an event that makes no sense is none.
        """
        if self._events is None:
            time.sleep(wait_s)
            return None
        try:
            with typed_usb_errors(self._who):
                size = max(int(self._events.wMaxPacketSize), _MOST_EVENT_BYTES)
                data = bytes(self._events.read(size, max(1, round(1000 * wait_s))))
        except CameraDisconnectedError:
            raise
        except CameraTimeoutError:
            return None
        except CameraError:  # a halted event pipe must not end a capture: handles are compared too
            self._clear_halt(self._events)
            time.sleep(min(wait_s, 0.05))
            return None
        if len(data) < HEADER.size:
            return None
        length, kind, code, number = HEADER.unpack_from(data)
        if kind != EVENT or not HEADER.size <= length <= len(data):
            return None
        return Container(kind, code, number, data[HEADER.size : length])

    # ---- recovery

    def recover(self, transaction: int) -> bool:
        """Give up a transaction: cancel it, clear halts, read what is still under way.

        Returns False where the camera does not come back to itself within `_RECOVERY_S`; it then
        wants `reset`.  Raises `CameraDisconnectedError`.
        """
        self._left_over = b""
        self._class_out(_CANCEL, struct.pack("<HI", _CANCELLED, transaction & 0xFFFFFFFF))
        deadline = time.monotonic() + _RECOVERY_S
        while True:
            self._clear_halts()
            self._drain()
            status = self._status()
            if status == _STATUS_OK or status is None:
                return status == _STATUS_OK
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)

    def reset(self) -> None:
        """Ask the camera to start anew; its session is closed afterwards."""
        self._class_out(_RESET, b"")
        self._clear_halts()
        self._drain()

    def _clear_halts(self) -> None:
        self._clear_halt(self._in)
        self._clear_halt(self._out)

    def _drain(self) -> None:
        """Read what the camera still sends, within bounds of time and size."""
        deadline, total = time.monotonic() + _DRAIN_S, 0
        while time.monotonic() < deadline and total < _DRAIN_BYTES:
            try:
                part = self._in.read(_CHUNK, 50)
            except usb.core.USBError as error:
                self._check_gone(error)
                return
            total += len(part)

    def _status(self) -> int | None:
        """Return the device status, or None where the camera does not tell."""
        try:
            answer = bytes(self._control(_FROM_INTERFACE, _STATUS, 4 + 2 * 4))
        except usb.core.USBError as error:
            self._check_gone(error)
            return None
        return int.from_bytes(answer[2:4], "little") if len(answer) >= 4 else None

    def _class_out(self, request: int, data: bytes) -> None:
        try:
            self._control(_TO_INTERFACE, request, data)
        except usb.core.USBError as error:
            self._check_gone(error)

    def _control(self, request_type: int, request: int, data: int | bytes) -> Any:
        return self.device.ctrl_transfer(request_type, request, 0, self._number, data, 1000)

    def _clear_halt(self, endpoint: Any) -> None:
        try:
            endpoint.clear_halt()
        except usb.core.USBError as error:
            self._check_gone(error)

    def _check_gone(self, error: usb.core.USBError) -> None:
        if error.errno in (errno.ENODEV, errno.ESHUTDOWN, errno.ENOENT, errno.ENXIO):
            with typed_usb_errors(self._who):
                raise error

    # ---- the rest

    def close(self) -> None:
        """Let go of the interface; a camera that is gone already is no error."""
        with suppress(usb.core.USBError, NotImplementedError):
            usb.util.release_interface(self.device, self._number)
        usb.util.dispose_resources(self.device)

    def _milliseconds(self) -> int:
        return round(1000 * self.silence_s)

    def _nonsense(self, why: str) -> CameraProtocolError:
        return CameraProtocolError(f"{self._who} sent {why}", hint="try again")


class HalfSentError(CameraProtocolError):
    """A data phase ended too early; the transaction itself was answered."""
