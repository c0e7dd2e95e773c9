"""Datasets of PTP (ISO 15740, section 5): parsers, and packers of what we send.

All numbers are little-endian (USB).  Any bytes are parsed into a value or rejected with a
`CameraProtocolError`; counts are checked against the bytes present before anything is allocated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from camctl.errors import CameraProtocolError

Value: TypeAlias = int | str | tuple[int, ...]

# Data type codes, ISO 15740 table 3: (bytes, signed); 0x4000 + n is an array of n.
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
_ARRAY = 0x4000  # flag of the type of an array (section 5.3)
STRING = 0xFFFF  # data types (section 5.3)
_READ_ONLY = 1  # access to a storage; 0: read and write, 2: read and delete
UINT16, UINT32 = 0x0004, 0x0006


class Reader:
    """Reads the fields of a dataset from its start; `what` names the dataset in errors."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data = data
        self._what = what
        self._position = 0

    @property
    def left(self) -> int:
        return len(self._data) - self._position

    def invalid(self, reason: str) -> CameraProtocolError:
        """Return the error for an invalid dataset."""
        return CameraProtocolError(
            f"the camera sent an invalid {self._what}: {reason}",
            hint="switch it off and on again; if that does not help, the model is not supported",
        )

    def take(self, count: int) -> bytes:
        if count > self.left:
            raise self.invalid(f"a field needs {count} bytes, {self.left} are left")
        self._position += count
        return self._data[self._position - count : self._position]

    def integer(self, size: int, *, signed: bool = False) -> int:
        return int.from_bytes(self.take(size), "little", signed=signed)

    def u8(self) -> int:
        return self.integer(1)

    def u16(self) -> int:
        return self.integer(2)

    def u32(self) -> int:
        return self.integer(4)

    def peek_u16(self) -> int:
        """Return the next two bytes and leave them to be read."""
        return int.from_bytes(self._data[self._position : self._position + 2], "little")

    def string(self) -> str:
        """Return a string, stored as a count of UTF-16 units and these, ending with a zero."""
        text = self.take(2 * self.u8()).decode("utf-16-le", "replace")
        text = text.split("\0", 1)[0]
        return "".join(c if c.isprintable() else "?" for c in text)

    def array(self, size: int, *, signed: bool = False) -> tuple[int, ...]:
        """Return an array, stored as a 32-bit count and integers of `size` bytes each."""
        return self.integers(self.u32(), size, signed=signed)

    def integers(self, count: int, size: int, *, signed: bool = False) -> tuple[int, ...]:
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
            raise self.invalid(f"unknown data type 0x{data_type:04X}")
        return _INTEGERS[data_type]


def pack_integer(value: int, data_type: int) -> bytes:
    """Return `value` as a PTP integer of a known type."""
    size, signed = _INTEGERS[data_type]
    return value.to_bytes(size, "little", signed=signed)


@dataclass(frozen=True)
class DeviceInfo:
    """Identity of a camera and the codes that it supports, ISO 15740 section 5.5.1."""

    vendor_extension: int
    operations: frozenset[int]
    properties: tuple[int, ...]
    make: str
    model: str
    serial: str

    @classmethod
    def parse(cls, data: bytes) -> DeviceInfo:
        """Return the dataset of GetDeviceInfo."""
        reader = Reader(data, "device information")
        reader.u16()  # version of the standard
        extension = reader.u32()
        reader.u16()  # version of the extension
        reader.string()  # name of the extension
        reader.u16()  # functional mode
        operations = frozenset(reader.array(2))
        reader.array(2)  # events
        properties = reader.array(2)
        reader.array(2)  # capture formats
        reader.array(2)  # image formats
        make, model, _, serial = (reader.string().strip() for _ in range(4))
        return cls(extension, operations, properties, make, model, serial)


@dataclass(frozen=True)
class ObjectInfo:
    """Description of an object on the card, ISO 15740 section 5.5.2."""

    format: int
    size: int
    columns: int
    rows: int
    parent: int
    name: str
    captured: str

    @classmethod
    def parse(cls, data: bytes) -> ObjectInfo:
        """Return the dataset of GetObjectInfo; some cameras omit the fields after the name."""
        reader = Reader(data, "object information")
        reader.u32()  # storage
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
        return cls(object_format, size, columns, rows, parent, name, captured)


@dataclass(frozen=True)
class StorageInfo:
    """Write access and free space of a card, ISO 15740 section 5.5.3.

    Attributes:
        is_read_only: True if neither pictures can be stored nor objects deleted; cards to which
            a host cannot send files, but which take pictures, say "read-only with object deletion"
        free_bytes, free_images: free space
    """

    is_read_only: bool
    free_bytes: int
    free_images: int

    @classmethod
    def parse(cls, data: bytes) -> StorageInfo:
        """Return the dataset of GetStorageInfo."""
        reader = Reader(data, "storage information")
        reader.take(2 + 2)  # types of storage and file system
        access = reader.u16()
        reader.take(8)  # capacity
        return cls(access == _READ_ONLY, reader.integer(8), reader.u32())


@dataclass(frozen=True)
class PropertyDescription:
    """A camera's description of a property, ISO 15740 section 13.3.3.

    Attributes:
        code, data_type: PTP codes
        is_writable: True if it can be set now
        current: current value
        choices: all values that can be set, if the camera lists them
        span: (minimum, maximum, step), if the camera gives a range
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
    """Return (choices, span) from the form field at the end of a property description."""
    form = reader.u8() if reader.left else 0
    if form == 0:
        return (), None
    if form == 1:
        low, high, step = (reader.value(data_type) for _ in range(3))
        if not (isinstance(low, int) and isinstance(high, int) and isinstance(step, int)):
            raise reader.invalid("the limits of a range are not numbers")
        return (), (low, high, step)
    if form == 2:
        return read_choices(reader, data_type), None
    raise reader.invalid(f"unknown form {form}")


def read_choices(reader: Reader, data_type: int) -> tuple[Value, ...]:
    """Return the values of an enumeration, stored after their 16-bit count."""
    return tuple([reader.value(data_type) for _ in range(reader.u16())])
