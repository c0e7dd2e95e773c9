"""Slot numbers from timestamps, and the time at which settings are written."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import CameraProtocolError
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureSetting
from camctl.streaming import FrameClock, FrameStamp, TimestampedStream

INTERVAL_S = 0.125


def started(*times_s: float) -> FrameClock:
    clock = FrameClock(INTERVAL_S)
    for time_s in times_s:
        clock.add(time_s)
    return clock


@given(
    st.lists(st.integers(1, 2), min_size=1, max_size=40),
    st.lists(st.floats(-0.05, 0.25), min_size=40, max_size=40),
)
def test_numbers_follow_the_timestamps_over_lost_frames(
    gaps: list[int], jitter: list[float]
) -> None:
    """Every other frame may be lost, and timestamps are late by up to a quarter of an interval."""
    clock = started(0.0)
    slot = 0
    for gap, shift in zip(gaps, jitter, strict=False):
        slot += gap
        stamp = clock.add((slot + shift) * INTERVAL_S)
        assert stamp.number == slot
        assert stamp.is_certain
    assert clock.number == slot


@pytest.mark.parametrize(
    ("gap", "number", "is_certain"),
    [
        *((1.0, 1, True), (1.3, 1, True), (1.5, 1, False), (1.8, 1, False), (1.95, 2, True)),
        *((2.3, 2, True), (0.8, 1, False), (0.1, 1, False)),
    ],
)
def test_gap_that_is_no_whole_number_of_intervals_is_uncertain(
    gap: float, number: int, is_certain: bool
) -> None:
    clock = started(0.0)
    assert clock.add(gap * INTERVAL_S) == FrameStamp(number, gap * INTERVAL_S, is_certain)


def test_first_frame_is_uncertain() -> None:
    assert FrameClock(INTERVAL_S).add(5.0) == FrameStamp(0, 5.0, is_certain=False)


@pytest.mark.parametrize(
    ("late", "count", "expected_s"),
    [(0.0, 11, INTERVAL_S), (0.0, 12, 0.13), (0.2, 12, 0.13), (0.2, 32, 0.13)],
)
def test_interval_is_measured_from_the_earliest_frames(
    late: float, count: int, expected_s: float
) -> None:
    """Two of three timestamps are late by up to `late` intervals, and frames are counted."""
    clock = FrameClock(INTERVAL_S)
    for index in range(count):
        clock.add((index + late * (index % 3) / 2) * 0.13, index)
    assert clock.interval_s == pytest.approx(expected_s)


def test_another_rate_is_noticed() -> None:
    clock = started(*(index * INTERVAL_S for index in range(8)))
    stamps = [clock.add((7 + index * 0.5) * INTERVAL_S) for index in range(1, 9)]
    assert clock.interval_s == pytest.approx(INTERVAL_S / 2)
    assert [stamp.is_certain for stamp in stamps] == [False] * 4 + [True] * 4


@pytest.mark.parametrize("late", [0.0, 0.3, 0.6])
def test_a_late_timestamp_does_not_move_the_slots(late: float) -> None:
    """The last of six frames was late; settings are written as if it had not been."""
    clock = FrameClock(INTERVAL_S)
    for index in range(6):
        stamp = clock.add((index + late * (index == 5)) * INTERVAL_S, index)
    assert stamp == FrameStamp(5, (5 + late) * INTERVAL_S)
    assert clock.late == pytest.approx(late)
    now_s = 5.95 * INTERVAL_S
    assert clock.phase(now_s) == pytest.approx(0.95)
    assert clock.time_of(0.95) == pytest.approx(now_s)
    assert (clock.upcoming(now_s), clock.upcoming(now_s + 0.1 * INTERVAL_S)) == (7, 8)


@pytest.mark.parametrize(
    ("times_s", "interval_s"),
    [
        ([0, 0.13, 0.26, 0.39], INTERVAL_S),  # as announced, within 10 %
        ([0, 0.25, 0.5, 0.75], 0.25),  # another rate
        ([0, 0.25, 0.5, 0.9], None),  # irregular
        ([0, 0, 0, 0], None),
    ],
    ids=["announced", "other", "irregular", "constant"],
)
def test_estimated_interval(times_s: list[float], interval_s: float | None) -> None:
    clock = FrameClock(INTERVAL_S)
    assert clock.estimate_interval(times_s) == (interval_s is not None)
    assert clock.interval_s == (interval_s or INTERVAL_S)


@pytest.mark.parametrize(("phase", "upcoming"), [(0.0, 2), (0.4, 2), (1.0, 2), (1.1, 3), (7.5, 9)])
def test_first_slot_that_has_not_begun(phase: float, upcoming: int) -> None:
    """The last frame was that of slot 0: slot 1 is being exposed up to a phase of 1."""
    clock = started(0.0)
    assert clock.upcoming(clock.time_of(phase)) == upcoming
    assert clock.phase(clock.time_of(phase)) == phase


def test_current_slot_is_unknown_before_the_first_frame() -> None:
    with pytest.raises(ValueError, match="needs a frame"):
        FrameClock(INTERVAL_S).upcoming(0.0)


class Regular:
    """Frames at whole intervals, which arrive `lateness` intervals after their timestamps.

    Writing a setting takes `write_s`.
    """

    def __init__(self, lateness: float = 0.0, write_s: float = 0.0) -> None:
        self.clock = VirtualClock()
        self._lateness, self._write_s = lateness, write_s
        self._frame = 0
        self.written_at: list[float] = []  # phase of each write

    def grab(self) -> float:
        self._frame += 1
        end_s = self._frame * INTERVAL_S
        self.clock.sleep_until(end_s + self._lateness * INTERVAL_S)
        return end_s

    def retrieve(self) -> int:
        return self._frame

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self.written_at.append(self.clock.now() / INTERVAL_S - self._frame)
        self.clock.sleep_until(self.clock.now() + self._write_s)
        return setting


def stream_of(source: Regular) -> TimestampedStream[int]:
    stream = TimestampedStream[int](source, source.clock, INTERVAL_S)
    stream.start()
    return stream


@pytest.mark.parametrize(
    ("lateness", "begin", "end"),
    [
        (0.0, 0.0, 0.5),
        (0.25, 0.25, 0.5),
        (0.5, 0.5, 0.75),
        (0.75, 0.75, 0.95),
        (0.9, 1.03, 1.5),  # too late for this slot: written in the next
        (1.25, 1.25, 1.5),
    ],
)
def test_settings_are_written_in_a_part_of_the_slot(
    lateness: float, begin: float, end: float
) -> None:
    source = Regular(lateness)
    stream = stream_of(source)
    running = 1 + int(begin)  # number of the slot after the last frame that is exposed meanwhile
    last = stream.next_frame().number
    assert stream.upcoming() == last + running + 1
    assert source.clock.now() / INTERVAL_S - 6 == pytest.approx(begin)
    assert stream.upcoming(late=True) == last + running + 1
    assert source.clock.now() / INTERVAL_S - 6 == pytest.approx(max(0.95 * end, begin))
    source.clock.sleep_until((6 + end + 0.01) * INTERVAL_S)
    assert stream.upcoming() is None


@pytest.mark.parametrize(("write", "slots"), [(0.0, 1), (0.7, 1), (0.8, 2), (1.8, 3)])
def test_slot_of_a_slow_write_is_uncertain(write: float, slots: int) -> None:
    """`write` is how long a write takes, in slots; it begins at the start of a slot."""
    source = Regular(write_s=write * INTERVAL_S)
    stream = stream_of(source)
    last = stream.next_frame().number
    written = stream.write(ExposureSetting(1.0))
    assert written.first == last + 2
    assert written.last - written.first == slots - 1


@pytest.mark.parametrize(
    ("shift_s", "message"),
    [(1.7e9, "not on the system's monotonic clock"), (None, "arrive at irregular times")],
)
def test_unusable_timestamps(shift_s: float | None, message: str) -> None:
    class Unusable(Regular):
        def grab(self) -> float:
            end_s = super().grab()
            return 0.0 if shift_s is None else end_s + shift_s

    with pytest.raises(CameraProtocolError, match=message):
        stream_of(Unusable())
