"""A host for webcams, of its own reading of the class definition: probe, controls, payloads."""

import struct
from dataclasses import dataclass

import numpy as np
import usb.core

SET, GET, MIN, MAX, RES, LEN, INFO, DEF = 1, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
CAMERA, PROCESSING = 1, 2
MODE, PRIORITY, TIME = (CAMERA, 2, 1), (CAMERA, 3, 1), (CAMERA, 4, 4)
BACKLIGHT, BRIGHTNESS, GAIN = (PROCESSING, 1, 2), (PROCESSING, 2, 2), (PROCESSING, 4, 2)
WHITE, WHITE_AUTO = (PROCESSING, 10, 2), (PROCESSING, 11, 1)
MANUAL = 1


@dataclass(frozen=True)
class Payload:
    header: bytes
    data: bytes

    @property
    def frame_id(self):
        return self.header[1] & 1


class Host:
    """Talks to a webcam of a pyusb backend."""

    def __init__(self, backend):
        self.usb = usb.core.find(backend=backend)
        self.interval = 0

    def ask(self, control, request=GET):
        entity, selector, size = control
        answer = self.usb.ctrl_transfer(0xA1, request, selector << 8, entity << 8, size, 200)
        return int.from_bytes(answer.tobytes(), "little")

    def set(self, control, value):
        entity, selector, size = control
        data = value.to_bytes(size, "little")
        self.usb.ctrl_transfer(0x21, SET, selector << 8, entity << 8, data, 200)

    def why(self):
        """Return the code of the last refusal."""
        return self.ask((0, 2, 1))

    def be_manual(self, ticks=100):
        """Turn all automatics off."""
        self.set(MODE, MANUAL)
        for control in (PRIORITY, BACKLIGHT, WHITE_AUTO):
            self.set(control, 0)
        self.set(TIME, ticks)

    def probe(self, form=1, frame=1, interval=0):
        data = struct.pack("<HBBI", 1, form, frame, interval) + bytes(18)
        self.usb.ctrl_transfer(0x21, SET, 0x100, 1, data, 200)
        return self.usb.ctrl_transfer(0xA1, GET, 0x100, 1, 26, 200).tobytes()

    def start(self, form=1, frame=1, interval=0):
        agreed = self.probe(form, frame, interval)
        self.usb.ctrl_transfer(0x21, SET, 0x200, 1, agreed, 200)
        self.interval = struct.unpack_from("<I", agreed, 4)[0]
        self.length = struct.unpack_from("<I", agreed, 22)[0]

    def payload(self, timeout=1000):
        """Return the next payload; a short packet ends it."""
        size = -(-(self.length + 1) // 512) * 512
        raw = self.usb.read(0x81, size, timeout).tobytes()
        return Payload(raw[: raw[0]], raw[raw[0] :])

    def stop(self):
        self.usb.clear_halt(0x81)

    def luma(self, rows, columns):
        """Return the luma of the next frame of YUYV."""
        return np.frombuffer(self.payload().data, np.uint8).reshape(rows, columns, 2)[..., 0]
