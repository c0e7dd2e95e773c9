"""Options, pixel formats and descriptors (USB Video Class 1.0) of a virtual webcam.

Section numbers are from "USB Device Class Definition for Video Devices", revision 1.1; format
identifiers are known to Linux's uvcvideo, which maps them to V4L2 pixel formats.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from camctl.errors import UsageError, unknown_name
from camctl.interface.backends import FrameShape
from camctl.interface.controls import Layout
from camctl.sim.devices.common import DeviceConfig, VirtualSensor, as_tuple
from camctl.sim.devices.uvc.controls import CAMERA, CONTROLS, PROCESSING

OUTPUT = 3  # entity: output terminal
STREAM_IN = 0x81  # address of the endpoint
PACKET = 512  # bytes, bulk at high speed (USB 2.0, 5.8.3)
_GUID_TAIL = bytes.fromhex("00001000800000aa00389b71")
INTERVALS_PER_S = 10_000_000  # frame intervals are in units of 100 ns


@dataclass(frozen=True)
class Format:
    """A pixel format.

    Attributes:
        code: first four bytes of its identifier; empty for Motion JPEG
        pixel_bytes: bytes per pixel; of a JPEG at most
        bits: largest bit depth of a sample
        layout: pixel layout of the sensors that have this format; None: any, the luma is sent
    """

    code: bytes
    pixel_bytes: int
    bits: int
    layout: Layout | None = None


#: By name.  Samples of more than 8 bits are little-endian words with the sensor's digital number in
#: their low bits.
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


_FrameRate = Annotated[float, Field(ge=1, le=240)]


class UvcConfig(DeviceConfig):
    """The options of a virtual webcam; a list may be given as a single value.

    Attributes:
        serial: serial number
        formats: names in `FORMATS`, the default first
        sizes: of frames, in addition to `size`, which is the default
        fps: frame rates, the default first
        delay: control delay, frames; -1: the running exposure has it already
        gain_delay: of the gain; None: as of the exposure time
        jitter: up to so many frames are added to the delay at random
        luma: range of yuyv
    """

    serial: str = Field(default="UVC00001", min_length=1, max_length=60, pattern=r"^[ -~]+$")
    formats: Annotated[tuple[str, ...], BeforeValidator(as_tuple), Field(min_length=1)] = (
        "yuyv",
        "mjpg",
    )
    sizes: Annotated[tuple[FrameShape, ...], BeforeValidator(as_tuple)] = ()
    fps: Annotated[tuple[_FrameRate, ...], BeforeValidator(as_tuple), Field(min_length=1)] = (10.0,)
    delay: int = Field(default=2, ge=-1, le=30)
    gain_delay: int | None = Field(default=None, ge=-1, le=30)
    jitter: int = Field(default=0, ge=0, le=30)
    luma: Literal["full", "limited"] = "limited"


def check_format(name: str, sensor: VirtualSensor) -> None:
    """Raise UsageError for a pixel format that is unknown or cannot hold the sensor's pixels."""
    if name not in FORMATS:
        raise unknown_name("pixel format", name, FORMATS)
    form, bits = FORMATS[name], sensor.model.bits
    if form.layout is None:
        is_suitable = not sensor.layout.is_mosaic
    else:
        is_suitable = form.layout is sensor.layout and bits <= form.bits
    if not is_suitable:
        raise UsageError(
            f"the pixel format {name} cannot hold the pixels of a sensor of {bits} bits,"
            f" {sensor.layout}",
            hint="choose another format or sensor",
        )


class Transfer(IntEnum):
    """Transfer characteristics in the colour matching descriptor (3.9.2.6)."""

    UNSPECIFIED = 0
    LINEAR = 6
    SRGB = 7

    @classmethod
    def of(cls, curve: object) -> Transfer:
        """Return the characteristics of the curve of a sensor."""
        return {"linear": cls.LINEAR, "srgb": cls.SRGB}.get(str(curve), cls.UNSPECIFIED)


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _control_bits(entity: int) -> int:
    return sum(1 << control.bit for control in CONTROLS.values() if control.entity == entity)


def device_descriptor() -> bytes:
    """Return the 18 bytes of a device with interface associations (USB 2.0, 9.6.1)."""
    linux_foundation, webcam, release = 0x1D6B, 0x0102, 0x0100
    fields = (18, 1, 0x200, 0xEF, 2, 1, 64, linux_foundation, webcam, release, 1, 2, 3, 1)
    return struct.pack("<BBHBBBBHHHBBBB", *fields)


def _control_interface() -> bytes:
    """Return the header, camera terminal, processing unit and output terminal (3.7.2)."""
    units = bytes([18, 0x24, 2, CAMERA, *_u16(0x0201), *bytes(8), 3])
    units += _control_bits(CAMERA).to_bytes(3, "little")
    units += bytes([11, 0x24, 5, PROCESSING, CAMERA, 0, 0, 2])
    units += bytes([*_u16(_control_bits(PROCESSING)), 0])
    units += bytes([9, 0x24, 3, OUTPUT, *_u16(0x0101), 0, PROCESSING, 0])
    header = bytes([13, 0x24, 1, *_u16(0x100), *_u16(13 + len(units))])
    return header + _u32(48_000_000) + bytes([1, 1]) + units


def _frames(
    subtype: int, pixel_bytes: int, sizes: Sequence[tuple[int, int]], intervals: Sequence[int]
) -> bytes:
    """Return the frame descriptors of one format (Uncompressed payload 3.1.2, MJPEG 3.1.2)."""
    frames = b""
    for number, (rows, columns) in enumerate(sizes, 1):
        size = rows * columns * pixel_bytes
        frames += bytes([26 + 4 * len(intervals), 0x24, subtype, number, 0])
        frames += _u16(columns) + _u16(rows)
        for interval in (max(intervals), min(intervals)):  # lowest and highest bit rate
            frames += _u32(min(size * 8 * INTERVALS_PER_S // interval, 2**32 - 1))
        frames += _u32(size) + _u32(intervals[0]) + bytes([len(intervals)])
        frames += b"".join(map(_u32, sorted(intervals)))  # hosts rely on the order (3.1.2)
    return frames


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
            body += bytes([27, 0x24, 4, number, len(sizes)]) + form.code + _GUID_TAIL
            body += bytes([8 * form.pixel_bytes, 1, 0, 0, 0, 0])
            body += _frames(5, form.pixel_bytes, sizes, intervals)
        else:
            body += bytes([11, 0x24, 6, number, len(sizes), 1, 1, 0, 0, 0, 0])
            body += _frames(7, form.pixel_bytes, sizes, intervals)
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
    """Return the configuration: video control, and video streaming on a bulk endpoint.

    Args:
        formats: names in `FORMATS`
        sizes: (rows, columns)
        intervals: between frames, 100 ns; the first is the default
        transfer: of all formats
    """
    body = bytes([8, 0x0B, 0, 2, 0x0E, 3, 0, 2])
    body += bytes([9, 4, 0, 0, 0, 0x0E, 1, 0, 2]) + _control_interface()
    body += bytes([9, 4, 1, 0, 1, 0x0E, 2, 0, 0])
    body += _streaming_interface(formats, sizes, intervals, transfer)
    body += bytes([7, 5, STREAM_IN, 2, *_u16(PACKET), 0])
    return bytes([9, 2, *_u16(9 + len(body)), 2, 1, 0, 0x80, 250]) + body
