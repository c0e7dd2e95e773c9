"""Faults of the virtual PTP camera, and arbitrary input from a host."""

from __future__ import annotations

import errno
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ptp_initiator import OK, Initiator, connected, make_camera, numbers
from sampling import some

from camctl.sim.devices.usb.device import Port, UsbDevice

NO_SESSION = 0x2003


class Socket(Port):
    """A port that a device is plugged into."""

    def __init__(self, device: UsbDevice) -> None:
        self.device = device

    def attach(self, device: UsbDevice) -> None:
        device.connect()

    def detach(self) -> None:
        self.device.disconnect()


def test_a_stall_lasts_until_the_halts_are_cleared() -> None:
    device, host = connected()
    device.do("stall")
    host.write(1, 0x1004)
    assert host.must_read()[0] == errno.EPIPE
    assert host.write(1, 0x1004) == errno.EPIPE
    status = device.request(0xA1, 0x67, 0, 0, 64, b"")
    assert isinstance(status, bytes)
    length, code, *halted = struct.unpack("<HHII", status)
    assert (length, code, halted) == (12, 0x201F, [0x81, 0x02])
    for endpoint in halted:
        assert device.request(0x02, 1, 0, endpoint, 0, b"") == b""
    assert device.request(0xA1, 0x67, 0, 0, 64, b"") == struct.pack("<HH", 4, OK)
    host.do(0x1004)


@pytest.mark.parametrize("form", ["enum", "range"])
def test_shutter_times_are_silently_cut(form: str) -> None:
    device, host = connected(time_form=form)
    device.do("clamp", max_s=0.005)
    host.do(0x1016, 0x500D, data=struct.pack("<I", 1000))
    assert host.get(0x1015, 0x500D) == struct.pack("<I", 50)


def test_a_camera_that_was_unplugged_has_no_session_but_its_pictures() -> None:
    device, host = connected()
    device.port = Socket(device)
    host.do(0x100E, 0, 0)
    device.do("unplug")
    assert host.must_read()[0] == errno.ENODEV
    assert host.write(1, 0x1004) == errno.ENODEV
    device.do("plug")
    device.body.wait()
    again = Initiator(device)
    assert again.response(0x1004) == NO_SESSION
    again.do(0x1002, 1)
    # The exposure that was running is on the card.
    (handle,) = numbers(again.get(0x1007, 0xFFFFFFFF, 0x3801, 0))
    assert again.get(0x1009, handle)[:2] == b"\xff\xd8"


@pytest.mark.parametrize("after", [0, 5000])
def test_unplugged_in_the_middle_of_an_object(after: int) -> None:
    device, host = connected(object_bytes=100_000)
    device.port = Socket(device)
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    device.do("unplug", after_bytes=after)
    host.write(1, 0x1009, struct.pack("<I", handle))
    error, data = host.must_read()
    assert error == errno.ENODEV
    assert len(data) == after // 512 * 512
    assert not device.is_attached


def test_a_camera_is_unplugged_even_if_the_host_reads_nothing() -> None:
    device, host = connected(object_bytes=100_000)
    device.port = Socket(device)
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    device.do("unplug", after_bytes=5000)
    host.write(1, 0x1009, struct.pack("<I", handle))
    host.sleep(1.9)
    assert device.is_attached
    host.sleep(0.2)
    assert not device.is_attached


def test_the_queues_for_a_host_that_reads_nothing_are_limited() -> None:
    device = make_camera()
    device.connect()
    device.write(2, struct.pack("<IHHII", 16, 1, 0x1002, 0, 1))
    for transaction in range(1, 500):
        device.write(2, struct.pack("<IHHI", 12, 1, 0x1001, transaction))
        value = struct.pack("<I", 100 if transaction % 2 else 80)
        device.write(2, struct.pack("<IHHII", 16, 1, 0x1016, transaction, 0x500D))
        device.write(2, struct.pack("<IHHI", 16, 2, 0x1016, transaction) + value)
    assert device.pending(1) <= 16
    assert device.pending(3) <= 64


def container(kind: int, code: int, body: bytes) -> bytes:
    return struct.pack("<IHHI", 12 + len(body), kind, code, 7) + body


OPERATIONS = st.sampled_from(
    [*range(0x1000, 0x101D), *range(0x90C0, 0x90CB), *range(0x9101, 0x9128), *range(0x9201, 0x920D)]
)
PROPERTIES = (0x500D, 0x5004, 0xD100, 0xD102, 0xD20D, 0xD2C1, 0xD2C2)
HANDLES = (0x00010001, 0x10000001, 0x20000001, 0xFFFF0001, 0xFFFFC001, 0xFFFFFFFF)
PARAMETERS = st.sampled_from([*range(5), *PROPERTIES, *HANDLES])
COMMANDS = st.builds(
    lambda code, parameters: container(1, code, struct.pack(f"<{len(parameters)}I", *parameters)),
    OPERATIONS,
    st.lists(st.one_of(PARAMETERS, st.integers(0, 2**32 - 1)), max_size=5),
)
DATA_PHASES = st.builds(
    lambda code, body: container(2, code, body), OPERATIONS, st.binary(max_size=40)
)
HEADERS = st.builds(
    struct.Struct("<IHHI").pack, st.integers(0, 2**32 - 1), OPERATIONS, OPERATIONS, PARAMETERS
)
TRANSFERS = st.lists(
    st.one_of(
        COMMANDS,
        DATA_PHASES,
        st.tuples(COMMANDS, DATA_PHASES).map(b"".join),
        st.binary(max_size=80),
        HEADERS,
    ),
    max_size=30,
)
REQUESTS = st.lists(
    st.tuples(
        st.integers(0, 255), st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)
    ),
    max_size=5,
)


@pytest.mark.parametrize("vendor", some(["none", "nikon", "canon", "sony"], every=3))
@given(transfers=TRANSFERS, requests=REQUESTS, has_handshake=st.booleans())
def test_after_any_transfers_and_requests_a_reset_makes_the_camera_usable(
    vendor: str, transfers: list[bytes], requests: list[tuple[int, ...]], has_handshake: bool
) -> None:
    options: dict[str, Any] = {
        "size": "8x8",
        "vendor": vendor,
        "bulb": True,
        "times": ["1/1000", "1/500"],
        "files": ["jpeg", "dng+jpeg"],
    }
    device = make_camera(**options)
    host = Initiator(device)
    host.do(0x1002, 1)
    if has_handshake and vendor == "canon":
        host.do(0x9114, 1)
        host.do(0x9115, 1)
    if has_handshake and vendor == "sony":
        for code, step in ((0x9201, 1), (0x9201, 2), (0x9201, 3)):
            host.do(code, step)
    for transfer in transfers:
        device.write(2, transfer)
        assert len(device._buffer) <= 2 * 64 * 1024
        assert device.pending(1) <= 16
    for kind, request, value, index in requests:
        device.request(kind, request, value, index, 64, b"")
    device.body.end_bulb()
    device.body.wait()
    device.request(0x21, 0x66, 0, 0, 0, b"")
    for endpoint in (0x81, 0x02):
        device.request(0x02, 1, 0, endpoint, 0, b"")
    host.do(0x1001)
    host.do(0x1002, 1)
    host.do(0x1004)
