"""Slot numbers from timestamps, and from the driver's sequence numbers where there are any.

Counting the frames that were read gives no slot numbers: frames are lost and discarded.  A camera
that keeps its frame rate shows in its timestamps how many slots have passed: the frame of slot k
ends at its timestamp, and slot k + 1 is exposed from then on.  A sequence number counts the frames
that reached the driver: it shows which were lost there, but not which the camera never sent.

A timestamp may be late, where a busy computer takes it, but not early.  So the earliest of the
recent ones show when slots end, and how late the last one is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Generic, Protocol, TypeVar

from camctl.errors import CameraProtocolError
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureSetting
from camctl.streaming.control_delay import FrameStamp, Written, irregular_frames

DataT = TypeVar("DataT")
DataT_co = TypeVar("DataT_co", covariant=True)

#: A timestamp may be later than the end of its slot by this share of a slot, which is more than
#: jitter; or as late as recent ones are, where a program looks for frames every so often.
_LATEST = 0.35
#: The same where the sequence numbers show the same number of slots: short of the next slot's end.
_LATEST_COUNTED = 0.65
#: A timestamp that is earlier than expected by more than this shows that all recent ones were late.
_EARLIEST = 0.1
#: After so many frames in a row that do not fit the recent ones, the camera's slots have moved, or
#: it has another rate.
_MOST_UNCERTAIN = 4
#: Sequence numbers have 32 bits and begin again at 0.
_SEQUENCES = 2**32
#: A measured interval that differs by more than this share from the announced one is another rate.
_RATE_TOLERANCE = 0.1
#: Gaps show another rate where all differ by at most this share from their median.
_GAP_TOLERANCE = 0.04
#: Recent frames are the frames of so many slots: few enough for an interval that is off by 0.3 %.
_RECENT_SLOTS = 32
#: The interval is measured from at least so many frames.
_FEWEST_FRAMES = 12
#: It is changed where it differs by so many times what late timestamps cause by chance (they cause
#: so much in exp(-6) of the cases), and where no frame would then be early by more than this share
#: of a slot.
_CHANCE, _JITTER = 6, 0.02

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
        late: from the end of the last frame's slot to its timestamp, slots
    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self.number: int | None = None
        self.time_s = -math.inf
        self.late = 0.0
        self._recent: deque[tuple[int, float]] = deque()  # slot and timestamp
        self._gaps: deque[float] = deque(maxlen=_MOST_UNCERTAIN)  # s
        self._lates: deque[float] = deque(maxlen=_RECENT_SLOTS)  # slots
        self._sequence: int | None = None
        self._uncertain = 0  # frames in a row

    def add(self, time_s: float, sequence: int | None = None) -> FrameStamp:
        """Return the number of the frame with this timestamp, and sequence number if it has one.

        It is certain where timestamp and sequence numbers agree, or where there are none and the
        timestamp is clear.  A timestamp that shows that earlier ones were late is uncertain:
        settings were perhaps written in another slot than it seemed.
        """
        counted = self._counted(sequence)
        if self.number is None:
            self.number, self.time_s = 0, time_s
            self._recent.append((0, time_s))
            return FrameStamp(0, time_s, is_certain=False)
        gap = (time_s - self.time_s) / self.interval_s
        passed = _passed(gap + self.late, counted)
        late = gap + self.late - passed
        if passed == counted:
            is_certain = -_EARLIEST <= late <= _LATEST_COUNTED
        else:
            # A frame that is late by a whole slot looks like one after a frame that was not sent.
            latest = self._latest
            is_clear = -_EARLIEST <= late <= latest and abs(gap - passed) <= latest
            is_certain = is_clear and not counted
        self.number += passed
        self.time_s = time_s
        self._uncertain = 0 if is_certain else self._uncertain + 1
        self._gaps.append(gap * self.interval_s)
        if late < -_EARLIEST:  # they were later than they seemed
            self._lates.clear()
        self._lates.append(max(0.0, late))
        # One that is a little early shows when slots end; the numbers are as certain as before.
        if is_certain or (-2 * _EARLIEST < late < 0 and self._uncertain < _MOST_UNCERTAIN):
            self._recent.append((self.number, time_s))
        else:
            self._begin_anew(max(0.0, late))
        while self._recent[0][0] < self.number - _RECENT_SLOTS:
            self._recent.popleft()
        self._measure()
        return FrameStamp(self.number, time_s, is_certain)

    @property
    def _latest(self) -> float:
        """How late a timestamp may be that is clear, slots: as late as all recent ones but one.

        It must not be one of the next slot.  It could be if all recent ones, the earliest of which
        shows when slots end, were late by what it lacks of a slot.
        """
        if len(self._lates) < _FEWEST_FRAMES:
            return _LATEST
        *_, usual, _ = sorted(self._lates)
        by_chance = _CHANCE * _least_late(self._lates, len(self._lates))
        return max(_LATEST, min(usual, 1 - _EARLIEST - by_chance))

    def _begin_anew(self, late: float) -> None:
        """Forget frames whose numbers may be wrong, but not when slots end unless it fits none."""
        if self._uncertain >= _MOST_UNCERTAIN:
            late, self._uncertain = 0.0, 0
            self._lates.clear()
            self.interval_s = _agreed(self._gaps) or self.interval_s
        elif len(self._lates) == self._lates.maxlen:
            # Slots end where the earliest of these did: the interval may be a little wrong.
            least = min(self._lates)
            self._lates = deque((each - least for each in self._lates), self._lates.maxlen)
            late -= least
        assert self.number is not None
        self._recent.clear()
        self._recent.append((self.number, self.time_s - late * self.interval_s))

    def _measure(self) -> None:
        """Measure how late the last frame is, and the interval, by the earliest recent frames."""
        frames = list(self._recent)
        if len(frames) >= _FEWEST_FRAMES:
            self._measure_interval(frames)
        number, time_s = self._earliest(frames)
        assert self.number is not None
        passed = self.number - number
        self.late = (self.time_s - time_s) / self.interval_s - passed

    def _measure_interval(self, frames: list[tuple[int, float]]) -> None:
        """Measure the interval from the earliest frame of each half of the recent ones.

        It is changed where that moves them by more than chance.  No timestamp is early, so an
        interval that makes one early is not used.
        """
        half = len(frames) // 2
        (first, first_s), (last, last_s) = map(self._earliest, (frames[:half], frames[half:]))
        passed = last - first
        interval_s = (last_s - first_s) / passed
        late_s = sorted(time_s - first_s - (k - first) * interval_s for k, time_s in frames)
        is_chance = abs(interval_s - self.interval_s) * passed < _CHANCE * _least_late(late_s, half)
        if not is_chance and late_s[0] >= -_JITTER * interval_s:
            self.interval_s = interval_s

    def _earliest(self, frames: list[tuple[int, float]]) -> tuple[int, float]:
        """Return the frame that is the least late."""
        return min(frames, key=lambda frame: frame[1] - frame[0] * self.interval_s)

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
        if abs(median(gaps) / self.interval_s - 1) <= _RATE_TOLERANCE:
            return True
        agreed = _agreed(gaps)
        self.interval_s = agreed or self.interval_s
        return agreed is not None

    def phase(self, now_s: float) -> float:
        """Return the time since the end of the last frame's slot, in slots."""
        return (now_s - self.time_s) / self.interval_s + self.late

    def time_of(self, phase: float) -> float:
        """Return the time that is `phase` slots after the end of the last frame's slot, s."""
        return self.time_s + (phase - self.late) * self.interval_s

    def upcoming(self, now_s: float) -> int:
        """Return the number of the first slot that has not begun at `now_s`.

        Raises:
            ValueError: no frame was added yet
        """
        if self.number is None:
            raise ValueError("a frame clock needs a frame before it knows the current slot")
        return self.number + max(1, math.ceil(self.phase(now_s))) + 1


def _least_late(lates: Sequence[float], count: int) -> float:
    """Return how late the earliest of so many timestamps is, about, where others are as `lates`.

    Of m timestamps, of which half are late by more than u, it is late by about 2 u / m.
    """
    return 2 * median(lates) / count


def _agreed(gaps_s: Sequence[float]) -> float | None:
    """Return the median of gaps between timestamps that are all alike, else None."""
    usual_s = median(gaps_s)
    if usual_s <= 0 or any(abs(gap_s / usual_s - 1) > _GAP_TOLERANCE for gap_s in gaps_s):
        return None
    return usual_s


def _passed(position: float, counted: int) -> int:
    """Return how many slots passed from a frame to the next.

    Args:
        position: of the next one's timestamp after the end of the slot of the first, slots
        counted: by the sequence numbers; 0 where that is unknown
    """
    if counted and position - counted <= _LATEST_COUNTED:
        return counted
    return max(1, math.floor(position + _EARLIEST), counted)


class TimestampedSource(Protocol[DataT_co]):
    """A running stream whose frames have timestamps: what a driver gives to `TimestampedStream`."""

    def grab(self) -> float:
        """Wait for the next frame and return the time at which its exposure ended, s.

        Raises:
            CameraTimeoutError: no frame arrived within the time-out of the stream
        """

    def retrieve(self) -> DataT_co | None:
        """Return the frame that was grabbed last; None where it is damaged."""

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the exposure and return it as read back.

        Raises:
            RefusedSettingError: the device applied another setting
        """


class TimestampedStream(Generic[DataT]):
    """Makes a `camctl.streaming.NumberedSource` of a stream with timestamps.

    Args:
        source: the running stream
        clock: on which its timestamps are
        interval_s: time from frame to frame as announced, s
        sequence: the driver's number of the frame grabbed last, where the stream has such numbers
        stated: the exposure that the camera states of a frame, see `FrameStamp.applied`

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
        stated: Callable[[DataT], ExposureSetting | None] | None = None,
    ) -> None:
        self._source = source
        self._stated = stated
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
        stamp = self.frame_clock.add(self._source.grab(), self._sequence())
        frame = None if self._stated is None else self._source.retrieve()
        if self._stated is None or frame is None:
            return stamp
        return replace(stamp, applied=self._stated(frame))

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
