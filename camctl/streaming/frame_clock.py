"""Slot numbers from timestamps, and from the driver's sequence numbers where there are any.

Counting the frames that were read gives no slot numbers: frames are lost and discarded.  A camera
that keeps its frame rate shows in its timestamps how many slots have passed: the frame of slot k
ends at its timestamp, and slot k + 1 is exposed from then on.  A sequence number counts the frames
that reached the driver: it shows which were lost there, but not which the camera never sent.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from statistics import median
from typing import Generic, Protocol, TypeVar

from camctl.clock import Clock
from camctl.controls import ExposureSetting
from camctl.errors import CameraProtocolError
from camctl.streaming.source import FrameStamp, Written, irregular_frames

DataT = TypeVar("DataT")
DataT_co = TypeVar("DataT_co", covariant=True)

#: A gap between timestamps may differ from a whole number of intervals by this share of one, which
#: is more than their jitter; 0.5 would accept every gap.
_GAP_TOLERANCE = 0.35
#: The same where the sequence numbers show the same number of slots.
_COUNTED_TOLERANCE = 0.5
#: Sequence numbers have 32 bits and begin again at 0.
_SEQUENCES = 2**32
#: A measured interval that differs by more than this share from the announced one is another rate.
_RATE_TOLERANCE = 0.1
#: The interval is the median of the last gaps: of at most, and at least, this number of them.
#: Frames may arrive in bursts, so a few gaps would be misleading.
_MOST_GAPS, _FEWEST_GAPS = 15, 5

#: When settings are written, in slots after the timestamp of a frame.  Up to the middle of the
#: slot, so that the write ends before the next slot begins.  Some cameras deliver a frame long
#: after its timestamp, which is when its transfer begins: there, up to a quarter of a slot after
#: the frame has arrived.
_WRITE_UNTIL, _WRITE_AFTER_ARRIVAL = 0.5, 0.25
#: The latest time to write in any case.
_LATEST_WRITE = 0.95
#: Frames that arrive later than this leave no time in the same slot: settings are written from
#: this far in the next slot on.
_ARRIVES_TOO_LATE, _NEXT_SLOT_BEGINS = 0.8, 0.03
#: A write that ends within this share of a slot before the end of its slot may count for the next.
_WRITE_MARGIN = 0.25
#: When a late write takes place, as a share of the time that is allowed for writing.
_LATE_WRITE = 0.95
#: Frames from which the interval is estimated, and how often that is tried.
_FIRST_FRAMES, _ATTEMPTS = 5, 16
#: A timestamp that differs more from the current time, s, is not on the same clock.
_SAME_CLOCK_S = 60.0


class FrameClock:
    """Numbers the slots of one stream by the timestamps of its frames.

    Args:
        interval_s: time from frame to frame as the camera announces it, s

    Attributes:
        interval_s: the same as measured
        number: slot of the last frame; None before the first
        time_s: timestamp of the last frame
    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self.number: int | None = None
        self.time_s = -math.inf
        self._gaps: deque[float] = deque(maxlen=_MOST_GAPS)
        self._sequence: int | None = None

    def add(self, time_s: float, sequence: int | None = None) -> FrameStamp:
        """Return the number of the frame with this timestamp, and sequence number if it has one.

        Both numbers must agree in how many slots have passed, or the timestamps alone must be
        clear and show more than the sequence numbers: frames that the camera did not send.
        """
        last, self.time_s = self.time_s, time_s
        counted = self._counted(sequence)
        if self.number is None:
            self.number = 0
            return FrameStamp(0, time_s, is_certain=False)
        gap = (time_s - last) / self.interval_s
        passed = max(1, round(gap), counted)
        self.number += passed
        tolerance = _COUNTED_TOLERANCE if passed == counted else _GAP_TOLERANCE
        is_certain = abs(gap - passed) <= tolerance
        if is_certain:
            self._gaps.append((time_s - last) / passed)
            if len(self._gaps) >= _FEWEST_GAPS:
                self.interval_s = median(self._gaps)
        return FrameStamp(self.number, time_s, is_certain)

    def _counted(self, sequence: int | None) -> int:
        """Return how many frames the driver has counted since the last; 0 where that is unknown."""
        last, self._sequence = self._sequence, sequence
        if last is None or sequence is None:
            return 0
        passed = (sequence - last) % _SEQUENCES
        return passed if passed < _SEQUENCES // 2 else 0

    def estimate_interval(self, times_s: list[float]) -> bool:
        """Estimate the interval from consecutive timestamps; False where they do not allow it.

        The announced interval is kept where the median gap is near it, because it is the more
        precise.  Another one needs gaps that all agree: a camera may begin irregularly.
        """
        gaps = [after - before for before, after in pairwise(times_s)]
        usual = median(gaps)
        if abs(usual / self.interval_s - 1) <= _RATE_TOLERANCE:
            return True
        if usual <= 0 or any(abs(gap / usual - 1) > _RATE_TOLERANCE for gap in gaps):
            return False
        self.interval_s = usual
        return True

    def phase(self, now_s: float) -> float:
        """Return the time since the timestamp of the last frame, in slots."""
        return (now_s - self.time_s) / self.interval_s

    def time_of(self, phase: float) -> float:
        """Return the time that is `phase` slots after the timestamp of the last frame, s."""
        return self.time_s + phase * self.interval_s

    def upcoming(self, now_s: float) -> int:
        """Return the number of the first slot that has not begun at `now_s`.

        Raises:
            ValueError: no frame was added yet
        """
        if self.number is None:
            raise ValueError("a frame clock needs a frame before it knows the current slot")
        return self.number + max(1, math.ceil(self.phase(now_s))) + 1


class TimestampedSource(Protocol[DataT_co]):
    """A running stream whose frames have timestamps: what a driver gives to `TimestampedStream`."""

    def grab(self) -> float:
        """Wait for the next frame and return the time at which its exposure ended, s.

        Raises:
            CameraTimeoutError: no frame arrived within the time-out of the stream
        """
        ...

    def retrieve(self) -> DataT_co | None:
        """Return the frame that was grabbed last; None where it is damaged."""
        ...

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the exposure and return it as read back.

        Raises:
            RefusedSettingError: the device applied another setting
        """
        ...


class TimestampedStream(Generic[DataT]):
    """Makes a `camctl.streaming.NumberedSource` of a stream with timestamps.

    Args:
        source: the running stream
        clock: on which its timestamps are
        interval_s: time from frame to frame as announced, s
        sequence: the driver's number of the frame grabbed last, where the stream has such numbers

    Attributes:
        frame_clock: numbers the frames
        arrival_s: from the end of an exposure to the arrival of its frame, as measured by `start`
    """

    def __init__(
        self,
        source: TimestampedSource[DataT],
        clock: Clock,
        interval_s: float,
        sequence: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._source = source
        self._sequence = sequence
        self._clock = clock
        self.frame_clock = FrameClock(interval_s)
        self.arrival_s = 0.0
        self._write_window = (0.0, _WRITE_UNTIL)

    def start(self) -> None:
        """Take the first frames and estimate their interval from them.

        Raises:
            CameraProtocolError: the timestamps are not on the clock, or not regular
        """
        for _ in range(_ATTEMPTS):
            times_s: list[float] = []
            delays_s: list[float] = []
            sequences: list[int | None] = []
            for _ in range(_FIRST_FRAMES):
                times_s.append(self._source.grab())
                sequences.append(self._sequence())
                delays_s.append(self._clock.now() - times_s[-1])
            if not abs(delays_s[-1]) < _SAME_CLOCK_S:
                raise CameraProtocolError(
                    "the timestamps of the frames are not on the system's monotonic clock",
                    hint="use another camera, or a newer kernel",
                )
            if self.frame_clock.estimate_interval(times_s):
                for time_s, sequence in zip(times_s, sequences, strict=True):
                    self.frame_clock.add(time_s, sequence)
                self.arrival_s = max(0.0, min(delays_s))
                self._write_window = _write_window(self.arrival_s / self.frame_clock.interval_s)
                return
        raise irregular_frames()

    def next_frame(self) -> FrameStamp:
        """Wait for the next frame and number it."""
        return self.frame_clock.add(self._source.grab(), self._sequence())

    def read(self) -> DataT | None:
        """Return the frame that arrived last; None where it is damaged."""
        return self._source.retrieve()

    def upcoming(self, *, late: bool = False) -> int | None:
        """Return the first slot not begun; None outside the part of a slot for writing."""
        begin, end = self._write_window
        if self.frame_clock.phase(self._clock.now()) > end:
            return None
        self._clock.sleep_until(self.frame_clock.time_of(_LATE_WRITE * end if late else begin))
        return self.frame_clock.upcoming(self._clock.now())

    def write(self, setting: ExposureSetting) -> Written:
        """Set the exposure; the slot of the write is certain unless it ended near a slot's end."""
        first = self.frame_clock.upcoming(self._clock.now())
        applied = self._source.write(setting)
        margin = min(_WRITE_MARGIN, (1 - self._write_window[1] % 1) / 2)
        ended_s = self._clock.now() + margin * self.frame_clock.interval_s
        return Written(applied, first, self.frame_clock.upcoming(ended_s))


def _write_window(arrival: float) -> tuple[float, float]:
    """Return from when to when settings are written, in slots after a timestamp.

    `arrival` is how long after its timestamp a frame arrives, in slots.
    """
    whole, part = divmod(max(arrival, 0.0), 1.0)
    if part > _ARRIVES_TOO_LATE:
        return whole + 1 + _NEXT_SLOT_BEGINS, whole + 1 + _WRITE_UNTIL
    return 0.0, whole + max(_WRITE_UNTIL, min(part + _WRITE_AFTER_ARRIVAL, _LATEST_WRITE))
