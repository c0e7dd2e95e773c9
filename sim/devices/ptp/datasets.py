"""How PTP writes numbers, texts, lists and datasets: ISO 15740, clause 5; all little endian."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from sim.devices.ptp.codes import Container, Format, Response, Type

HEADER = struct.Struct("<IHHI")  # length, kind of container, code, transaction

_NUMBERS = {
    Type.INT8: "b",
    Type.UINT8: "B",
    Type.INT16: "h",
    Type.UINT16: "H",
    Type.INT32: "i",
    Type.UINT32: "I",
    Type.UINT64: "Q",
}
_RANGE, _ENUMERATION = 1, 2


def pack_text(text: str) -> bytes:
    """Return a text of up to 254 characters: their number with the closing NUL, then UTF-16."""
    if not text:
        return b"\0"
    return bytes([len(text) + 1]) + text.encode("utf-16-le") + b"\0\0"


def pack_list(values: Sequence[int], kind: Type = Type.UINT16) -> bytes:
    """Return a list of numbers: how many, then each."""
    return struct.pack(f"<I{len(values)}{_NUMBERS[kind]}", len(values), *values)


def pack_value(kind: Type, value: int | str) -> bytes:
    """Return a property's value."""
    return pack_text(value) if isinstance(value, str) else struct.pack("<" + _NUMBERS[kind], value)


def unpack_number(kind: Type, data: bytes) -> int | None:
    """Return the number that `data` is; None where it is not exactly one of that kind."""
    if kind not in _NUMBERS or len(data) != struct.calcsize(_NUMBERS[kind]):
        return None
    return int(struct.unpack("<" + _NUMBERS[kind], data)[0])


def pack_container(kind: Container, code: int, transaction: int, body: bytes = b"") -> bytes:
    """Return a whole container."""
    return HEADER.pack(HEADER.size + len(body), kind, code, transaction) + body


def pack_parameters(parameters: Sequence[int]) -> bytes:
    """Return the parameters of a response or an event."""
    return struct.pack(f"<{len(parameters)}I", *parameters)


@dataclass
class DeviceProperty:
    """A property that a host may read, and perhaps set.

    Attributes:
        code, kind: which it is, and its data type
        value, default: in the property's own units
        choices: values that it may have; empty: see `limits`
        limits: (least, most, step) where any value between is allowed
        is_writable: a host may set it
    """

    code: int
    kind: Type
    value: int | str
    choices: tuple[int, ...] = ()
    limits: tuple[int, int, int] | None = None
    is_writable: bool = True
    default: int | str = field(init=False)

    def __post_init__(self) -> None:
        self.default = self.value

    def allows(self, value: int) -> bool:
        """Return whether its form has `value`."""
        if self.choices:
            return value in self.choices
        if self.limits is not None:
            least, most, step = self.limits
            return least <= value <= most and (value - least) % step == 0
        return True

    def packed(self) -> bytes:
        """Return its value as it goes over the wire."""
        return pack_value(self.kind, self.value)

    def description(self) -> bytes:
        """Return the property description dataset."""
        head = struct.pack("<HHB", self.code, self.kind, self.is_writable)
        return head + pack_value(self.kind, self.default) + self.packed() + self.form()

    def form(self) -> bytes:
        """Return the end of its description: which values it may have."""
        if self.choices:
            listed = b"".join(pack_value(self.kind, choice) for choice in self.choices)
            return struct.pack("<BH", _ENUMERATION, len(self.choices)) + listed
        if self.limits is not None:
            return bytes([_RANGE]) + b"".join(pack_value(self.kind, v) for v in self.limits)
        return b"\0"


@dataclass(frozen=True)
class DeviceInfo:
    """The device info dataset; fields in the order of the wire."""

    vendor_extension: int
    vendor_version: int
    operations: Sequence[int]
    events: Sequence[int]
    properties: Sequence[int]
    capture_formats: Sequence[int]
    image_formats: Sequence[int]
    make: str
    model: str
    version: str
    serial: str

    def packed(self) -> bytes:
        """Return the dataset."""
        lists = (
            self.operations,
            self.events,
            self.properties,
            self.capture_formats,
            self.image_formats,
        )
        texts = (self.make, self.model, self.version, self.serial)
        return (
            struct.pack("<HIH", 100, self.vendor_extension, self.vendor_version)
            + pack_text("")
            + struct.pack("<H", 0)  # functional mode: standard
            + b"".join(pack_list(values) for values in lists)
            + b"".join(pack_text(text) for text in texts)
        )


def pack_storage_info(capacity: int, free: int, free_images: int) -> bytes:
    """Return the dataset of a removable card with folders that may be read and written."""
    removable_ram, hierarchical, read_write = 4, 2, 0
    return (
        struct.pack("<HHHQQI", removable_ram, hierarchical, read_write, capacity, free, free_images)
        + pack_text("card")
        + pack_text("VIRT")
    )


@dataclass(frozen=True, eq=False)
class StoredObject:
    """A file or a folder on the card.

    Attributes:
        name: with its suffix
        format: see `sim.devices.ptp.codes.Format`
        data: of a file
        parent: handle of its folder; 0 at the top
        rows, columns, bits: of the picture in it; bits a pixel
        thumbnail: a small JPEG, or nothing
    """

    name: str
    format: int
    data: bytes = b""
    parent: int = 0
    rows: int = 0
    columns: int = 0
    bits: int = 0
    thumbnail: bytes = b""

    def info(self, storage: int) -> bytes:
        """Return the object info dataset."""
        thumb_format = 0x3808 if self.thumbnail else 0  # JFIF
        return (
            struct.pack("<IHHI", storage, self.format, 0, len(self.data))
            + struct.pack("<HIII", thumb_format, len(self.thumbnail), 0, 0)
            + struct.pack(
                "<IIIIHII",
                self.columns,
                self.rows,
                self.bits,
                self.parent,
                self.format == Format.FOLDER,
                0,
                0,
            )
            + pack_text(self.name)
            + pack_text("20240101T120000")
            + pack_text("20240101T120000")
            + pack_text("")
        )


@dataclass(frozen=True)
class Reply:
    """What an operation comes to.

    Attributes:
        code: response code
        parameters: of the response
        data: of the data phase, where there is one
        sent: called when all of it has gone out
    """

    code: int = Response.OK
    parameters: tuple[int, ...] = ()
    data: bytes | None = None
    sent: Callable[[], None] | None = None


# Parameters as they came (there may be fewer than an operation needs) and the data phase's bytes;
# None: the answer comes later.
Handler = Callable[[Sequence[int], bytes], Reply | None]
