"""An endless stream of a running camera: a setting goes with the next request that is returned.

How many frames pass until it is in force depends on how many requests wait in the camera, and these
are fewer where the program is slow.  Which frame has it is therefore taken from the metadata, once
the pixels have agreed with them; until then each setting is waited for.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from camctl.drivers.libcamera.requests import LATEST, SILENCE_S, Arrived, Requests, Stated
from camctl.interface.controls import ExposureSetting
from camctl.interface.cycle import CycleMethod
from camctl.streaming import FrameStamp, StreamCycle, Written

#: When a frame arrives the next one is being exposed; what is sent then is for one after that.
_NOT_BEGUN = 2


class RequestCycle(StreamCycle[Arrived]):
    """An endless stream whose settings go with requests."""

    method = CycleMethod.REQUEST


class RequestStream:
    """A `camctl.streaming.NumberedSource`, and the settings that `Requests` sends meanwhile.

    Args:
        requests: of the camera
        request: what is sent for a setting
        stated: the setting that the metadata of a frame state
        ended_s: when the exposure of a frame ended, by its metadata
    """

    def __init__(
        self,
        requests: Requests,
        request: Callable[[ExposureSetting], Stated],
        stated: Callable[[Mapping[str, Any]], ExposureSetting],
        ended_s: Callable[[Mapping[str, Any]], float],
    ) -> None:
        self._requests, self._request = requests, request
        self._stated, self._ended_s = stated, ended_s
        self._lock = threading.Lock()  # frames arrive in the thread of picamera2
        self._waiting: Stated | None = None
        self._newest: int | None = None
        self._longest_s = 0.0
        self._frame: Arrived | None = None
        self._running = ExitStack()
        self._running.enter_context(requests.running(self))

    def close(self) -> None:
        """End the stream; a setting that waits is sent."""
        self._running.close()
        if self._waiting is not None:
            self._requests.send(self._waiting)

    def takes(self, number: int, metadata: Mapping[str, Any]) -> bool:
        """Return True: each frame is taken."""
        with self._lock:
            self._newest = number
        return True

    def to_be_sent(self) -> Stated | None:
        """See `Exchange.to_be_sent`."""
        with self._lock:
            waiting, self._waiting = self._waiting, None
        return waiting

    def next_frame(self) -> FrameStamp:
        """See `NumberedSource.next_frame`."""
        self._frame = self._requests.next(SILENCE_S + LATEST * self._longest_s)
        metadata = self._frame.metadata
        return FrameStamp(
            self._frame.number, self._ended_s(metadata), applied=self._stated(metadata)
        )

    def read(self) -> Arrived | None:
        """Return the frame that arrived last."""
        return self._frame

    def upcoming(self, *, late: bool = False) -> int | None:
        """Return the first slot that a setting may be for; None while another one waits.

        None, too, before the first frame, whose number says which slots those are.
        """
        with self._lock:
            if self._waiting is not None or self._newest is None:
                return None
            return self._newest + 1 + _NOT_BEGUN

    def write(self, setting: ExposureSetting) -> Written:
        """Let a setting be sent when the next frame arrives."""
        self._longest_s = max(self._longest_s, setting.time_s)
        with self._lock:
            self._waiting = self._request(setting)
            slot = (self._newest or 0) + 1 + _NOT_BEGUN
        return Written(setting, slot, slot)
