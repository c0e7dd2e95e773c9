"""A device's endpoints as the bus has them, through pyusb on the in-process backend."""

import errno
import struct
import threading
import time

import pytest
import usb.core
import usb.util
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import UsageError
from sim.devices.usb.backend import VirtualBackend
from sim.devices.usb.device import SILENCE, STALL, Answer, UsbDevice

PACKET = 64
BULK_IN, BULK_OUT, EVENTS = 0x81, 0x02, 0x83


class Echo(UsbDevice):
    """Sends back what it is sent; vendor request 1 is refused, 2 never answered, 3 a greeting."""

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

    def __init__(self):
        super().__init__()
        self.cleared = []

    def control(self, request_type, request, value, index, length, data) -> Answer:
        return {1: STALL, 2: SILENCE, 3: b"hello"}[request]

    def received(self, endpoint, data):
        self.send(1, data)

    def halt_cleared(self, endpoint):
        self.cleared.append(endpoint)


@pytest.fixture
def device():
    return Echo()


@pytest.fixture
def backend(device):
    return VirtualBackend([device])


@pytest.fixture
def host(backend):
    found = usb.core.find(backend=backend)
    yield found
    usb.util.dispose_resources(found)


def failure(call, *arguments, **options):
    with pytest.raises(usb.core.USBError) as info:
        call(*arguments, **options)
    return info.value.errno


def test_it_is_found_by_its_numbers_and_class(backend):
    assert usb.core.find(backend=backend, idVendor=0x1D6B, idProduct=0x0101) is not None
    assert usb.core.find(backend=backend, idVendor=0x1D6B, idProduct=0x0102) is None


def test_descriptors_and_strings(host):
    configuration = host.get_active_configuration()
    interface = configuration[0, 0]
    assert interface.bInterfaceClass == 255
    assert bytes(interface.extra_descriptors) == b"\x04\x24\x07\x08"
    assert [e.bEndpointAddress for e in interface] == [BULK_IN, BULK_OUT, EVENTS]
    assert interface[2].wMaxPacketSize == 24
    assert (host.manufacturer, host.product, host.serial_number) == ("Maker", "Écho", "0001")
    assert host.bus == 250


def test_bytes_go_there_and_back(host):
    assert host.write(BULK_OUT, b"abc") == 3
    assert host.read(BULK_IN, 512).tobytes() == b"abc"


@given(
    sizes=st.lists(st.integers(1, 300), max_size=6), buffer=st.sampled_from([64, 128, 192, 1024])
)
def test_transfers_arrive_whole_and_end_where_they_ended(sizes, buffer):
    """With empty packets at their ends, reads of any whole number of packets find the ends."""
    device = Echo()
    host = usb.core.find(backend=VirtualBackend([device]))
    for number, size in enumerate(sizes):
        host.write(BULK_OUT, bytes([number]) * size)
    for number, size in enumerate(sizes):
        data = b""
        while True:
            part = host.read(BULK_IN, buffer, 1000).tobytes()
            data += part
            if len(part) < buffer:
                break
        assert data == bytes([number]) * size
    assert device.pending(1) == 0


def test_without_an_empty_packet_a_read_goes_on_waiting(device, host):
    """The trap: whole packets, no empty one, and a read that asked for more."""
    device.zero_length.discard(1)
    device.send(1, b"a" * PACKET)
    began = time.monotonic()
    assert host.read(BULK_IN, 2 * PACKET, 100).tobytes() == b"a" * PACKET
    assert time.monotonic() - began > 0.09
    device.send(1, b"a" * PACKET)
    assert host.read(BULK_IN, PACKET, 1000).tobytes() == b"a" * PACKET
    assert failure(host.read, BULK_IN, PACKET, 20) == errno.ETIMEDOUT


def test_the_empty_packet_comes_by_itself_after_a_full_buffer(device, host):
    device.send(1, b"a" * PACKET)
    assert len(host.read(BULK_IN, PACKET, 1000)) == PACKET
    assert len(host.read(BULK_IN, PACKET, 1000)) == 0


def test_a_packet_larger_than_the_buffer_is_lost(device, host):
    device.send(1, b"a" * 30)
    device.send(1, b"b")
    assert failure(host.read, BULK_IN, 12, 100) == errno.EOVERFLOW
    assert host.read(BULK_IN, 12, 100).tobytes() == b"b"


def test_silence_is_a_timeout(host):
    with pytest.raises(usb.core.USBTimeoutError) as info:
        host.read(EVENTS, 24, 20)
    assert info.value.errno == errno.ETIMEDOUT
    with pytest.raises(usb.core.USBTimeoutError):
        host.ctrl_transfer(0xC0, 2, 0, 0, 10, 20)


def test_control_requests(host):
    assert host.ctrl_transfer(0xC0, 3, 0, 0, 64).tobytes() == b"hello"
    assert host.ctrl_transfer(0xC0, 3, 0, 0, 2).tobytes() == b"he"
    assert failure(host.ctrl_transfer, 0xC0, 1, 0, 0, 64) == errno.EPIPE


@pytest.mark.parametrize("endpoint", [BULK_IN, BULK_OUT])
def test_a_halt_lasts_until_it_is_cleared(device, host, endpoint):
    def use():
        return host.read(endpoint, 64, 100) if endpoint & 0x80 else host.write(endpoint, b"x")

    device.send(1, b"after")
    device.stall(endpoint)
    assert failure(use) == errno.EPIPE
    assert failure(use) == errno.EPIPE
    assert host.ctrl_transfer(0x82, 0, 0, endpoint, 2).tobytes() == b"\1\0"
    host.clear_halt(endpoint)
    use()
    assert device.cleared == [endpoint]


def test_unplugging_ends_a_read_and_all_that_follows(device, host):
    host.set_configuration()
    usb.util.claim_interface(host, 0)
    threading.Timer(0.05, device.do, ["unplug"]).start()
    assert failure(host.read, BULK_IN, 64, 5000) == errno.ENODEV
    assert failure(host.write, BULK_OUT, b"x") == errno.ENODEV
    assert failure(host.ctrl_transfer, 0xC0, 3, 0, 0, 64) == errno.ENODEV


def test_after_replugging_it_is_another_device(device, backend, host):
    assert host.write(BULK_OUT, b"left over") == 9
    device.do("unplug")
    assert usb.core.find(backend=backend) is None
    device.do("plug")
    assert failure(host.write, BULK_OUT, b"x") == errno.ENODEV
    again = usb.core.find(backend=backend)
    assert again.address != host.address
    assert failure(again.read, BULK_IN, 64, 20) == errno.ETIMEDOUT


def test_an_interface_is_one_hosts(backend, device, host):
    other = next(iter(usb.core.find(backend=backend, find_all=True)))
    usb.util.claim_interface(host, 0)
    assert failure(usb.util.claim_interface, other, 0) == errno.EBUSY
    usb.util.release_interface(host, 0)
    usb.util.claim_interface(other, 0)
    usb.util.release_interface(other, 0)
    backend.hold(device)
    assert failure(host.read, BULK_IN, 64, 20) == errno.EBUSY
    backend.let_go(device)
    assert host.is_kernel_driver_active(0) is False


def test_permission_is_a_thing_of_the_backend(backend, device, host):
    backend.forbidden.add(device)
    assert failure(host.get_active_configuration) == errno.EACCES


def test_resetting_forgets_what_was_queued(device, host):
    device.send(1, b"old")
    host.reset()
    assert failure(host.read, BULK_IN, 64, 20) == errno.ETIMEDOUT


def test_an_unknown_verb(device):
    with pytest.raises(UsageError, match="known: plug, state, unplug"):
        device.do("xyzzy")
    assert device.do("state") == {}
