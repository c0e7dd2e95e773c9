"""What a virtual webcam says of itself: USB Video Class 1.0 descriptors, formats and controls.

Section numbers are those of "USB Device Class Definition for Video Devices", revision 1.1; format
identifiers are those that Linux's uvcvideo maps to V4L2 pixel formats.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from camctl.controls import Layout

CAMERA, PROCESSING, OUTPUT = 1, 2, 3  # entities: camera terminal, processing unit, output
STREAM_IN = 0x81
PACKET = 512
_GUID_TAIL = bytes.fromhex("00001000800000aa00389b71")
_UNITS_A_SECOND = 10_000_000  # of frame intervals


@dataclass(frozen=True)
class Format:
    """A pixel format.

    Attributes:
        code: first four bytes of its identifier; empty for Motion JPEG
        bytes_a_pixel: of a frame; of a JPEG at most
        bits: a sample may have
        layout: of the sensor it goes with; None: any, its luma is sent
    """

    code: bytes
    bytes_a_pixel: int
    bits: int
    layout: Layout | None = None


#: By the names that a configuration gives them.  Samples of more than 8 bits are little-endian
#: words that hold the sensor's number itself, in their low bits.
FORMATS: Mapping[str, Format] = {
    "yuyv": Format(b"YUY2", 2, 8),
    "grey": Format(b"Y8  ", 1, 8, Layout.MONO),
    "y10": Format(b"Y10 ", 2, 10, Layout.MONO),
    "y12": Format(b"Y12 ", 2, 12, Layout.MONO),
    "y16": Format(b"Y16 ", 2, 16, Layout.MONO),
    "rggb8": Format(b"RGGB", 1, 8, Layout.RGGB),
    "grbg8": Format(b"GRBG", 1, 8, Layout.GRBG),
    "gbrg8": Format(b"GBRG", 1, 8, Layout.GBRG),
    "bggr8": Format(b"BA81", 1, 8, Layout.BGGR),
    "rggb16": Format(b"RG16", 2, 16, Layout.RGGB),
    "mjpg": Format(b"", 2, 8),
}


@dataclass(frozen=True)
class ControlSpec:
    """A control of an entity (sections 4.2.2.1 and 4.2.2.3).

    Attributes:
        entity, selector, bit: where it is, and its bit in the entity's bmControls
        size: bytes
        minimum, maximum, step, default: its range; for a bitmap `step` is the choices
        is_bitmap: a choice of one bit
    """

    entity: int
    selector: int
    bit: int
    size: int
    minimum: int
    maximum: int
    step: int
    default: int
    is_bitmap: bool = False

    def pack(self, value: int) -> bytes:
        """Return a value as the wire has it."""
        return value.to_bytes(self.size, "little")

    def allows(self, value: int) -> bool:
        """Say whether the control can be set to a value."""
        if self.is_bitmap:
            return value.bit_count() == 1 and bool(value & self.step)
        return self.minimum <= value <= self.maximum


MANUAL, APERTURE_PRIORITY = 1, 8  # of ae_mode's bitmap
CONTROLS: Mapping[str, ControlSpec] = {
    "ae_mode": ControlSpec(
        CAMERA, 0x02, 1, 1, 1, 8, MANUAL | APERTURE_PRIORITY, APERTURE_PRIORITY, is_bitmap=True
    ),
    "ae_priority": ControlSpec(CAMERA, 0x03, 2, 1, 0, 1, 1, 1),
    "exposure": ControlSpec(CAMERA, 0x04, 3, 4, 1, 100_000, 1, 157),  # 100 us
    "backlight": ControlSpec(PROCESSING, 0x01, 8, 2, 0, 2, 1, 1),
    "brightness": ControlSpec(PROCESSING, 0x02, 0, 2, 0, 255, 1, 128),
    "gain": ControlSpec(PROCESSING, 0x04, 9, 2, 0, 240, 1, 0),  # linear gain 1 + value / 16
    "mains": ControlSpec(PROCESSING, 0x05, 10, 1, 0, 2, 1, 1),
    "wb_temperature": ControlSpec(PROCESSING, 0x0A, 6, 2, 2800, 6500, 10, 4000),
    "wb_auto": ControlSpec(PROCESSING, 0x0B, 12, 1, 0, 1, 1, 1),
}


class Transfer(IntEnum):
    """How brightness follows light, in the colour matching descriptor (3.9.2.6)."""

    UNSPECIFIED = 0
    LINEAR = 6
    SRGB = 7

    @classmethod
    def of(cls, curve: object) -> Transfer:
        """Return that of a sensor's curve (`sim.sensors.sensor.Sensor.curve`)."""
        return {"linear": cls.LINEAR, "srgb": cls.SRGB}.get(str(curve), cls.UNSPECIFIED)


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _bits(entity: int) -> int:
    return sum(1 << control.bit for control in CONTROLS.values() if control.entity == entity)


def device_descriptor() -> bytes:
    """Return the 18 bytes of a device of interface associations (USB 2.0, 9.6.1)."""
    linux_foundation, webcam, release = 0x1D6B, 0x0102, 0x0100
    fields = (18, 1, 0x200, 0xEF, 2, 1, 64, linux_foundation, webcam, release, 1, 2, 3, 1)
    return struct.pack("<BBHBBBBHHHBBBB", *fields)


def _control_interface() -> bytes:
    """Return camera terminal, processing unit and output terminal behind their header (3.7.2)."""
    units = bytes([18, 0x24, 2, CAMERA, *_u16(0x0201), *bytes(8), 3]) + _bits(CAMERA).to_bytes(
        3, "little"
    )
    units += bytes([11, 0x24, 5, PROCESSING, CAMERA, 0, 0, 2, *_u16(_bits(PROCESSING)), 0])
    units += bytes([9, 0x24, 3, OUTPUT, *_u16(0x0101), 0, PROCESSING, 0])
    header = bytes([13, 0x24, 1, *_u16(0x100), *_u16(13 + len(units))])
    return header + _u32(48_000_000) + bytes([1, 1]) + units


def _frames(
    subtype: int, depth: int, sizes: Sequence[tuple[int, int]], intervals: Sequence[int]
) -> bytes:
    """Return the frame descriptors of one format (Uncompressed payload 3.1.2, MJPEG 3.1.2)."""
    found = b""
    for number, (rows, columns) in enumerate(sizes, 1):
        size = rows * columns * depth
        found += bytes([26 + 4 * len(intervals), 0x24, subtype, number, 0])
        found += _u16(columns) + _u16(rows)
        for interval in (max(intervals), min(intervals)):  # least and most bits a second
            found += _u32(min(size * 8 * _UNITS_A_SECOND // interval, 2**32 - 1))
        found += _u32(size) + _u32(intervals[0]) + bytes([len(intervals)])
        found += b"".join(map(_u32, sorted(intervals)))  # hosts rely on the order (3.1.2)
    return found


def _streaming_interface(
    formats: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    intervals: Sequence[int],
    transfer: Transfer,
) -> bytes:
    colours = bytes([6, 0x24, 0x0D, 1, transfer, 4])  # sRGB primaries, SMPTE 170M luma (3.9.2.6)
    body = b""
    for number, name in enumerate(formats, 1):
        form = FORMATS[name]
        if form.code:
            depth = form.bytes_a_pixel
            body += bytes([27, 0x24, 4, number, len(sizes)]) + form.code + _GUID_TAIL
            body += bytes([8 * depth, 1, 0, 0, 0, 0]) + _frames(5, depth, sizes, intervals)
        else:
            body += bytes([11, 0x24, 6, number, len(sizes), 1, 1, 0, 0, 0, 0])
            body += _frames(7, form.bytes_a_pixel, sizes, intervals)
        body += colours
    head = bytes([13 + len(formats), 0x24, 1, len(formats)])
    head += _u16(13 + len(formats) + len(body)) + bytes([STREAM_IN, 0, OUTPUT, 0, 0, 0, 1])
    return head + bytes(len(formats)) + body


def configuration_descriptor(
    formats: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    intervals: Sequence[int],
    transfer: Transfer,
) -> bytes:
    """Return the one configuration: video control, and video streaming on a bulk endpoint.

    Args:
        formats: names in `FORMATS`
        sizes: (rows, columns)
        intervals: from frame to frame, 100 ns; the first is the default
        transfer: what all formats claim
    """
    body = bytes([8, 0x0B, 0, 2, 0x0E, 3, 0, 2])
    body += bytes([9, 4, 0, 0, 0, 0x0E, 1, 0, 2]) + _control_interface()
    body += bytes([9, 4, 1, 0, 1, 0x0E, 2, 0, 0])
    body += _streaming_interface(formats, sizes, intervals, transfer)
    body += bytes([7, 5, STREAM_IN, 2, *_u16(PACKET), 0])
    return bytes([9, 2, *_u16(9 + len(body)), 2, 1, 0, 0x80, 250]) + body
