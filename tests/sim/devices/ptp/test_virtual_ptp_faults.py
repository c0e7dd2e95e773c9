"""Faults of the virtual PTP camera, and arbitrary input from a host."""

from __future__ import annotations

import errno
import io
import struct
import threading
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from ptp_initiator import BUSY, OK, Initiator, connected, make_camera, numbers
from sampling import some

from camctl.errors import UsageError
from camctl.sim.devices.clock import RealDeviceClock
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


def test_busy_for_some_operations_or_until_ok() -> None:
    device, host = connected()
    device.do("busy", count=2)
    assert [host.response(0x1004) for _ in range(3)] == [BUSY, BUSY, OK]
    device.do("busy", count=-1)
    assert host.response(0x100E, 0, 0) == BUSY
    host.do(0x1001)
    device.do("ok")
    host.do(0x1004)


def test_a_hanging_camera_answers_nothing_until_ok() -> None:
    device, host = connected()
    device.do("hang")
    host.write(1, 0x1004)
    assert host.read(timeout_s=60.0) is None
    device.do("ok")
    host.do(0x1004)


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


@pytest.mark.parametrize("answers", [False, True])
def test_half_of_an_object_is_sent(answers: bool) -> None:
    device, host = connected(object_bytes=10_000)
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    device.do("truncate", answers=answers)
    host.write(1, 0x1009, struct.pack("<I", handle))
    error, data = host.must_read()
    assert error == 0
    assert struct.unpack_from("<I", data) == (10_012,)
    assert 4000 < len(data) < 6000
    response = host.read()
    assert (response is not None) == answers
    # By its response the camera counts the object as read.
    assert (device.do("log")["shots"][0]["downloaded_s"] is not None) == answers
    host.transaction += 1
    assert len(host.get(0x1009, handle)) == 10_000
    assert device.do("log")["shots"][0]["downloaded_s"] is not None


def test_random_bytes_instead_of_a_reply() -> None:
    device, host = connected()
    device.do("garbage")
    host.write(1, 0x1004)
    error, data = host.must_read()
    assert error == 0
    assert struct.unpack_from("<IHHI", data)[0] != len(data)
    host.transaction += 1
    host.do(0x1004)


def test_a_full_card_and_an_empty_battery_refuse_captures() -> None:
    device, host = connected()
    device.do("card_full")
    assert host.response(0x100E, 0, 0) == 0x200C
    assert host.event()[0] == 0x400A
    device.do("ok")
    device.do("battery_low")
    assert host.response(0x100E, 0, 0) == 0x2002
    assert host.get(0x1015, 0x5001) == b"\x03"
    device.do("ok")
    host.do(0x100E, 0, 0)


def test_one_wrong_exposure() -> None:
    device, host = connected(files="tiff", repeat_noise=True)
    host.do(0x1016, 0x500D, data=struct.pack("<I", 100))
    device.do("wrong_exposure", factor=2.0, count=1)
    for time_s in (0.02, 0.01):
        picture = tifffile.imread(io.BytesIO(host.shoot()))
        assert np.array_equal(picture, device.body.sensor.expose(time_s))


@pytest.mark.parametrize("form", ["enum", "range"])
def test_shutter_times_are_silently_cut(form: str) -> None:
    device, host = connected(time_form=form)
    device.do("clamp", max_s=0.005)
    host.do(0x1016, 0x500D, data=struct.pack("<I", 1000))
    assert host.get(0x1015, 0x500D) == struct.pack("<I", 50)


def test_no_events_until_ok() -> None:
    device, host = connected()
    device.do("no_events")
    host.do(0x100E, 0, 0)
    device.body.wait()
    assert not host.events
    device.do("ok")
    host.shoot()


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


def test_a_negative_number_of_bytes_before_unplugging_is_refused() -> None:
    device, _ = connected()
    with pytest.raises(UsageError, match="invalid after_bytes -1: expected 0 or more"):
        device.do("unplug", after_bytes=-1)


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


def test_control_commands_in_another_thread_during_captures_in_real_time() -> None:
    device, host = connected(clock=RealDeviceClock())
    stop = threading.Event()

    def pester() -> None:
        while not stop.wait(0.001):
            device.do("state")
            device.do("log")

    thread = threading.Thread(target=pester)
    thread.start()
    try:
        for _ in range(5):
            assert host.shoot()[:2] == b"\xff\xd8"
    finally:
        stop.set()
        thread.join()
