"""Codes and datasets of PTP (ISO 15740) and of three makers' extensions.

Only those that still cameras use.  Standard codes: ISO 15740:2013, clauses 5 and 10 to 13 (PIMA
15740:2000 has the same numbers).  Makers' codes: as published in the header of libgphoto2's PTP
driver; the makers have not published them.  Datasets: clause 5; all numbers are little endian.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

HEADER = struct.Struct("<IHHI")  # of a container: length, type, code, transaction


class Container(IntEnum):
    """Container types (USB still image class 1.0, section 7)."""

    COMMAND = 1
    DATA = 2
    RESPONSE = 3
    EVENT = 4


class Type(IntEnum):
    """Data types of properties."""

    INT8 = 0x0001
    UINT8 = 0x0002
    INT16 = 0x0003
    UINT16 = 0x0004
    INT32 = 0x0005
    UINT32 = 0x0006
    UINT64 = 0x0008
    STRING = 0xFFFF


class Operation(IntEnum):
    """Operation codes."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_STORAGE_INFO = 0x1005
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    INITIATE_CAPTURE = 0x100E
    RESET_DEVICE = 0x1010
    GET_PROPERTY_DESCRIPTION = 0x1014
    GET_PROPERTY_VALUE = 0x1015
    SET_PROPERTY_VALUE = 0x1016
    TERMINATE_OPEN_CAPTURE = 0x1018
    GET_PARTIAL_OBJECT = 0x101B
    INITIATE_OPEN_CAPTURE = 0x101C

    NIKON_CAPTURE = 0x90C0
    NIKON_DRIVE_FOCUS = 0x90C1
    NIKON_SET_CONTROL_MODE = 0x90C2
    NIKON_CHECK_EVENTS = 0x90C7
    NIKON_DEVICE_READY = 0x90C8
    NIKON_GET_VENDOR_CODES = 0x90CA
    NIKON_CAPTURE_TO = 0x9207
    NIKON_TERMINATE_CAPTURE = 0x920C

    EOS_GET_STORAGE_IDS = 0x9101
    EOS_GET_STORAGE_INFO = 0x9102
    EOS_GET_OBJECT = 0x9104
    EOS_GET_PARTIAL_OBJECT = 0x9107
    EOS_GET_DEVICE_INFO = 0x9108
    EOS_RELEASE = 0x910F
    EOS_SET_PROPERTY = 0x9110
    EOS_SET_REMOTE_MODE = 0x9114
    EOS_SET_EVENT_MODE = 0x9115
    EOS_GET_EVENTS = 0x9116
    EOS_TRANSFER_COMPLETE = 0x9117
    EOS_HOST_CAPACITY = 0x911A
    EOS_KEEP_ON = 0x911D
    EOS_BULB_START = 0x9125
    EOS_BULB_END = 0x9126
    EOS_REQUEST_PROPERTY = 0x9127

    EOS_RELEASE_ON = 0x9128
    EOS_RELEASE_OFF = 0x9129

    OLYMPUS_CAPTURE = 0x9481

    PANASONIC_OPEN = 0x9102
    PANASONIC_CLOSE = 0x9103
    PANASONIC_DESCRIPTION = 0x9108
    PANASONIC_GET = 0x9402
    PANASONIC_SET = 0x9403
    PANASONIC_CAPTURE = 0x9404

    SONY_CONNECT = 0x9201
    SONY_GET_INFO = 0x9202
    SONY_SET_PROPERTY = 0x9205
    SONY_CONTROL = 0x9207
    SONY_GET_PROPERTIES = 0x9209


class Response(IntEnum):
    """Response codes."""

    OK = 0x2001
    GENERAL_ERROR = 0x2002
    SESSION_NOT_OPEN = 0x2003
    INVALID_TRANSACTION = 0x2004
    OPERATION_NOT_SUPPORTED = 0x2005
    PARAMETER_NOT_SUPPORTED = 0x2006
    INVALID_STORAGE = 0x2008
    INVALID_HANDLE = 0x2009
    PROPERTY_NOT_SUPPORTED = 0x200A
    STORE_FULL = 0x200C
    STORE_READ_ONLY = 0x200E
    ACCESS_DENIED = 0x200F
    INVALID_PARENT = 0x201A
    DEVICE_BUSY = 0x2019
    INVALID_VALUE_FORMAT = 0x201B
    INVALID_VALUE = 0x201C
    INVALID_PARAMETER = 0x201D
    SESSION_ALREADY_OPEN = 0x201E
    TRANSACTION_CANCELLED = 0x201F
    NO_CARD = 0x2013
    NIKON_INVALID_STATUS = 0xA004
    NIKON_LENS_RING = 0xA00A
    CANON_REFUSED = 0xA005
    CANON_LENS_COVER = 0xA006


class Event(IntEnum):
    """Event codes; Canon's are record types in the reply to its event poll."""

    OBJECT_ADDED = 0x4002
    OBJECT_REMOVED = 0x4003
    PROPERTY_CHANGED = 0x4006
    STORE_FULL = 0x400A
    CAPTURE_COMPLETE = 0x400D
    NIKON_OBJECT_IN_MEMORY = 0xC101
    EOS_OBJECT_ADDED = 0xC181
    EOS_REQUEST_TRANSFER = 0xC186
    EOS_PROPERTY_CHANGED = 0xC189
    EOS_CHOICES_CHANGED = 0xC18A
    FUJI_OBJECT_ADDED = 0xC004
    OLYMPUS_OBJECT_ADDED = 0xC102
    PANASONIC_OBJECT_ADDED = 0xC108
    SONY_OBJECT_ADDED = 0xC201
    SONY_PROPERTY_CHANGED = 0xC203


class Format(IntEnum):
    """Object formats."""

    FOLDER = 0x3001
    JPEG = 0x3801
    TIFF = 0x380D
    DNG = 0x3811
    CANON_RAW = 0xB103


class Property(IntEnum):
    """Device properties."""

    BATTERY_LEVEL = 0x5001
    IMAGE_SIZE = 0x5003
    COMPRESSION = 0x5004
    F_NUMBER = 0x5007
    FOCUS_MODE = 0x500A
    EXPOSURE_TIME = 0x500D
    EXPOSURE_PROGRAM = 0x500E
    EXPOSURE_INDEX = 0x500F
    DATE_TIME = 0x5011

    NIKON_AUTO_ISO = 0xD054
    NIKON_RETRACTABLE_LENS = 0xD09C
    NIKON_FOCAL_LENGTH_MIN = 0xD0E3
    NIKON_FOCAL_LENGTH_MAX = 0xD0E4
    NIKON_MAX_APERTURE_AT_MIN = 0xD0E5
    NIKON_MAX_APERTURE_AT_MAX = 0xD0E6
    NIKON_EXPOSURE_TIME = 0xD100

    EOS_APERTURE = 0xD101
    EOS_SHUTTER = 0xD102
    EOS_ISO = 0xD103
    EOS_PROGRAM = 0xD105
    EOS_AVAILABLE_SHOTS = 0xD11B
    EOS_DESTINATION = 0xD11C
    EOS_OUTPUT = 0xD1B0
    EOS_LENS_NAME = 0xD1D8

    FUJI_PRIORITY = 0xD207
    FUJI_BUTTON = 0xD208
    FUJI_FOCUS_STATE = 0xD209

    OLYMPUS_APERTURE = 0xD002
    OLYMPUS_ISO = 0xD007
    OLYMPUS_PROGRAM = 0xD00C
    OLYMPUS_SHUTTER = 0xD01C
    OLYMPUS_CONTROL_MODE = 0xD052

    SONY_SHUTTER = 0xD20D
    SONY_OBJECT_IN_MEMORY = 0xD215
    SONY_ISO = 0xD21E
    SONY_ISO_SET = 0xD226
    SONY_SHUTTER_SET = 0xD229
    SONY_PRIORITY = 0xD25A
    SONY_BUTTON_FOCUS = 0xD2C1
    SONY_BUTTON_SHUTTER = 0xD2C2


_NUMBERS = {
    Type.INT8: "b",
    Type.UINT8: "B",
    Type.INT16: "h",
    Type.UINT16: "H",
    Type.INT32: "i",
    Type.UINT32: "I",
    Type.UINT64: "Q",
}


def pack_text(text: str) -> bytes:
    """Return a string of up to 254 characters: its length with a NUL, then UTF-16 with the NUL."""
    if not text:
        return b"\0"
    return bytes([len(text) + 1]) + text.encode("utf-16-le") + b"\0\0"


def pack_list(values: Sequence[int], kind: Type = Type.UINT16) -> bytes:
    """Return an array: the number of elements, then the elements."""
    return struct.pack(f"<I{len(values)}{_NUMBERS[kind]}", len(values), *values)


def pack_value(kind: Type, value: int | str) -> bytes:
    """Return the value of a property."""
    return pack_text(value) if isinstance(value, str) else struct.pack("<" + _NUMBERS[kind], value)


def unpack_number(kind: Type, data: bytes) -> int | None:
    """Return the number in `data`; None if `data` is not exactly one number of that type."""
    if kind not in _NUMBERS or len(data) != struct.calcsize(_NUMBERS[kind]):
        return None
    return int(struct.unpack("<" + _NUMBERS[kind], data)[0])


def pack_container(kind: Container, code: int, transaction: int, body: bytes = b"") -> bytes:
    """Return a container."""
    return HEADER.pack(HEADER.size + len(body), kind, code, transaction) + body


def pack_parameters(parameters: Sequence[int]) -> bytes:
    """Return the parameters of a response or an event."""
    return struct.pack(f"<{len(parameters)}I", *parameters)


@dataclass(frozen=True)
class DeviceInfo:
    """The device info dataset, fields in their order."""

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


@dataclass(frozen=True)
class Reply:
    """The result of an operation.

    Attributes:
        code: response code
        parameters: of the response
        data: of the data phase; None: there is none
        sent: called when the reply has been passed to the transport
    """

    code: int = Response.OK
    parameters: tuple[int, ...] = ()
    data: bytes | None = None
    sent: Callable[[], None] | None = None


# Takes the parameters that the host sent (perhaps fewer than the operation needs) and the bytes of
# its data phase; returns None where the reply follows later.
Handler = Callable[[Sequence[int], bytes], Reply | None]
