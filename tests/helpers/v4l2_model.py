"""A webcam as the kernel and OpenCV show it, in virtual time: slots, late controls, few buffers."""

from __future__ import annotations

import ctypes
import errno
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.clock import VirtualClock
from drivers.v4l2 import abi
from drivers.v4l2.abi import ControlId, ControlType, fourcc

PATH = "/dev/video-of-the-model"
ROWS, COLUMNS = 6, 8
#: Light of each pixel; brightness is light x ticks (100 us), up to white.
LIGHT = np.linspace(0.02, 0.5, ROWS * COLUMNS).reshape(ROWS, COLUMNS)
_DESCRIPTOR = 7
_OPENCV_TIMEOUT_S = 10


def put(text: str, field_: Any) -> None:
    """Write text into a fixed field of a structure."""
    raw = text.encode()[: len(field_)]
    for index, byte in enumerate(raw):
        field_[index] = byte


@dataclass
class Register:
    """A control of the model.

    `stuck`: it keeps its value whatever is set; `clamp`: larger values are set to this one.
    """

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


def registers() -> dict[int, Register]:
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
    """The device with its kernel side (`open`, `ioctl`, `close`) and its OpenCV side (`video`).

    Attributes:
        delay: control delay, frames
        delays: control delay by the number of the write, instead of `delay`
        interval_s, announced_s: true frame interval, and the one reported if that differs
        formats, sizes, intervals: offered; sizes as (width, height)
        lateness_s: from the end of a frame to its arrival
        write_s: duration of writing a control
        jitter_s: error of a slot's timestamp, by its number
        lose, damage: slots whose frames are lost or arrive damaged
        errors: errno by the request that fails with it
        first_error: errno with which opening fails
    """

    delay: int = 2
    interval_s: float = 0.1
    announced_s: float | None = None
    formats: tuple[str, ...] = ("YUYV",)
    sizes: tuple[tuple[int, int], ...] = ((COLUMNS, ROWS),)
    intervals: tuple[tuple[int, int], ...] = ((1, 10), (1, 30))
    lateness_s: float = 0.002
    write_s: float = 0.001
    jitter_s: Callable[[int], float] | None = None
    delays: Callable[[int], int] | None = None
    lose: set[int] = field(default_factory=set)
    damage: set[int] = field(default_factory=set)
    quantization: int = 1
    bytesperline: int = 0
    caps: int = abi.Caps.VIDEO_CAPTURE | abi.Caps.STREAMING
    opens: bool = True
    first_error: int | None = None
    errors: dict[abi.Request, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.clock = VirtualClock(1000.0)
        self.controls = registers()
        self.buffers = 4
        self.waiting: deque[tuple[int, float, int]] = deque()  # slot, end of exposure, ticks
        self.slot = 0  # the one being exposed
        self.slot_end_s: float | None = None
        self.pending: list[tuple[int, int]] = []  # first slot that has it, ticks
        self.ticks = 157
        self.writes = 0
        self.written_in: list[int] = []  # the slot of each write of the exposure
        self.used: list[int] = []  # slots that were grabbed
        self.frozen = False
        self.unplugged = False
        self.current: tuple[int, int, int] = (0, 0, 0)  # pixel format, width, height
        self.descriptors = 0
        self.released = 0
        self.stamp_s: Callable[[float], float] = lambda end_s: end_s

    # The stream.

    def advance(self) -> float:
        """Bring the device up to the clock; return when the slot being exposed ends, s."""
        if self.slot_end_s is None:
            self.slot_end_s = self.clock.now() + self.interval_s
        while self.slot_end_s <= self.clock.now():
            if not self.frozen:
                self.finish()
            self.slot += 1
            self.slot_end_s += self.interval_s
        return self.slot_end_s

    def finish(self) -> None:
        """Finish the slot being exposed; its frame is lost where it finds no buffer."""
        assert self.slot_end_s is not None
        for first, ticks in list(self.pending):
            if first <= self.slot:
                self.ticks = ticks
                self.pending.remove((first, ticks))
        jitter_s = self.jitter_s(self.slot) if self.jitter_s else 0.0
        if len(self.waiting) < self.buffers and self.slot not in self.lose:
            self.waiting.append((self.slot, self.slot_end_s + jitter_s, self.ticks))

    def write_exposure(self, ticks: int) -> None:
        self.advance()
        delay = self.delays(self.writes) if self.delays else self.delay
        self.writes += 1
        self.written_in.append(self.slot)
        self.pending.append((self.slot + 1 + delay, ticks))

    # OpenCV.

    def video(self, path: str) -> Video:
        return Video(self)

    # The kernel.

    def open(self, path: str) -> int:
        if self.first_error is not None:
            raise OSError(self.first_error, os.strerror(self.first_error))
        self.descriptors += 1
        return _DESCRIPTOR

    def close(self, descriptor: int) -> None:
        assert descriptor == _DESCRIPTOR
        self.descriptors -= 1

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        number = errno.ENODEV if self.unplugged else self.errors.get(request)
        if number is not None:
            self.fail(number)
        getattr(self, request.name.lower())(argument)

    def fail(self, number: int = errno.EINVAL) -> None:
        raise OSError(number, os.strerror(number))

    def querycap(self, found: abi.Capability) -> None:
        put("uvcvideo", found.driver)
        put("A webcam: A webcam", found.card)
        put("usb-1", found.bus_info)
        found.capabilities = self.caps | abi.Caps.DEVICE_CAPS
        found.device_caps = self.caps

    def enum_fmt(self, found: abi.FormatDescription) -> None:
        if found.index >= len(self.formats):
            self.fail()
        found.pixelformat = fourcc(self.formats[found.index])

    def enum_framesizes(self, found: abi.SizeQuery) -> None:
        if found.index >= len(self.sizes):
            self.fail()
        found.type = abi.Grid.DISCRETE
        found.words[0], found.words[1] = self.sizes[found.index]

    def enum_frameintervals(self, found: abi.IntervalQuery) -> None:
        if found.index >= len(self.intervals):
            self.fail()
        found.type = abi.Grid.DISCRETE
        found.words[0], found.words[1] = self.intervals[found.index]

    def g_fmt(self, found: abi.Format) -> None:
        found.pixelformat, found.width, found.height = self.current
        found.bytesperline, found.quantization = self.bytesperline, self.quantization

    def g_parm(self, found: abi.StreamParameters) -> None:
        announced_s = self.announced_s or self.interval_s
        found.numerator, found.denominator = round(announced_s * 1e6), 1_000_000

    def queryctrl(self, found: abi.ControlQuery) -> None:
        if found.id not in self.controls:
            self.fail()
        control = self.controls[found.id]
        put(control.name, found.name)
        found.type, found.flags = control.kind, control.flags
        found.minimum, found.maximum = control.minimum, control.maximum
        found.step, found.default_value = control.step, control.default

    def querymenu(self, found: abi.MenuQuery) -> None:
        if found.index not in self.controls[found.id].menu:
            self.fail()

    def g_ctrl(self, found: abi.ControlValue) -> None:
        found.value = self.controls[found.id].value

    def s_ctrl(self, found: abi.ControlValue) -> None:
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

    def __init__(self, model: Model) -> None:
        self.model = model
        self.properties: dict[int, float] = {}
        self.frame = (0, 0.0, 0)
        self.is_first = True

    def isOpened(self) -> bool:  # noqa: N802
        return self.model.opens

    def set(self, propId: int, value: float) -> bool:
        self.properties[propId] = value
        model = self.model
        if propId == cv2.CAP_PROP_BUFFERSIZE:
            model.buffers = int(value)
        model.current = (
            int(self.properties.get(cv2.CAP_PROP_FOURCC, 0)),
            int(self.properties.get(cv2.CAP_PROP_FRAME_WIDTH, 0)),
            int(self.properties.get(cv2.CAP_PROP_FRAME_HEIGHT, 0)),
        )
        return True

    def get(self, propId: int) -> float:
        assert propId == cv2.CAP_PROP_POS_MSEC
        return self.model.stamp_s(self.frame[1]) * 1000

    def grab(self) -> bool:
        model = self.model
        model.advance()
        if model.unplugged:
            return False
        while not model.waiting:
            if model.frozen:
                model.clock.sleep_until(model.clock.now() + _OPENCV_TIMEOUT_S)
                return False
            model.clock.sleep_until(model.advance() + model.lateness_s)
            model.advance()
        self.frame = model.waiting.popleft()
        model.clock.sleep_until(self.frame[1] + model.lateness_s)
        if self.is_first:  # OpenCV discards the first frame of a stream
            self.is_first = False
            return self.grab()
        model.used.append(self.frame[0])
        return True

    def retrieve(self) -> tuple[bool, NDArray[Any]]:
        slot, _, ticks = self.frame
        if slot in self.model.damage:
            return True, np.zeros((1, 5), np.uint8)
        return True, as_opencv(self.model.current[0], ticks)

    def release(self) -> None:
        self.model.released += 1


def brightness(ticks: int, bits: int = 8) -> NDArray[np.float64]:
    """Return the samples of a frame that was exposed for `ticks` x 100 us."""
    scale = 2 ** (bits - 8)
    samples: NDArray[np.float64] = np.minimum(np.floor(LIGHT * ticks * scale), 2**bits - 1)
    return samples


def as_opencv(code: int, ticks: int) -> NDArray[Any]:
    """Return a frame as OpenCV delivers it with CAP_PROP_CONVERT_RGB = 0."""
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


def ticks_of(pixels: Pixels, bits: int = 8) -> int:
    """Return the exposure of a frame, x 100 us, found from its pixels alone."""
    samples = np.asarray(pixels, dtype=float)
    return next(t for t in range(1, 1001) if np.array_equal(brightness(t, bits), samples))
