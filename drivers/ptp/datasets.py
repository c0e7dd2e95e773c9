"""PTP's datasets, ISO 15740 section 5: a small packer and a parser that nonsense cannot hurt.

All numbers are little-endian (USB).  Whatever arrives, parsing ends in a value or in a
`CameraProtocolError`; counts are checked against the bytes that are there before anything is built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from camctl.errors import CameraProtocolError

Value: TypeAlias = int | str | tuple[int, ...]

# Data type codes, ISO 15740 table 3: bytes and sign; 0x4000 + n is an array of n.
_INTEGERS: dict[int, tuple[int, bool]] = {
    0x0001: (1, True),
    0x0002: (1, False),
    0x0003: (2, True),
    0x0004: (2, False),
    0x0005: (4, True),
    0x0006: (4, False),
    0x0007: (8, True),
    0x0008: (8, False),
    0x0009: (16, True),
    0x000A: (16, False),
}
_ARRAY = 0x4000
STRING = 0xFFFF
UINT16, UINT32 = 0x0004, 0x0006


class Reader:
    """Takes one field after another from the front of a dataset."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data = data
        self._what = what
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes not yet read."""
        return len(self._data) - self.at

    def nonsense(self, why: str) -> CameraProtocolError:
        """Return the error for a dataset that cannot be."""
        return CameraProtocolError(
            f"the camera's {self._what} makes no sense: {why}",
            hint="switch it off and on again; if it stays so, the model is not supported",
        )

    def take(self, count: int) -> bytes:
        """Return the next `count` bytes."""
        if count > self.left:
            raise self.nonsense(f"{count} bytes wanted, {self.left} left")
        self.at += count
        return self._data[self.at - count : self.at]

    def integer(self, size: int, *, signed: bool = False) -> int:
        """Return an integer of `size` bytes."""
        return int.from_bytes(self.take(size), "little", signed=signed)

    def u8(self) -> int:
        """Return one byte."""
        return self.integer(1)

    def u16(self) -> int:
        """Return two bytes."""
        return self.integer(2)

    def u32(self) -> int:
        """Return four bytes."""
        return self.integer(4)

    def peek_u16(self) -> int:
        """Return the next two bytes without taking them."""
        return int.from_bytes(self._data[self.at : self.at + 2], "little")

    def string(self) -> str:
        """Return a string: a count of UTF-16 units with the closing zero, then these."""
        text = self.take(2 * self.u8()).decode("utf-16-le", "replace")
        text = text.split("\0", 1)[0]
        return "".join(c if c.isprintable() else "?" for c in text)

    def array(self, size: int, *, signed: bool = False) -> tuple[int, ...]:
        """Return an array of integers of `size` bytes each, after its 32-bit count."""
        return self.integers(self.u32(), size, signed=signed)

    def integers(self, count: int, size: int, *, signed: bool = False) -> tuple[int, ...]:
        """Return `count` integers of `size` bytes each."""
        data = self.take(count * size)
        parts = (data[i : i + size] for i in range(0, len(data), size))
        return tuple(int.from_bytes(part, "little", signed=signed) for part in parts)

    def value(self, data_type: int) -> Value:
        """Return a value of a PTP data type."""
        if data_type == STRING:
            return self.string()
        size, signed = self._integer_type(data_type & ~_ARRAY)
        if data_type & _ARRAY:
            return self.array(size, signed=signed)
        return self.integer(size, signed=signed)

    def _integer_type(self, data_type: int) -> tuple[int, bool]:
        if data_type not in _INTEGERS:
            raise self.nonsense(f"data type 0x{data_type:04X}")
        return _INTEGERS[data_type]


def pack_integer(value: int, data_type: int) -> bytes:
    """Return `value` as a PTP integer; the caller got type and value from the camera itself."""
    size, signed = _INTEGERS[data_type]
    return value.to_bytes(size, "little", signed=signed)


@dataclass(frozen=True)
class DeviceInfo:
    """Who a camera is and what it knows, ISO 15740 section 5.5.1; codes as numbers."""

    vendor_extension: int
    operations: frozenset[int]
    events: frozenset[int]
    properties: tuple[int, ...]
    image_formats: tuple[int, ...]
    make: str
    model: str
    version: str
    serial: str

    @classmethod
    def parse(cls, data: bytes) -> DeviceInfo:
        """Return the dataset of GetDeviceInfo."""
        reader = Reader(data, "device information")
        reader.u16()  # version of the standard
        extension = reader.u32()
        reader.u16()  # version of the extension
        reader.string()  # what the extension is called
        reader.u16()  # functional mode
        operations, events, properties = (reader.array(2) for _ in range(3))
        reader.array(2)  # capture formats
        formats = reader.array(2)
        make, model, version, serial = (reader.string().strip() for _ in range(4))
        return cls(
            extension,
            frozenset(operations),
            frozenset(events),
            properties,
            formats,
            make,
            model,
            version,
            serial,
        )


@dataclass(frozen=True)
class ObjectInfo:
    """What is known of an object on the card, ISO 15740 section 5.5.2."""

    storage: int
    format: int
    size: int
    columns: int
    rows: int
    parent: int
    name: str
    captured: str

    @classmethod
    def parse(cls, data: bytes) -> ObjectInfo:
        """Return the dataset of GetObjectInfo; cameras leave out what comes behind the name."""
        reader = Reader(data, "object information")
        storage = reader.u32()
        object_format = reader.u16()
        reader.u16()  # protection
        size = reader.u32()
        reader.take(2 + 3 * 4)  # thumbnail: format, size, width, height
        columns, rows = reader.u32(), reader.u32()
        reader.u32()  # bit depth
        parent = reader.u32()
        reader.take(2 + 4 + 4)  # association, sequence number
        name = reader.string()
        captured = reader.string() if reader.left else ""
        return cls(storage, object_format, size, columns, rows, parent, name, captured)


@dataclass(frozen=True)
class StorageInfo:
    """A card, ISO 15740 section 5.5.3, as far as a shot needs to know it."""

    is_writable: bool
    free_bytes: int
    free_images: int

    @classmethod
    def parse(cls, data: bytes) -> StorageInfo:
        """Return the dataset of GetStorageInfo."""
        reader = Reader(data, "storage information")
        reader.take(2 + 2)  # kind of storage, of file system
        access = reader.u16()
        reader.take(8)  # capacity
        return cls(access == 0, reader.integer(8), reader.u32())


@dataclass(frozen=True)
class PropertyDescription:
    """A property as the camera describes it, ISO 15740 section 13.3.3.

    Attributes:
        code, data_type: PTP codes
        is_writable: it can be set now
        current: value now
        choices: all values it can take, where it lists them
        span: (minimum, maximum, step), where it has these instead
    """

    code: int
    data_type: int
    is_writable: bool
    current: Value
    choices: tuple[Value, ...] = ()
    span: tuple[int, int, int] | None = None

    @classmethod
    def parse(cls, data: bytes) -> PropertyDescription:
        """Return the dataset of GetDevicePropDesc."""
        reader = Reader(data, "property description")
        code, data_type, access = reader.u16(), reader.u16(), reader.u8()
        reader.value(data_type)  # factory default
        current = reader.value(data_type)
        choices, span = read_form(reader, data_type)
        return cls(code, data_type, access == 1, current, choices, span)


def read_form(
    reader: Reader, data_type: int
) -> tuple[tuple[Value, ...], tuple[int, int, int] | None]:
    """Return (choices, span) of the form that ends a property description."""
    form = reader.u8() if reader.left else 0
    if form == 0:
        return (), None
    if form == 1:
        low, high, step = (reader.value(data_type) for _ in range(3))
        if not (isinstance(low, int) and isinstance(high, int) and isinstance(step, int)):
            raise reader.nonsense("a range of what is no number")
        return (), (low, high, step)
    if form == 2:
        return read_choices(reader, data_type), None
    raise reader.nonsense(f"form {form}")


def read_choices(reader: Reader, data_type: int) -> tuple[Value, ...]:
    """Return the values of an enumeration, after their 16-bit count."""
    values: Sequence[Value] = [reader.value(data_type) for _ in range(reader.u16())]
    return tuple(values)
