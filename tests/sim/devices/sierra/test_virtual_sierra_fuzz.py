"""Whatever a host sends, the virtual CoolPix goes on and keeps little."""

import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from sim.devices.sierra import device as sierra
from sim.devices.still_body import StillBody


class Line:
    """In place of the serial line: what was sent is counted."""

    host_speed = None

    def __init__(self):
        self.sent = 0

    def send(self, data, speed=0):
        self.sent += len(data)


def make():
    device = sierra.make({"scene": "ramp", "sensor": "ideal-8", "size": "8x8"})
    device.line = Line()
    return device


def packet(data, head=b"\x1b\x53"):
    total = struct.pack("<H", sum(data) & 0xFFFF)
    return head + struct.pack("<H", len(data)) + data + total


register = st.sampled_from([*range(90), 255])
commands = st.one_of(
    st.tuples(st.just(0), register, st.binary(max_size=6)),
    st.tuples(st.just(1), register, st.binary(max_size=2)),
    st.tuples(st.just(2), st.integers(0, 20), st.binary(max_size=2)),
    st.tuples(st.just(3), register, st.binary(max_size=20)),
    st.tuples(st.just(4), register, st.just(b"")),
).map(lambda parts: packet(bytes(parts[:2]) + parts[2]))
said = st.lists(
    st.one_of(
        commands,
        st.binary(max_size=64),
        st.binary(max_size=64).map(packet),
        st.sampled_from([b"\0", b"\x06", b"\x15", b"\x1b\x43\xff\xff", b"\x02\0\xff\x07"]),
        st.binary(max_size=30).map(lambda data: packet(data, b"\x03\0")),
    ),
    max_size=40,
)


@given(said)
@settings(max_examples=150)
def test_it_goes_on_and_keeps_little(pieces):
    device = make()
    assert isinstance(device.body, StillBody)
    for piece in pieces:
        device.received(piece)
        assert len(device._buffer) <= 8192
        assert len(device._outgoing) <= 64
    device.body.wait()
    device._end_session()
    before = device.line.sent
    device.received(b"\0")
    assert device.line.sent == before + 1
    device.received(packet(bytes([1, 16])))
    assert device.line.sent == before + 1 + 10
