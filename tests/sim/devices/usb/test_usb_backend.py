"""A virtual USB device through pyusb on the in-process backend: transfers, halts, unplugging."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import usb.core
import usb.util
from hypothesis import given
from hypothesis import strategies as st
from virtual_usb_bus import VirtualBackend

from camctl.errors import UsageError
from camctl.sim.devices.clock import DeviceClock, VirtualDeviceClock
from camctl.sim.devices.usb.device import NO_REPLY, STALL, ControlReply, UsbDevice

PACKET = 64
BULK_IN, BULK_OUT, EVENTS = 0x81, 0x02, 0x83
STALLED, UNANSWERED, GREETING = 1, 2, 3  # vendor requests


class Echo(UsbDevice):
    """A device that sends back what it receives."""

    device_descriptor = struct.pack(
        "<BBHBBBBHHHBBBB", 18, 1, 0x200, 0, 0, 0, 64, 0x1D6B, 0x0101, 0x100, 1, 2, 3, 1
    )
    configuration_descriptor = (
        struct.pack("<BBHBBBBB", 9, 2, 9 + 9 + 4 + 21, 1, 1, 0, 0x80, 50)
        + struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 3, 255, 1, 1, 0)
        + b"\x04\x24\x07\x08"
        + struct.pack("<BBBBHB", 7, 5, BULK_IN, 2, PACKET, 0)
        + struct.pack("<BBBBHB", 7, 5, BULK_OUT, 2, PACKET, 0)
        + struct.pack("<BBBBHB", 7, 5, EVENTS, 3, 24, 8)
    )
    strings = ("", "Maker", "Écho", "0001")

    def __init__(self, clock: DeviceClock | None = None) -> None:
        super().__init__(clock=clock if clock is not None else VirtualDeviceClock())
        self.cleared: list[int] = []

    def control(
        self, request_type: int, request: int, value: int, index: int, length: int, data: bytes
    ) -> ControlReply:
        replies: dict[int, ControlReply] = {
            STALLED: STALL,
            UNANSWERED: NO_REPLY,
            GREETING: b"hello",
        }
        return replies[request]

    def received(self, endpoint: int, data: bytes) -> None:
        self.send(1, data)

    def halt_cleared(self, endpoint: int) -> None:
        self.cleared.append(endpoint)


@pytest.fixture
def device() -> Echo:
    return Echo()


@pytest.fixture
def backend(device: Echo) -> VirtualBackend:
    return VirtualBackend([device])


@pytest.fixture
def host(backend: VirtualBackend) -> Iterator[Any]:
    found = usb.core.find(backend=backend)
    yield found
    usb.util.dispose_resources(found)


def error_number(call: Callable[..., Any], *arguments: Any) -> int | None:
    """Return the errno of the USBError that a call raises."""
    with pytest.raises(usb.core.USBError) as caught:
        call(*arguments)
    number: int | None = caught.value.errno
    return number


def test_descriptors_and_strings(host: Any) -> None:
    configuration = host.get_active_configuration()
    interface = configuration[0, 0]
    assert interface.bInterfaceClass == 255
    assert bytes(interface.extra_descriptors) == b"\x04\x24\x07\x08"
    assert [e.bEndpointAddress for e in interface] == [BULK_IN, BULK_OUT, EVENTS]
    assert interface[2].wMaxPacketSize == 24
    assert (host.manufacturer, host.product, host.serial_number) == ("Maker", "Écho", "0001")
    assert host.bus == 250


@given(
    sizes=st.lists(st.integers(1, 300), max_size=6), buffer=st.sampled_from([64, 128, 192, 1024])
)
def test_a_short_or_empty_packet_ends_each_transfer(sizes: list[int], buffer: int) -> None:
    device = Echo()
    host = usb.core.find(backend=VirtualBackend([device]))
    for number, size in enumerate(sizes):
        host.write(BULK_OUT, bytes([number]) * size)
    for number, size in enumerate(sizes):
        data = b""
        while True:
            part = bytes(host.read(BULK_IN, buffer, 1000))
            data += part
            if len(part) < buffer:
                break
        assert data == bytes([number]) * size
    assert device.pending(1) == 0


def test_a_read_waits_after_whole_packets_without_an_empty_one(device: Echo, host: Any) -> None:
    device.zero_length.discard(1)
    device.send(1, b"a" * PACKET)
    began_s = device.clock.now()
    assert bytes(host.read(BULK_IN, 2 * PACKET, 100)) == b"a" * PACKET
    assert device.clock.now() - began_s == pytest.approx(0.1)
    device.send(1, b"a" * PACKET)
    assert bytes(host.read(BULK_IN, PACKET, 1000)) == b"a" * PACKET
    assert error_number(host.read, BULK_IN, PACKET, 20) == errno.ETIMEDOUT


def test_the_empty_packet_is_read_alone_after_a_full_buffer(device: Echo, host: Any) -> None:
    device.send(1, b"a" * PACKET)
    assert len(host.read(BULK_IN, PACKET, 1000)) == PACKET
    assert len(host.read(BULK_IN, PACKET, 1000)) == 0


def test_a_packet_larger_than_the_buffer_is_lost(device: Echo, host: Any) -> None:
    device.send(1, b"a" * 30)
    device.send(1, b"b")
    assert error_number(host.read, BULK_IN, 12, 100) == errno.EOVERFLOW
    assert bytes(host.read(BULK_IN, 12, 100)) == b"b"


@pytest.mark.parametrize("timeout_ms", [20, 3000])
def test_a_transfer_without_reply_times_out(device: Echo, host: Any, timeout_ms: int) -> None:
    began_s = device.clock.now()
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        host.read(EVENTS, 24, timeout_ms)
    assert caught.value.errno == errno.ETIMEDOUT
    assert device.clock.now() - began_s == pytest.approx(timeout_ms / 1000)
    with pytest.raises(usb.core.USBTimeoutError):
        host.ctrl_transfer(0xC0, UNANSWERED, 0, 0, 10, timeout_ms)
    assert device.clock.now() - began_s == pytest.approx(2 * timeout_ms / 1000)


def test_control_requests_reply_stall_and_truncate(host: Any) -> None:
    assert bytes(host.ctrl_transfer(0xC0, GREETING, 0, 0, 64)) == b"hello"
    assert bytes(host.ctrl_transfer(0xC0, GREETING, 0, 0, 2)) == b"he"
    assert error_number(host.ctrl_transfer, 0xC0, STALLED, 0, 0, 64) == errno.EPIPE


@pytest.mark.parametrize("endpoint", [BULK_IN, BULK_OUT])
def test_a_halt_lasts_until_it_is_cleared(device: Echo, host: Any, endpoint: int) -> None:
    def transfer() -> None:
        if endpoint == BULK_IN:
            host.read(endpoint, 64, 100)
        else:
            host.write(endpoint, b"x")

    device.send(1, b"after")
    device.stall(endpoint)
    assert error_number(transfer) == errno.EPIPE
    assert error_number(transfer) == errno.EPIPE
    assert bytes(host.ctrl_transfer(0x82, 0, 0, endpoint, 2)) == b"\1\0"
    host.clear_halt(endpoint)
    transfer()
    assert device.cleared == [endpoint]


def test_a_device_that_is_plugged_in_again_has_a_new_address(
    device: Echo, backend: VirtualBackend, host: Any
) -> None:
    assert host.write(BULK_OUT, b"left over") == 9
    device.do("unplug")
    assert usb.core.find(backend=backend) is None
    device.do("plug")
    assert error_number(host.write, BULK_OUT, b"x") == errno.ENODEV
    again = usb.core.find(backend=backend)
    assert again.address != host.address
    assert error_number(again.read, BULK_IN, 64, 20) == errno.ETIMEDOUT


def test_control_commands_of_every_device(device: Echo) -> None:
    with pytest.raises(UsageError, match="command 'xyzzy'; known: plug, state, unplug"):
        device.do("xyzzy")
    assert device.do("state") == {}


def test_a_device_without_a_port_cannot_be_attached() -> None:
    with pytest.raises(UsageError, match="the virtual device has no port"):
        Echo().attach()
