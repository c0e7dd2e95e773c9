"""Arbitrary bytes from a host leave the virtual CoolPix usable and its queues limited."""

from __future__ import annotations

import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.sim.devices.clock import VirtualDeviceClock
from camctl.sim.devices.sierra import device as sierra


class CountingLine:
    """A line that counts the bytes sent to the host."""

    path = "none"
    host_speed = None

    def __init__(self) -> None:
        self.sent = 0

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def send(self, data: bytes, speed: int = 0) -> None:
        self.sent += len(data)


def packet(data: bytes, head: bytes = b"\x1b\x53") -> bytes:
    total = struct.pack("<H", sum(data) & 0xFFFF)
    return head + struct.pack("<H", len(data)) + data + total


REGISTERS = st.sampled_from([*range(90), 255])
COMMANDS = st.one_of(
    st.tuples(st.just(0), REGISTERS, st.binary(max_size=6)),
    st.tuples(st.just(1), REGISTERS, st.binary(max_size=2)),
    st.tuples(st.just(2), st.integers(0, 20), st.binary(max_size=2)),
    st.tuples(st.just(3), REGISTERS, st.binary(max_size=20)),
    st.tuples(st.just(4), REGISTERS, st.just(b"")),
).map(lambda parts: packet(bytes(parts[:2]) + parts[2]))
BYTES = st.lists(
    st.one_of(
        COMMANDS,
        st.binary(max_size=64),
        st.binary(max_size=64).map(packet),
        st.sampled_from([b"\0", b"\x06", b"\x15", b"\x1b\x43\xff\xff", b"\x02\0\xff\x07"]),
        st.binary(max_size=30).map(lambda data: packet(data, b"\x03\0")),
    ),
    max_size=40,
)


@given(pieces=BYTES, pauses=st.lists(st.sampled_from([0.0, 0.01, 0.6, 6.0]), max_size=40))
@settings(max_examples=settings().max_examples * 3 // 2)
def test_after_any_bytes_and_pauses_the_camera_answers_a_new_session(
    pieces: list[bytes], pauses: list[float]
) -> None:
    clock, line = VirtualDeviceClock(), CountingLine()
    device = sierra.make({"scene": "ramp", "sensor": "ideal-8", "size": "8x8"}, clock)
    device.line = line
    pauses = pauses + [0.0] * (len(pieces) - len(pauses))
    for piece, pause_s in zip(pieces, pauses, strict=False):
        device.received(piece)
        clock.sleep_until(clock.now() + pause_s)
        assert len(device._buffer) <= 8192
        assert len(device._outgoing) <= 64
    device.body.wait()
    clock.sleep_until(clock.now() + 60.0)
    assert device.do("state")["session"] is False
    before = line.sent
    device.received(b"\0")
    assert line.sent == before + 1
    device.received(packet(bytes([1, 16])))
    assert line.sent == before + 1 + 10
