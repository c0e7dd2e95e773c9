"""Frames through OpenCV: choose a stream mode, open the stream, grab frames, explain failures.

OpenCV's V4L2 backend ignores its time-out properties; it waits OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT
seconds (a whole number, read once in a process; 10 if it is not set) for each frame.  It reports
no reason for a failure, so the kernel is asked.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.clock import Clock
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from drivers.v4l2.formats import PixelFormat
from drivers.v4l2.node import Node, Shape, SizeGrid, size_text
from drivers.v4l2.system import PLUG_IN, busy_error, processes_using

#: Buffers that the kernel fills while no frame is taken: enough for the frames that are on their
#: way to a late consumer with a control delay of 5 frames.
BUFFERS = 8
#: Attempts to grab a frame that fails at once, and the pause between them.
_ATTEMPTS, _PAUSE_S = 3, 0.3
#: Frame interval where the camera offers no list, s.
_USUAL_INTERVAL_S = 1 / 30
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
    """Return the frame interval, s, for `fps` frames a second, or the longest.

    The longest is the default, because no exposure may be longer than the interval.  Only those
    intervals count that OpenCV can request: the nearest to a whole number of frames a second.

    Raises:
        UsageError: the camera does not offer that rate
    """
    usable = [
        interval_s
        for interval_s in offered
        if min(offered, key=lambda each: abs(each - 1 / _whole_rate(interval_s))) == interval_s
    ]
    if not usable:
        return 1 / fps if fps is not None else _USUAL_INTERVAL_S
    if fps is None:
        return max(usable)
    nearest = min(usable, key=lambda interval_s: abs(math.log(interval_s * fps)))
    if abs(nearest * fps - 1) > _SAME_RATE:
        known = ", ".join(f"{1 / interval_s:.4g}" for interval_s in sorted(usable, reverse=True))
        raise UsageError(
            f"{path} does not offer {fps:g} frames a second", hint=f"it offers {known}"
        )
    return nearest


def _whole_rate(interval_s: float) -> int:
    """Return the nearest whole number of frames a second: OpenCV can request no other rate."""
    return max(1, round(1 / interval_s))


class Video(Protocol):
    """The part of `cv2.VideoCapture` that the driver uses."""

    def isOpened(self) -> bool: ...  # noqa: N802, D102
    def set(self, propId: int, value: float) -> bool: ...  # noqa: D102
    def get(self, propId: int) -> float: ...  # noqa: D102
    def grab(self) -> bool: ...  # noqa: D102
    def retrieve(self) -> tuple[bool, NDArray[Any]]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


class VideoOpener(Protocol):
    """Opens the video of a node."""

    def __call__(self, path: str) -> Video:
        """Return the video, opened or not."""
        ...


def open_video(path: str) -> Video:
    """Open a node with OpenCV, whose log is silenced from then on."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2.VideoCapture(path, cv2.CAP_V4L2)


def select_timeout_s() -> float:
    """Return how long OpenCV waits for a frame, s."""
    try:
        return float(int(os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"]))
    except (KeyError, ValueError):
        return 10.0


class Capture:
    """A running stream.

    Args:
        node: the same device on the driver's own descriptor, to find out what failed
        mode: what to stream
        clock: monotonic, as are the timestamps of the frames
        opener: opens the video

    Raises:
        CameraBusyError: another process streams from the device
        CameraProtocolError: the device does not stream in that mode
    """

    def __init__(
        self, node: Node, mode: StreamMode, clock: Clock, opener: VideoOpener = open_video
    ) -> None:
        self._node = node
        self._clock = clock
        self._video = opener(node.path)
        try:
            if not self._video.isOpened():
                raise self._no_stream("cannot be opened for streaming")
            self._set_up(mode)
        except BaseException:
            self._video.release()
            raise

    def close(self) -> None:
        """Stop the stream."""
        self._video.release()

    def grab(self) -> float:
        """Wait for the next frame; return its timestamp, s, which is when its exposure ended.

        Raises:
            CameraTimeoutError: no frame arrived for as long as OpenCV waits
            CameraDisconnectedError: the camera was unplugged
            CameraBusyError: another process took the stream
            CameraProtocolError: the stream failed several times in a row
        """
        for _ in range(_ATTEMPTS):
            began_s = self._clock.now()
            if self._video.grab():
                return self._video.get(cv2.CAP_PROP_POS_MSEC) / 1000
            silence_s = self._clock.now() - began_s
            self._check_plug()
            if silence_s > select_timeout_s() / 2:
                raise CameraTimeoutError(
                    f"no frame from {self._node.path} for {silence_s:.0f} s",
                    hint="unplug it, plug it in again and resume",
                )
            self._clock.sleep_until(self._clock.now() + _PAUSE_S)
        raise self._no_stream("delivers no frames")

    def retrieve(self) -> NDArray[Any] | None:
        """Return the frame grabbed last as OpenCV delivers it; None where that fails."""
        try:
            is_there, data = self._video.retrieve()
        except cv2.error:
            return None
        return data if is_there and isinstance(data, np.ndarray) and data.size else None

    def _set_up(self, mode: StreamMode) -> None:
        # Each of the first four restarts the stream; a rate is accepted only while it is stopped.
        video, (rows, columns) = self._video, mode.shape
        video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        video.set(cv2.CAP_PROP_BUFFERSIZE, BUFFERS)
        video.set(cv2.CAP_PROP_FOURCC, mode.format.fourcc)
        video.set(cv2.CAP_PROP_FRAME_WIDTH, columns)
        video.set(cv2.CAP_PROP_FRAME_HEIGHT, rows)
        video.set(cv2.CAP_PROP_FPS, _whole_rate(mode.interval_s))
        if not video.isOpened():
            raise self._no_stream("cannot be opened for streaming")
        found = self._node.current_format()
        if (found.pixelformat, found.height, found.width) != (mode.format.fourcc, rows, columns):
            raise self._no_stream(f"does not stream {mode.format.name} at {size_text(mode.shape)}")
        bytes_per_line = mode.format.packing.bytes_per_line
        if bytes_per_line is not None and found.bytesperline > bytes_per_line(columns):
            raise CameraError(
                f"{self._node.path} pads its lines of {bytes_per_line(columns)} bytes to "
                f"{found.bytesperline}, which OpenCV cannot read",
                hint="choose another size with -O size=WIDTHxHEIGHT",
            )

    def _check_plug(self) -> None:
        """Raise `CameraDisconnectedError` where the camera does not respond to the kernel."""
        try:
            self._node.identity()
        except CameraError as error:
            raise CameraDisconnectedError(
                f"{self._node.path} was unplugged", hint=PLUG_IN
            ) from error

    def _no_stream(self, what: str) -> CameraError:
        self._check_plug()
        processes = processes_using(self._node.path)
        if processes:
            return busy_error(self._node.path, processes)
        return CameraProtocolError(
            f"{self._node.path} {what}",
            hint="close other programs that use it, give it a USB port of its own, or choose a "
            "smaller size with -O size=WIDTHxHEIGHT",
        )
