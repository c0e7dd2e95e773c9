"""The stream of a video node: its mode, its buffers, and the frames in them.

The kernel fills buffers that are mapped into this process.  A buffer that was filled says when,
with which sequence number, with how many bytes, and whether the driver saw an error in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.formats import PixelFormat
from camctl.drivers.v4l2.kernel import Memory
from camctl.drivers.v4l2.node import Node, Shape, SizeGrid, StreamBuffer, size_text
from camctl.drivers.v4l2.packing import DamagedFrameError
from camctl.drivers.v4l2.system import PLUG_IN
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from camctl.interface.camera import Pixels

#: Buffers that the kernel fills while no frame is taken: enough for the frames that are on their
#: way to a late consumer with a control delay of 5 frames.
BUFFERS = 8
#: A stream without at least so many buffers loses frames: one is read while others are filled.
_FEWEST_BUFFERS = 3
#: Silence after which the camera counts as frozen: at least so many seconds and so many frames.
_SILENCE_S, _SILENCE_FRAMES = 10.0, 5
#: Attempts to take a frame where that fails at once.
_ATTEMPTS = 3
#: Frame interval where the camera offers no list, s.
_USUAL_INTERVAL_S = 1 / 30
#: Frames a second of the default mode, at least.
LEAST_FPS = 15.0
#: Frame rates that differ by at most this share are the same: 29.97 is 30.
_SAME_RATE = 0.01


@dataclass(frozen=True)
class StreamMode:
    """What is streamed: pixel format, (rows, columns), and time from frame to frame, s."""

    format: PixelFormat
    shape: Shape
    interval_s: float

    @property
    def name(self) -> str:
        """Pixel format, size and frame rate, such as yuyv-640x480-30."""
        rate = round(1 / self.interval_s, 3)
        return f"{self.format.name}-{size_text(self.shape)}-{rate:g}"


def choose_mode(
    node: Node, format_: PixelFormat, size: Shape | None, fps: float | None
) -> StreamMode:
    """Return the requested mode; without a size the largest at `LEAST_FPS` frames a second or more.

    Without a rate it is the lowest such rate, because no exposure may be longer than the interval.
    Where no size has such a rate, it is the largest at its highest rate.

    Raises:
        UsageError: the camera does not offer that size or that rate
    """
    grid = node.sizes(format_.fourcc)
    sizes = [choose_size(grid, size, node.path)]
    if size is None:
        largest_first = sorted(grid.listed, key=lambda each: (each[0] * each[1], each[1]))[::-1]
        sizes = list(largest_first)
    offered = {shape: node.intervals(format_.fourcc, shape) for shape in sizes}
    wanted = 1 / (fps or LEAST_FPS) * (1 + _SAME_RATE)
    fast = [each for each in sizes if not offered[each] or min(offered[each]) <= wanted]
    shape = (fast or sizes)[0]
    return StreamMode(format_, shape, choose_interval(offered[shape], fps, node.path))


def choose_size(grid: SizeGrid, requested: Shape | None, path: str) -> Shape:
    """Return the requested size, or the largest; raise `UsageError` where it is not offered."""
    if requested is None:
        return grid.largest
    if not grid.has(requested):
        known = ", ".join(size_text(each) for each in grid.listed)
        raise UsageError(
            f"{path} does not offer frames of {size_text(requested)}", hint=f"it offers {known}"
        )
    return requested


def choose_interval(offered: Sequence[float], fps: float | None, path: str) -> float:
    """Return the frame interval, s, for `fps` frames a second, or the longest usual one.

    Without `fps` it is the longest with `LEAST_FPS` frames a second or more, else the shortest: no
    exposure may be longer than the interval, and a slow stream is slow to meter.

    Raises:
        UsageError: the camera does not offer that rate
    """
    if not offered:
        return 1 / fps if fps is not None else _USUAL_INTERVAL_S
    if fps is None:
        usual = [each for each in offered if each <= (1 + _SAME_RATE) / LEAST_FPS]
        return max(usual) if usual else min(offered)
    nearest = min(offered, key=lambda interval_s: abs(math.log(interval_s * fps)))
    if abs(nearest * fps - 1) > _SAME_RATE:
        known = ", ".join(f"{1 / interval_s:.4g}" for interval_s in sorted(offered, reverse=True))
        raise UsageError(
            f"{path} does not offer {fps:g} frames a second", hint=f"it offers {known}"
        )
    return nearest


class Capture:
    """The running stream of an open node.

    Args:
        node: the device; its format and stream are then this object's
        mode: what to stream

    Attributes:
        sequence: the driver's number of the frame that was grabbed last
        interval_s: the frame interval that the driver has set

    Raises:
        CameraBusyError: another process streams from the device
        CameraProtocolError: the device does not stream in that mode
    """

    def __init__(self, node: Node, mode: StreamMode) -> None:
        self.sequence = 0
        self._node = node
        self._mode = mode
        self._silence_s = max(_SILENCE_S, _SILENCE_FRAMES * mode.interval_s)
        self._memory: list[Memory] = []
        self._held: StreamBuffer | None = None
        try:
            self._line_bytes = self._set_mode()
            self._allocate()
            self._node.query(abi.Request.STREAMON, self._all_buffers(), "start the stream of")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop the stream and give its buffers back; what fails is ignored."""
        self._held = None
        self._memory.clear()
        for request, argument in (
            (abi.Request.STREAMOFF, self._all_buffers()),
            (abi.Request.REQBUFS, self._buffer_request(0)),
        ):
            try:
                self._node.query(request, argument, "stop the stream of")
            except CameraError:
                continue

    def grab(self) -> float:
        """Wait for the next frame; return its timestamp, s, which is when its exposure ended.

        Raises:
            CameraTimeoutError: no frame arrived within the time-out
            CameraDisconnectedError: the camera was unplugged
            CameraProtocolError: the stream failed several times in a row
        """
        attempts = _ATTEMPTS
        while True:
            try:
                return self._next_frame()
            except CameraTimeoutError:
                self._check_plug()
                raise
            except CameraError:
                self._check_plug()
                attempts -= 1
                if not attempts:
                    raise

    def retrieve(self) -> Pixels | None:
        """Return the samples of the frame grabbed last; None where it is damaged or incomplete."""
        held = self._held
        if held is None or held.raw.flags & abi.BufferFlag.ERROR:
            return None
        data = self._memory[held.raw.index][held.filled]
        try:
            return self._mode.format.packing.samples(data, self._mode.shape, self._line_bytes)
        except DamagedFrameError:
            return None

    def _next_frame(self) -> float:
        if self._held is not None:
            held, self._held = self._held, None
            self._node.query(abi.Request.QBUF, held.raw, "take a frame of")
        if not self._node.wait(self._silence_s):
            raise CameraTimeoutError(
                f"no frame from {self._node.path} for {self._silence_s:.0f} s",
                hint="unplug it, plug it in again and resume",
            )
        held = self._node.buffer(0)
        raw = self._node.query(abi.Request.DQBUF, held.raw, "take a frame of")
        if raw.index >= len(self._memory):
            raise self._node.invalid("a frame in buffer", raw.index)
        self._held, self.sequence = held, int(raw.sequence)
        return float(raw.seconds) + float(raw.microseconds) / 1e6

    def _set_mode(self) -> int:
        """Set pixel format, size and rate; return the bytes from line to line, 0 if unknown."""
        node, (rows, columns), code = self._node, self._mode.shape, self._mode.format.fourcc
        found = node.set_format(code, self._mode.shape)
        if (found.pixelformat, found.height, found.width) != (code, rows, columns):
            raise CameraProtocolError(
                f"{node.path} does not stream {self._mode.format.name} at "
                f"{size_text(self._mode.shape)}",
                hint="choose another size or another format",
                remedies={"option:size": None, "option:format": None},
            )
        self.interval_s = node.set_interval(self._mode.interval_s) or self._mode.interval_s
        return int(found.bytesperline)

    def _allocate(self) -> None:
        """Map the buffers and hand them to the kernel."""
        node = self._node
        granted = node.query(abi.Request.REQBUFS, self._buffer_request(BUFFERS), "stream from")
        if granted.count < _FEWEST_BUFFERS:
            raise CameraProtocolError(
                f"{node.path} has {granted.count} buffers for frames, and {_FEWEST_BUFFERS} are "
                "needed",
                hint="choose a smaller size",
                remedies={"option:size": None},
            )
        for index in range(granted.count):
            buffer = node.buffer(index)
            node.query(abi.Request.QUERYBUF, buffer.raw, "stream from")
            self._memory.append(node.map(buffer))
            node.query(abi.Request.QBUF, buffer.raw, "stream from")

    def _check_plug(self) -> None:
        """Raise `CameraDisconnectedError` where the camera does not respond to the kernel."""
        try:
            self._node.identity()
        except CameraError as error:
            raise CameraDisconnectedError(
                f"{self._node.path} was unplugged", hint=PLUG_IN
            ) from error

    def _buffer_request(self, count: int) -> abi.BufferRequest:
        kind = self._node.buffer_type
        return abi.BufferRequest(count=count, type=kind, memory=abi.MAPPED_MEMORY)

    def _all_buffers(self) -> abi.BufferType:
        return abi.BufferType(type=self._node.buffer_type)
