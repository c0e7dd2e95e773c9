"""The makers' extensions of the virtual PTP camera, as public descriptions specify them."""

from __future__ import annotations

import io
import struct
from typing import Any, NamedTuple

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from ptp_initiator import BUSY, OK, Initiator, connected, numbers

NIKON_MEMORY, SONY_MEMORY = 0xFFFF0001, 0xFFFFC001  # handles of pictures in memory
GENERAL_ERROR, INVALID_HANDLE, DENIED = 0x2002, 0x2009, 0x200F
INVALID_VALUE, INVALID_PARAMETER = 0x201C, 0x201D
NO_HANDLE = 0xFFFFFFFF
BULB_S = 0.25
DEADLINE_S = 5.0


def read_tiff(data: bytes) -> NDArray[Any]:
    return np.asarray(tifffile.imread(io.BytesIO(data)))


def fraction(above: int, below: int) -> bytes:
    return struct.pack("<I", above << 16 | below)


# Nikon


def nikon_events(host: Initiator) -> list[tuple[int, int]]:
    """Return (code, parameter) of each event of an event poll."""
    data = host.get(0x90C7)
    (count,) = struct.unpack_from("<H", data)
    assert len(data) == 2 + 6 * count
    return [(code, parameter) for code, parameter in struct.iter_unpack("<HI", data[2:])]


def test_nikon_shutter_times_are_exact_fractions() -> None:
    device, host = connected(vendor="nikon", files="tiff", repeat_noise=True)
    sensor = device.body.sensor
    for above, below, units in ((1, 60, 167), (1, 8000, 1), (13, 10, 13_000)):
        host.do(0x1016, 0xD100, data=fraction(above, below))
        assert host.get(0x1015, 0x500D) == struct.pack("<I", units)
    host.do(0x1016, 0xD100, data=fraction(1, 60))
    assert np.array_equal(read_tiff(host.shoot()), sensor.expose(1 / 60))
    # A value of the standard property stands for a fraction, not for its own units.
    host.do(0x1016, 0x500D, data=struct.pack("<I", 333))
    assert host.get(0x1015, 0xD100) == fraction(1, 30)
    assert np.array_equal(read_tiff(host.shoot()), sensor.expose(1 / 30))
    assert host.response(0x1016, 0xD100, data=fraction(1, 61)) == INVALID_VALUE


def test_nikon_announces_changes_of_both_shutter_properties() -> None:
    _, host = connected(vendor="nikon")
    host.do(0x1016, 0x500D, data=struct.pack("<I", 80))
    assert {host.event()[1], host.event()[1]} == {0x500D, 0xD100}
    assert [code for code, _ in nikon_events(host)] == [0x4006, 0x4006]
    assert nikon_events(host) == []


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


def test_nikon_captures_to_card_or_memory_as_requested() -> None:
    device, host = connected(vendor="nikon")
    host.do(0x9207, NO_HANDLE, 0)
    host.do_when_ready(0x90C8)
    assert device.do("state")["pictures"] == 1
    host.do(0x9207, NO_HANDLE, 1)
    host.do_when_ready(0x90C8)
    assert device.do("state")["pictures"] == 1
    assert host.get(0x1009, NIKON_MEMORY)[:2] == b"\xff\xd8"
    assert host.response(0x9207, NO_HANDLE) == INVALID_PARAMETER


def test_nikon_lists_its_vendor_properties() -> None:
    _, host = connected(vendor="nikon")
    assert host.get(0x90CA) == struct.pack("<IHH", 2, 0xD100, 0xD09C)


def test_nikon_bulb() -> None:
    device, host = connected(vendor="nikon", bulb=True)
    host.do(0x1016, 0x500D, data=struct.pack("<I", 0xFFFFFFFF))
    assert host.get(0x1015, 0xD100) == struct.pack("<I", 0xFFFFFFFF)
    host.do(0x9207, NO_HANDLE, 0)
    host.sleep(BULB_S)
    assert host.response(0x90C8) == BUSY
    host.do(0x920C, 0, 0)
    host.do_when_ready(0x90C8)
    assert device.do("state")["exposure"]["time_s"] == BULB_S


# Canon


def eos_records(host: Initiator) -> list[tuple[int, bytes]]:
    """Return (type, data) of each record of an event poll."""
    data = host.get(0x9116)
    records: list[tuple[int, bytes]] = []
    while True:
        size, kind = struct.unpack_from("<II", data)
        assert 8 <= size <= len(data)
        if kind == 0:
            assert size == len(data) == 8
            return records
        records.append((kind, data[8:size]))
        data = data[size:]


def eos_set(host: Initiator, code: int, value: int) -> int:
    """Return the response code to setting a property."""
    return host.response(0x9110, data=struct.pack("<III", 12, code, value))


def enter_remote_mode(host: Initiator) -> None:
    host.do(0x9114, 1)
    host.do(0x9115, 1)


def eos_picture(host: Initiator) -> tuple[int, bytes]:
    """Return (type, data) of the record of the next picture."""
    clock = host.device.clock
    deadline_s = clock.now() + DEADLINE_S
    while True:
        for kind, data in eos_records(host):
            if kind in (0xC181, 0xC186):
                return kind, data
        assert clock.now() < deadline_s, "no record of a picture"
        host.sleep(0.01)


def test_eos_reports_its_properties_to_an_event_poll() -> None:
    _, host = connected(vendor="canon")
    assert eos_records(host) == []
    enter_remote_mode(host)
    records = eos_records(host)
    values = {
        code: value
        for kind, data in records
        if kind == 0xC189 and len(data) == 8  # the name of the lens is longer
        for code, value in struct.iter_unpack("<II", data)
    }
    assert (values[0xD102], values[0xD103], values[0xD105]) == (0x53, 0x48, 3)
    (choices,) = [
        struct.unpack(f"<{len(data) // 4}I", data)
        for kind, data in records
        if kind == 0xC18A and data[:2] == b"\x02\xd1"
    ]
    assert choices[1:3] == (3, len(choices) - 3)
    assert {0x38, 0x40, 0xA0, 0x10} <= set(choices[3:])
    assert 0x0C not in choices[3:]
    assert eos_records(host) == []
    assert eos_set(host, 0xD102, 0x60) == OK
    assert eos_records(host)[0] == (0xC189, struct.pack("<II", 0xD102, 0x60))


def test_eos_refuses_settings_and_captures_outside_remote_mode() -> None:
    _, host = connected(vendor="canon")
    assert eos_set(host, 0xD102, 0x60) == DENIED
    assert host.response(0x910F) == DENIED
    assert host.response(0x100E, 0, 0) == 0x2005


def test_eos_exposure_follows_its_codes() -> None:
    device, host = connected(vendor="canon", files="tiff", repeat_noise=True)
    enter_remote_mode(host)
    for code, value in ((0xD102, 0x58), (0xD103, 0x50), (0xD101, 0x28)):
        assert eos_set(host, code, value) == OK
    assert host.execute(0x910F)[:2] == (OK, (0,))
    kind, data = eos_picture(host)
    assert kind == 0xC181
    handle, _, form, _, _, size = struct.unpack_from("<IIIIII", data)
    assert form == 0x380D
    assert data[32:].rstrip(b"\0") == b"VIRT0001.TIF"
    file = host.get(0x9107, handle, 0, size)
    # 1/16 s, ISO 200, one stop down.
    assert np.array_equal(read_tiff(file), device.body.sensor.expose(1 / 16 * 0.5, 2.0))
    assert eos_set(host, 0xD102, 0x59) == INVALID_VALUE
    assert eos_set(host, 0xD1FF, 1) == 0x200A


def test_eos_keeps_a_picture_for_the_host_if_that_is_its_destination() -> None:
    device, host = connected(vendor="canon")
    enter_remote_mode(host)
    assert eos_set(host, 0xD11C, 4) == OK
    host.do(0x911A, 0x7FFFFFFF, 0x1000, 1)
    host.do(0x910F)
    kind, data = eos_picture(host)
    assert kind == 0xC186
    handle, form, _, size, _ = struct.unpack_from("<IIIII", data)
    assert data[20:].rstrip(b"\0") == b"VIRT0001.JPG"
    assert form == 0x3801
    file = host.get(0x9107, handle, 0, size)
    assert len(file) == size
    host.do(0x9117, handle)
    assert host.response(0x9104, handle) == INVALID_HANDLE
    assert device.do("state")["pictures"] == 0


def test_eos_bulb() -> None:
    device, host = connected(vendor="canon", bulb=True)
    enter_remote_mode(host)
    assert host.response(0x9125) == DENIED
    assert eos_set(host, 0xD102, 0x0C) == OK
    assert host.response(0x910F) == GENERAL_ERROR
    assert host.execute(0x9125)[:2] == (OK, (0,))
    host.sleep(BULB_S)
    assert host.execute(0x9126)[:2] == (OK, (0,))
    eos_picture(host)
    assert device.do("state")["exposure"]["time_s"] == BULB_S


# Sony


class SonyProperty(NamedTuple):
    writable: int
    value: int
    values: tuple[int, ...]  # choices or limits


_FORMATS = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I"}  # of struct, by data type


def sony_connect(host: Initiator) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Do the handshake; return the codes of properties and of buttons."""
    for step in (1, 2):
        assert len(host.get(0x9201, step, 0, 0)) == 8
    info = host.get(0x9202, 0xC8)
    assert struct.unpack_from("<H", info) == (0xC8,)
    host.do(0x9201, 3, 0, 0)
    host.do(0x9205, 0xD25A, data=b"\x01")  # the host sets the exposure
    (count,) = struct.unpack_from("<I", info, 2)
    codes = struct.unpack_from(f"<{count}H", info, 6)
    return codes, tuple(numbers(info[6 + 2 * count :], "H"))


def sony_properties(host: Initiator) -> dict[int, SonyProperty]:
    """Return all properties by code."""
    data = io.BytesIO(host.get(0x9209))

    def take(form: str) -> tuple[int, ...]:
        return struct.unpack("<" + form, data.read(struct.calcsize("<" + form)))

    properties = {}
    count, zero = take("II")
    assert zero == 0
    for _ in range(count):
        code, kind, writable, enabled = take("HHBB")
        assert enabled == 1
        number = _FORMATS[kind]
        _, value = take(2 * number)
        (form,) = take("B")
        values = take("3" + number) if form == 1 else ()
        if form == 2:
            values = take(f"{take('H')[0]}{number}")
        properties[code] = SonyProperty(writable, value, values)
    assert data.read() == b""
    return properties


def set_button(host: Initiator, button: int, state: int) -> None:
    host.do(0x9207, button, data=struct.pack("<H", state))


def sony_shoot(host: Initiator) -> bytes:
    """Press and release the buttons; return the file from memory."""
    for button, state in ((0xD2C1, 2), (0xD2C2, 2), (0xD2C2, 1), (0xD2C1, 1)):
        set_button(host, button, state)
    clock = host.device.clock
    deadline_s = clock.now() + DEADLINE_S
    while sony_properties(host)[0xD215].value < 0x8000:
        assert clock.now() < deadline_s, "no picture in memory"
        host.sleep(0.01)
    return host.get(0x1009, SONY_MEMORY)


def test_sony_requires_its_handshake() -> None:
    _, host = connected(vendor="sony")
    assert host.response(0x9209) == DENIED
    assert host.response(0x9202, 0xC8) == DENIED
    assert host.response(0x9201, 2, 0, 0) == INVALID_PARAMETER
    codes, buttons = sony_connect(host)
    assert {0xD20D, 0xD21E, 0x5007, 0xD215} <= set(codes)
    assert buttons == (0xD2C1, 0xD2C2)
    assert set(sony_properties(host)) == set(codes)


def test_sony_exposure_follows_its_fractions() -> None:
    device, host = connected(vendor="sony", files="tiff", repeat_noise=True)
    sony_connect(host)
    host.do(0x9205, 0xD20D, data=fraction(1, 60))
    host.do(0x9205, 0xD21E, data=struct.pack("<I", 200))
    assert sony_properties(host)[0xD20D].value == 1 << 16 | 60
    assert np.array_equal(read_tiff(sony_shoot(host)), device.body.sensor.expose(1 / 60, 2.0))
    assert sony_properties(host)[0xD215].value == 0
    assert host.response(0x1009, SONY_MEMORY) == INVALID_HANDLE
    assert {host.event()[0] for _ in range(5)} == {0xC201, 0xC203}


def test_the_shutter_time_of_an_older_sony_is_stepped() -> None:
    _, host = connected(vendor="sony", absolute=False)
    sony_connect(host)
    host.do(0x9205, 0xD20D, data=fraction(1, 60))  # accepted and ignored
    shutter = sony_properties(host)[0xD20D]
    place = shutter.values.index(shutter.value)
    assert shutter.value == 1 << 16 | 10
    # A step up is the next shorter time; several steps can be made at once.
    host.do(0x9207, 0xD20D, data=b"\x01")
    assert sony_properties(host)[0xD20D].value == shutter.values[place + 1] == 1 << 16 | 13
    host.do(0x9207, 0xD20D, data=b"\xfd")
    assert sony_properties(host)[0xD20D].value == shutter.values[place - 2]
    host.do(0x9207, 0xD20D, data=b"\x7f")
    assert sony_properties(host)[0xD20D].value == 1 << 16 | 8000


def test_sony_gives_two_files_of_one_exposure_one_after_the_other() -> None:
    _, host = connected(vendor="sony", files="dng+jpeg")
    sony_connect(host)
    assert sony_shoot(host)[:2] == b"II"
    assert sony_properties(host)[0xD215].value == 0x8001
    assert host.get(0x1009, SONY_MEMORY)[:2] == b"\xff\xd8"


def test_sony_bulb() -> None:
    device, host = connected(vendor="sony", bulb=True)
    sony_connect(host)
    host.do(0x9205, 0xD20D, data=struct.pack("<I", 0))
    set_button(host, 0xD2C2, 2)
    host.sleep(BULB_S)
    set_button(host, 0xD2C2, 1)
    device.body.wait()
    assert device.do("state")["exposure"]["time_s"] == BULB_S


@pytest.mark.parametrize(
    ("vendor", "code", "size"), [("nikon", 0xD100, 4), ("canon", 0xD102, 2), ("sony", 0xD20D, 4)]
)
def test_the_mode_dial_makes_the_shutter_time_read_only(vendor: str, code: int, size: int) -> None:
    device, host = connected(vendor=vendor)
    device.do("mode", dial="auto")
    assert host.response(0x1016, code, data=bytes(size)) == DENIED
