"""Clocks, waits that a cancelled capture ends, and what takes time in a capture.

Drivers and cameras wait in real time; tests in virtual time, which is exact and takes no time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

from camctl.errors import InterruptedCaptureError

#: How often a wait asks whether the capture was cancelled, s: half of what people notice as a delay
#: (0.2 s).
POLL_S = 0.1

_cancelled: ContextVar[Callable[[], bool] | None] = ContextVar("cancelled", default=None)


@contextmanager
def cancelled_by(cancelled: Callable[[], bool] | None) -> Iterator[None]:
    """Let the waits of this thread end while the block runs, once `cancelled` returns True."""
    token = _cancelled.set(cancelled)
    try:
        yield
    finally:
        _cancelled.reset(token)


def check_cancelled() -> None:
    """Raise `InterruptedCaptureError` where the capture of this thread was cancelled.

    `RealClock` asks by itself; a driver that waits for something else does while it waits.
    """
    cancelled = _cancelled.get()
    if cancelled is not None and cancelled():
        raise InterruptedCaptureError("cancelled")


def wait_for(wait: Callable[[float], bool], timeout_s: float) -> bool:
    """Return whether `wait`, called with a time-out in seconds, returns True within `timeout_s`.

    Raises:
        InterruptedCaptureError: the capture of this thread was cancelled; within `POLL_S`
    """
    if _cancelled.get() is None:
        return wait(timeout_s)
    while timeout_s > POLL_S:
        check_cancelled()
        if wait(POLL_S):
            return True
        timeout_s -= POLL_S
    return wait(timeout_s)


class Clock(Protocol):
    """A monotonic clock: seconds since an arbitrary zero."""

    def now(self) -> float:
        """Return the time, s."""

    def sleep_until(self, deadline_s: float) -> None:
        """Return when `now()` has reached `deadline_s`, immediately if it already has."""


class RealClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep until the monotonic clock shows `deadline_s`.

        Raises:
            InterruptedCaptureError: as `check_cancelled`, within `POLL_S`
        """
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            check_cancelled()
            is_awaited = _cancelled.get() is not None
            time.sleep(min(remaining_s, POLL_S) if is_awaited else remaining_s)


class VirtualClock:
    """A clock that advances only by `sleep_until`, exactly to its deadline, without waiting.

    >>> clock = VirtualClock()
    >>> clock.sleep_until(3600.0)
    >>> clock.now()
    3600.0
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now(self) -> float:
        """Return the virtual time, s."""
        return self._now_s

    def sleep_until(self, deadline_s: float) -> None:
        """Jump to `deadline_s`."""
        self._now_s = max(self._now_s, deadline_s)


@dataclass(frozen=True)
class CaptureTiming:
    """What takes time in a capture beside the exposures and the frame interval.

    Attributes:
        settling_s: still cameras: before each exposure, to make its settings and to release the
            shutter, s
        readout_s: from the end of an exposure until its frame is here, or its file is on the
            camera's card, s
        download_s: still cameras: transfer and decoding of a file, s
        overlaps: still cameras: a file is downloaded during the next exposure
        lead_frames: streams: frames, on average, that pass from the request until the first setting
            is written in time for a frame; half a frame, since a request comes at any time
            within a frame
        old_frames: streams without a constant control delay: frames after each write that still
            have the exposure before, on average
        unsettled_frames: streams without a constant control delay: frames after `old_frames`
            that are not used, on average
        rests: streams: a preview or a capture leaves the stream with frames that take one frame
            interval each, however long its last exposure was
    """

    settling_s: float = 0.0
    readout_s: float = 0.0
    download_s: float = 0.0
    overlaps: bool = False
    lead_frames: float = 0.0
    old_frames: float = 0.0
    unsettled_frames: float = 0.0
    rests: bool = False
