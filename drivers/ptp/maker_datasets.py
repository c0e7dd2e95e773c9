"""Datasets of makers: parsers, and packers of what we send.

Makers do not publish the layouts of their datasets; the parsers read the parts that others have
found and that taking a picture needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from camctl.drivers.ptp.codes import Event, Prop
from camctl.drivers.ptp.datasets import (
    UINT16,
    UINT32,
    PropertyDescription,
    Reader,
    pack_integer,
    read_choices,
    read_form,
)

_EOS_HEADER_BYTES = 8  # size and type of a record
_EOS_LIST = 3  # form of a list of choices


@dataclass(frozen=True)
class EosEvents:
    """The answer to one poll of Canon's events, in the order of its records.

    Attributes:
        values: (property, number or text) of properties that changed
        choices: (property, numbers) of lists of choices that changed
        added: handles of new objects
    """

    values: tuple[tuple[int, int | str], ...]
    choices: tuple[tuple[int, tuple[int, ...]], ...]
    added: tuple[int, ...]

    @classmethod
    def parse(cls, data: bytes) -> EosEvents:
        """Return the data of operation 9116."""
        values: list[tuple[int, int | str]] = []
        choices: list[tuple[int, tuple[int, ...]]] = []
        added: list[int] = []
        for kind, body in _eos_records(data):
            reader = Reader(body, "event record")
            if kind == Event.EOS_PROPERTY_CHANGED and reader.left >= 8:
                code = reader.u32()
                is_text = code == Prop.EOS_LENS_NAME
                values.append((code, _text(reader) if is_text else reader.u32()))
            elif kind == Event.EOS_CHOICES_CHANGED and reader.left >= 12:
                code, form, count = reader.u32(), reader.u32(), reader.u32()
                if form == _EOS_LIST:
                    choices.append((code, reader.integers(count, 4)))
            elif kind in (Event.EOS_OBJECT_ADDED, Event.EOS_OBJECT_ADDED_64) and reader.left >= 4:
                added.append(reader.u32())
        return cls(tuple(values), tuple(choices), tuple(added))

    def update(self, known: dict[int, PropertyDescription], codes: frozenset[int]) -> None:
        """Update the descriptions of the properties `codes` in `known`."""
        for code, number in self.values:
            if code in codes:
                before = known.get(code) or PropertyDescription(code, UINT32, False, number)
                known[code] = replace(before, current=number)
        for code, numbers in self.choices:
            if code in codes:
                before = known.get(code) or PropertyDescription(code, UINT32, False, 0)
                # A property that cannot be set in this mode lists no choice, or one.
                known[code] = replace(before, choices=numbers, is_writable=len(numbers) > 1)


def _text(reader: Reader) -> str:
    """Return a text of Canon's: ASCII up to a NUL."""
    return reader.take(reader.left).partition(b"\0")[0].decode("ascii", "replace")


def _eos_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, body) of each record up to a record of type 0, which ends the list."""
    reader = Reader(data, "list of events")
    while reader.left >= _EOS_HEADER_BYTES:
        size, kind = reader.u32(), reader.u32()
        if size < _EOS_HEADER_BYTES:
            raise reader.invalid(f"a record of {size} bytes")
        if kind == 0:
            return
        yield kind, reader.take(size - _EOS_HEADER_BYTES)


def pack_eos_property(code: int, number: int) -> bytes:
    """Return the data of operation 9110."""
    return b"".join(part.to_bytes(4, "little") for part in (12, code, number))


def parse_sony_properties(data: bytes) -> dict[int, PropertyDescription]:
    """Return the descriptions in the data of operation 9209, by property."""
    reader = Reader(data, "list of properties")
    reader.take(8)  # their number, in a format that differs between bodies
    found: dict[int, PropertyDescription] = {}
    while reader.left >= 6:
        code, data_type, can_set, is_enabled = reader.u16(), reader.u16(), reader.u8(), reader.u8()
        reader.value(data_type)
        current = reader.value(data_type)
        choices, span = read_form(reader, data_type)
        # Newer bodies append a second list: the choices that can be set now.  Property codes of
        # Sony start at 5000, so that a smaller number here is the count of that list.
        if choices and reader.left >= 2 and reader.peek_u16() < 0x5000:
            choices = read_choices(reader, data_type) or choices
        writable = can_set == 1 and is_enabled == 1
        found[code] = PropertyDescription(code, data_type, writable, current, choices, span)
    return found


def parse_nikon_events(data: bytes) -> tuple[tuple[int, int], ...]:
    """Return (event, parameter) of each event in the data of operation 90C7."""
    reader = Reader(data, "list of events")
    count = reader.u16() if reader.left else 0
    if count * 6 > reader.left:
        raise reader.invalid(f"{count} events in {reader.left} bytes")
    return tuple((reader.u16(), reader.u32()) for _ in range(count))


def parse_panasonic_property(data: bytes, code: int) -> PropertyDescription:
    """Return the description in the data of operation 9108.

    Known from recorded answers: the second word says where, in words, the data type stands; after
    it come the form, the current value, the number of choices and these.
    """
    reader = Reader(data, "property description")
    reader.u32()
    words = reader.u32()
    reader.take(max(4 * words - 8, 0))
    data_type = reader.u32()
    if data_type not in (UINT16, UINT32):
        raise reader.invalid(f"values of type {data_type}")
    reader.u32()
    size = 2 if data_type == UINT16 else 4
    current = reader.integer(size)
    choices = reader.array(size) if reader.left else ()
    return PropertyDescription(code, data_type, True, current, choices)


def parse_panasonic_value(data: bytes) -> int:
    """Return the value in the data of operation 9402: code, size and value."""
    reader = Reader(data, "property")
    reader.u32()
    return reader.integer(min(reader.u32(), 4))


def pack_panasonic_property(code: int, number: int, data_type: int) -> bytes:
    """Return the data of operation 9403."""
    value = pack_integer(number, data_type)
    return code.to_bytes(4, "little") + len(value).to_bytes(4, "little") + value
