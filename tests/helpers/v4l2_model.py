"""A webcam as the kernel shows it, in virtual time: slots, late controls, few buffers."""

from __future__ import annotations

import ctypes
import errno
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.abi import ControlId, ControlType, fourcc
from camctl.interface.camera import Pixels
from camctl.interface.clock import VirtualClock

PATH = "/dev/video-of-the-model"
ROWS, COLUMNS = 6, 8
#: Light of each pixel; brightness is light x ticks (100 us), up to white.
LIGHT = np.linspace(0.02, 0.5, ROWS * COLUMNS).reshape(ROWS, COLUMNS)
#: Bytes of a buffer, and what the model fills the rest of it with.
_BUFFER_BYTES, _JUNK = 4096, 0xA5

#: Requests that the kernel grants to one descriptor at a time.
_OF_THE_STREAM = frozenset(
    (abi.Request.S_FMT, abi.Request.REQBUFS, abi.Request.STREAMON, abi.Request.STREAMOFF)
)


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


@dataclass(frozen=True)
class Filled:
    """A buffer with a frame: its index, the slot, the end of its exposure, ticks, and number."""

    index: int
    slot: int
    end_s: float
    ticks: int
    sequence: int


@dataclass
class Model:
    """The device behind the system calls of `camctl.drivers.v4l2.kernel.Kernel`.

    Attributes:
        delay: control delay, frames
        delays: control delay by the number of the write, instead of `delay`
        interval_s, announced_s: true frame interval, and the one reported if that differs
        formats, sizes, intervals: offered; sizes as (width, height)
        lateness_s: from the end of a frame to its arrival
        write_s: duration of writing a control
        jitter_s: error of a slot's timestamp, by its number
        lose: slots whose frames are lost on their way; the driver counts them
        skip: slots whose frames the device does not send, so that the driver cannot count them
        damage: slots whose frames have 5 bytes
        flag: slots whose frames the driver flags as erroneous, with all their bytes
        counts: whether frames have sequence numbers
        planes: of a frame on a multi-planar node; 0: the node is none
        header_bytes: before the samples of a plane
        size_intervals: frame intervals of a size, where they differ from `intervals`
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
    skip: set[int] = field(default_factory=set)
    damage: set[int] = field(default_factory=set)
    flag: set[int] = field(default_factory=set)
    counts: bool = True
    quantization: int = 1
    bytesperline: int = 0
    caps: int = abi.Caps.VIDEO_CAPTURE | abi.Caps.STREAMING
    streams: bool = True
    planes: int = 0
    header_bytes: int = 0
    size_intervals: dict[tuple[int, int], tuple[tuple[int, int], ...]] = field(default_factory=dict)
    pixel_rate: int | None = None
    first_error: int | None = None
    errors: dict[abi.Request, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.planes:
            self.caps = abi.Caps.VIDEO_CAPTURE_PLANES | abi.Caps.STREAMING
        self.clock = VirtualClock(1000.0)
        self.controls = registers()
        self.memory: list[NDArray[np.uint8]] = []
        self.queued: deque[int] = deque()  # buffers to fill
        self.waiting: deque[Filled] = deque()
        self.sequence = 0
        self.is_streaming = False
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
        self.last_descriptor = 6
        self.owner: int | None = None  # the descriptor that has the stream
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
        if self.slot in self.skip or not self.is_streaming:
            return
        self.sequence += self.counts
        jitter_s = self.jitter_s(self.slot) if self.jitter_s else 0.0
        if self.queued and self.slot not in self.lose:
            end_s = self.slot_end_s + jitter_s
            self.waiting.append(
                Filled(self.queued.popleft(), self.slot, end_s, self.ticks, self.sequence)
            )

    def write_exposure(self, ticks: int) -> None:
        self.advance()
        delay = self.delays(self.writes) if self.delays else self.delay
        self.writes += 1
        self.written_in.append(self.slot)
        self.pending.append((self.slot + 1 + delay, ticks))

    # The kernel.

    def open(self, path: str) -> int:
        if self.first_error is not None:
            raise OSError(self.first_error, os.strerror(self.first_error))
        self.descriptors += 1
        self.last_descriptor += 1
        return self.last_descriptor

    def close(self, descriptor: int) -> None:
        self.descriptors -= 1
        self.owner = None if descriptor == self.owner else self.owner

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        number = errno.ENODEV if self.unplugged else self.errors.get(request)
        if number is not None:
            self.fail(number)
        if request in _OF_THE_STREAM:
            if self.owner not in (None, descriptor):
                self.fail(errno.EBUSY)
            self.owner = descriptor
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
        intervals = self.size_intervals.get((found.width, found.height), self.intervals)
        if found.index >= len(intervals):
            self.fail()
        found.type = abi.Grid.DISCRETE
        found.words[0], found.words[1] = intervals[found.index]

    def g_fmt(self, found: abi.Format | abi.PlanesFormat) -> None:
        found.pixelformat, found.width, found.height = self.current
        found.quantization = self.quantization
        if isinstance(found, abi.PlanesFormat):
            found.num_planes, found.planes[0].bytesperline = self.planes, self.bytesperline
        else:
            found.bytesperline = self.bytesperline
        self.has_type(found)

    def has_type(self, found: Any) -> None:
        """Refuse a request that is not of this node's type of buffers, as the kernel does."""
        if found.type != (abi.PLANES_BUFFER if self.planes else abi.CAPTURE_BUFFER):
            self.fail()

    def place(self, found: abi.Buffer) -> Any:
        """Return what has length, offset and filled bytes of a buffer: itself, or its plane."""
        self.has_type(found)
        if not self.planes:
            return found
        assert found.length == abi.MOST_PLANES
        return ctypes.cast(found.offset, ctypes.POINTER(abi.Plane))[0]

    def s_fmt(self, found: abi.Format | abi.PlanesFormat) -> None:
        if not self.streams:
            found.width, found.height = 2, 2
        self.current = (found.pixelformat, found.width, found.height)
        self.g_fmt(found)

    def s_parm(self, found: abi.StreamParameters) -> None:
        announced_s = self.announced_s or self.interval_s
        found.numerator, found.denominator = round(announced_s * 1e6), 1_000_000

    def reqbufs(self, found: abi.BufferRequest) -> None:
        self.queued.clear()
        self.waiting.clear()
        self.memory = [np.full(_BUFFER_BYTES, _JUNK, np.uint8) for _ in range(found.count)]
        self.released += found.count == 0

    def querybuf(self, found: abi.Buffer) -> None:
        place = self.place(found)
        place.offset, place.length = found.index * _BUFFER_BYTES, _BUFFER_BYTES

    def map(self, descriptor: int, offset: int, length: int) -> NDArray[np.uint8]:
        if length != _BUFFER_BYTES or not 0 <= offset < _BUFFER_BYTES * len(self.memory):
            self.fail()
        return self.memory[offset // _BUFFER_BYTES]

    def qbuf(self, found: abi.Buffer) -> None:
        self.advance()
        if found.index in self.queued or found.index >= len(self.memory):
            self.fail()
        self.memory[found.index][:] = _JUNK
        self.queued.append(found.index)

    def streamon(self, found: abi.BufferType) -> None:
        self.is_streaming = True
        self.advance()

    def streamoff(self, found: abi.BufferType) -> None:
        self.is_streaming = False

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        self.advance()
        silent_s = self.clock.now() + timeout_s
        while not self.waiting:
            if self.unplugged:
                return True
            due_s = self.advance() + self.lateness_s
            if self.frozen or due_s > silent_s:
                self.clock.sleep_until(silent_s)
                return False
            self.clock.sleep_until(due_s)
            self.advance()
        self.clock.sleep_until(self.waiting[0].end_s + self.lateness_s)
        return True

    def dqbuf(self, found: abi.Buffer) -> None:
        if not self.waiting:
            self.fail(errno.EAGAIN)
        filled = self.waiting.popleft()
        self.used.append(filled.slot)
        data = b"\0" * 5 if filled.slot in self.damage else self.packed(filled.ticks)
        place, begin = self.place(found), self.header_bytes
        self.memory[filled.index][begin : begin + len(data)] = np.frombuffer(data, np.uint8)
        found.index, place.bytesused = filled.index, begin + len(data)
        if self.planes:
            place.data_offset = begin
        found.flags = abi.BufferFlag.ERROR if filled.slot in self.flag else 0
        found.sequence = filled.sequence % 2**32
        microseconds = round(self.stamp_s(filled.end_s) * 1e6)
        found.seconds, found.microseconds = divmod(microseconds, 1_000_000)

    def packed(self, ticks: int) -> bytes:
        """Return the bytes of a frame, its lines padded to `bytesperline`."""
        code = self.current[0].to_bytes(4, "little").decode()
        lines = packed_lines(code, ticks)
        return b"".join(line.ljust(self.bytesperline, b"\xee") for line in lines)

    def g_ext_ctrls(self, found: abi.LongValues) -> None:
        value = found.controls[0]
        if value.id == ControlId.PIXEL_RATE and self.pixel_rate is not None:
            value.value = self.pixel_rate
        elif value.id in self.controls:
            value.value = self.controls[value.id].value
        else:
            self.fail()

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
        if found.id in (ControlId.EXPOSURE_ABSOLUTE, ControlId.EXPOSURE):
            self.write_exposure(control.value)
        self.clock.sleep_until(self.clock.now() + self.write_s / 2)


def brightness(ticks: int, bits: int = 8) -> NDArray[np.float64]:
    """Return the samples of a frame that was exposed for `ticks` x 100 us."""
    scale = 2 ** (bits - 8)
    samples: NDArray[np.float64] = np.minimum(np.floor(LIGHT * ticks * scale), 2**bits - 1)
    return samples


def packed_lines(code: str, ticks: int) -> list[bytes]:
    """Return the lines of a frame as V4L2 packs them in a format; the whole of a JPEG."""
    if code == "YUYV":
        luma = brightness(ticks).astype(np.uint8)
        return [line.tobytes() for line in np.stack([luma, np.full_like(luma, 128)], axis=-1)]
    if code in ("RGB3", "BGR3"):  # red, green and blue have the whole, half and a quarter
        luma = brightness(ticks).astype(np.uint8)
        colours = [luma, luma // 2, luma // 4]
        pixels = np.stack(colours if code == "RGB3" else colours[::-1], axis=-1)
        return [line.tobytes() for line in pixels]
    if code in ("YU12", "YV12", "NV12"):  # luma, then chroma of half the lines
        luma = brightness(ticks).astype(np.uint8)
        return [line.tobytes() for line in luma] + [b"\x80" * COLUMNS] * (ROWS // 2)
    if code == "MJPG":
        import cv2

        done, data = cv2.imencode(".jpg", brightness(ticks).astype(np.uint8))
        assert done
        return [data.tobytes()]
    if code[0] == "p" or code.endswith("P"):  # MIPI: upper 8 bits, then lower bits
        bits = {"A": 10, "C": 12, "E": 14}[code[3]] if code[0] == "p" else int(code[1:3])
        return [mipi(line, bits) for line in brightness(ticks, bits).astype(int).tolist()]
    deep = {"BYR2": 16, "BA10": 10, "BA12": 12}
    digits = [int(code[at:][:2]) for at in (1, 2) if code[at:][:2].isdigit()]
    bits = deep.get(code) or (digits[0] if digits and digits[0] != 81 else 8)
    samples = brightness(ticks, bits)
    return [line.astype("<u2" if bits > 8 else np.uint8).tobytes() for line in samples]


def mipi(samples: list[int], bits: int) -> bytes:
    """Return a line in MIPI CSI-2 packing (RAW10, RAW12, RAW14)."""
    size = 2 if bits == 12 else 4
    line = b""
    for first in range(0, len(samples), size):
        group = samples[first : first + size]
        lower = sum((each % 2 ** (bits - 8)) << (bits - 8) * at for at, each in enumerate(group))
        line += bytes(each >> bits - 8 for each in group)
        line += lower.to_bytes(size * (bits - 8) // 8, "little")
    return line


def ticks_of(pixels: Pixels, bits: int = 8) -> int:
    """Return the exposure of a frame, x 100 us, found from its pixels alone."""
    samples = np.asarray(pixels, dtype=float)
    return next(t for t in range(1, 1001) if np.array_equal(brightness(t, bits), samples))
