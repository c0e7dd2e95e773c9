"""Tables of PTP: what the numbers of properties mean, and which dialect a camera speaks.

Damaged datasets are parsed in `tests/fuzz`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.drivers.ptp.datasets import PropertyDescription
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
from camctl.drivers.ptp.maker_datasets import EosEvents, parse_sony_properties
from camctl.drivers.ptp.makers import CANON_EOS, NIKON, SONY, dialect_of
from camctl.errors import CameraError
from camctl.interface.controls import Choices, Steps


def test_canon_events_are_parsed_and_applied() -> None:
    events = EosEvents.parse(
        struct.pack("<IIII", 16, 0xC189, 0xD102, 0x68)
        + struct.pack("<IIIIIII", 28, 0xC18A, 0xD102, 3, 2, 0x60, 0x68)
        + struct.pack("<IIII", 16, 0xC181, 0x91000001, 0x20001)
        + struct.pack("<II", 8, 0)
    )
    assert events.added == (0x91000001,)
    known: dict[int, PropertyDescription] = {}
    events.update(known, frozenset({0xD102}))
    assert known[0xD102].current == 0x68
    assert known[0xD102].choices == (0x60, 0x68)
    assert known[0xD102].is_writable


def test_a_property_of_canon_that_lists_one_choice_cannot_be_set() -> None:
    events = EosEvents.parse(struct.pack("<IIIIIIII", 24, 0xC18A, 0xD102, 3, 1, 0x60, 8, 0))
    known: dict[int, PropertyDescription] = {}
    events.update(known, frozenset({0xD102}))
    assert not known[0xD102].is_writable


def test_the_second_list_of_sony_holds_the_choices() -> None:
    data = struct.pack("<II", 1, 0) + struct.pack(
        "<HHBBIIBHIHI", 0xD20D, 6, 1, 1, 0, 0x1003C, 2, 1, 0x1003C, 1, 0x1001E
    )
    found = parse_sony_properties(data)[0xD20D]
    assert (found.current, found.choices) == (0x1003C, (0x1001E,))


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
