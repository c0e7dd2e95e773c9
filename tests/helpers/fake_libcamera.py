"""A module `libcamera` for picamera2 where the real one is missing: a sensor on a Raspberry Pi.

Written from libcamera's documentation and from what picamera2 calls; never compared with a board.
Settings go with requests, in order, and take effect some frames after their request: those of time
and gain together, as DelayedControls has them.  Frames come in a thread, one for each request that
waits, and time passes with them: it stands still while no request waits, and while the program has
one that is complete, so that a busy machine loses no frame (a program may keep it: see `KEPT_S`).

    install(FakePi(...))     before picamera2 is imported for the first time
"""

from __future__ import annotations

import enum
import importlib.machinery
import mmap
import os
import sys
import threading
import time
import types
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import MagicMock

import numpy as np
from numpy.typing import NDArray
from small_cameras import gradient

from camctl.sim.devices.common import VirtualSensor
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import Sensor, load_sensor

ALIGNMENT = 32  # bytes of a line
PAUSE_S = 1e-3  # real time of a frame
KEPT_S = 0.25  # real time after which frames go on without a request that does not come back


class Printed:
    def __str__(self) -> str:  # picamera2 makes it __repr__, too
        return type(self).__name__


class Size(Printed):
    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height

    def to_tuple(self) -> tuple[int, int]:
        return self.width, self.height


class Rectangle(Printed):
    def __init__(self, x: int, y: int, width: int, height: int) -> None:
        self.x, self.y, self.width, self.height = x, y, width, height

    def to_tuple(self) -> tuple[int, ...]:
        return self.x, self.y, self.width, self.height


class Transform(Printed):
    def __init__(self, other: Any = None, **flags: int) -> None:
        for name in ("hflip", "vflip", "transpose"):
            setattr(self, name, bool(getattr(other, name, flags.get(name, 0))))

    def _key(self) -> tuple[Any, ...]:
        return tuple(vars(self).items())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Transform) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


class ColorSpace(Printed):
    YcbcrEncoding = enum.Enum("YcbcrEncoding", "Null Rec601 Rec709")
    Range = enum.Enum("Range", "Full Limited")

    def __init__(self, other: Any) -> None:
        self.primaries = self.transferFunction = getattr(other, "primaries", other)
        self.ycbcrEncoding, self.range = self.YcbcrEncoding.Rec601, self.Range.Full


for _name in ("Sycc", "Smpte170m", "Rec709", "Raw"):
    setattr(ColorSpace, _name, staticmethod(lambda name=_name: ColorSpace(name)))

StreamRole = enum.Enum("StreamRole", "StillCapture Raw VideoRecording Viewfinder")
ControlType = enum.Enum("ControlType", "Bool Integer32 Float Rectangle Size")
Orientation = enum.Enum(
    "Orientation",
    "Rotate0 Rotate0Mirror Rotate180 Rotate180Mirror Rotate90 Rotate90Mirror Rotate270 "
    "Rotate270Mirror",
)
ConfigurationStatus = enum.Enum("ConfigurationStatus", "Valid Adjusted Invalid")
FrameStatus = enum.Enum("FrameStatus", "Success Error Cancelled Startup")
RequestStatus = enum.Enum("RequestStatus", "Pending Complete Cancelled")


@dataclass(frozen=True)
class ControlId:
    name: str
    type: Any = ControlType.Integer32


CONTROLS = {
    each.name: each
    for each in (
        *map(ControlId, ("ExposureTime", "AnalogueGain", "ExposureTimeMode", "AnalogueGainMode")),
        *map(ControlId, ("AeEnable", "AwbEnable", "NoiseReductionMode", "FrameDurationLimits")),
        *map(ControlId, ("AfMode", "HdrMode", "AeFlickerMode")),
        *map(ControlId, ("SensorTimestamp", "SensorBlackLevels", "FrameDuration")),
        ControlId("ScalerCrop", ControlType.Rectangle),
    )
}


@dataclass(frozen=True)
class PixelFormat:
    name: str

    def __str__(self) -> str:
        return self.name


class FrameBuffer:
    class Plane:
        fd: int
        offset: int
        length: int

    def __init__(self, planes: list[Any]) -> None:
        self.planes = planes
        used = [types.SimpleNamespace(bytes_used=plane.length) for plane in planes]
        self.metadata = types.SimpleNamespace(planes=used, status=FrameStatus.Success)


class Request:
    Status = RequestStatus

    def __init__(self, cookie: int) -> None:
        self.cookie = cookie
        self.buffers: dict[Any, FrameBuffer] = {}
        self.metadata: dict[ControlId, Any] = {}
        self.controls: dict[ControlId, Any] = {}
        self.status = RequestStatus.Pending
        self.sequence = 0  # of the last time that it was queued

    def add_buffer(self, stream: Any, buffer: FrameBuffer) -> None:
        self.buffers[stream] = buffer

    def set_control(self, control: ControlId, value: Any) -> None:
        self.controls[control] = value

    def reuse(self) -> None:
        self.controls, self.metadata = {}, {}
        self.status = RequestStatus.Pending


@dataclass
class FakePi:
    """What the sensor and its driver are like.

    Attributes:
        converts: raw formats that libcamera accepts beside the packed one that it lists, and what
            it makes of them; empty: the unpacked one
        delay: frames from a request until its settings are in force
        line_us: time of a line
        lost: numbers of frames whose buffers never come back with success
        ignored: numbers of requests whose controls are lost
        is_silent: True: no frame comes any more
        states_late: True: metadata state the exposure of the frame before
        sensor, bits: of `camctl.sim`, with samples of so many bits
        light: relative irradiance that it sees, (rows, columns)
    """

    converts: dict[str, str] = field(default_factory=dict)
    delay: int = 2
    line_us: float = 18.904
    lines: tuple[int, int] = (4, 600_000)
    interval_us: int = 10_000
    gain_steps: int = 232  # of 256: the table of an IMX219
    lost: tuple[int, ...] = ()
    ignored: tuple[int, ...] = ()
    is_silent: bool = False
    states_late: bool = False
    sensor: str = "phone"
    bits: int = 12
    light: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        self.queued: deque[Request] = deque()
        self.now_s = 1000.0
        self.frame = self.request = 0
        self.applied = {CONTROLS["ExposureTime"]: 5000, CONTROLS["AnalogueGain"]: 1.0}
        self.coming: deque[dict[ControlId, Any]] = deque()
        self.last = (0.0, 1.0)  # time, s, and gain of the last frame
        self.exposed: list[tuple[float, float, float]] = []  # end, time and gain of each frame
        self.controls: dict[str, Any] = {}
        self.is_acquired = False
        unpacked = f"SRGGB{self.bits}"
        self.formats = (f"{unpacked}_CSI2P",)
        self.converts = self.converts or {unpacked: unpacked}
        plain = load_sensor(self.sensor)
        self.black = round(plain.black * 2.0 ** (self.bits - plain.bits))
        electrons = plain.electrons_per_dn * 2.0 ** (plain.bits - self.bits)
        changes = {"bits": self.bits, "black": self.black, "electrons_per_dn": electrons}
        model = Sensor.model_validate({**plain.model_dump(), **changes})
        light = gradient(24, 32, 0.3) if self.light is None else self.light
        unit = model.controls(light.shape[:2], is_coloured=False, photons_per_unit=1.0)
        assert unit.sensitivity is not None
        scene = Scene("board", light, photons_per_unit=1 / (unit.sensitivity * 0.006 * 1.2))
        self.seen = VirtualSensor(scene, model, seed=1)

    def now(self) -> float:
        """The time, s: as a clock of camctl."""
        return self.now_s

    def sleep_until(self, deadline_s: float) -> None:
        self.now_s = max(self.now_s, deadline_s)

    def exposed_until(self, end_s: float) -> tuple[float, float]:
        """Return time, s, and gain of the frame that ended nearest to a time."""
        return min(self.exposed, key=lambda frame: abs(frame[0] - end_s))[1:]

    def in_force(self) -> tuple[float, float]:
        """Return time, s, and gain as the sensor has them: whole lines, a table of gains."""
        wanted_us = self.applied[CONTROLS["ExposureTime"]]
        lines = min(max(int(wanted_us / self.line_us), self.lines[0]), self.lines[1])
        code = min(round(256 - 256 / self.applied[CONTROLS["AnalogueGain"]]), self.gain_steps)
        return lines * self.line_us / 1e6, 256 / (256 - code)


class FakeCamera:
    """The one camera of the board."""

    id = "/base/soc/i2c0mux/i2c@1/imx219@10"

    def __init__(self, board: FakePi, manager: CameraManager) -> None:
        self.board, self._manager = board, manager
        self.thread: threading.Thread | None = None
        self.sequence = 0
        self.requests = 0  # all, waiting or with the program
        self.configuration: Configuration | None = None

    @property
    def controls(self) -> dict[ControlId, Any]:
        board = self.board
        limits = {
            "ExposureTime": tuple(int(lines * board.line_us) for lines in board.lines),
            "AnalogueGain": (1.0, 256 / (256 - board.gain_steps)),
            "AeEnable": (False, True),
            "AwbEnable": (False, True),
            "NoiseReductionMode": (0, 4),
            "AfMode": (0, 2),
            "HdrMode": (0, 4),
            "AeFlickerMode": (0, 1),
            "FrameDurationLimits": (board.interval_us, 11_767_556),
            "ScalerCrop": (Rectangle(0, 0, 64, 64), Rectangle(0, 0, 3280, 2464)),
        }
        return {
            CONTROLS[name]: types.SimpleNamespace(min=low, max=high, default=high)
            for name, (low, high) in limits.items()
        }

    @property
    def properties(self) -> dict[ControlId, Any]:
        values = {"Model": "imx219", "Location": 2, "Rotation": 180, "ColorFilterArrangement": 0}
        return {ControlId(name): value for name, value in values.items()}

    def acquire(self) -> None:
        if self.board.is_acquired:
            raise RuntimeError("Failed to acquire camera: Device or resource busy")
        self.board.is_acquired = True

    def release(self) -> None:
        self.board.is_acquired = False

    def generate_configuration(self, roles: list[Any]) -> Configuration:
        return Configuration(self.board, roles)

    def configure(self, configuration: Configuration) -> int:
        self.configuration = configuration
        self.requests = 0
        return 0

    def create_request(self, cookie: int) -> Request:
        self.requests += 1
        return Request(cookie)

    def start(self, controls: dict[ControlId, Any]) -> None:
        board = self.board
        self._take(controls)
        board.applied |= {k: v for k, v in controls.items() if k in board.applied}
        board.coming = deque([{}] * board.delay)
        self.is_running = True
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def stop(self) -> None:
        self.is_running = False
        assert self.thread is not None
        self.thread.join()
        while self.board.queued:
            self.board.queued.popleft().status = RequestStatus.Cancelled

    def queue_request(self, request: Request) -> None:
        request.sequence, self.sequence = self.sequence, self.sequence + 1
        self.board.queued.append(request)

    def _take(self, controls: dict[ControlId, Any]) -> None:
        self.board.controls |= {control.name: value for control, value in controls.items()}

    def _run(self) -> None:
        board, began_s = self.board, time.monotonic()
        while self.is_running:
            time.sleep(PAUSE_S)
            is_kept = len(board.queued) < self.requests and time.monotonic() < began_s + KEPT_S
            if board.queued and not board.is_silent and not is_kept:
                self._expose(board.queued.popleft())
                began_s = time.monotonic()

    def _expose(self, request: Request) -> None:
        board = self.board
        self._take(request.controls)
        sent = {} if board.request in board.ignored else request.controls
        board.request += 1
        board.coming.append({k: v for k, v in sent.items() if k in board.applied})
        board.applied |= board.coming.popleft()
        before, (time_s, gain) = board.last, board.in_force()
        board.last = time_s, gain
        board.now_s += max(time_s, board.interval_us / 1e6)
        board.exposed.append((board.now_s, time_s, gain))
        pixels = board.seen.expose(time_s, gain, board.frame)
        assert self.configuration is not None
        for stream, buffer in request.buffers.items():
            is_lost = board.frame in board.lost
            buffer.metadata.status = FrameStatus.Error if is_lost else FrameStatus.Success
            if stream.is_raw:
                data = stored(pixels, stream, board.bits)
                with mmap.mmap(buffer.planes[0].fd, stream.frame_size) as memory:
                    memory[: data.size] = data.tobytes()
        board.frame += 1
        stated_s, stated_gain = before if board.states_late else board.last
        request.metadata = {
            CONTROLS["ExposureTime"]: int(stated_s * 1e6),
            CONTROLS["AnalogueGain"]: float(np.float32(stated_gain)),
            CONTROLS["SensorTimestamp"]: int(board.now_s * 1e9),
            CONTROLS["SensorBlackLevels"]: (board.black << 16 - board.bits,) * 4,
        }
        request.status = RequestStatus.Complete
        self._manager.complete(request)


def stored(pixels: NDArray[Any], stream: StreamConfiguration, bits: int) -> NDArray[np.uint8]:
    """Return the bytes of a frame as the format has them, lines padded."""
    rows, columns = pixels.shape
    name = stream.pixel_format.name
    lines = np.zeros((rows, stream.stride), np.uint8)
    depth = int("".join(filter(str.isdigit, name.split("_")[0])))
    values = pixels.astype(np.uint32) << depth - bits if depth > bits else pixels.astype(np.uint32)
    if not name.endswith("_CSI2P"):
        lines[:, : 2 * columns] = values.astype("<u2").view(np.uint8).reshape(rows, -1)
        return lines
    count, low = {10: (4, 2), 12: (2, 4)}[depth]
    groups = values.reshape(rows, columns // count, count)
    tail = sum((groups[..., k] & 2**low - 1) << low * k for k in range(count))
    packed = np.concatenate((groups >> low, np.asarray(tail)[..., None]), axis=2).astype(np.uint8)
    used = packed.reshape(rows, -1)
    lines[:, : used.shape[1]] = used
    return lines


class StreamConfiguration:
    """One stream of a configuration; it stands for the stream, too."""

    def __init__(self, board: FakePi, *, is_raw: bool) -> None:
        self._board, self.is_raw = board, is_raw
        self.size, self.stride, self.buffer_count = Size(640, 480), 0, 4
        self.pixel_format = PixelFormat(board.formats[0] if is_raw else "XBGR8888")
        self.color_space: Any = None
        self.stream = self

    @property
    def formats(self) -> Any:
        rows, columns = self._board.seen.shape
        names = [PixelFormat(name) for name in self._board.formats]
        return types.SimpleNamespace(pixel_formats=names, sizes=lambda _: [Size(columns, rows)])

    @property
    def frame_size(self) -> int:
        return self.stride * self.size.height

    def validate(self) -> None:
        name, board = self.pixel_format.name, self._board
        if self.is_raw:
            rows, columns = board.seen.shape
            self.size = Size(columns, rows)
            known = {each: each for each in board.formats} | board.converts
            self.pixel_format = PixelFormat(known.get(name, board.formats[0]))
            depth = int("".join(filter(str.isdigit, self.pixel_format.name.split("_")[0])) or 8)
            is_packed = self.pixel_format.name.endswith("_CSI2P")
            used = columns * depth // 8 if is_packed else 2 * columns
        else:
            used = 4 * self.size.width
        self.stride = -(-used // ALIGNMENT) * ALIGNMENT


class Configuration(list[StreamConfiguration]):
    Status = ConfigurationStatus

    def __init__(self, board: FakePi, roles: list[Any]) -> None:
        super().__init__(
            StreamConfiguration(board, is_raw=role is StreamRole.Raw) for role in roles
        )
        self.orientation = Orientation.Rotate0
        self.sensor_config: Any = None

    def at(self, place: int) -> StreamConfiguration:
        return self[place]

    def validate(self) -> Any:
        for each in self:
            each.validate()
        return ConfigurationStatus.Valid


class CameraManager:
    _singleton: CameraManager | None = None

    def __init__(self, board: FakePi) -> None:
        self.cameras = [FakeCamera(board, self)]
        self._done: deque[Request] = deque()
        self.event_fd, self._write_fd = os.pipe()
        os.set_blocking(self.event_fd, False)

    @classmethod
    def singleton(cls) -> CameraManager:
        assert cls._singleton is not None
        return cls._singleton

    def complete(self, request: Request) -> None:
        self._done.append(request)
        os.write(self._write_fd, b"\0")

    def get_ready_requests(self) -> list[Request]:
        with suppress(BlockingIOError):
            os.read(self.event_fd, 1 << 16)
        return [self._done.popleft() for _ in range(len(self._done))]


def memory_allocator() -> type:
    """Return a class of buffers in memory for picamera2, where /dev/dma_heap is missing."""
    from picamera2.allocators import Allocator

    class MemoryAllocator(Allocator):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.files: list[int] = []
            self.of: dict[Any, list[FrameBuffer]] = {}

        def allocate(self, libcamera_config: Any, use_case: Any) -> None:
            self.of = {
                each: [self._buffer(each) for _ in range(each.buffer_count)]
                for each in libcamera_config
            }

        def _buffer(self, stream: StreamConfiguration) -> FrameBuffer:
            plane = FrameBuffer.Plane()
            plane.fd, plane.offset, plane.length = os.memfd_create("frame"), 0, stream.frame_size
            os.ftruncate(plane.fd, plane.length)
            self.files.append(plane.fd)
            return FrameBuffer([plane])

        def buffers(self, stream: Any) -> list[FrameBuffer]:
            return self.of[stream]

        def __del__(self) -> None:
            for each in self.files:
                os.close(each)

    return MemoryAllocator


def _library() -> dict[str, Any]:
    """Return the modules of the fake, and those that picamera2 imports for what is not used here.

    These are ffmpeg's child processes, and windows without a desktop.
    """
    library = types.ModuleType("libcamera")
    library.__spec__ = importlib.machinery.ModuleSpec("libcamera", None)
    noise = enum.IntEnum("noise", "Off Fast HighQuality Minimal", start=0)
    arrangement = enum.IntEnum("arrangement", "RGGB GRBG GBRG BGGR RGB MONO", start=0)
    controls = types.ModuleType("libcamera.controls")
    vars(controls).update(CONTROLS)
    vars(controls)["draft"] = types.SimpleNamespace(NoiseReductionModeEnum=noise)
    draft = types.SimpleNamespace(ColorFilterArrangementEnum=arrangement)
    public = (Size, Rectangle, Transform, ColorSpace, PixelFormat, FrameBuffer, Request)
    enums = {"StreamRole": StreamRole, "ControlType": ControlType, "Orientation": Orientation}
    vars(library).update(
        {each.__name__: each for each in (*public, CameraManager)},
        **enums,
        CameraConfiguration=Configuration,
        Camera=FakeCamera,
        FrameMetadata=types.SimpleNamespace(Status=FrameStatus),
        SensorConfiguration=types.SimpleNamespace,
        FrameBufferAllocator=None,
        controls=controls,
        properties=types.SimpleNamespace(draft=draft),
        _libcamera=types.SimpleNamespace(ColorSpace=ColorSpace, Transform=Transform),
    )
    others = {"prctl": MagicMock(), "pykms": MagicMock()}
    return {"libcamera": library, "libcamera.controls": controls, **others}


_MODULES = _library()


def uninstall() -> None:
    """Let no other test see the fake."""
    CameraManager._singleton = None
    for name in _MODULES:
        sys.modules.pop(name, None)


def install(board: FakePi) -> None:
    """Let `import libcamera` give a board; picamera2 is imported with it where it was not."""
    CameraManager._singleton = CameraManager(board)
    sys.modules.update(_MODULES)
    import picamera2.picamera2 as library_module

    library_module.DmaAllocator = memory_allocator()
    library_module.Picamera2._cm.reset()
