"""Datasets of makers: Canon's event records, Sony's list of properties, Nikon's events.

Their layouts are not published; these are the parts that others have found and that a shot needs.
Each parser takes any bytes and ends in a value or a `CameraProtocolError`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from drivers.ptp.codes import Event
from drivers.ptp.datasets import UINT32, PropertyDescription, Reader, read_choices, read_form

_EOS_HEAD = 8
_EOS_LIST = 3  # kind of a list of choices
# A property code of Sony is 5000 or more, so that a smaller number there is a count: newer bodies
# send a second list, of what can be set now.
_FIRST_PROPERTY = 0x5000


@dataclass(frozen=True)
class EosNews:
    """What one poll of Canon's events says, in the order in which it came.

    Attributes:
        values: (property, number) of properties that changed
        choices: (property, numbers) of lists that changed
        added: handles of new objects
    """

    values: tuple[tuple[int, int], ...]
    choices: tuple[tuple[int, tuple[int, ...]], ...]
    added: tuple[int, ...]


def parse_eos_events(data: bytes) -> EosNews:
    """Return what the data of operation 9116 says."""
    values: list[tuple[int, int]] = []
    choices: list[tuple[int, tuple[int, ...]]] = []
    added: list[int] = []
    for kind, body in _eos_records(data):
        reader = Reader(body, "event record")
        if kind == Event.EOS_PROPERTY_CHANGED and reader.left >= 8:
            values.append((reader.u32(), reader.u32()))
        elif kind == Event.EOS_CHOICES_CHANGED and reader.left >= 12:
            code, form, count = reader.u32(), reader.u32(), reader.u32()
            if form == _EOS_LIST:
                choices.append((code, reader.integers(count, 4)))
        elif kind in (Event.EOS_OBJECT_ADDED, Event.EOS_OBJECT_ADDED_64) and reader.left >= 4:
            added.append(reader.u32())
    return EosNews(tuple(values), tuple(choices), tuple(added))


def _eos_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (kind, body) until the record of kind 0, which ends them."""
    reader = Reader(data, "list of events")
    while reader.left >= _EOS_HEAD:
        size, kind = reader.u32(), reader.u32()
        if size < _EOS_HEAD:
            raise reader.nonsense(f"a record of {size} bytes")
        if kind == 0:
            return
        yield kind, reader.take(size - _EOS_HEAD)


def merge_eos(known: dict[int, PropertyDescription], news: EosNews, codes: frozenset[int]) -> None:
    """Bring the descriptions of the properties `codes` up to date."""
    for code, number in news.values:
        if code in codes:
            before = known.get(code) or PropertyDescription(code, UINT32, False, number)
            known[code] = replace(before, current=number)
    for code, numbers in news.choices:
        if code in codes:
            before = known.get(code) or PropertyDescription(code, UINT32, False, 0)
            # A property that cannot be set in this mode has a list of none, or of one.
            known[code] = replace(before, choices=numbers, is_writable=len(numbers) > 1)


def pack_eos_property(code: int, number: int) -> bytes:
    """Return the data of operation 9110."""
    return b"".join(part.to_bytes(4, "little") for part in (12, code, number))


def parse_sony_properties(data: bytes) -> dict[int, PropertyDescription]:
    """Return the descriptions in the data of operation 9209, by property."""
    reader = Reader(data, "list of properties")
    reader.take(8)  # their number, in a form that differs between bodies
    found: dict[int, PropertyDescription] = {}
    while reader.left >= 6:
        code, data_type, can_set, is_enabled = reader.u16(), reader.u16(), reader.u8(), reader.u8()
        reader.value(data_type)
        current = reader.value(data_type)
        choices, span = read_form(reader, data_type)
        if choices and reader.left >= 2 and reader.peek_u16() < _FIRST_PROPERTY:
            choices = read_choices(reader, data_type) or choices
        writable = can_set == 1 and is_enabled == 1
        found[code] = PropertyDescription(code, data_type, writable, current, choices, span)
    return found


def parse_nikon_events(data: bytes) -> tuple[tuple[int, int], ...]:
    """Return (event, parameter) of the data of operation 90C7."""
    reader = Reader(data, "list of events")
    count = reader.u16() if reader.left else 0
    if count * 6 > reader.left:
        raise reader.nonsense(f"{count} events in {reader.left} bytes")
    return tuple((reader.u16(), reader.u32()) for _ in range(count))
