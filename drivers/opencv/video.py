"""A video that OpenCV opens: by the index of a camera, by a URL or file, or by a pipeline.

OpenCV reports of a frame neither when it was exposed nor with which exposure, and of a control only
the value that it has now.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from camctl.interface.camera import Pixels
from camctl.interface.clock import Clock

Kind: TypeAlias = Literal["index", "url", "pipeline"]

#: Silence of a stream after which it counts as dead, ms: for opening and for each frame.
SILENCE_MS = 10_000
#: FFmpeg's messages (libavutil/log.h, AV_LOG_QUIET) would appear on standard error.
_QUIET = "-8"
_PLACEHOLDERS: Mapping[str, float] = {"{us}": 1e6, "{ms}": 1e3, "{s}": 1.0}


@dataclass(frozen=True)
class Address:
    """What follows ``opencv:`` in a camera id.

    Attributes:
        text: as the user gave it
        kind: index of a camera, URL (or file), or GStreamer pipeline
    """

    text: str
    kind: Kind

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the address: digits are an index, a " ! " makes a pipeline; the rest is a URL."""
        if not text:
            raise UsageError(
                "the backend opencv needs an address",
                hint="give an index, a URL or a GStreamer pipeline, such as opencv:0",
            )
        if text.isascii() and text.isdigit():
            return cls(text, "index")
        return cls(text, "pipeline" if " ! " in text else "url")

    @property
    def has_exposure(self) -> bool:
        """Whether the address has a place for the exposure time: {us}, {ms} or {s}."""
        return any(mark in self.text for mark in _PLACEHOLDERS)

    def at(self, time_s: float) -> str:
        """Return the address with an exposure time in its place, in whole microseconds at least."""
        text = self.text
        for mark, unit in _PLACEHOLDERS.items():
            text = text.replace(mark, f"{round(time_s * unit, 6):.10g}")
        return text


def cv2_module() -> ModuleType:
    """Return OpenCV with its messages switched off; it is imported here, since it takes a second.

    Raises:
        CameraError: OpenCV is not installed
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _QUIET)
    try:
        import cv2
    except ImportError as error:
        raise CameraError(
            "the backend opencv needs OpenCV, which is not installed",
            hint="pip install opencv-contrib-python-headless, or choose another camera",
        ) from error
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2


class Video:
    """An open video.

    Args:
        address: what to open
        clock: measures silence
        time_s: exposure time for an address that has a place for one

    Raises:
        CameraNotFoundError: OpenCV cannot open it
        CameraError: this OpenCV was built without what it needs
    """

    def __init__(self, address: Address, clock: Clock, time_s: float) -> None:
        self._cv2 = cv2 = cv2_module()
        self._address = address
        self._clock = clock
        self.name = f"opencv:{address.text}"
        limits = [
            *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, SILENCE_MS),
            *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, SILENCE_MS),
        ]
        if address.kind == "index":
            self._video = cv2.VideoCapture(int(address.text), cv2.CAP_ANY)
        elif address.kind == "url":
            self._video = cv2.VideoCapture(address.at(time_s), cv2.CAP_FFMPEG, limits)
        else:
            self._check_gstreamer()
            self._video = cv2.VideoCapture(address.at(time_s), cv2.CAP_GSTREAMER)
        if not self._video.isOpened():
            self.close()
            raise CameraNotFoundError(
                f"OpenCV cannot open {address.text}", hint=_HINTS[address.kind]
            )

    @property
    def backend(self) -> str:
        """OpenCV's name of what reads the video, such as V4L2, DSHOW, MSMF or FFMPEG."""
        return str(self._video.getBackendName())

    @property
    def interval_s(self) -> float | None:
        """Time from frame to frame as the video states it, s; None where it does not."""
        rate = self.get("FPS")
        return 1 / rate if 0.01 <= rate <= 10_000 else None

    def get(self, name: str) -> float:
        """Return a property by the part of its name after CAP_PROP_; 0 or -1 where unknown."""
        return float(self._video.get(getattr(self._cv2, f"CAP_PROP_{name}")))

    def set(self, name: str, value: float) -> float:
        """Set a property and return what is read back."""
        self._video.set(getattr(self._cv2, f"CAP_PROP_{name}"), value)
        return self.get(name)

    def grab(self) -> None:
        """Wait for the next frame.

        Raises:
            CameraTimeoutError: none came
            CameraDisconnectedError: the stream ended
        """
        began_s = self._clock.now()
        if self._video.grab():
            return
        silence_s = self._clock.now() - began_s
        if silence_s > SILENCE_MS / 2000:
            raise CameraTimeoutError(
                f"no frame from {self.name} for {silence_s:.0f} s",
                hint="check the camera and its network, then resume",
            )
        raise CameraDisconnectedError(
            f"the stream of {self.name} ended", hint=_HINTS[self._address.kind]
        )

    def retrieve(self) -> Pixels | None:
        """Return the frame that was grabbed: grey or RGB, 8 or 16 bits; None if it is damaged."""
        try:
            is_there, data = self._video.retrieve()
        except self._cv2.error:
            return None
        if not is_there or not isinstance(data, np.ndarray) or not data.size:
            return None
        return self._pixels(data)

    def close(self) -> None:
        self._video.release()

    def _pixels(self, data: NDArray[Any]) -> Pixels:
        if data.dtype not in (np.uint8, np.uint16) or data.ndim not in (2, 3):
            raise CameraProtocolError(
                f"{self.name} sends frames of {data.dtype} with {data.ndim} dimensions",
                hint="let it send 8-bit grey or colour frames",
            )
        if data.ndim == 2 or data.shape[2] == 1:
            return np.array(data.reshape(data.shape[:2]))
        return np.ascontiguousarray(data[:, :, 2::-1])  # OpenCV's order is blue, green, red

    def _check_gstreamer(self) -> None:
        lines = self._cv2.getBuildInformation().splitlines()
        if not any("GStreamer" in line and "YES" in line for line in lines):
            raise CameraError(
                "this OpenCV was built without GStreamer, which the pipeline needs",
                hint="use an OpenCV with GStreamer, such as Debian's python3-opencv, or give a URL",
            )


_HINTS: Mapping[Kind, str] = {
    "index": "check that the camera is connected and free, or give another index",
    "url": "check the URL, and that the camera is on and sends video",
    "pipeline": "check the pipeline with gst-launch-1.0; it must end with appsink",
}
