"""A webcam as the kernel and OpenCV show it, in virtual time: slots, late controls, few buffers."""

from __future__ import annotations

import errno
import os
from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from camctl.clock import VirtualClock
from drivers.v4l2 import abi
from drivers.v4l2.abi import ControlId, ControlType, fourcc

PATH = "/dev/video-of-the-model"
ROWS, COLUMNS = 6, 8
#: Light of each pixel; brightness is light x ticks, cut at white.
LIGHT = np.linspace(0.02, 0.5, ROWS * COLUMNS).reshape(ROWS, COLUMNS)


def put(text, field_):
    """Write text into a fixed field."""
    raw = text.encode()[: len(field_)]
    for index, byte in enumerate(raw):
        field_[index] = byte


@dataclass
class Register:
    """A control of the model."""

    name: str
    kind: int
    minimum: int
    maximum: int
    step: int
    default: int
    value: int
    flags: int = 0
    menu: tuple[int, ...] = ()
    stuck: bool = False
    clamp: int | None = None


def registers():
    switch, menu, integer = ControlType.BOOLEAN, ControlType.MENU, ControlType.INTEGER
    return {
        ControlId.EXPOSURE_AUTO: Register("Auto Exposure", menu, 0, 3, 1, 3, 3, menu=(1, 3)),
        ControlId.EXPOSURE_ABSOLUTE: Register("Exposure", integer, 1, 5000, 1, 157, 157),
        ControlId.EXPOSURE_AUTO_PRIORITY: Register("Dynamic", switch, 0, 1, 1, 0, 1),
        ControlId.AUTO_WHITE_BALANCE: Register("Auto WB", switch, 0, 1, 1, 1, 1),
        ControlId.AUTOGAIN: Register("Auto gain", switch, 0, 1, 1, 1, 1),
        ControlId.GAIN: Register("Gain", integer, 0, 255, 1, 16, 90),
        ControlId.BACKLIGHT_COMPENSATION: Register("Backlight", integer, 0, 2, 1, 1, 1),
    }


@dataclass
class Model:
    """The device, its kernel side (`open`, `ioctl`, `close`) and its OpenCV side (`video`)."""

    delay: int = 2
    interval_s: float = 0.1
    announced_s: float | None = None
    formats: tuple[str, ...] = ("YUYV",)
    sizes: tuple[tuple[int, int], ...] = ((COLUMNS, ROWS),)
    intervals: tuple[tuple[int, int], ...] = ((1, 10), (1, 30))
    lateness_s: float = 0.002
    write_s: float = 0.001
    jitter_s: object = None  # slot -> s
    delays: object = None  # number of the write -> frames
    lose: set = field(default_factory=set)
    spoil: set = field(default_factory=set)
    quantization: int = 1
    bytesperline: int = 0
    caps: int = abi.Caps.VIDEO_CAPTURE | abi.Caps.STREAMING
    opens: bool = True
    first_error: int | None = None
    errors: dict = field(default_factory=dict)  # request -> errno

    def __post_init__(self):
        self.clock = VirtualClock(1000.0)
        self.controls = registers()
        self.buffers = 4
        self.waiting = deque()
        self.slot = 0  # the next to be finished
        self.slot_end_s = None
        self.pending = []  # (from which slot, ticks)
        self.ticks = 157
        self.writes = 0
        self.written_in = []  # the slot of each write of the exposure
        self.used = []  # slots handed over by grab
        self.frozen = False
        self.unplugged = False
        self.picture = None
        self.rate_s = self.interval_s
        self.descriptors = 0
        self.read_out = 0
        self.released = 0
        self.stamp_s = lambda end_s: end_s

    # The stream.

    def begin(self):
        if self.slot_end_s is None:
            self.slot_end_s = self.clock.now() + self.interval_s

    def advance(self):
        """Bring the device up to the clock; frames that find no buffer are lost."""
        self.begin()
        while self.slot_end_s <= self.clock.now():
            if not self.frozen:
                self._finish()
            self.slot += 1
            self.slot_end_s += self.interval_s

    def _finish(self):
        for first, ticks in list(self.pending):
            if first <= self.slot:
                self.ticks = ticks
                self.pending.remove((first, ticks))
        jitter_s = self.jitter_s(self.slot) if self.jitter_s else 0.0
        if len(self.waiting) < self.buffers and self.slot not in self.lose:
            self.waiting.append((self.slot, self.slot_end_s + jitter_s, self.ticks))

    def write_exposure(self, ticks):
        self.advance()
        delay = self.delays(self.writes) if self.delays else self.delay
        self.writes += 1
        self.written_in.append(self.slot)
        if self.slot == 0 and self.slot_end_s is None:
            self.ticks = ticks
        # Slot `self.slot` is being exposed.
        self.pending.append((self.slot + 1 + delay, ticks))

    # OpenCV.

    def video(self, path):
        return Video(self)

    # The kernel.

    def open(self, path):
        if self.first_error is not None:
            raise OSError(self.first_error, os.strerror(self.first_error))
        self.descriptors += 1
        return 7

    def close(self, descriptor):
        assert descriptor == 7
        self.descriptors -= 1

    def ioctl(self, descriptor, request, argument):
        number = errno.ENODEV if self.unplugged else self.errors.get(request)
        if number is not None:
            raise OSError(number, os.strerror(number))
        getattr(self, request.name.lower())(argument)

    def no(self, number=errno.EINVAL):
        raise OSError(number, os.strerror(number))

    def querycap(self, found):
        put("uvcvideo", found.driver)
        put("A webcam: A webcam", found.card)
        put("usb-1", found.bus_info)
        found.capabilities = self.caps | abi.Caps.DEVICE_CAPS
        found.device_caps = self.caps

    def enum_fmt(self, found):
        if found.index >= len(self.formats):
            self.no()
        found.pixelformat = fourcc(self.formats[found.index])

    def enum_framesizes(self, found):
        if found.index >= len(self.sizes):
            self.no()
        found.type = abi.Grid.DISCRETE
        found.words[0], found.words[1] = self.sizes[found.index]

    def enum_frameintervals(self, found):
        if found.index >= len(self.intervals):
            self.no()
        found.type = abi.Grid.DISCRETE
        found.words[0], found.words[1] = self.intervals[found.index]

    def g_fmt(self, found):
        code, width, height = self.picture
        found.width, found.height, found.pixelformat = width, height, code
        found.bytesperline, found.quantization = self.bytesperline, self.quantization

    def g_parm(self, found):
        announced_s = self.announced_s or self.interval_s
        found.numerator, found.denominator = round(announced_s * 1e6), 1_000_000

    def queryctrl(self, found):
        control = self.controls.get(found.id)
        if control is None:
            self.no()
        put(control.name, found.name)
        found.type, found.flags = control.kind, control.flags
        found.minimum, found.maximum = control.minimum, control.maximum
        found.step, found.default_value = control.step, control.default

    def querymenu(self, found):
        if found.index not in self.controls[found.id].menu:
            self.no()

    def g_ctrl(self, found):
        self.read_out += 1
        found.value = self.controls[found.id].value

    def s_ctrl(self, found):
        control = self.controls[found.id]
        self.clock.sleep_until(self.clock.now() + self.write_s / 2)
        if not control.stuck:
            control.value = found.value
            if control.clamp is not None:
                control.value = min(control.value, control.clamp)
        if found.id == ControlId.EXPOSURE_ABSOLUTE:
            self.write_exposure(control.value)
        self.clock.sleep_until(self.clock.now() + self.write_s / 2)


class Video:
    """The model's `cv2.VideoCapture`."""

    def __init__(self, model):
        self.model = model
        self.set_up = {}
        self.frame = None
        self.first = True

    def isOpened(self):  # noqa: N802
        return self.model.opens

    def set(self, propId, value):
        self.set_up[propId] = value
        model = self.model
        if propId == cv2.CAP_PROP_BUFFERSIZE:
            model.buffers = int(value)
        model.picture = (
            int(self.set_up.get(cv2.CAP_PROP_FOURCC, 0)),
            int(self.set_up.get(cv2.CAP_PROP_FRAME_WIDTH, 0)),
            int(self.set_up.get(cv2.CAP_PROP_FRAME_HEIGHT, 0)),
        )
        return True

    def get(self, propId):
        assert propId == cv2.CAP_PROP_POS_MSEC
        return self.model.stamp_s(self.frame[1]) * 1000

    def grab(self):
        model = self.model
        model.advance()
        if model.unplugged:
            return False
        while not model.waiting:
            if model.frozen:
                model.clock.sleep_until(model.clock.now() + 10)
                return False
            arrives_s = model.slot_end_s + model.lateness_s
            model.clock.sleep_until(arrives_s)
            model.advance()
        self.frame = model.waiting.popleft()
        model.clock.sleep_until(self.frame[1] + model.lateness_s)
        if self.first:  # OpenCV throws the first frame of a stream away
            self.first = False
            return self.grab()
        model.used.append(self.frame[0])
        return True

    def retrieve(self):
        slot, _, ticks = self.frame
        code = self.model.picture[0]
        if slot in self.model.spoil:
            return True, np.zeros((1, 5), np.uint8)
        return True, as_opencv(code, ticks)

    def release(self):
        self.model.released += 1


def brightness(ticks, bits=8):
    """Return the samples of a frame that was exposed for so many 100 us."""
    scale = 2 ** (bits - 8)
    return np.minimum(np.floor(LIGHT * ticks * scale), 2**bits - 1)


def as_opencv(code, ticks):
    """Return a frame as OpenCV gives it with CAP_PROP_CONVERT_RGB = 0."""
    name = code.to_bytes(4, "little").decode()
    if name == "YUYV":
        luma = brightness(ticks).astype(np.uint8)
        return np.stack([luma, np.full_like(luma, 128)], axis=-1)
    if name in ("Y16 ", "Y12 ", "Y10 "):
        return brightness(ticks, int(name[1:3])).astype(np.uint16)
    if name == "RG10":
        return brightness(ticks, 10).astype("<u2").view(np.uint8).reshape(1, -1)
    if name == "MJPG":
        done, data = cv2.imencode(".jpg", brightness(ticks).astype(np.uint8))
        assert done
        return data.reshape(1, -1)
    return brightness(ticks).astype(np.uint8).reshape(1, -1)  # 8 bits, a byte each


def ticks_of(pixels, bits=8):
    """Return the exposure that a frame shows, by its pixels alone."""
    wanted = np.asarray(pixels, dtype=float)
    return next(t for t in range(1, 1001) if np.array_equal(brightness(t, bits), wanted))
