"""Frames through OpenCV: open a stream in one picture, grab, and tell why nothing comes.

OpenCV's V4L2 road obeys no time-out property; it waits OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT seconds
(whole ones, read once for the process, 10 if unset) for each frame.  It says of a failure only
that it failed, so the reason is asked from the kernel.
"""

from __future__ import annotations

import os
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
)
from drivers.v4l2.errors import PLUG_IN, busy_error, holding
from drivers.v4l2.formats import PixelFormat
from drivers.v4l2.modes import Size, whole_rate
from drivers.v4l2.node import Node

#: Buffers that the kernel fills while nobody takes them: enough for the frames that are under way
#: to a late consumer with a control delay of 5.
BUFFERS = 8
_RETRIES = 3
_RETRY_S = 0.3


@dataclass(frozen=True)
class Picture:
    """What is streamed: pixel format, size, and time from frame to frame, s."""

    format: PixelFormat
    size: Size
    interval_s: float


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
    """Open a node with OpenCV, which keeps its words to itself from now on."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2.VideoCapture(path, cv2.CAP_V4L2)


def select_timeout_s() -> float:
    """Return for how long OpenCV waits for a frame, s."""
    try:
        return float(int(os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"]))
    except (KeyError, ValueError):
        return 10.0


class Capture:
    """A running stream.

    Args:
        node: the same device on a descriptor of our own, which tells what went wrong
        picture: what to stream
        clock: monotonic, as the timestamps of the frames are
        opener: opens the video; OpenCV by default

    Raises:
        CameraBusyError: another process streams from it
        CameraProtocolError: it does not stream that picture

    """

    def __init__(
        self, node: Node, picture: Picture, clock: Clock, opener: VideoOpener = open_video
    ) -> None:
        self._node = node
        self._clock = clock
        self._video = opener(node.path)
        try:
            if not self._video.isOpened():
                raise self._no_stream("cannot be opened for streaming")
            self._set_up(picture)
        except BaseException:
            self._video.release()
            raise

    def close(self) -> None:
        """Stop the stream."""
        self._video.release()

    def grab(self) -> float:
        """Wait for the next frame; return its timestamp, s, which is when its exposure ended.

        Raises:
            CameraTimeoutError: nothing came for as long as OpenCV waits
            CameraDisconnectedError: the camera is gone
            CameraBusyError: another process took the stream
            CameraProtocolError: the stream fails again and again

        """
        for _ in range(_RETRIES):
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
            self._clock.sleep_until(self._clock.now() + _RETRY_S)
        raise self._no_stream("gives no frames")

    def retrieve(self) -> NDArray[Any] | None:
        """Return the frame grabbed last as OpenCV has it, None where it cannot be had."""
        try:
            is_there, data = self._video.retrieve()
        except cv2.error:
            return None
        return data if is_there and isinstance(data, np.ndarray) and data.size else None

    def _set_up(self, picture: Picture) -> None:
        # Each of the first four restarts the stream, and a rate is only taken while it stands.
        video, size = self._video, picture.size
        video.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        video.set(cv2.CAP_PROP_BUFFERSIZE, BUFFERS)
        video.set(cv2.CAP_PROP_FOURCC, picture.format.fourcc)
        video.set(cv2.CAP_PROP_FRAME_WIDTH, size.width)
        video.set(cv2.CAP_PROP_FRAME_HEIGHT, size.height)
        video.set(cv2.CAP_PROP_FPS, whole_rate(picture.interval_s))
        if not video.isOpened():
            raise self._no_stream("cannot be opened for streaming")
        found = self._node.picture()
        if (found.pixelformat, found.width, found.height) != (
            picture.format.fourcc,
            size.width,
            size.height,
        ):
            raise self._no_stream(f"does not stream {picture.format.name} at {size}")
        needed = picture.format.packing.bytes_for
        if needed is not None and found.bytesperline > needed(size.width):
            raise CameraError(
                f"{self._node.path} pads its lines of {needed(size.width)} bytes to "
                f"{found.bytesperline}, which OpenCV cannot read",
                hint="choose another size with -O size=WIDTHxHEIGHT",
            )

    def _check_plug(self) -> None:
        """Raise `CameraDisconnectedError` where the camera is gone or going."""
        try:
            self._node.identity()
        except CameraError as error:
            raise CameraDisconnectedError(
                f"{self._node.path} was unplugged", hint=PLUG_IN
            ) from error

    def _no_stream(self, what: str) -> CameraError:
        self._check_plug()
        holders = holding(self._node.path)
        if holders:
            return busy_error(self._node.path, holders)
        return CameraProtocolError(
            f"{self._node.path} {what}",
            hint="close other programs that use it, give it a USB port of its own, or choose a "
            "smaller size with -O size=WIDTHxHEIGHT",
        )
