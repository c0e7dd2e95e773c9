"""Frames of a running camera and the settings that are sent to it, in the thread of picamera2.

libcamera applies the settings of a request some frames later, and states in the metadata of each
frame which exposure it had.  A setting goes with each request that is returned to the camera; the
frame whose metadata state it is its frame.  A setting whose frame does not come is sent again.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CameraProtocolError, CameraTimeoutError
from camctl.interface.clock import wait_for

#: Frames without the next setting until the settings are sent again: more than the requests that
#: wait in the camera (6) and the largest delay of a sensor in libcamera (3) together.
LATEST = 16
#: How often they are sent again at most.
_ATTEMPTS = 8
#: Copies of frames that wait for the program; then the camera waits.
_WAITING = 4
#: How often the thread of picamera2 asks whether a frame is still wanted, s.
_PUT_S = 0.05
#: How long a camera may send nothing, s, beside the time of exposures.
SILENCE_S = 5.0


class Stated(NamedTuple):
    """The exposure that metadata state: time in us, and analogue gain."""

    time_us: int
    gain: float


class Arrived(NamedTuple):
    """A frame: its bytes, (rows, bytes of a line), its metadata, and the number of its request."""

    data: NDArray[np.uint8]
    metadata: Mapping[str, Any]
    number: int


class Exchange(Protocol):
    """What is taken and sent while frames arrive, in the thread of picamera2."""

    def takes(self, number: int, metadata: Mapping[str, Any]) -> bool:
        """Return whether a frame that has arrived is wanted: with the number of its request."""

    def to_be_sent(self) -> Stated | None:
        """Return the setting that goes with the request that is returned now, once."""


@dataclass
class _Sequence:
    """Settings that are sent, one with each request, and the frames that are taken.

    Attributes:
        to_send: settings
        is_taken: whether a frame of this metadata is the one at a place of the list
        count: frames that are taken
        sent: settings sent so far
        done: frames taken so far
        waited: frames since the next one's setting was sent
        attempts: how often settings were sent again
    """

    to_send: Sequence[Stated]
    is_taken: Callable[[int, Mapping[str, Any]], bool]
    count: int
    sent: int = 0
    done: int = 0
    waited: int = 0
    attempts: int = 0

    def to_be_sent(self) -> Stated | None:
        """See `Exchange.to_be_sent`."""
        if self.sent == len(self.to_send):
            return None
        self.sent += 1
        return self.to_send[self.sent - 1]

    def takes(self, number: int, metadata: Mapping[str, Any]) -> bool:
        """Return whether a frame is the next one of the list."""
        if self.done < self.count and self.is_taken(self.done, metadata):
            self.done += 1
            self.waited = 0
            return True
        self.waited += self.sent > self.done
        if self.waited > LATEST:
            self.sent, self.waited = self.done, 0
            self.attempts += 1
            if self.attempts > _ATTEMPTS:
                raise CameraProtocolError(
                    "the camera does not apply the exposures that it was sent",
                    hint="close other programs that use the camera, and open it again",
                )
        return False


class Requests:
    """The requests of a started `picamera2.Picamera2`.

    Args:
        camera: it
        name: of the camera in errors
    """

    def __init__(self, camera: Any, name: str) -> None:
        self._camera, self._name = camera, name
        self._exchange: Exchange | None = None
        self._frames: queue.Queue[Arrived | Exception] = queue.Queue(_WAITING)
        camera.pre_callback = self._arrived

    def shoot(
        self,
        to_send: Sequence[Stated],
        count: int,
        is_taken: Callable[[int, Mapping[str, Any]], bool],
        silence_s: float = 0.0,
    ) -> Generator[Arrived, None, None]:
        """Yield `count` frames: each is the first for which `is_taken` returns True.

        Args:
            to_send: settings, in their order; those behind `count` need no frame
            count: frames
            is_taken: whether a frame is the one of a place, by its metadata
            silence_s: how long a frame may take, s

        Raises:
            CameraTimeoutError: the camera sends nothing
            CameraProtocolError: it does not apply what it was sent
        """
        with self.running(_Sequence(to_send, is_taken, count)):
            for _ in range(count):
                yield self.next(SILENCE_S + LATEST * silence_s)

    def metadata(self, to_send: Sequence[Stated]) -> list[Stated]:
        """Send settings, one a frame, and return what frames state until all were in force."""
        found: list[Stated] = []

        def is_taken(place: int, metadata: Mapping[str, Any]) -> bool:
            found.append(stated(metadata))
            return True

        count = len(to_send) + LATEST
        for _ in self.shoot(to_send, count, is_taken):
            pass
        return found

    @contextmanager
    def running(self, exchange: Exchange) -> Iterator[None]:
        """Take frames and send settings while the block runs."""
        self._frames = queue.Queue(_WAITING)
        self._exchange = exchange
        try:
            yield
        finally:
            self._exchange = None
            self._frames = queue.Queue(_WAITING)  # nothing waits in the other thread

    def next(self, timeout_s: float) -> Arrived:
        """Return the next frame that was taken; raises as `shoot` does."""
        found: list[Arrived | Exception] = []

        def wait(wait_s: float) -> bool:
            try:
                found.append(self._frames.get(timeout=wait_s))
            except queue.Empty:
                return False
            return True

        if not wait_for(wait, timeout_s):
            raise CameraTimeoutError(
                f"{self._name} sends no frames",
                hint="check its ribbon cable, and that no other program uses it",
            )
        if isinstance(found[0], Exception):
            raise found[0]
        return found[0]

    def _arrived(self, request: Any) -> None:
        """Take a frame and send a setting; picamera2 calls this in its thread for each request."""
        exchange = self._exchange
        if exchange is None:
            return
        try:
            metadata, number = request.get_metadata(), int(request.request.sequence)
            is_taken = exchange.takes(number, metadata)
            # What is set goes with the next request: settings that wait would be overwritten.
            if not self._camera.controls.make_dict():
                setting = exchange.to_be_sent()
                if setting is not None:
                    self.send(setting)
            # Then the program has the time of a frame to choose the next setting.
            if is_taken:
                self._put(Arrived(request.make_array("raw"), metadata, number))
        except Exception as error:  # in this thread it would end the stream unseen
            self._exchange = None
            self._put(error)

    def send(self, setting: Stated) -> None:
        """Send a setting with the next request that is returned to the camera."""
        self._camera.set_controls({"ExposureTime": setting.time_us, "AnalogueGain": setting.gain})

    def _put(self, frame: Arrived | Exception) -> None:
        """Give a frame to the program; while it does not take it, the camera waits."""
        frames = self._frames
        while self._frames is frames:
            with suppress(queue.Full):
                frames.put(frame, timeout=_PUT_S)
                return


def stated(metadata: Mapping[str, Any]) -> Stated:
    """Return the exposure that the metadata of a frame state.

    Raises:
        CameraProtocolError: they state none
    """
    try:
        return Stated(int(metadata["ExposureTime"]), float(metadata["AnalogueGain"]))
    except (KeyError, TypeError, ValueError):
        raise CameraProtocolError(
            "the camera does not state the exposures of its frames",
            hint="libcamera has no exposure control for this sensor; use v4l2",
        ) from None
