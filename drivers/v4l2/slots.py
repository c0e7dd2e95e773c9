"""Frame slots, numbered by the timestamps of the frames and never by counting reads.

A camera that keeps its frame rate divides time into slots of one interval.  The frame of slot k
ends at its timestamp; slot k + 1 is exposed from then on.  What was lost or thrown away leaves a
gap between timestamps, and the numbers go on after it as if it had been seen.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from statistics import median

#: A gap between timestamps that differs from whole intervals by more tells no number.
SURE = 0.35
#: A rate that differs by more is another.
OTHER_RATE = 0.1
_GAPS = 15


class Slots:
    """The slots of one stream.

    Args:
        interval_s: time from frame to frame as the camera announces it, s

    Attributes:
        interval_s: the same as the frames show it
        number: of the frame seen last; None before the first
        time_s: its timestamp

    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self.number: int | None = None
        self.time_s = -math.inf
        self._gaps: deque[float] = deque(maxlen=_GAPS)

    def see(self, time_s: float) -> bool:
        """Take a frame's timestamp; False where it cannot be told how many slots have passed."""
        last, self.time_s = self.time_s, time_s
        if self.number is None:
            self.number = 0
            return False
        gap = (time_s - last) / self.interval_s
        passed = max(1, round(gap))
        self.number += passed
        is_sure = abs(gap - passed) <= SURE
        if is_sure:
            self._gaps.append((time_s - last) / passed)
            # A few gaps are no measurement where frames come in bursts.
            if len(self._gaps) >= 5:
                self.interval_s = median(self._gaps)
        return is_sure

    def learn(self, times_s: list[float]) -> bool:
        """Take the interval from a run of timestamps; False where they do not tell it.

        The announced one stays where the usual gap is like it: it is the more precise.  Another
        is believed only where all gaps agree: a camera that has just begun may hurry or stumble.
        """
        gaps = [after - before for before, after in pairwise(times_s)]
        usual = median(gaps)
        if abs(usual / self.interval_s - 1) <= OTHER_RATE:
            return True
        if usual <= 0 or _share(gaps, usual, OTHER_RATE) < 1:
            return False
        self.interval_s = usual
        return True

    def phase(self, now_s: float) -> float:
        """Return how much of the slot after the frame seen last is over; above 1: all of it."""
        return (now_s - self.time_s) / self.interval_s

    def at(self, phase: float) -> float:
        """Return the time at which `phase` comes, s."""
        return self.time_s + phase * self.interval_s

    def running(self, now_s: float) -> int:
        """Return the number of the slot that is exposed at `now_s`, not before the last frame."""
        assert self.number is not None
        return self.number + max(1, math.ceil(self.phase(now_s)))


def _share(gaps: list[float], interval_s: float, tolerance: float) -> float:
    """Return the share of gaps that differ from an interval by at most so much of it."""
    return sum(abs(gap / interval_s - 1) <= tolerance for gap in gaps) / len(gaps)
