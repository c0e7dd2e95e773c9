"""Clocks, and what takes time in a capture.

Drivers and cameras wait in real time; tests in virtual time, which is exact and takes no time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol


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
        """Sleep until the monotonic clock shows `deadline_s`."""
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            time.sleep(remaining_s)


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
