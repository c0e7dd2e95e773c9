"""The last frame of each exposure of a cycle, and their running sum: S += new - old.

The frame of a slot stays until the next one of its exposure arrives: where that was lost, it is
older than a round of the cycle, and marked.  When a list of exposures is exchanged, each frame of
the new list takes the place of one of the old; those that are left go with the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CaptureError
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.pictures.accumulator import Accumulator

OLDEST = "age_s"
"""In the details of a frame that was made of several: how much older the oldest of them is, s."""


@dataclass(frozen=True)
class SlotState:
    """One exposure of a result.

    Attributes:
        setting: as applied
        exposure: its true exposure, in the unit of `ExposureSetting.exposure`
        timestamp_s: when the exposure ended, on the camera's clock, s
        age_s: how much earlier it, or the first of which it was made, ended than the newest one, s
        number: of its slot in the stream
        is_old: whether it is of an earlier round of the cycle: newer frames of it were lost
        plan: number of the list that it belongs to
    """

    setting: ExposureSetting
    exposure: float
    timestamp_s: float
    age_s: float
    number: int
    is_old: bool
    plan: int


class Window:
    """The frames of the last round of a cycle.

    Args:
        controls: of the camera

    Attributes:
        is_complete: whether there is a frame of each exposure
        newest: the last frame
    """

    def __init__(self, controls: ExposureControls) -> None:
        self._black, self._white = controls.black, controls.white
        colours = (3,) if controls.layout is Layout.RGB else ()
        dtype: np.dtype[np.unsignedinteger] = np.dtype(
            np.uint8 if controls.bits <= 8 else np.uint16
        )
        self._sum = Accumulator((*controls.shape, *colours), dtype, 1, controls.white)
        self.clear()

    def clear(self) -> None:
        """Begin anew: the frames that are there no longer count."""
        self._frames: list[Frame | None] = []
        self._plan: int | None = None
        self._missing: set[int] = set()
        self.is_complete = False
        self.newest: Frame | None = None
        self._sum.total[:] = 0

    @property
    def total(self) -> NDArray[np.unsignedinteger]:
        """The sum of `min(frame, white)` of `frames`, black included."""
        return self._sum.total

    @property
    def frames(self) -> list[Frame]:
        """The last frame of each exposure; those that a new list lacks follow at the end."""
        return [frame for frame in self._frames if frame is not None]

    def add(self, frame: Frame, count: int) -> None:
        """Put a frame in the place of the last one of its exposure.

        Args:
            frame: of a cycle
            count: length of its list

        Raises:
            CaptureError: its format differs from the others
        """
        assert frame.place is not None  # a frame of a cycle has one
        if frame.place.plan != self._plan:
            self._plan = frame.place.plan
            self._missing = set(range(count))
            self._extend(count)
        self.put(frame, frame.index)
        self._missing.discard(frame.index)
        if not self._missing:
            for place in range(count, len(self._frames)):
                self._exchange(place, None)
            del self._frames[count:]
            self._sum.fit(count)
            self.is_complete = True

    def put(self, frame: Frame, place: int) -> None:
        """Put a frame in a place, the next one at most; raises as `add` does."""
        if (frame.black, frame.white) != (self._black, self._white):
            raise CaptureError(
                f"the camera changed its black and white level to {frame.black} and {frame.white}",
                hint="keep gain and format fixed",
            )
        self._extend(place + 1)
        self._exchange(place, frame)
        self.newest = frame

    def _extend(self, count: int) -> None:
        """Have places for `count` frames at least, and a sum that holds them."""
        if count > len(self._frames):
            self._frames += [None] * (count - len(self._frames))
            self._sum.fit(count)

    def _exchange(self, place: int, new: Frame | None) -> None:
        old, self._frames[place] = self._frames[place], new
        if new is not None and old is not None:
            self._sum.exchange(old.pixels, new.pixels)
        elif new is not None:
            self._sum.accumulate(new.pixels)
        elif old is not None:
            self._sum.withdraw(old.pixels)

    def states(self, controls: ExposureControls) -> tuple[SlotState, ...]:
        """Return the exposures of `frames`, in their order."""
        assert self.newest is not None
        assert self.newest.place is not None
        last, frames = self.newest.place.number, self.frames
        return tuple(
            SlotState(
                setting=frame.applied,
                exposure=controls.exposure(frame.applied),
                timestamp_s=frame.timestamp_s,
                age_s=self.newest.timestamp_s - frame.timestamp_s + frame.details.get(OLDEST, 0.0),
                number=frame.place.number,
                is_old=last - frame.place.number >= len(frames),
                plan=frame.place.plan,
            )
            for frame in frames
            if frame.place is not None
        )
