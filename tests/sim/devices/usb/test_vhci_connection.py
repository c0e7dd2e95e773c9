"""USB/IP between a virtual device and the kernel; the test takes the part of the kernel."""

from __future__ import annotations

import errno
import socket
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from camctl.sim.devices.usb.device import NO_REPLY, STALL, ControlReply, UsbDevice
from camctl.sim.devices.usb.vhci import UsbIpConnection

SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
OUT, IN = 0, 1
STALLED, UNANSWERED, GREETING = 1, 2, 3  # vendor requests
_REPLIES: dict[int, ControlReply] = {STALLED: STALL, UNANSWERED: NO_REPLY, GREETING: b"hello"}


class Device(UsbDevice):
    """A device that sends back what it receives."""

    device_descriptor = bytes(18)
    configuration_descriptor = (
        struct.pack("<BBHBBBBB", 9, 2, 9 + 9 + 14, 1, 1, 0, 0x80, 50)
        + struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 2, 255, 1, 1, 0)
        + struct.pack("<BBBBHB", 7, 5, 0x81, 2, 64, 0)
        + struct.pack("<BBBBHB", 7, 5, 0x02, 2, 64, 0)
    )

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        return _REPLIES[request]

    def received(self, endpoint: int, data: bytes) -> None:
        self.send(1, data)


@dataclass(frozen=True)
class Reply:
    command: int
    number: int
    status: int
    data: bytes = b""


class Kernel:
    """The kernel's end of a connection; sequence numbers increase as in the kernel."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._last = 99
        self._reads: set[int] = set()  # transfers to the host, whose results have data

    def number(self) -> int:
        """Return the next sequence number."""
        self._last += 1
        return self._last

    def submit(
        self,
        direction: int,
        endpoint: int,
        length: int,
        *,
        data: bytes = b"",
        setup: bytes = bytes(8),
        number: int | None = None,
    ) -> int:
        """Send a transfer; return its sequence number."""
        number = self.number() if number is None else number
        if direction == IN:
            self._reads.add(number)
        header = struct.pack(">5I", SUBMIT, number, 0, direction, endpoint)
        header += struct.pack(">Iiiii", 0, length, 0, 0, 0) + setup
        self._channel.sendall(header + data)
        return number

    def control(self, request: int) -> int:
        """Send a vendor request for up to 64 bytes; return its sequence number."""
        return self.submit(IN, 0, 64, setup=struct.pack("<BBHHH", 0xC0, request, 0, 0, 64))

    def unlink(self, cancelled: int) -> int:
        """Request the end of a transfer; return the request's sequence number."""
        number = self.number()
        header = struct.pack(">5I", UNLINK, number, 0, 0, 0)
        self._channel.sendall(header + struct.pack(">I24x", cancelled))
        return number

    def reply(self) -> Reply:
        """Return the next reply of the device."""
        header = self._receive(48)
        command, number = struct.unpack_from(">II", header)
        status, length = struct.unpack_from(">ii", header, 20)
        data = b""
        if command == SUBMITTED and number in self._reads:
            data = self._receive(length)
        return Reply(command, number, -status, data)

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self._channel.recv(size - len(data))
            assert part, "the device has ended the connection"
            data += part
        return data


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def kernel(device: Device) -> Iterator[Kernel]:
    ours, theirs = socket.socketpair()
    connection = UsbIpConnection(device, 0, ours)
    device.connect()
    thread = threading.Thread(target=connection.serve)
    thread.start()
    yield Kernel(theirs)
    theirs.close()
    thread.join()
    assert not device.is_attached


@pytest.mark.parametrize(
    ("request_number", "status", "data"), [(GREETING, 0, b"hello"), (STALLED, errno.EPIPE, b"")]
)
def test_control_requests(kernel: Kernel, request_number: int, status: int, data: bytes) -> None:
    request = kernel.control(request_number)
    assert kernel.reply() == Reply(SUBMITTED, request, status, data)


def test_a_cancelled_read_ends_before_the_reply_to_its_unlink_request(kernel: Kernel) -> None:
    read = kernel.submit(IN, 1, 64)
    unlink = kernel.unlink(read)
    assert kernel.reply() == Reply(SUBMITTED, read, errno.ECONNRESET)
    assert kernel.reply() == Reply(UNLINKED, unlink, 0)


def test_a_cancelled_read_returns_the_bytes_it_has(kernel: Kernel, device: Device) -> None:
    device.zero_length.clear()
    read = kernel.submit(IN, 1, 1024)
    write = kernel.submit(OUT, 2, 64, data=bytes(64))
    assert kernel.reply() == Reply(SUBMITTED, write, 0)
    unlink = kernel.unlink(read)
    assert kernel.reply() == Reply(SUBMITTED, read, errno.ECONNRESET, bytes(64))
    assert kernel.reply() == Reply(UNLINKED, unlink, 0)


def test_an_unlink_request_for_a_transfer_that_has_ended(kernel: Kernel) -> None:
    request = kernel.control(GREETING)
    assert kernel.reply().data == b"hello"
    unlink = kernel.unlink(request)
    assert kernel.reply() == Reply(UNLINKED, unlink, 0)


def test_a_control_request_without_reply_is_cancelled(kernel: Kernel) -> None:
    request = kernel.control(UNANSWERED)
    unlink = kernel.unlink(request)
    assert kernel.reply() == Reply(UNLINKED, unlink, errno.ECONNRESET)


def test_an_unlink_request_may_come_before_its_transfer(kernel: Kernel) -> None:
    cancelled = kernel.number()
    unlink = kernel.unlink(cancelled)
    kernel.submit(IN, 1, 64, number=cancelled)
    assert kernel.reply() == Reply(SUBMITTED, cancelled, errno.ECONNRESET)
    assert kernel.reply() == Reply(UNLINKED, unlink, 0)
    # The cancelled read takes no data from a later one.
    read = kernel.submit(IN, 1, 64)
    write = kernel.submit(OUT, 2, 3, data=b"abc")
    assert kernel.reply() == Reply(SUBMITTED, read, 0, b"abc")
    assert kernel.reply() == Reply(SUBMITTED, write, 0)
