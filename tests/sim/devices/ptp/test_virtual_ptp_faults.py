"""What goes wrong with the virtual PTP camera when it is told to, and how that ends."""

import errno
import io
import struct
import threading
import time

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from ptp_initiator import BUSY, OK, Initiator, camera, numbers

from camctl.errors import UsageError
from sim.devices.ptp import camera as ptp
from sim.devices.usb.device import Port

SESSION = 0x2003


class Socket(Port):
    """Where a device is plugged in, in these tests."""

    def __init__(self, device):
        self.device = device

    def attach(self, device):
        device.connect()

    def detach(self):
        self.device.disconnect()


def test_busy_for_a_while():
    with camera() as (device, host):
        device.do("busy", count=2)
        codes = [host.ask(0x1004)[0] for _ in range(3)]
        assert codes == [BUSY, BUSY, OK]
        device.do("busy", count=-1)
        assert host.ask(0x100E, 0, 0)[0] == BUSY
        host.good(0x1001)
        device.do("ok")
        host.good(0x1004)


def test_a_hang_ends_with_ok():
    with camera() as (device, host):
        device.do("hang")
        host.write(1, 0x1004)
        assert host.read(timeout_s=0.1) is None
        device.do("ok")
        host.good(0x1004)


def test_a_stall_wants_its_halt_cleared():
    with camera() as (device, host):
        device.do("stall")
        host.write(1, 0x1004)
        assert host.read()[0] == errno.EPIPE
        assert host.write(1, 0x1004) == errno.EPIPE
        status = device.request(0xA1, 0x67, 0, 0, 64, b"")
        length, code, *halted = struct.unpack("<HHII", status)
        assert (length, code, halted) == (12, 0x201F, [0x81, 0x02])
        for endpoint in halted:
            assert device.request(0x02, 1, 0, endpoint, 0, b"") == b""
        assert device.request(0xA1, 0x67, 0, 0, 64, b"")[2:4] == struct.pack("<H", OK)
        host.good(0x1004)


@pytest.mark.parametrize("answers", [False, True])
def test_half_an_object(answers):
    with camera(object_bytes=10_000) as (device, host):
        host.good(0x100E, 0, 0)
        handle = host.added()
        device.do("truncate", answers=answers)
        host.write(1, 0x1009, struct.pack("<I", handle))
        error, data = host.read()
        assert error == 0
        assert struct.unpack_from("<I", data) == (10_012,)
        assert 4000 < len(data) < 6000
        after = host.read(timeout_s=0.1)
        assert (after is not None) == answers
        host.transaction += 1
        assert len(host.good(0x1009, handle)) == 10_000
        # Nobody has it until it was sent whole.
        assert device.do("log")["shots"][0]["downloaded_s"] is not None


def test_rubbish_instead_of_an_answer():
    with camera() as (device, host):
        device.do("garbage")
        host.write(1, 0x1004)
        error, data = host.read()
        assert error == 0
        assert struct.unpack_from("<IHHI", data)[0] != len(data)
        host.transaction += 1
        host.good(0x1004)


def test_no_room_and_no_power():
    with camera() as (device, host):
        device.do("card_full")
        assert host.ask(0x100E, 0, 0)[0] == 0x200C
        assert host.event()[0] == 0x400A
        device.do("ok")
        device.do("battery_low")
        assert host.ask(0x100E, 0, 0)[0] == 0x2002
        assert host.good(0x1015, 0x5001) == b"\x03"
        device.do("ok")
        host.good(0x100E, 0, 0)


def test_a_wrong_exposure():
    with camera(files="tiff", repeat_noise=True) as (device, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 100))
        right = device.body.exposer.expose(0.01)
        twice = device.body.exposer.expose(0.02)
        device.do("wrong", factor=2.0, count=1)
        for expected in (twice, right):
            assert np.array_equal(tifffile.imread(io.BytesIO(host.shoot())), expected)


@pytest.mark.parametrize("form", ["enum", "range"])
def test_silent_clamping(form):
    with camera(time_form=form) as (device, host):
        device.do("clamp", max_s=0.005)
        host.good(0x1016, 0x500D, data=struct.pack("<I", 1000))
        assert host.good(0x1015, 0x500D) == struct.pack("<I", 50)


def test_no_events_until_ok():
    with camera() as (device, host):
        device.do("no_events")
        host.good(0x100E, 0, 0)
        device.body.wait()
        assert host.events.empty()
        device.do("ok")
        host.shoot()


def test_unplugged_and_plugged_in_again():
    with camera() as (device, host):
        device.port = Socket(device)
        host.good(0x100E, 0, 0)
        device.do("unplug")
        assert host.read()[0] == errno.ENODEV
        assert host.write(1, 0x1004) == errno.ENODEV
        device.do("plug")
        device.body.wait()
        again = Initiator(device)
        assert again.ask(0x1004)[0] == SESSION
        again.good(0x1002, 1)
        # What it was exposing is on its card all the same.
        (handle,) = numbers(again.good(0x1007, 0xFFFFFFFF, 0x3801, 0))
        assert again.good(0x1009, handle)[:2] == b"\xff\xd8"


@pytest.mark.parametrize("after", [0, 5000])
def test_unplugged_in_the_middle_of_an_object(after):
    with camera(object_bytes=100_000) as (device, host):
        device.port = Socket(device)
        host.good(0x100E, 0, 0)
        handle = host.added()
        device.do("unplug", after_bytes=after)
        host.write(1, 0x1009, struct.pack("<I", handle))
        error, data = host.read()
        assert error == errno.ENODEV
        assert len(data) == after // 512 * 512
        assert not device.is_attached


def test_a_negative_number_of_bytes():
    with camera() as (device, _), pytest.raises(UsageError, match="unplug after -1 bytes"):
        device.do("unplug", after_bytes=-1)


def test_a_host_that_reads_nothing_fills_no_memory():
    device = ptp.make({"scene": "ramp", "sensor": "ideal-8", "size": "48x32"})
    device.connect()
    device.write(2, struct.pack("<IHHII", 16, 1, 0x1002, 0, 1))
    for transaction in range(1, 500):
        device.write(2, struct.pack("<IHHI", 12, 1, 0x1001, transaction))
        value = struct.pack("<I", 100 if transaction % 2 else 80)
        device.write(2, struct.pack("<IHHII", 16, 1, 0x1016, transaction, 0x500D))
        device.write(2, struct.pack("<IHHI", 16, 2, 0x1016, transaction) + value)
    assert device.pending(1) <= 16
    assert device.pending(3) <= 64


codes = st.sampled_from(
    [*range(0x1000, 0x101D), *range(0x90C0, 0x90CB), *range(0x9101, 0x9128), *range(0x9201, 0x920D)]
)
PROPERTIES = (0x500D, 0x5004, 0xD100, 0xD102, 0xD20D, 0xD2C1, 0xD2C2)
HANDLES = (0x00010001, 0x10000001, 0x20000001, 0xFFFF0001, 0xFFFFC001, 0xFFFFFFFF)
small = st.sampled_from([*range(5), *PROPERTIES, *HANDLES])


def container(kind, code, body):
    return struct.pack("<IHHI", 12 + len(body), kind, code, 7) + body


commands = st.builds(
    lambda code, parameters: container(1, code, struct.pack(f"<{len(parameters)}I", *parameters)),
    codes,
    st.lists(st.one_of(small, st.integers(0, 2**32 - 1)), max_size=5),
)
phases = st.builds(lambda code, body: container(2, code, body), codes, st.binary(max_size=40))
pieces = st.lists(
    st.one_of(
        commands,
        phases,
        st.tuples(commands, phases).map(b"".join),
        st.binary(max_size=80),
        st.builds(struct.Struct("<IHHI").pack, st.integers(0, 2**32 - 1), codes, codes, small),
    ),
    max_size=30,
)
requests = st.tuples(
    st.integers(0, 255), st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)
)


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
@given(said=pieces, asked=st.lists(requests, max_size=5), handshake=st.booleans())
@settings(max_examples=60)
def test_whatever_a_host_sends_it_goes_on(vendor, said, asked, handshake):
    device = ptp.make(
        {"scene": "ramp", "sensor": "ideal-8", "size": "8x8", "vendor": vendor, "bulb": True,
         "times": ["1/1000", "1/500"], "files": ["jpeg", "dng+jpeg"]}
    )  # fmt: skip
    host = Initiator(device)
    host.good(0x1002, 1)
    if handshake and vendor == "canon":
        host.good(0x9114, 1)
        host.good(0x9115, 1)
    if handshake and vendor == "sony":
        for code, step in ((0x9201, 1), (0x9201, 2), (0x9201, 3)):
            host.good(code, step)
    for piece in said:
        device.write(2, piece)
        assert len(device._waiting) <= 2 * 64 * 1024
        assert device.pending(1) <= 16
    for kind, request, value, index in asked:
        device.request(kind, request, value, index, 64, b"")
    device.body.end_bulb()
    device.body.wait()
    # The class request for a reset, and clearing halts, bring any of this to an end.
    device.request(0x21, 0x66, 0, 0, 0, b"")
    for endpoint in (0x81, 0x02):
        device.request(0x02, 1, 0, endpoint, 0, b"")
    host.good(0x1001)
    host.good(0x1002, 1)
    host.good(0x1004)


def test_verbs_from_another_thread_while_a_host_is_at_work():
    with camera() as (device, host):
        stop = threading.Event()

        def pester():
            while not stop.is_set():
                device.do("state")
                device.do("log")
                time.sleep(0.001)

        thread = threading.Thread(target=pester)
        thread.start()
        try:
            for _ in range(5):
                assert host.shoot()[:2] == b"\xff\xd8"
        finally:
            stop.set()
            thread.join()
