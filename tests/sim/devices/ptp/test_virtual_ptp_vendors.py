"""The makers' extensions of the virtual PTP camera, as public descriptions specify them."""

from __future__ import annotations

import struct

import pytest
from ptp_initiator import BUSY, Initiator, connected, numbers

NIKON_MEMORY, NO_HANDLE = 0xFFFF0001, 0xFFFFFFFF  # handles: of a picture in memory; none
INVALID_HANDLE, DENIED, INVALID_PARAMETER = 0x2009, 0x200F, 0x201D


# Nikon


def nikon_events(host: Initiator) -> list[tuple[int, int]]:
    """Return (code, parameter) of each event of an event poll."""
    data = host.get(0x90C7)
    (count,) = struct.unpack_from("<H", data)
    assert len(data) == 2 + 6 * count
    return [(code, parameter) for code, parameter in struct.iter_unpack("<HI", data[2:])]


def test_nikon_captures_into_memory() -> None:
    _, host = connected(vendor="nikon", files="dng+jpeg", delay_s=0.1)
    host.do(0x90C0, NO_HANDLE)
    assert host.response(0x90C8) == BUSY
    host.do_when_ready(0x90C8)
    assert (0xC101, NIKON_MEMORY) in nikon_events(host)
    assert host.get(0x1009, NIKON_MEMORY)[:2] == b"II"
    assert host.get(0x1009, NIKON_MEMORY + 1)[:2] == b"\xff\xd8"
    assert numbers(host.get(0x1007, 0xFFFFFFFF, 0x3801, 0)) == ()
    host.do(0x100B, NIKON_MEMORY)
    assert host.response(0x1009, NIKON_MEMORY) == INVALID_HANDLE


# Canon


def eos_set(host: Initiator, code: int, value: int) -> int:
    """Return the response code to setting a property."""
    return host.response(0x9110, data=struct.pack("<III", 12, code, value))


def test_eos_refuses_settings_and_captures_outside_remote_mode() -> None:
    _, host = connected(vendor="canon")
    assert eos_set(host, 0xD102, 0x60) == DENIED
    assert host.response(0x910F) == DENIED
    assert host.response(0x100E, 0, 0) == 0x2005


@pytest.mark.parametrize(
    ("place", "kind", "at"), [(2, 0xC181, 20), (4, 0xC186, 12)], ids=["card", "computer"]
)
def test_eos_states_the_size_of_a_new_picture(place: int, kind: int, at: int) -> None:
    """At this byte of the body of the record."""
    _, host = connected(vendor="canon")
    host.do(0x9114, 1)
    host.do(0x9115, 1)
    assert eos_set(host, 0xD11C, place) == 0x2001
    host.do(0x910F)
    host.sleep(5)
    data, bodies = host.get(0x9116), {}
    while data:
        length, code = struct.unpack_from("<II", data)
        bodies[code], data = data[8:length], data[length:]
    (handle,) = struct.unpack_from("<I", bodies[kind])
    assert struct.unpack_from("<I", bodies[kind], at) == (len(host.get(0x9104, handle)),)


# Sony


def test_sony_requires_its_handshake() -> None:
    _, host = connected(vendor="sony")
    assert host.response(0x9209) == DENIED
    assert host.response(0x9202, 0xC8) == DENIED
    assert host.response(0x9201, 2, 0, 0) == INVALID_PARAMETER
    for step in (1, 2):
        assert len(host.get(0x9201, step, 0, 0)) == 8
    listed = struct.unpack("<H", host.get(0x9202, 0xC8)[:2])
    host.do(0x9201, 3, 0, 0)
    assert listed == (0xC8,)
    host.do(0x9209)


def test_a_step_of_an_older_sony_is_the_next_shorter_time() -> None:
    device, host = connected(vendor="sony", absolute=False)
    for step in (1, 2, 3):
        host.do(0x9201, step, 0, 0)
    host.do(0x9205, 0xD25A, data=b"\x01")  # the host sets the exposure
    for steps, time_s in ((1, 1 / 13), (-2, 1 / 8), (127, 1 / 8000)):
        host.do(0x9207, 0xD20D, data=struct.pack("b", steps))
        assert device.responder.exposure_time_s() == time_s
