"""Datasets and tables of PTP: valid data is parsed, and any other bytes end in a typed error."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.drivers.ptp.datasets import (
    DeviceInfo,
    ObjectInfo,
    PropertyDescription,
    Reader,
    StorageInfo,
    pack_integer,
)
from camctl.drivers.ptp.dialects import STANDARD, Dialect
from camctl.drivers.ptp.dials import (
    Scale,
    eos_f_number,
    eos_gain,
    eos_time,
    fuji_time,
    hundredths,
    iso,
    make_dial,
    panasonic_time,
    ratio,
    sony_iso,
    ten_thousandths,
    tenths,
)
from camctl.drivers.ptp.maker_datasets import (
    EosEvents,
    pack_eos_property,
    parse_nikon_events,
    parse_panasonic_property,
    parse_panasonic_value,
    parse_sony_properties,
)
from camctl.drivers.ptp.makers import (
    CANON_EOS,
    NIKON,
    SONY,
    dialect_of,
)
from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.controls import Choices, Steps

Parser = Callable[[bytes], object]
PARSERS: dict[str, Parser] = {
    "device": DeviceInfo.parse,
    "object": ObjectInfo.parse,
    "storage": StorageInfo.parse,
    "property": PropertyDescription.parse,
    "handles": lambda data: Reader(data, "handles").array(4),
    "canon": EosEvents.parse,
    "sony": parse_sony_properties,
    "nikon": parse_nikon_events,
    "panasonic": lambda data: parse_panasonic_property(data, 0x02000030),
    "panasonic value": parse_panasonic_value,
}


def text(words: str) -> bytes:
    return bytes([len(words) + 1]) + words.encode("utf-16-le") + b"\0\0" if words else b"\0"


def u16s(*values: int) -> bytes:
    return struct.pack(f"<I{len(values)}H", len(values), *values)


DEVICE = (
    struct.pack("<HIH", 100, 0x0A, 100)
    + text("ext")
    + struct.pack("<H", 0)
    + u16s(0x1001, 0x1002)
    + u16s(0x4002)
    + u16s(0x500D)
    + u16s(0x3801)
    + u16s(0x3801)
    + text("Nikon")
    + text("D7000")
    + text("1.0")
    + text("123")
)
OBJECT = (
    struct.pack("<IHHIHIIIIIIIHII", 1, 0x3801, 0, 99, 0, 0, 0, 0, 640, 480, 24, 7, 0, 0, 0)
    + text("A.JPG")
    + text("20240101T120000")
)
PROPERTY = struct.pack("<HHBIIBHII", 0x500D, 6, 1, 100, 166, 2, 2, 100, 166)
RANGE = struct.pack("<HHBIIBIII", 0x500D, 6, 1, 100, 166, 1, 1, 300000, 1)
SONY_LIST = struct.pack("<II", 1, 0) + struct.pack(
    "<HHBBIIBHIHI", 0xD20D, 6, 1, 1, 0, 0x1003C, 2, 1, 0x1003C, 1, 0x1001E
)
EOS = (
    struct.pack("<IIII", 16, 0xC189, 0xD102, 0x68)
    + struct.pack("<IIIIIII", 28, 0xC18A, 0xD102, 3, 2, 0x60, 0x68)
    + struct.pack("<IIII", 16, 0xC181, 0x91000001, 0x20001)
    + struct.pack("<II", 8, 0)
)
SAMPLES = [DEVICE, OBJECT, PROPERTY, RANGE, SONY_LIST, EOS]


def test_device_information_is_parsed() -> None:
    info = DeviceInfo.parse(DEVICE)
    assert (info.make, info.model, info.serial) == ("Nikon", "D7000", "123")
    assert info.operations == {0x1001, 0x1002}
    assert info.properties == (0x500D,)


def test_object_information_is_parsed() -> None:
    info = ObjectInfo.parse(OBJECT)
    assert (info.name, info.size, info.rows, info.columns, info.parent) == (
        "A.JPG",
        99,
        480,
        640,
        7,
    )


def test_property_descriptions_are_parsed() -> None:
    assert PropertyDescription.parse(PROPERTY).choices == (100, 166)
    assert PropertyDescription.parse(RANGE).span == (1, 300000, 1)


def test_canon_events_are_parsed_and_applied() -> None:
    events = EosEvents.parse(EOS)
    assert events.added == (0x91000001,)
    known: dict[int, PropertyDescription] = {}
    events.update(known, frozenset({0xD102}))
    assert known[0xD102].current == 0x68
    assert known[0xD102].choices == (0x60, 0x68)
    assert known[0xD102].is_writable
    assert pack_eos_property(0xD102, 0x68) == bytes.fromhex("0c00000002d1000068000000")


def test_the_second_list_of_sony_holds_the_choices() -> None:
    found = parse_sony_properties(SONY_LIST)[0xD20D]
    assert (found.current, found.choices) == (0x1003C, (0x1001E,))


def parse_with_all(data: bytes) -> None:
    for parser in PARSERS.values():
        with suppress(CameraProtocolError):
            parser(data)


@given(data=st.binary(max_size=400))
@settings(max_examples=150)
def test_arbitrary_bytes_are_parsed_or_rejected(data: bytes) -> None:
    parse_with_all(data)


@given(data=st.data())
@settings(max_examples=150)
def test_damaged_datasets_are_parsed_or_rejected(data: st.DataObject) -> None:
    sample = bytearray(data.draw(st.sampled_from(SAMPLES)))
    for _ in range(data.draw(st.integers(1, 4))):
        sample[data.draw(st.integers(0, len(sample) - 1))] = data.draw(st.integers(0, 255))
    parse_with_all(bytes(sample[: data.draw(st.integers(0, len(sample)))]))


def test_a_count_of_four_billion_allocates_no_memory() -> None:
    tracemalloc.start()
    for parser in PARSERS.values():
        for fill in (b"\xff", b"\xfe"):
            with suppress(CameraProtocolError):
                parser(fill * 200)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


@given(
    scale=st.sampled_from([s for d in (STANDARD, NIKON, CANON_EOS, SONY) for s in d.times]),
    choices=st.lists(st.integers(0, 0xFFFFFFFF), max_size=20),
    span=st.none() | st.tuples(*[st.integers(0, 0xFFFFFFFF)] * 3),
    writable=st.booleans(),
)
@settings(max_examples=200)
def test_arbitrary_descriptions_give_a_dial_or_none_or_a_typed_error(
    scale: Scale, choices: list[int], span: tuple[int, int, int] | None, writable: bool
) -> None:
    current = choices[0] if choices else 0
    description = PropertyDescription(scale.code, 6, writable, current, tuple(choices), span)
    try:
        dial = make_dial("time_s", scale, description)
    except CameraError:
        return
    if dial is None:
        return
    control = dial.control
    assert isinstance(control, Choices | Steps)
    for value in (control.nearest(control.minimum), control.nearest(control.maximum)):
        shown = dial.value(dial.number(value))
        assert shown == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize(
    ("decode", "number", "value"),
    [
        (ten_thousandths, 166, 0.0166),
        (ten_thousandths, 300000, 30.0),
        (ten_thousandths, 1, None),
        (ten_thousandths, 0xFFFFFFFF, None),
        (ratio, 1 << 16 | 8000, 1 / 8000),
        (ratio, 300 << 16 | 10, 30.0),
        (ratio, 0xFFFFFFFF, None),
        (ratio, 0, None),
        (ratio, 1 << 16, None),
        (eos_time, 0x38, 1.0),
        (eos_time, 0x10, 32.0),
        (eos_time, 0xA0, 1 / 8192),
        (eos_time, 0x0C, None),
        (eos_time, 0x3B, 2 ** (-1 / 3)),
        (eos_time, 0x3D, 2 ** (-2 / 3)),
        (eos_time, 0x3C, 2**-0.5),
        (eos_f_number, 0x30, 5.656854249492381),
        (eos_f_number, 0x2B, 2 ** (13 / 6)),
        (eos_gain, 0x4D, 2 ** (2 / 3)),
        (fuji_time, 15625, 1 / 64),
        (fuji_time, 6200, 2 ** (-22 / 3)),
        (fuji_time, 64_000_000, 64.0),
        (fuji_time, 64_000_030, None),
        (fuji_time, 0xFFFFFFFF, None),
        (panasonic_time, 8_000_000, 1 / 8000),
        (panasonic_time, 0x80000000 | 60_000, 60.0),
        (panasonic_time, 0xFFFFFFFF, None),
        (tenths, 56, 5.6),
        (iso, 51200, 512.0),
        (iso, 53249, None),
        (iso, -3, None),
        (eos_gain, 0x48, 1.0),
        (eos_gain, 0, None),
        (hundredths, 560, 5.6),
        (iso, 0xFFFF, None),
        (iso, 100, 1.0),
        (sony_iso, 0xFFFFFF, None),
        (sony_iso, 0x01000064, None),
        (sony_iso, 6400, 64.0),
    ],
)
def test_numbers_are_decoded_to_si_values(
    decode: Callable[[int], float | None], number: int, value: float | None
) -> None:
    assert decode(number) == (None if value is None else pytest.approx(value, rel=1e-14))


@pytest.mark.parametrize(
    ("extension", "make", "operations", "dialect"),
    [
        (0, "camctl", set(), STANDARD),
        (0x0A, "", {0x90C8}, NIKON),
        (6, "Nikon Corporation", {0x90C8}, NIKON),
        (6, "NIKON CORPORATION", set(), STANDARD),  # an old Coolpix
        (0x0B, "Canon Inc.", {0x9114, 0x9110, 0x9116}, CANON_EOS),
        (0x0B, "Canon Inc.", {0x9008}, STANDARD),  # a PowerShot
        (0x11, "Sony Corporation", {0x9201, 0x9207, 0x9209}, SONY),
    ],
)
def test_the_dialect_follows_from_maker_extension_and_operations(
    extension: int, make: str, operations: set[int], dialect: Dialect
) -> None:
    assert dialect_of(extension, make, frozenset(operations)) is dialect


@given(value=st.integers(0, 0xFFFFFFFF))
def test_packed_integers_are_read_back(value: int) -> None:
    assert Reader(pack_integer(value, 6), "number").value(6) == value
