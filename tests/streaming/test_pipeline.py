"""The control-delay pipeline on a source with exact slot numbers: no frame of a wrong exposure."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import CameraProtocolError, CameraTimeoutError, RefusedSettingError
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
    resting_setting,
)
from camctl.profiles.profile import DelayRecord
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposurePipeline,
    FrameStamp,
    Written,
)

POWER_ON_S = 0.5


class Numbered:
    """A stream with sequence numbers; a frame is the exposure time that it had.

    Args:
        delay: control delay by the number of the write
        lost: frames that never arrive
        uncertain: frames whose number is not certain
        damaged: frames that cannot be read
        refused: exposure times that the device does not accept
        slow: numbers of the writes that may have ended in the next slot
    """

    def __init__(
        self,
        delay: Callable[[int], int],
        *,
        lost: frozenset[int] = frozenset(),
        uncertain: frozenset[int] = frozenset(),
        damaged: frozenset[int] = frozenset(),
        refused: frozenset[float] = frozenset(),
        slow: frozenset[int] = frozenset(),
    ) -> None:
        self._delay = delay
        self._lost, self._uncertain, self._damaged = lost, uncertain, damaged
        self._refused, self._slow = refused, slow
        self.slot = 0  # the next to be exposed
        self.writes: list[int] = []  # the slot before which each write took place
        self._pending: list[tuple[int, float]] = []
        self._time_s = POWER_ON_S
        self.frames = 0  # that arrived

    def next_frame(self) -> FrameStamp:
        while True:
            for first, time_s in self._pending:
                if first == self.slot:
                    self._time_s = time_s
            number, self.slot = self.slot, self.slot + 1
            self._number = number
            if number not in self._lost:
                self.frames += 1
                return FrameStamp(number, float(number), number not in self._uncertain)
            if number > 10_000:
                raise CameraTimeoutError("no frame arrives", hint="stop the test")

    def read(self) -> float | None:
        return None if self._number in self._damaged else self._time_s

    def upcoming(self, *, late: bool = False) -> int:
        return self.slot

    def write(self, setting: ExposureSetting) -> Written:
        number = len(self.writes)
        self.writes.append(self.slot)
        in_force = self.slot + self._delay(number)
        if setting.time_s in self._refused:
            # The device applies something, which nobody knows.
            self._pending.append((in_force, -1.0))
            raise RefusedSettingError("time_s", setting.time_s, 1.0)
        is_late = number in self._slow
        self._pending.append((in_force + is_late, setting.time_s))
        return Written(setting, self.slot, self.slot + is_late)


def constant(delay: int) -> ControlDelay:
    return ControlDelay(delay, delay, DelayOrigin.GUARANTEED)


def settings_of(times_s: list[float]) -> list[ExposureSetting]:
    return [ExposureSetting(time_s) for time_s in times_s]


def pipeline(source: Numbered, delay: ControlDelay) -> ExposurePipeline[float]:
    return ExposurePipeline(source, delay, brightness=lambda time_s: time_s)


times = st.lists(st.integers(1, 9).map(float), min_size=1, max_size=12)
slots = st.frozensets(st.integers(0, 60), max_size=12)


@given(times, st.integers(0, 6))
def test_n_settings_take_n_plus_d_frames(times_s: list[float], delay: int) -> None:
    source = Numbered(lambda _: delay)
    shots = list(pipeline(source, constant(delay)).shoot(settings_of(times_s)))
    assert [shot.data for shot in shots] == times_s
    assert [shot.applied for shot in shots] == settings_of(times_s)
    assert [shot.index for shot in shots] == list(range(len(times_s)))
    assert [shot.time_s for shot in shots] == [float(delay + i) for i in range(len(times_s))]
    assert source.frames == len(times_s) + delay
    assert source.writes == list(range(len(times_s)))


@pytest.mark.parametrize(
    "delay", [constant(0), constant(3), ControlDelay(3, 3), ControlDelay(1, 3)], ids=str
)
def test_the_next_list_waits_for_no_long_frames(delay: ControlDelay) -> None:
    """The stream goes on with a short time after a list that ended with the longest one."""
    source = Numbered(lambda _: delay.largest)
    shooting = pipeline(source, delay).shoot(settings_of([1.0, 5.0, 60.0]), ExposureSetting(1.0))
    assert [shot.data for shot in shooting] == [1, 5, 60]
    again = [source.next_frame() and source.read() for _ in range(delay.largest + 3)]
    longest = 0 if delay.frames is not None else delay.largest + 1
    assert again[longest:] == [1.0] * (len(again) - longest)


@given(times, st.integers(0, 6))
def test_the_stream_rests_after_the_last_setting_at_no_cost(
    times_s: list[float], delay: int
) -> None:
    source = Numbered(lambda _: delay)
    rest = ExposureSetting(0.25)
    shots = list(pipeline(source, constant(delay)).shoot(settings_of(times_s), rest))
    assert [shot.data for shot in shots] == times_s
    assert source.frames == len(times_s) + delay
    # It is written in the slot after that of the last setting, and in force in the next frames;
    # without a delay there is a frame between.
    source.next_frame()
    if delay == 0:
        source.next_frame()
    assert source.read() == rest.time_s


def test_a_stream_rests_only_after_frames_longer_than_its_interval() -> None:
    controls = ExposureControls(
        Steps(0.001, 60.0),
        (4, 4),
        Layout.MONO,
        8,
        white=255,
        frame_interval_s=0.04,
        response_origin=ResponseOrigin.STATED,
    )
    assert resting_setting(controls, []) is None
    assert resting_setting(controls, settings_of([2.0, 0.04])) is None
    assert resting_setting(controls, settings_of([0.01, 2.0])) == ExposureSetting(0.02)


@given(
    times,
    st.integers(0, 4),
    slots,
    slots,
    slots,
    st.frozensets(st.integers(0, 40), max_size=6),
)
def test_every_setting_has_its_frame_in_spite_of_faults(
    times_s: list[float],
    delay: int,
    lost: frozenset[int],
    uncertain: frozenset[int],
    damaged: frozenset[int],
    slow: frozenset[int],
) -> None:
    source = Numbered(lambda _: delay, lost=lost, uncertain=uncertain, damaged=damaged, slow=slow)
    shots = list(pipeline(source, constant(delay)).shoot(settings_of(times_s)))
    assert [shot.data for shot in shots] == times_s
    assert [shot.index for shot in shots] == list(range(len(times_s)))


@given(times, st.integers(0, 3), st.integers(1, 4), st.randoms(use_true_random=False))
def test_guaranteed_varying_delay_takes_the_largest_for_each_setting(
    times_s: list[float], smallest: int, range_: int, random: Random
) -> None:
    largest = smallest + range_
    source = Numbered(lambda _: random.randint(smallest, largest))
    delay = ControlDelay(smallest, largest, DelayOrigin.GUARANTEED)
    shots = list(pipeline(source, delay).shoot(settings_of(times_s)))
    assert [shot.data for shot in shots] == times_s
    assert source.frames == len(times_s) * (largest + 1)


@given(times, st.integers(0, 6))
def test_unknown_delay_settles_until_two_frames_agree(times_s: list[float], delay: int) -> None:
    source = Numbered(lambda _: delay)
    unknown = ControlDelay.from_record(None)
    shots = list(pipeline(source, unknown).shoot(settings_of(times_s)))
    assert [shot.data for shot in shots] == times_s
    assert source.frames == len(times_s) * (unknown.largest + 2)


def test_measured_delay_that_is_too_small_is_noticed_while_settling() -> None:
    """The exposure changes after the largest delay that was measured; two frames then differ."""
    source = Numbered(lambda _: 4)
    delay = ControlDelay(1, 3)
    shots = list(pipeline(source, delay).shoot(settings_of([2.0, 4.0, 8.0])))
    assert [shot.data for shot in shots] == [2.0, 4.0, 8.0]


@pytest.mark.parametrize("place", range(4))
def test_frames_before_a_refused_setting_are_yielded(place: int) -> None:
    times_s = [2.0, 3.0, 4.0]
    source = Numbered(lambda _: 2, refused=frozenset({9.0}))
    shots = pipeline(source, constant(2)).shoot(
        settings_of([*times_s[:place], 9.0, *times_s[place:]])
    )
    data = [next(shots).data for _ in range(place)]
    assert data == times_s[:place]
    with pytest.raises(RefusedSettingError):
        next(shots)


def test_stream_without_usable_frames_is_an_error() -> None:
    source = Numbered(lambda _: 1, damaged=frozenset(range(1000)))
    with pytest.raises(CameraProtocolError, match="frames are lost, damaged, or arrive"):
        list(pipeline(source, constant(1)).shoot(settings_of([1.0])))


@given(st.integers(0, 6), slots, st.frozensets(st.integers(0, 9), max_size=3))
def test_step_returns_consecutive_frames(
    delay: int, faulty: frozenset[int], slow: frozenset[int]
) -> None:
    source = Numbered(lambda _: delay, lost=faulty, slow=slow)
    shots = pipeline(source, ControlDelay.from_record(None)).step(
        ExposureSetting(2.0), ExposureSetting(4.0), 9
    )
    assert [shot.data for shot in shots] == [2.0] * delay + [4.0] * (9 - delay)
    numbers = [shot.time_s for shot in shots]
    assert numbers == [numbers[0] + index for index in range(9)]
    assert numbers[0] == source.writes[-1]


def test_step_settles_for_the_largest_guaranteed_delay() -> None:
    source = Numbered(lambda number: (9, 1)[number % 2])
    delay = ControlDelay(1, 9, DelayOrigin.GUARANTEED)
    shots = pipeline(source, delay).step(ExposureSetting(2.0), ExposureSetting(4.0), 2)
    assert [shot.data for shot in shots] == [2.0, 4.0]
    assert source.writes == [0, 10]


def test_step_is_not_possible_if_frames_are_always_lost() -> None:
    source = Numbered(lambda _: 1, lost=frozenset(range(0, 9000, 3)))
    with pytest.raises(CameraProtocolError, match="frames are lost, damaged, or arrive"):
        pipeline(source, constant(1)).step(ExposureSetting(2.0), ExposureSetting(4.0), 5)


def record(smallest: int, largest: int) -> DelayRecord:
    return DelayRecord(
        frames=smallest if smallest == largest else None,
        smallest=smallest,
        largest=largest,
        trials=12,
        measured_at="2026-01-01T00:00:00",
    )


@pytest.mark.parametrize(
    ("measured", "frames", "found"),
    [
        (record(2, 2), 2, []),
        (record(1, 3), None, [("delay_varies", 3.0, {})]),
        (None, None, [("delay_unknown", None, {"calibrate_delay": "mine:1"})]),
    ],
)
def test_delay_of_a_profile(
    measured: DelayRecord | None, frames: int | None, found: list[object]
) -> None:
    delay = ControlDelay.from_record(measured)
    assert delay.frames == frames
    findings = delay.findings("mine:1")
    assert [(each.code, each.value, each.remedies) for each in findings] == found


def test_brightness_is_needed_unless_the_delay_is_guaranteed() -> None:
    source = Numbered(lambda _: 1)
    with pytest.raises(ValueError, match="brightness is needed"):
        ExposurePipeline(source, ControlDelay(1, 1))
    assert ExposurePipeline(source, constant(1)) is not None
