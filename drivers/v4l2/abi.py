"""The kernel's interface to video devices: the V4L2 ioctls that the driver uses, and their data.

Source of numbers and layouts: linux/videodev2.h and linux/v4l2-controls.h.  The structures have
the layout of 64-bit Linux; a test compares their sizes and the ioctl numbers with the kernel's.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from typing import Any

#: Types of fields, by the letters of the module `struct`; a field without one is a u32.
_TYPES: Mapping[str, Any] = {
    "": ctypes.c_uint32,
    "B": ctypes.c_uint8,
    "H": ctypes.c_uint16,
    "I": ctypes.c_uint32,
    "Q": ctypes.c_uint64,
    "i": ctypes.c_int32,
    "q": ctypes.c_int64,
}

CAPTURE_BUFFER = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
PLANES_BUFFER = 9  # V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE
MOST_PLANES = 8  # VIDEO_MAX_PLANES
MAPPED_MEMORY = 1  # V4L2_MEMORY_MMAP


def _fields(text: str) -> tuple[tuple[str, Any], ...]:
    """Return fields by name and type, "name:B", of an array with its length, "name:B16"."""
    parts = [each.partition(":")[::2] for each in text.split()]
    types = [(name, _TYPES[kind[:1]], int(kind[1:] or 0)) for name, kind in parts]
    return tuple((name, type_ * count if count else type_) for name, type_, count in types)


class Capability(ctypes.Structure):
    """Driver, name and capabilities of a node: struct v4l2_capability."""

    _fields_ = _fields(
        "driver:B16 card:B32 bus_info:B32 version capabilities device_caps reserved:I3"
    )


class FormatDescription(ctypes.Structure):
    """An entry of the list of pixel formats: struct v4l2_fmtdesc."""

    _fields_ = _fields("index type flags description:B32 pixelformat reserved:I4")


class Format(ctypes.Structure):
    """Pixel format and size: struct v4l2_format with struct v4l2_pix_format in its union."""

    _fields_ = _fields(
        "type _alignment width height pixelformat field bytesperline sizeimage "
        "colorspace priv flags ycbcr_enc quantization xfer_func _rest:B152"
    )


class PlaneFormat(ctypes.Structure):
    """Size of a plane: struct v4l2_plane_pix_format (packed)."""

    _pack_ = 1
    _fields_ = _fields("sizeimage bytesperline _reserved:H6")


class PlanesFormat(ctypes.Structure):
    """Pixel format of a multi-planar node: struct v4l2_format with struct v4l2_pix_format_mplane.

    Its fields after the planes have one byte each.
    """

    _pack_ = 1
    _fields_ = (
        *_fields("type _alignment width height pixelformat field colorspace"),
        ("planes", PlaneFormat * MOST_PLANES),
        *_fields("num_planes:B flags:B ycbcr_enc:B quantization:B _rest:B16"),
    )


class Plane(ctypes.Structure):
    """A plane of a buffer: struct v4l2_plane."""

    _fields_ = _fields("bytesused length offset:Q data_offset _reserved:I11")


class StreamParameters(ctypes.Structure):
    """The frame interval: struct v4l2_streamparm with struct v4l2_captureparm in its union."""

    _fields_ = _fields("type capability capturemode numerator denominator _rest:B184")


class ControlQuery(ctypes.Structure):
    """A control's range: struct v4l2_queryctrl."""

    _fields_ = _fields(
        "id type name:B32 minimum:i maximum:i step:i default_value:i flags reserved:I2"
    )


class MenuQuery(ctypes.Structure):
    """An entry of a menu control: struct v4l2_querymenu (packed)."""

    _pack_ = 1
    _fields_ = _fields("id index name:B32 reserved")


class ControlValue(ctypes.Structure):
    """A control's value: struct v4l2_control."""

    _fields_ = _fields("id value:i")


class SizeQuery(ctypes.Structure):
    """An entry of the list of sizes: struct v4l2_frmsizeenum.

    The six words are width and height if the type is discrete, else minimum, maximum and step of
    the width, then of the height.
    """

    _fields_ = _fields("index pixel_format type words:I6 reserved:I2")


class IntervalQuery(ctypes.Structure):
    """An entry of the list of frame intervals: struct v4l2_frmivalenum.

    The words are fractions of a second, numerator and denominator: one fraction if the type is
    discrete, else minimum, maximum and step.
    """

    _fields_ = _fields("index pixel_format width height type words:I6 reserved:I2")


class BufferRequest(ctypes.Structure):
    """How many buffers a stream has: struct v4l2_requestbuffers."""

    _fields_ = _fields("count type memory capabilities flags")


class Buffer(ctypes.Structure):
    """A buffer of a stream: struct v4l2_buffer; the timestamp in seconds and microseconds."""

    _fields_ = _fields(
        "index type bytesused flags field _alignment seconds:q microseconds:q "
        "_timecode:I4 sequence memory offset:Q length _reserved _request _end"
    )


class BufferType(ctypes.Structure):
    """The kind of buffers that is started or stopped: an int."""

    _fields_ = _fields("type:i")


class LongValue(ctypes.Structure):
    """A control's value of up to 64 bits: struct v4l2_ext_control (packed)."""

    _pack_ = 1
    _fields_ = _fields("id size _reserved value:q")


class LongValues(ctypes.Structure):
    """A list of such values: struct v4l2_ext_controls."""

    _fields_ = (
        *_fields("which count error_index _request:i _reserved:I2"),
        ("controls", ctypes.POINTER(LongValue)),
    )


_READ, _WRITE = 2, 1  # directions of an ioctl


class Entity(ctypes.Structure):
    """A part of a media device: struct media_entity_desc of linux/media.h."""

    _fields_ = _fields(
        "id name:B32 type revision flags group_id pads:H links:H reserved:I4 major minor raw:B176"
    )


class PadFormat(ctypes.Structure):
    """The format of a pad of a subdevice: struct v4l2_subdev_format of linux/v4l2-subdev.h."""

    _fields_ = _fields("which pad width height code field rest:B64")


def _request(
    direction: int, number: int, structure: type[ctypes.Structure], kind: str = "V"
) -> int:
    """Return the number of an ioctl: direction, size, kind, index (asm-generic/ioctl.h)."""
    return direction << 30 | ctypes.sizeof(structure) << 16 | ord(kind) << 8 | number


class Request(IntEnum):
    """Numbers of the ioctls."""

    QUERYCAP = _request(_READ, 0, Capability)
    ENUM_FMT = _request(_READ | _WRITE, 2, FormatDescription)
    G_FMT = _request(_READ | _WRITE, 4, Format)
    S_FMT = _request(_READ | _WRITE, 5, Format)
    REQBUFS = _request(_READ | _WRITE, 8, BufferRequest)
    QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
    QBUF = _request(_READ | _WRITE, 15, Buffer)
    DQBUF = _request(_READ | _WRITE, 17, Buffer)
    STREAMON = _request(_WRITE, 18, BufferType)
    STREAMOFF = _request(_WRITE, 19, BufferType)
    S_PARM = _request(_READ | _WRITE, 22, StreamParameters)
    G_CTRL = _request(_READ | _WRITE, 27, ControlValue)
    S_CTRL = _request(_READ | _WRITE, 28, ControlValue)
    QUERYCTRL = _request(_READ | _WRITE, 36, ControlQuery)
    QUERYMENU = _request(_READ | _WRITE, 37, MenuQuery)
    G_EXT_CTRLS = _request(_READ | _WRITE, 71, LongValues)
    ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, SizeQuery)
    ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, IntervalQuery)
    SUBDEV_G_FMT = _request(_READ | _WRITE, 4, PadFormat)
    ENUM_ENTITIES = _request(_READ | _WRITE, 1, Entity, "|")


class Caps(IntFlag):
    """Bits of `Capability.capabilities` and `device_caps`."""

    VIDEO_CAPTURE = 0x00000001
    VIDEO_CAPTURE_PLANES = 0x00001000
    STREAMING = 0x04000000
    DEVICE_CAPS = 0x80000000


class BufferFlag(IntFlag):
    """Bits of `Buffer.flags`."""

    ERROR = 0x0040  # the frame is damaged


class ControlFlag(IntFlag):
    """Bits of `ControlQuery.flags`."""

    DISABLED = 0x0001
    READ_ONLY = 0x0004


class ControlType(IntEnum):
    """Types of controls with a 32-bit value."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    INTEGER_MENU = 9


class Grid(IntEnum):
    """Values of `SizeQuery.type` and `IntervalQuery.type`."""

    DISCRETE = 1
    CONTINUOUS = 2
    STEPWISE = 3


class Quantization(IntEnum):
    """Values of `Format.quantization`."""

    DEFAULT = 0
    FULL = 1
    LIMITED = 2


COLORSPACE_JPEG = 7  # enum v4l2_colorspace
# Bases of the ids of controls, by class (V4L2_CID_BASE and the like).
_USER, _CAMERA, _SOURCE, _PROCESSING = 0x00980900, 0x009A0900, 0x009E0900, 0x009F0900


class ControlId(IntEnum):
    """The controls that set the exposure, and those that would change it automatically."""

    AUTO_WHITE_BALANCE = _USER + 12
    EXPOSURE = _USER + 17
    AUTOGAIN = _USER + 18
    GAIN = _USER + 19
    POWER_LINE_FREQUENCY = _USER + 24
    HUE_AUTO = _USER + 25
    BACKLIGHT_COMPENSATION = _USER + 28
    CHROMA_AGC = _USER + 29
    AUTOBRIGHTNESS = _USER + 32
    EXPOSURE_AUTO = _CAMERA + 1
    EXPOSURE_ABSOLUTE = _CAMERA + 2
    EXPOSURE_AUTO_PRIORITY = _CAMERA + 3
    FOCUS_ABSOLUTE = _CAMERA + 10
    FOCUS_AUTO = _CAMERA + 12
    AUTO_N_PRESET_WHITE_BALANCE = _CAMERA + 20
    WIDE_DYNAMIC_RANGE = _CAMERA + 21
    IMAGE_STABILIZATION = _CAMERA + 22
    ISO_SENSITIVITY_AUTO = _CAMERA + 24
    SCENE_MODE = _CAMERA + 26
    HDR_SENSOR_MODE = _CAMERA + 36
    VBLANK = _SOURCE + 1
    HBLANK = _SOURCE + 2
    ANALOGUE_GAIN = _SOURCE + 3
    PIXEL_RATE = _PROCESSING + 2


MANUAL_EXPOSURE = 1  # entry of the menu EXPOSURE_AUTO


def fourcc(code: str) -> int:
    """Return the number of a pixel format from its four characters."""
    return int.from_bytes(code.encode("ascii"), "little")


def text(field: ctypes.Array[ctypes.c_uint8]) -> str:
    """Return the text of a field up to its first NUL, with "?" for unprintable characters."""
    decoded = bytes(field).split(b"\0", 1)[0].decode("utf-8", "replace")
    return "".join(letter if letter.isprintable() else "?" for letter in decoded).strip()
