"""Timestamps that are late on a busy computer, lost frames, and no frame of a wrong exposure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from random import Random

import pytest
from sampling import some

from camctl.errors import CameraProtocolError
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureSetting
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposurePipeline,
    FrameClock,
    FrameStamp,
    TimestampedStream,
)

INTERVAL_S = 0.1
#: Frames that wait for the consumer at most, and how long a write takes at most, slots.
BUFFERS, WRITE = 8, 0.1
#: Share of the frames that the driver loses, and of those that the camera does not send.
LOST, UNSENT = 0.05, 0.05
#: Settings of a capture, and pauses within it and after it, slots.
SETTINGS, PAUSE, LONG_PAUSE = 8, 0.6, 5.0


@dataclass(frozen=True)
class Arrived:
    """A frame: its timestamp, the driver's number of it, and the exposure time that it had."""

    stamp_s: float
    sequence: int
    time_s: float


class Camera:
    """A source of frames whose timestamps are late by `late` slots; frames are lost at random."""

    def __init__(self, random: Random, delay: int, late: Callable[[], float]) -> None:
        self.clock = VirtualClock(1000.0)
        self.last = Arrived(self.clock.now(), 0, 1.0)
        self._random, self._delay, self._late = random, delay, late
        self._slot, self._begin_s = 0, self.clock.now()
        self._time_s, self._stamp_s = 1.0, 0.0
        self._writes: deque[tuple[int, float]] = deque()  # first slot that has it, exposure time
        self._sequence = 0
        self._arrived: deque[Arrived] = deque()

    def wait(self, slots: float) -> None:
        self.clock.sleep_until(self.clock.now() + slots * INTERVAL_S)
        self._advance()

    def grab(self) -> float:
        self._advance()
        while not self._arrived:
            self.clock.sleep_until(self._begin_s + INTERVAL_S)
            self._advance()
        self.last = self._arrived.popleft()
        self.clock.sleep_until(self.last.stamp_s)
        return self.last.stamp_s

    def retrieve(self) -> float:
        return self.last.time_s

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self.wait(self._random.random() * WRITE / 2)
        self._writes.append((self._slot + 1 + self._delay, setting.time_s))
        self.wait(self._random.random() * WRITE / 2)
        return setting

    def _advance(self) -> None:
        while self._begin_s + INTERVAL_S <= self.clock.now():
            self._end_slot()

    def _end_slot(self) -> None:
        while self._writes and self._writes[0][0] <= self._slot:
            self._time_s = self._writes.popleft()[1]
        self._slot += 1
        self._begin_s += INTERVAL_S
        fate = self._random.random()
        self._sequence += fate >= UNSENT
        if fate >= UNSENT + LOST and len(self._arrived) < BUFFERS:
            # Frames arrive in order, in bursts after one that is late by more than a slot.
            stamp_s = max(self._begin_s + self._late() * INTERVAL_S, self._stamp_s + 1e-4)
            self._stamp_s = stamp_s
            self._arrived.append(Arrived(stamp_s, self._sequence, self._time_s))


def wrong_captures(seed: int, captures: int, share: float, late: float) -> tuple[int, int]:
    """Return how many captures have a frame of a wrong exposure, and how many are refused.

    A share of the timestamps is late by up to `late` slots, the others by up to 0.02.
    """
    random = Random(seed)
    delay = random.randrange(4)
    camera = Camera(
        random, delay, lambda: random.random() * (late if random.random() < share else 0.02)
    )
    stream = TimestampedStream[float](
        camera, camera.clock, INTERVAL_S, sequence=lambda: camera.last.sequence
    )
    stream.start()
    pipeline = ExposurePipeline(stream, ControlDelay(delay, delay, DelayOrigin.GUARANTEED))
    wrong = refused = 0
    for _ in range(captures):
        times_s = [float(random.randint(1, 9)) for _ in range(SETTINGS)]
        taken = []
        try:
            for shot in pipeline.shoot([ExposureSetting(time_s) for time_s in times_s]):
                taken.append(shot.data)
                camera.wait(random.random() * PAUSE)
        except CameraProtocolError:
            refused += 1
        wrong += taken != times_s[: len(taken)]
        camera.wait(random.random() * LONG_PAUSE)
    return wrong, refused


def totals(seeds: int, share: float, late: float) -> tuple[int, int]:
    """Return `wrong_captures` of 50 captures with each of these seeds."""
    counts = [wrong_captures(seed, 50, share, late) for seed in range(seeds)]
    return sum(wrong for wrong, _ in counts), sum(refused for _, refused in counts)


@pytest.mark.parametrize(("share", "late"), some([(0.02, 3.0), (0.2, 0.6), (0.5, 0.6)], every=3))
def test_no_frame_has_a_wrong_exposure(share: float, late: float) -> None:
    """A clock that leaps makes timestamps late by whole slots: as if frames were not sent."""
    assert totals(16, share, late) == (0, 0)


def test_no_frame_has_a_wrong_exposure_where_every_timestamp_is_late() -> None:
    """By chance they look like those of another rate, by which others would be early."""
    wrong, refused = totals(16, 1.0, 0.6)
    assert wrong == 0
    assert refused <= 0.02 * 16 * 50


@pytest.mark.slow
def test_no_frame_of_10000_captures_has_a_wrong_exposure() -> None:
    shares = (0.1, 0.2, 0.35, 0.5)
    assert {share: totals(50, share, 0.6) for share in shares} == dict.fromkeys(shares, (0, 0))


@pytest.mark.parametrize("error", [-0.002, 0.0, 0.002])
@pytest.mark.parametrize("period", [0.456, 0.6])
def test_frames_of_a_program_that_looks_every_so_often_are_numbered(
    period: float, error: float
) -> None:
    """Times are those at which it looked; one frame in ten is lost, and none is numbered wrong."""
    chance = Random(1)
    clock = FrameClock(1 + error)
    slots: list[int] = []
    stamps: list[FrameStamp] = []
    for slot in range(1000):
        if chance.random() > 0.1:
            slots.append(slot)
            stamps.append(clock.add(math.ceil((slot + 0.3) / period) * period))
    pairs = zip(pairwise(slots), pairwise(stamps), strict=True)
    right = [
        stamp.number - before.number == after - first
        for (first, after), (before, stamp) in pairs
        if stamp.is_certain
    ]
    assert all(right)
    assert len(right) > len(slots) / 2
