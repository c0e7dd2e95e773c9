"""Which exposure a frame has: settings that take effect late, and the sequencer's sets."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Exposure:
    """Exposure time, us, and gain, dB, as the registers hold them."""

    time_us: float
    gain_db: float

    @property
    def time_s(self) -> float:
        """Exposure time, s."""
        return self.time_us / 1e6

    @property
    def gain(self) -> float:
        """Linear gain."""
        return float(10 ** (self.gain_db / 20))


class DelayedSettings:
    """Settings that take effect some slots after they were written.

    Args:
        setting: in force at first
        delay: slots; 0: the first slot that has not begun has it; -1: the running one has it
        gain_delay: of the gain
        jitter: up to so many more, at random
        seed: of the jitter
    """

    def __init__(
        self, setting: Exposure, delay: int, gain_delay: int, jitter: int, seed: int
    ) -> None:
        self._now = setting
        self._pending: tuple[deque[tuple[int, Exposure]], ...] = (deque(), deque())
        self._random = random.Random(seed)
        self.delays, self.jitter = (delay, gain_delay), jitter

    def write(self, setting: Exposure, upcoming: int) -> None:
        """Set what follows; `upcoming` is the first slot that has not begun."""
        more = self._random.randint(0, self.jitter)
        for pending, delay in zip(self._pending, self.delays, strict=True):
            pending.append((upcoming + delay + more, setting))

    def at(self, slot: int) -> Exposure:
        """Return the setting of a slot; slots must be asked for in their order."""
        times, gains = self._pending
        while times and times[0][0] <= slot:
            self._now = replace(self._now, time_us=times.popleft()[1].time_us)
        while gains and gains[0][0] <= slot:
            self._now = replace(self._now, gain_db=gains.popleft()[1].gain_db)
        return self._now


@dataclass(frozen=True)
class SequencerSet:
    """A set of the sequencer: its exposure, and the set that follows it."""

    exposure: Exposure
    following: int


class Sequencer:
    """The sets of a sequencer, and which of them is active.

    Args:
        count: of sets
        exposure: of all sets at first
        lead: frames at the start that do not count
    """

    def __init__(self, count: int, exposure: Exposure, lead: int) -> None:
        self.sets = [SequencerSet(exposure, 0) for _ in range(count)]
        self._lead = lead
        self._waiting = 0
        self.active = 0

    def start(self, first: int) -> None:
        """Begin with a set."""
        self.active, self._waiting = first, self._lead

    def advance(self) -> None:
        """Go on to the next set, after a frame."""
        if self._waiting:
            self._waiting -= 1
        else:
            self.active = self.sets[self.active].following
