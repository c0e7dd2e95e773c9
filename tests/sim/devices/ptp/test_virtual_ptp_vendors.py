"""The makers' own properties and operations, as public descriptions of them say."""

import io
import struct
import time

import numpy as np
import pytest
import tifffile
from ptp_initiator import BUSY, OK, camera, numbers

IN_MEMORY = {"nikon": 0xFFFF0001, "sony": 0xFFFFC001}


def tiff(data):
    return tifffile.imread(io.BytesIO(data))


# Nikon


def nikon_events(host):
    data = host.good(0x90C7)
    (count,) = struct.unpack_from("<H", data)
    assert len(data) == 2 + 6 * count
    return list(struct.iter_unpack("<HI", data[2:]))


def fraction(above, below):
    return struct.pack("<I", above << 16 | below)


def test_nikons_fractions_are_exact():
    with camera(vendor="nikon", files="tiff", repeat_noise=True) as (device, host):
        for above, below, units in ((1, 60, 167), (1, 8000, 1), (13, 10, 13_000)):
            host.good(0x1016, 0xD100, data=fraction(above, below))
            assert host.good(0x1015, 0x500D) == struct.pack("<I", units)
        host.good(0x1016, 0xD100, data=fraction(1, 60))
        assert np.array_equal(tiff(host.shoot()), device.body.exposer.expose(1 / 60))
        # The standard's number stands for the fraction, not for itself.
        host.good(0x1016, 0x500D, data=struct.pack("<I", 333))
        assert host.good(0x1015, 0xD100) == fraction(1, 30)
        assert np.array_equal(tiff(host.shoot()), device.body.exposer.expose(1 / 30))
        assert host.ask(0x1016, 0xD100, data=fraction(1, 61))[0] == 0x201C


def test_nikon_tells_of_both_shutter_times():
    with camera(vendor="nikon") as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 80))
        assert {host.event()[1], host.event()[1]} == {0x500D, 0xD100}
        assert [code for code, _ in nikon_events(host)] == [0x4006, 0x4006]
        assert nikon_events(host) == []


def test_nikon_captures_into_memory():
    with camera(vendor="nikon", files="dng+jpeg", delay_s=0.1) as (_, host):
        host.good(0x90C0, 0xFFFFFFFF)
        assert host.ask(0x90C8)[0] == BUSY
        host.patiently(0x90C8)
        assert (0xC101, IN_MEMORY["nikon"]) in nikon_events(host)
        assert host.good(0x1009, IN_MEMORY["nikon"])[:2] == b"II"
        assert host.good(0x1009, IN_MEMORY["nikon"] + 1)[:2] == b"\xff\xd8"
        assert numbers(host.good(0x1007, 0xFFFFFFFF, 0x3801, 0)) == []
        host.good(0x100B, IN_MEMORY["nikon"])
        assert host.ask(0x1009, IN_MEMORY["nikon"])[0] == 0x2009


def test_nikon_captures_to_where_it_is_told():
    with camera(vendor="nikon") as (device, host):
        host.good(0x9207, 0xFFFFFFFF, 0)
        host.patiently(0x90C8)
        assert device.do("state")["pictures"] == 1
        host.good(0x9207, 0xFFFFFFFF, 1)
        host.patiently(0x90C8)
        assert device.do("state")["pictures"] == 1
        assert host.good(0x1009, IN_MEMORY["nikon"])[:2] == b"\xff\xd8"
        assert host.ask(0x9207, 0xFFFFFFFF)[0] == 0x201D
        assert host.good(0x90CA) == struct.pack("<IH", 1, 0xD100)


def test_nikons_bulb():
    with camera(vendor="nikon", bulb=True) as (device, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 0xFFFFFFFF))
        assert host.good(0x1015, 0xD100) == struct.pack("<I", 0xFFFFFFFF)
        host.good(0x9207, 0xFFFFFFFF, 0)
        time.sleep(0.15)
        assert host.ask(0x90C8)[0] == BUSY
        host.good(0x920C, 0, 0)
        host.patiently(0x90C8)
        assert 0.15 <= device.do("state")["exposure"]["time_s"] < 0.5


# Canon


def eos_records(host):
    """Return (kind, data) of each record of an event poll."""
    data, records = host.good(0x9116), []
    while True:
        size, kind = struct.unpack_from("<II", data)
        assert 8 <= size <= len(data)
        if kind == 0:
            assert size == len(data) == 8
            return records
        records.append((kind, data[8:size]))
        data = data[size:]


def eos_set(host, code, value):
    return host.ask(0x9110, data=struct.pack("<III", 12, code, value))[0]


def remote(host):
    host.good(0x9114, 1)
    host.good(0x9115, 1)


def eos_picture(host):
    """Return (kind, data) of the record of the next picture."""
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline:
        for kind, data in eos_records(host):
            if kind in (0xC181, 0xC186):
                return kind, data
        time.sleep(0.01)
    raise AssertionError("no picture")


def test_eos_tells_its_properties_to_who_polls():
    with camera(vendor="canon") as (_, host):
        assert eos_records(host) == []
        remote(host)
        records = eos_records(host)
        values = {
            code: value
            for kind, data in records
            if kind == 0xC189
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


def test_eos_wants_remote_mode():
    with camera(vendor="canon") as (_, host):
        assert eos_set(host, 0xD102, 0x60) == 0x200F
        assert host.ask(0x910F)[0] == 0x200F
        assert host.ask(0x100E, 0, 0)[0] == 0x2005


def test_eos_exposes_by_its_codes():
    with camera(vendor="canon", files="tiff", repeat_noise=True) as (device, host):
        remote(host)
        for code, value in ((0xD102, 0x58), (0xD103, 0x50), (0xD101, 0x28)):
            assert eos_set(host, code, value) == OK
        assert host.ask(0x910F)[:2] == (OK, (0,))
        kind, data = eos_picture(host)
        assert kind == 0xC181
        handle, _, form, _, _, size = struct.unpack_from("<IIIIII", data)
        assert form == 0x380D
        assert data[32:].rstrip(b"\0") == b"VIRT0001.TIF"
        file = host.good(0x9107, handle, 0, size)
        # 1/16 s, ISO 200, a stop closed.
        assert np.array_equal(tiff(file), device.body.exposer.expose(1 / 16 * 0.5, 2.0))
        assert eos_set(host, 0xD102, 0x59) == 0x201C
        assert eos_set(host, 0xD1FF, 1) == 0x200A


def test_eos_hands_pictures_to_the_host():
    with camera(vendor="canon") as (device, host):
        remote(host)
        assert eos_set(host, 0xD11C, 4) == OK
        host.good(0x911A, 0x7FFFFFFF, 0x1000, 1)
        host.good(0x910F)
        kind, data = eos_picture(host)
        assert kind == 0xC186
        handle, form, _, size, _ = struct.unpack_from("<IIIII", data)
        assert data[20:].rstrip(b"\0") == b"VIRT0001.JPG"
        assert form == 0x3801
        file = host.good(0x9107, handle, 0, size)
        assert len(file) == size
        host.good(0x9117, handle)
        assert host.ask(0x9104, handle)[0] == 0x2009
        assert device.do("state")["pictures"] == 0


def test_eos_bulb():
    with camera(vendor="canon", bulb=True) as (device, host):
        remote(host)
        assert host.ask(0x9125)[0] == 0x200F
        assert eos_set(host, 0xD102, 0x0C) == OK
        assert host.ask(0x910F)[0] == 0x2002
        assert host.ask(0x9125)[:2] == (OK, (0,))
        time.sleep(0.15)
        assert host.ask(0x9126)[:2] == (OK, (0,))
        eos_picture(host)
        assert 0.15 <= device.do("state")["exposure"]["time_s"] < 0.5


# Sony


def sony_connect(host):
    for step in (1, 2):
        assert len(host.good(0x9201, step, 0, 0)) == 8
    info = host.good(0x9202, 0xC8)
    assert struct.unpack_from("<H", info) == (0xC8,)
    host.good(0x9201, 3, 0, 0)
    (count,) = struct.unpack_from("<I", info, 2)
    codes = struct.unpack_from(f"<{count}H", info, 6)
    controls = numbers(info[6 + 2 * count :], "H")
    return codes, controls


SIZES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I"}


def sony_properties(host):
    """Return code to (writable, value, choices or limits)."""
    data = io.BytesIO(host.good(0x9209))

    def take(form):
        return struct.unpack("<" + form, data.read(struct.calcsize("<" + form)))

    found = {}
    count, zero = take("II")
    assert zero == 0
    for _ in range(count):
        code, kind, writable, enabled = take("HHBB")
        assert enabled == 1
        size = SIZES[kind]
        _, value = take(2 * size)
        (form,) = take("B")
        values = take("3" + size) if form == 1 else ()
        if form == 2:
            values = take(f"{take('H')[0]}{size}")
        found[code] = writable, value, values
    assert data.read() == b""
    return found


def press(host, control, value):
    host.good(0x9207, control, data=struct.pack("<H", value))


def sony_shoot(host):
    press(host, 0xD2C1, 2)
    press(host, 0xD2C2, 2)
    press(host, 0xD2C2, 1)
    press(host, 0xD2C1, 1)
    deadline = time.monotonic() + 5
    while sony_properties(host)[0xD215][1] < 0x8000:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return host.good(0x1009, IN_MEMORY["sony"])


def test_sony_wants_its_handshake():
    with camera(vendor="sony") as (_, host):
        assert host.ask(0x9209)[0] == 0x200F
        assert host.ask(0x9202, 0xC8)[0] == 0x200F
        assert host.ask(0x9201, 2, 0, 0)[0] == 0x201D
        codes, controls = sony_connect(host)
        assert {0xD20D, 0xD21E, 0x5007, 0xD215} <= set(codes)
        assert controls == [0xD2C1, 0xD2C2]
        assert set(sony_properties(host)) == set(codes)


def test_sony_exposes_by_fractions():
    with camera(vendor="sony", files="tiff", repeat_noise=True) as (device, host):
        sony_connect(host)
        host.good(0x9205, 0xD20D, data=fraction(1, 60))
        host.good(0x9205, 0xD21E, data=struct.pack("<I", 200))
        assert sony_properties(host)[0xD20D][1] == 1 << 16 | 60
        assert np.array_equal(tiff(sony_shoot(host)), device.body.exposer.expose(1 / 60, 2.0))
        assert sony_properties(host)[0xD215][1] == 0
        assert host.ask(0x1009, IN_MEMORY["sony"])[0] == 0x2009
        codes = [host.event()[0] for _ in range(4)]
        assert set(codes) == {0xC201, 0xC203}


def test_an_older_sony_is_stepped():
    with camera(vendor="sony", absolute=False) as (_, host):
        sony_connect(host)
        host.good(0x9205, 0xD20D, data=fraction(1, 60))
        _, value, choices = sony_properties(host)[0xD20D]
        place = choices.index(value)
        assert value == 1 << 16 | 10
        # Up the dial is shorter, and several steps may be taken at once.
        host.good(0x9207, 0xD20D, data=b"\x01")
        assert sony_properties(host)[0xD20D][1] == choices[place + 1] == 1 << 16 | 13
        host.good(0x9207, 0xD20D, data=b"\xfd")
        assert sony_properties(host)[0xD20D][1] == choices[place - 2]
        host.good(0x9207, 0xD20D, data=b"\x7f")
        assert sony_properties(host)[0xD20D][1] == 1 << 16 | 8000


def test_sonys_two_files_come_one_after_the_other():
    with camera(vendor="sony", files="dng+jpeg") as (_, host):
        sony_connect(host)
        assert sony_shoot(host)[:2] == b"II"
        assert sony_properties(host)[0xD215][1] == 0x8001
        assert host.good(0x1009, IN_MEMORY["sony"])[:2] == b"\xff\xd8"


def test_sonys_bulb():
    with camera(vendor="sony", bulb=True) as (device, host):
        sony_connect(host)
        host.good(0x9205, 0xD20D, data=struct.pack("<I", 0))
        press(host, 0xD2C2, 2)
        time.sleep(0.15)
        press(host, 0xD2C2, 1)
        device.body.wait()
        assert 0.15 <= device.do("state")["exposure"]["time_s"] < 0.5


@pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
def test_the_mode_dial_locks_the_shutter(vendor):
    with camera(vendor=vendor) as (device, host):
        device.do("mode", dial="auto")
        code = {"nikon": 0xD100, "canon": 0xD102, "sony": 0xD20D}[vendor]
        assert host.ask(0x1016, code, data=bytes(2 if vendor == "canon" else 4))[0] == 0x200F
