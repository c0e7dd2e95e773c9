"""A stream with an exposure control, in virtual time, whose true exposures are known."""

from __future__ import annotations

from collections import deque
from random import Random

from camctl.errors import CameraTimeoutError
from camctl.interface.controls import ExposureSetting
from camctl.streaming import FrameStamp, Written


class CycleStream:
    """A `NumberedSource` whose frames are (number of the slot, exposure that it had).

    Args:
        delay: control delay, frames
        random: chooses what goes wrong
        lost, damaged, uncertain: share of the frames that do not arrive, cannot be read, or have a
            number that may be wrong
        missed: share of the slots in which the computer comes too late to write
        spanning: share of the writes that may have ended in the next slot, half of which have
        states: the exposure that the device states is that of the frame so many slots before; None:
            it states none
    """

    def __init__(
        self,
        delay: int,
        random: Random | None = None,
        *,
        lost: float = 0.0,
        damaged: float = 0.0,
        uncertain: float = 0.0,
        missed: float = 0.0,
        spanning: float = 0.0,
        states: int | None = None,
    ) -> None:
        self._delay, self._random = delay, random or Random(0)
        self._lost, self._damaged, self._uncertain = lost, damaged, uncertain
        self._missed, self._spanning, self._states = missed, spanning, states
        self._pending: deque[tuple[int, ExposureSetting]] = deque()
        self._past: deque[ExposureSetting] = deque([ExposureSetting(1.0)] * 4, maxlen=4)
        self.slot = 0  # the next to be exposed
        self._offset = 0  # by which numbers are wrong
        self._is_missed = False
        self.received = 0

    def next_frame(self) -> FrameStamp:
        for _ in range(10_000):
            while self._pending and self._pending[0][0] <= self.slot:
                self._past.append(self._pending.popleft()[1])
            exposed = self._past[-1]
            number, self.slot = self.slot, self.slot + 1
            self._is_missed = self._random.random() < self._missed
            self._frame = number, exposed
            self._shown = deque([*getattr(self, "_shown", [exposed] * 4), exposed], maxlen=4)
            if self._random.random() < self._lost:
                continue
            is_certain = self._random.random() >= self._uncertain
            if not is_certain:
                self._offset += self._random.randint(0, 1)
            self.received += 1
            stated = None if self._states is None else self._shown[-1 - self._states]
            return FrameStamp(number + self._offset, float(number), is_certain, stated)
        raise CameraTimeoutError("no frame arrives", hint="stop the test")

    def read(self) -> tuple[int, ExposureSetting] | None:
        return None if self._random.random() < self._damaged else self._frame

    def upcoming(self, *, late: bool = False) -> int | None:
        return None if self._is_missed else self.slot + self._offset

    def write(self, setting: ExposureSetting) -> Written:
        is_spanning = self._random.random() < self._spanning
        late = int(is_spanning and self._random.random() < 0.5)
        self._pending.append((self.slot + late + self._delay, setting))
        first = self.slot + self._offset
        return Written(setting, first, first + is_spanning)


def brightness(frame: tuple[int, ExposureSetting]) -> float:
    """Return the mean brightness of a frame: a linear camera before a steady scene."""
    return min(1.0, frame[1].exposure / 16)
