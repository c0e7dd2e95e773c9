"""A small USB Video Class host for tests of the virtual webcam: probe, controls, payloads."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import usb.core
from numpy.typing import NDArray
from virtual_usb_bus import VirtualBackend

Control = tuple[int, int, int]  # entity, selector, size in bytes

SET, GET, MIN, MAX, RES, LEN, INFO, DEF = 1, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
CAMERA, PROCESSING = 1, 2
MODE, PRIORITY, TIME = (CAMERA, 2, 1), (CAMERA, 3, 1), (CAMERA, 4, 4)
BACKLIGHT, BRIGHTNESS, GAIN = (PROCESSING, 1, 2), (PROCESSING, 2, 2), (PROCESSING, 4, 2)
MAINS, WHITE, WHITE_AUTO = (PROCESSING, 5, 1), (PROCESSING, 10, 2), (PROCESSING, 11, 1)
MANUAL = 1
_TIMEOUT_MS = 1000


@dataclass(frozen=True)
class Payload:
    """A frame with its payload header."""

    header: bytes
    data: bytes

    @property
    def frame_id(self) -> int:
        """The bit that changes from frame to frame."""
        return self.header[1] & 1


class Host:
    """A host of the only webcam of a pyusb backend."""

    def __init__(self, backend: VirtualBackend) -> None:
        self.usb: Any = usb.core.find(backend=backend)
        self.interval = 0
        self.length = 0

    def get(self, control: Control, request: int = GET) -> int:
        """Return the value of a control, or another of its attributes."""
        entity, selector, size = control
        reply = self.usb.ctrl_transfer(0xA1, request, selector << 8, entity << 8, size, 200)
        return int.from_bytes(reply.tobytes(), "little")

    def set(self, control: Control, value: int) -> None:
        """Set a control."""
        entity, selector, size = control
        data = value.to_bytes(size, "little")
        self.usb.ctrl_transfer(0x21, SET, selector << 8, entity << 8, data, 200)

    def last_error(self) -> int:
        """Return the request error code of the last refusal."""
        return self.get((0, 2, 1))

    def set_manual(self, ticks: int = 100) -> None:
        """Turn all automatic modes off and set the shutter time, 100 us."""
        self.set(MODE, MANUAL)
        for control in (PRIORITY, BACKLIGHT, WHITE_AUTO):
            self.set(control, 0)
        self.set(TIME, ticks)

    def probe(self, form: int = 1, frame: int = 1, interval: int = 0) -> bytes:
        """Return the stream parameters that the camera offers for the requested ones."""
        data = struct.pack("<HBBI", 1, form, frame, interval) + bytes(18)
        self.usb.ctrl_transfer(0x21, SET, 0x100, 1, data, 200)
        return bytes(self.usb.ctrl_transfer(0xA1, GET, 0x100, 1, 26, 200))

    def start(self, form: int = 1, frame: int = 1, interval: int = 0) -> None:
        """Start streaming."""
        offered = self.probe(form, frame, interval)
        self.usb.ctrl_transfer(0x21, SET, 0x200, 1, offered, 200)
        self.interval = struct.unpack_from("<I", offered, 4)[0]
        self.length = struct.unpack_from("<I", offered, 22)[0]

    def payload(self, timeout_ms: int = _TIMEOUT_MS) -> Payload:
        """Return the next payload; a short packet ends it."""
        size = -(-(self.length + 1) // 512) * 512
        raw = bytes(self.usb.read(0x81, size, timeout_ms))
        return Payload(raw[: raw[0]], raw[raw[0] :])

    def stop(self) -> None:
        """Stop streaming."""
        self.usb.clear_halt(0x81)

    def luma(self, rows: int, columns: int) -> NDArray[np.uint8]:
        """Return the luma of the next frame in YUYV."""
        return np.frombuffer(self.payload().data, np.uint8).reshape(rows, columns, 2)[..., 0]
