"""Endless streams over a list of exposures, set from the computer ahead of the control delay.

As in `camctl.streaming.pipeline` each setting that was written has a first slot that may have it
and a first one that must.  A frame belongs to a setting if its slot is not before the first slot
that must have it, and before the first one that may have the next.  What was lost is not taken
again: the stream goes on with the next setting.  Where the delay is not constant each setting is
written when the frame of the one before has settled, unless the camera states the exposure of each
frame and the pixels have agreed with that.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Generic, Self, TypeVar

from camctl.errors import CameraError
from camctl.interface.camera import CyclePlace, Frame
from camctl.interface.controls import ExposureControls, ExposureSetting, resting_setting
from camctl.interface.cycle import CycleMethod, check_not_empty
from camctl.streaming.control_delay import ASSUMED_LARGEST, ControlDelay, FrameStamp, NumberedSource
from camctl.streaming.pipeline import ExposurePipeline, Shot
from camctl.streaming.stated_exposures import StatedExposures, is_same

DataT = TypeVar("DataT")


@dataclass(frozen=True)
class _Write:
    """A setting that was written.

    Attributes:
        index, plan: its position in the list, and the number of the list
        requested: as in the list
        applied: as read back
        slot: last number that the first slot not begun at the write may have had
        earliest, latest: the first slot that may have the setting, and the first that must
    """

    index: int
    plan: int
    requested: ExposureSetting
    applied: ExposureSetting
    slot: int
    earliest: int
    latest: int


class ExposureCycle(Generic[DataT]):
    """Frames without end over a list of settings.

    Args:
        source: a running stream
        delay: of its exposure control
        brightness: mean brightness of a frame as a share of full scale, see `ExposurePipeline`
        settings: the list, not empty
    """

    def __init__(
        self,
        source: NumberedSource[DataT],
        delay: ControlDelay,
        brightness: Callable[[DataT], float] | None,
        settings: Sequence[ExposureSetting],
    ) -> None:
        check_not_empty(settings)
        self._source = StatedExposures.of(source, brightness)
        self._pipeline = ExposurePipeline(self._source, delay, brightness)
        self._bounds = self._delay = delay
        self._settings = tuple(settings)
        self._plan = self._last_plan = 0
        self._next_settings: tuple[ExposureSetting, ...] | None = None
        self._at = 0  # position of the next setting to be written
        self._writes: deque[_Write] = deque()
        self._has_begun = False
        self._mixed = (0, 0)  # slots that may have one control of a list and one of the list before
        self._lock = threading.Lock()
        self._delay = delay.over([*self._settings, self._settings[0]])

    @classmethod
    def of(cls, pipeline: ExposurePipeline[DataT], settings: Sequence[ExposureSetting]) -> Self:
        """Return an endless stream from the source of a pipeline, which is idle meanwhile."""
        source, brightness = pipeline.release()
        return cls(source, pipeline.delay, brightness, settings)

    @property
    def is_stated(self) -> bool:
        """Whether frames have the exposures that the camera states of them."""
        return self._source.are_believed

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        """Go on with another list after the present one; return its number."""
        check_not_empty(settings)
        with self._lock:
            self._next_settings = tuple(settings)
            self._last_plan += 1
            return self._last_plan

    @property
    def longest(self) -> ExposureSetting:
        """The setting with the longest time."""
        return max(self._settings, key=lambda setting: setting.time_s)

    def shots(self) -> Generator[tuple[Shot[DataT], ExposureSetting], None, None]:
        """Yield the frames whose exposure is known, and the setting in the list of each.

        Raises:
            RefusedSettingError: the device applied another setting
            CameraError: as the source raises
        """
        while True:
            settles = self._delay.frames is None and not self.is_stated
            shot = self._settled() if settles else self._next()
            if shot is not None:
                yield shot

    def rest(self, setting: ExposureSetting | None) -> None:
        """Write the setting in which the stream rests, if the device still takes it."""
        if setting is not None:
            with suppress(CameraError):
                self._source.write(setting)

    def _take_next_setting(self) -> tuple[int, ExposureSetting]:
        """Return the next setting and its position; at the end of a list another one begins."""
        with self._lock:
            if self._at == 0 and self._next_settings is not None:
                after, self._next_settings = self._next_settings, None
                self._delay = self._bounds.over([*after, after[0]])
                self._settings, self._plan = after, self._last_plan
            index = self._at
            self._at = (index + 1) % len(self._settings)
            return index, self._settings[index]

    def _settled(self) -> tuple[Shot[DataT], ExposureSetting]:
        index, setting = self._take_next_setting()
        self._writes.clear()
        shot = self._pipeline.settled(index, setting)
        return replace(shot, place=CyclePlace(self._source.number, self._plan)), setting

    def _next(self) -> tuple[Shot[DataT], ExposureSetting] | None:
        """Take one frame; return None where it is lost, or its exposure is not known."""
        self._write_next()
        stamp = self._source.next_frame()
        write = self._write_of(stamp)
        # The next setting is written before the frame is yielded: the caller may take long.
        self._write_next()
        if write is None:
            return None
        data = self._source.read()
        if data is None:
            return None
        place = CyclePlace(stamp.number, write.plan)
        applied = self._source.applied(stamp, write.applied)
        return Shot(write.index, applied, stamp.time_s, data, place), write.requested

    def _write_of(self, stamp: FrameStamp) -> _Write | None:
        """Return the write whose setting a frame has; None: that is not certain."""
        if (stated := self._source.believed(stamp)) is not None:
            return self._write_stated(stamp.number, stated)
        writes = self._writes
        if not stamp.is_certain:
            writes.clear()
            return None
        while len(writes) > 1 and writes[1].latest <= stamp.number:
            writes.popleft()
        if not writes or stamp.number < writes[0].latest:
            return None
        if self._mixed[0] <= stamp.number < self._mixed[1]:
            return None
        is_ambiguous = len(writes) > 1 and writes[1].earliest <= stamp.number
        return None if is_ambiguous else writes[0]

    def _write_stated(self, number: int, stated: ExposureSetting) -> _Write | None:
        """Return the write whose setting the camera states, and forget the writes before it."""
        writes = self._writes
        order = [*range(1, len(writes)), 0] if writes else []
        for place in order:
            write = writes[place]
            is_possible = place == 0 or write.slot - 1 <= number
            if is_possible and is_same(write.applied, stated):
                for _ in range(place):
                    writes.popleft()
                return write
        return None

    def _write_next(self) -> None:
        """Write the next setting if the current slot has none yet."""
        upcoming = self._source.upcoming()
        if upcoming is None or (self._writes and upcoming <= self._writes[-1].slot):
            return
        plan = self._plan
        index, setting = self._take_next_setting()
        written = self._source.write(setting)
        if plan != self._plan or not self._has_begun:
            bounds, self._has_begun = self._bounds, True
            first, (before, end) = written.first + bounds.smallest, self._mixed
            is_past = end <= self._source.number + 1  # of the exchange before
            self._mixed = (first if is_past else before, written.last + bounds.largest)
        self._writes.append(
            _Write(
                index,
                self._plan,
                setting,
                written.applied,
                written.last,
                written.first + self._delay.smallest,
                written.last + self._delay.largest,
            )
        )
        most = max(ASSUMED_LARGEST, self._delay.largest) + 2 + len(self._settings)
        while len(self._writes) > most:  # frames are lost, and no frame says which
            self._writes.popleft()


class StreamCycle(Generic[DataT]):
    """A `camctl.interface.cycle.FrameCycle` of a driver that has an `ExposurePipeline`.

    Args:
        cycle: assigns exposures to frames
        controls: of the camera, which has checked the list
        check: raises where the camera is no longer open
        frame: makes a frame of a shot, which was requested with a setting
        ended: called once, at the end of the stream
    """

    method: CycleMethod = CycleMethod.AHEAD

    def __init__(
        self,
        cycle: ExposureCycle[DataT],
        controls: ExposureControls,
        check: Callable[[], None],
        frame: Callable[[Shot[DataT], ExposureSetting], Frame],
        ended: Callable[[], None],
    ) -> None:
        self._cycle, self._controls, self._frame = cycle, controls, frame
        self._check, self._ended = check, ended
        self._shots = cycle.shots()
        self._is_open = True

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Frame:
        self._check()
        shot, requested = next(self._shots)
        return replace(self._frame(shot, requested), place=shot.place)

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        """See `FrameCycle.exchange`."""
        for setting in settings:
            self._controls.check(setting)
        return self._cycle.exchange(settings)

    def close(self) -> None:
        """See `FrameCycle.close`."""
        if self._is_open:
            self._is_open = False
            self._shots.close()
            try:
                self._cycle.rest(resting_setting(self._controls, [self._cycle.longest]))
            finally:
                self._ended()
