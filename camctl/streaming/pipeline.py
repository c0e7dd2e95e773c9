"""The control-delay pipeline: a frame of known exposure for each setting of a list.

The pipeline records for each setting that it wrote the first slot that may have it and the first
slot that must have it, as libcamera's DelayedControls does for its sensors.  A frame belongs to a
setting if its slot is not before the first slot that must have the setting, and before the first
slot that may have the next setting.  All other frames are discarded, so that a
frame of unknown exposure is never yielded.  A setting whose frame was lost or damaged is written
again while the frames of later settings still come: it costs one slot.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Generic, TypeVar

from camctl.errors import CameraError, CameraProtocolError
from camctl.interface.camera import CyclePlace
from camctl.interface.controls import ExposureSetting
from camctl.streaming.control_delay import (
    ASSUMED_LARGEST,
    ControlDelay,
    DelayOrigin,
    FrameStamp,
    NumberedSource,
    irregular_frames,
    same_brightness,
)
from camctl.streaming.stated_exposures import StatedExposures, is_same

DataT = TypeVar("DataT")

#: Frames for which `step` waits at the first setting: it must not rely on a delay that it measures.
_STEP_SETTLING = ASSUMED_LARGEST + 2
#: Attempts without a usable frame until the stream counts as unusable.
_ATTEMPTS = 16
#: Old frames that are dropped at once at most: more than any driver has buffers.
_OLD_FRAMES = 100
#: Writes that are remembered: more than can be on their way at once.
_WRITES = 64


@dataclass(frozen=True, eq=False)
class Shot(Generic[DataT]):
    """A frame whose exposure is known.

    Attributes:
        index: position of its setting in the list
        applied: its setting as read back
        time_s: when its exposure ended, s
        data: the frame as the source delivered it
        place: where it is in an endless stream; None: it is one of a list
        lost: frames of the setting that were lost, or could not be read, before it
    """

    index: int
    applied: ExposureSetting
    time_s: float
    data: DataT
    place: CyclePlace | None = None
    lost: int = 0


@dataclass(frozen=True)
class _Pending:
    """A setting that was written and has no frame yet.

    Attributes:
        index: position in the list
        applied: as read back
        slot: last number that the first slot not begun at the write may have had
        earliest, latest: the first slot that may have the setting, and the first that must
        error: of a failed write; raised once the frames of all settings before it were yielded
    """

    index: int
    applied: ExposureSetting
    slot: int
    earliest: int
    latest: int
    error: CameraError | None = None


class ExposurePipeline(Generic[DataT]):
    """Yields a frame of known exposure for each setting.

    Args:
        source: a running stream
        delay: of its exposure control
        brightness: mean brightness of a frame as a share of full scale, such as `mean_brightness`;
            needed unless the delay is guaranteed, to see when an exposure has settled

    Attributes:
        delay: of all controls, from the next list of settings on
    """

    def __init__(
        self,
        source: NumberedSource[DataT],
        delay: ControlDelay,
        brightness: Callable[[DataT], float] | None = None,
    ) -> None:
        self._source = StatedExposures.of(source, brightness)
        self.delay = self._delay = delay
        #: The last settings that were written, with the last number that the first slot not begun
        #: at the write may have had.
        self._writes: deque[tuple[int, ExposureSetting]] = deque(maxlen=_WRITES)
        self._brightness = brightness
        if brightness is None and delay.origin is not DelayOrigin.GUARANTEED:
            raise ValueError("brightness is needed unless the control delay is guaranteed")
        self._steps = 0

    def shoot(
        self, settings: Sequence[ExposureSetting], rest: ExposureSetting | None = None
    ) -> Generator[Shot[DataT], None, None]:
        """Yield a frame for each setting, in order.

        With a constant delay of d frames, n settings take n + d frames: one setting is written in
        each slot.  Otherwise each setting is written when the frame of the one before it has been
        yielded, and settles: the largest delay passes and, unless that is guaranteed, two
        consecutive frames have the same brightness.

        At the end `rest` is written, which costs no time: where a slot is as long as its exposure,
        the next request then waits for short slots.

        Raises:
            CameraProtocolError: too many frames are lost, or the brightness does not settle
            CameraError: as the source raises; frames of earlier settings are yielded before that
        """
        self._delay = self._delay_over(settings if rest is None else (*settings, rest))
        if self._delay.frames is not None:
            yield from self._pipelined(settings, rest)
        else:
            yield from self._settled_each(settings, rest)

    def _delay_over(self, settings: Sequence[ExposureSetting]) -> ControlDelay:
        """Return the delay of the changes to these settings, and of those that are on their way.

        Where time and gain differ in their delays, a list that changes one of them alone may begin
        while the other still has the value before.
        """
        if not settings or self.delay.frames is not None or self.delay.time == self.delay.gain:
            return self.delay
        self._drop_old_frames()
        upcoming = self._source.upcoming()
        if upcoming is None:
            return self.delay
        in_force: list[ExposureSetting] = []
        for slot, setting in reversed(self._writes):
            in_force.insert(0, setting)
            if slot + self.delay.largest <= upcoming + self.delay.smallest:
                return self.delay.over([*in_force, *settings])
        return self.delay  # what is in force is not known

    def settled(self, index: int, setting: ExposureSetting) -> Shot[DataT]:
        """Write a setting and return a frame that surely has it; raises as `shoot` does."""
        self._delay = self.delay
        return self._settled(self._write_now(index, setting))

    @property
    def is_stated(self) -> bool:
        """Whether frames have the exposures that the camera states of them."""
        return self._source.are_believed

    def release(self) -> tuple[NumberedSource[DataT], Callable[[DataT], float] | None]:
        """Return the stream and the brightness of its frames, for settings written elsewhere."""
        self._writes.clear()  # what is written last is not known here
        return self._source, self._brightness

    def step(
        self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
    ) -> list[Shot[DataT]]:
        """Settle at `before`, write `after`, and return the next `frames` frames without a gap.

        Frame 0 is the first whose exposure had not begun at the write; `applied` is `after` as read
        back, and `index` counts the frames.  With `early` = 1 the frame before it is returned, too,
        where it comes after the write.  `after` is written early and late in a slot in turn,
        so that a delay which depends on that is not mistaken for a constant one.

        Raises:
            CameraProtocolError: frames are lost in every attempt
        """
        self._delay = self.delay
        is_guaranteed = self._delay.origin is DelayOrigin.GUARANTEED
        settling = self._delay.largest if is_guaranteed else _STEP_SETTLING
        for attempt in range(_ATTEMPTS):
            settled = self._write_now(0, before).slot + settling
            while self._next_frame().number < settled:
                pass
            self._drop_old_frames()
            if (self._steps + attempt) % 2:
                self._source.upcoming(late=True)
            written = self._source.write(after)
            self._writes.append((written.last, written.applied))
            shots = self._consecutive(written.applied, written.last, frames, early)
            # A write that may have ended in the next slot does not count.
            if written.first == written.last and shots is not None:
                self._steps += 1
                return shots
        raise irregular_frames()

    def _pipelined(
        self, settings: Sequence[ExposureSetting], rest: ExposureSetting | None
    ) -> Generator[Shot[DataT], None, None]:
        to_write = settings if rest is None else (*settings, rest)
        unwritten = list(range(len(to_write)))  # a heap: a setting without a frame comes first
        pending: deque[_Pending] = deque()
        taken: dict[int, Shot[DataT]] = {}  # frames that wait for one of a setting before theirs
        losses: Counter[int] = Counter()
        done = attempts = 0
        while done < len(settings):
            if attempts > _ATTEMPTS:
                raise irregular_frames()
            if not pending:
                attempts += 1
                self._drop_old_frames()
            self._write_next(pending, to_write, unwritten)
            if not pending:  # the time to write has just passed
                continue
            if (error := pending[0].error) is not None:
                if not unwritten or unwritten[0] > pending[0].index:
                    raise error
                _write_again(pending, 1, unwritten)
                continue
            stamp = self._next_frame()
            if not stamp.is_certain:
                _write_again(pending, len(pending), unwritten)
                continue
            lost = sum(stamp.number >= later.earliest for later in list(pending)[1:])
            attempts += lost
            losses.update(_write_again(pending, lost, unwritten))
            if stamp.number < pending[0].latest or pending[0].error is not None:
                continue
            # The next setting is written before the frame is yielded: the caller may take long.
            self._write_next(pending, to_write, unwritten)
            data = self._source.read()
            if data is None:
                attempts += 1
                losses[pending[0].index] += 1
                # The last setting stays in force: the next frame has it, too.
                _write_again(pending, len(pending) > 1, unwritten)
                continue
            shot = pending.popleft()
            lost = losses[shot.index]
            applied = self._source.applied(stamp, shot.applied)
            taken[shot.index] = Shot(shot.index, applied, stamp.time_s, data, lost=lost)
            while done < len(settings) and done in taken:  # the frame at rest is nobody's
                yield taken.pop(done)
                done, attempts = done + 1, 0

    def _settled_each(
        self, settings: Sequence[ExposureSetting], rest: ExposureSetting | None
    ) -> Generator[Shot[DataT], None, None]:
        for index, setting in enumerate(settings):
            shot = self._settled(self._write_now(index, setting))
            if rest is not None and index + 1 == len(settings):
                with suppress(CameraError):  # what was asked for has been shot
                    self._write(index, rest)
            yield shot

    def _settled(self, written: _Pending) -> Shot[DataT]:
        """Return a frame that states its setting, or the first frame after the delay.

        Unless the delay is guaranteed, that is the second of two that are equally bright.
        """
        previous: tuple[int, float] | None = None
        looked_at = unread = 0
        while looked_at < _ATTEMPTS:
            stamp = self._next_frame()
            stated = self._source.believed(stamp)
            is_stated = stated is not None and is_same(stated, written.applied)
            if stamp.number < written.earliest or (stamp.number < written.latest and not is_stated):
                continue
            looked_at += 1
            data = self._source.read() if stamp.is_certain or is_stated else None
            if data is None:
                unread += stamp.is_certain
                previous = None
                continue
            applied = self._source.applied(stamp, written.applied)
            shot = Shot(written.index, applied, stamp.time_s, data, lost=unread)
            if (
                is_stated
                or self._brightness is None
                or self._delay.origin is DelayOrigin.GUARANTEED
            ):
                return shot
            light = self._brightness(data)
            if (
                previous is not None
                and previous[0] + 1 == stamp.number
                and same_brightness(light, previous[1])
            ):
                return shot
            previous = (stamp.number, light)
        raise CameraProtocolError(
            f"the brightness does not settle: no two consecutive frames of {_ATTEMPTS} with one "
            "exposure agree",
            hint="keep scene and light steady, or measure the control delay",
            remedies={"calibrate_delay": None},
        )

    def _consecutive(
        self, applied: ExposureSetting, first: int, frames: int, early: int
    ) -> list[Shot[DataT]] | None:
        """Return the frames from slot `first` on, up to `early` before it; None: one is missing."""
        shots: list[Shot[DataT]] = []
        while not shots or shots[-1].index + 1 < frames:
            stamp = self._next_frame()
            if not stamp.is_certain:
                return None
            index = stamp.number - first
            if index < -early:
                continue
            data = self._source.read()
            expected = shots[-1].index + 1 if shots else min(index, 0)
            if data is None or index != expected:
                return None
            shots.append(Shot(index, applied, stamp.time_s, data))
        return shots

    def _next_frame(self) -> FrameStamp:
        """Wait for the next frame."""
        stamp = self._source.next_frame()
        if not stamp.is_certain:
            self._writes.clear()  # how long ago they were is not known any more
        return stamp

    def _drop_old_frames(self) -> None:
        """Discard frames that have been waiting, until a setting may be written."""
        for _ in range(_OLD_FRAMES):
            if self._source.upcoming() is not None:
                return
            self._next_frame()
        raise irregular_frames()

    def _write_next(
        self,
        pending: deque[_Pending],
        settings: Sequence[ExposureSetting],
        unwritten: list[int],
    ) -> None:
        """Write the next setting if there is one and the current slot has none yet."""
        if not unwritten or (pending and pending[-1].error is not None):
            return
        upcoming = self._source.upcoming()
        if upcoming is None or (pending and upcoming <= pending[-1].slot):
            return
        index = heappop(unwritten)
        try:
            pending.append(self._write(index, settings[index]))
        except CameraError as error:
            # From here on the exposure is unknown: no later frame belongs to an earlier setting.
            unknown_from = upcoming + self._delay.smallest
            pending.append(
                _Pending(index, settings[index], upcoming, unknown_from, unknown_from, error)
            )

    def _write_now(self, index: int, setting: ExposureSetting) -> _Pending:
        self._drop_old_frames()
        return self._write(index, setting)

    def _write(self, index: int, setting: ExposureSetting) -> _Pending:
        try:
            written = self._source.write(setting)
        except CameraError:
            self._writes.clear()  # the device may have another setting now
            raise
        self._writes.append((written.last, written.applied))
        return _Pending(
            index,
            written.applied,
            written.last,
            written.first + self._delay.smallest,
            written.last + self._delay.largest,
        )


def _write_again(pending: deque[_Pending], count: int, unwritten: list[int]) -> list[int]:
    """Put the first `count` written settings back to be written; return their indices."""
    again = [pending.popleft().index for _ in range(count)]
    for index in again:
        heappush(unwritten, index)
    return again
