"""Frame-exact exposure on a stream whose controls are late.

A setting that is written in slot k, between two frame boundaries, is in force from slot k + 1 + d
on, d the control delay in frames (`camctl.camera.StreamingCamera.step` defines it so).  With a
constant d one setting is written a slot, always just after a frame has come; frame number k has
setting i if, and only if, k lies in or after the slot in which i lands at the latest, and before
the earliest slot in which i + 1 may land.  All else is discarded, so that a frame that is stale or
of unsure exposure is never handed over; where no frame is left for a setting, it is written again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from camctl.camera import Pixels
from camctl.clock import Clock
from camctl.controls import ExposureSetting
from camctl.errors import CameraError, CameraProtocolError
from drivers.v4l2.slots import Slots

#: Controls are written in the first half of a slot.  Where frames arrive later than that after
#: their timestamp, which is when their transfer begins, controls are written within `AFTER_ARRIVAL`
#: of a slot after that, up to `END`; and where `END` is too near, from `BEGIN` of the next slot on.
WINDOW, AFTER_ARRIVAL, END, BEGIN = 0.5, 0.25, 0.95, 0.03
_TOO_NEAR = 0.8
#: A write that ended in this last share of a slot may have landed in the next.
MARGIN = 0.25
#: Frames until an exposure counts as settled where the delay was never measured.
UNKNOWN_DELAY = 6
#: Means of two frames agree if they differ by less than this share of the light, or of the range.
AGREES, AGREES_AT_LEAST = 0.02, 0.002
_TRIES = 16
_MOST_STALE = 100
_SAMPLES = 1 << 14


class Source(Protocol):
    """What a stream is made of: frames and a late exposure control."""

    def grab(self) -> float:
        """Wait for the next frame and return its timestamp, s."""
        ...

    def retrieve(self) -> Pixels | None:
        """Return the samples of the frame grabbed last; None where they are spoilt."""
        ...

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the exposure and return it as read back."""
        ...


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame whose exposure is known: its setting's index, read back, and its timestamp, s."""

    index: int
    applied: ExposureSetting
    time_s: float
    pixels: Pixels


@dataclass(frozen=True)
class _Write:
    """A setting on its way: the first slot that may have it, and the first that must.

    Where it failed, `error` says so once the frames before it are handed over.
    """

    index: int
    applied: ExposureSetting
    earliest: int
    latest: int
    error: CameraError | None = None


class Stream:
    """A running stream of frames.

    Args:
        source: its frames and controls
        clock: on which the timestamps are
        interval_s: time from frame to frame as announced, s
        range_dn: white minus black, DN

    """

    def __init__(self, source: Source, clock: Clock, interval_s: float, range_dn: int) -> None:
        self._source = source
        self._clock = clock
        self._range_dn = range_dn
        self.slots = Slots(interval_s)
        self._window = (0.0, WINDOW)
        self._steps = 0

    def start(self, frames: int = 5) -> None:
        """Take the first frames and learn their interval.

        Raises:
            CameraProtocolError: timestamps that are not on the monotonic clock, or not regular

        """
        for _ in range(_TRIES):
            times_s, late_s = [], []
            for _ in range(frames):
                times_s.append(self._source.grab())
                late_s.append(self._clock.now() - times_s[-1])
            if not abs(late_s[-1]) < 60:
                raise CameraProtocolError(
                    "the timestamps of the frames are not on the system's monotonic clock",
                    hint="use another camera, or a newer kernel",
                )
            if self.slots.learn(times_s):
                for time_s in times_s:
                    self.slots.see(time_s)
                self._window = _window(min(late_s) / self.slots.interval_s)
                return
        raise self._irregular()

    def shoot(self, settings: Sequence[ExposureSetting], delay: int) -> Generator[Shot, None, None]:
        """Yield a frame for each setting at a constant delay: n + delay frames for n settings.

        Raises:
            CameraProtocolError: so many frames are lost that there is no progress

        """
        written: deque[_Write] = deque()
        done = tries = 0
        while done < len(settings):
            if tries > _TRIES:
                raise self._irregular()
            if not written:
                tries += 1
                self._catch_up()
            self._fill(written, settings, done, delay)
            if not written:  # the time to write has just run out
                continue
            if (error := written[0].error) is not None:
                raise error
            if not self._grab():
                written.clear()  # which slots these frames were, nobody can tell
                continue
            if self._number < written[0].latest:
                continue
            if len(written) > 1 and self._number >= written[1].earliest:
                written.clear()  # the frame of this setting was lost
                continue
            # The next change goes out before the frame, which may be held for long.
            self._fill(written, settings, done, delay)
            pixels = self._source.retrieve()
            if pixels is None:
                tries += 1
                continue
            shot = written.popleft()
            yield Shot(shot.index, shot.applied, self.slots.time_s, pixels)
            done, tries = done + 1, 0

    def settle(
        self, settings: Sequence[ExposureSetting], delay: int
    ) -> Generator[Shot, None, None]:
        """Yield a frame for each setting once `delay` is over and two frames in a row agree.

        Raises:
            CameraProtocolError: the picture does not come to rest

        """
        for index, setting in enumerate(settings):
            self._catch_up()
            write = self._must_write(index, setting, delay)
            yield self._settled(write)

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Shot]:
        """Settle at `before`, write `after`, and return the next `frames` frames, none missing.

        The write goes out at the begin of a slot and at the end of its first half in turn: where
        that makes a difference, the delay is not constant, and no measurement may hide it.  (A
        write that takes so long that it may end in the next slot is tried at the other end.)

        Raises:
            CameraProtocolError: frames are lost again and again

        """
        for tries in range(_TRIES):
            self._catch_up()
            settled = self._must_write(0, before, UNKNOWN_DELAY + 2).latest
            while self._number < settled:
                self._grab()
            self._catch_up()
            if (self._steps + tries) % 2:
                self._clock.sleep_until(self.slots.at(0.95 * self._window[1]))
            write = self._must_write(0, after, 0)
            shots = self._run(write, frames)
            if write.earliest == write.latest and shots is not None:
                self._steps += 1
                return shots
        raise self._irregular()

    def _run(self, write: _Write, frames: int) -> list[Shot] | None:
        """Return the frames from a write on; None where one is missing."""
        shots: list[Shot] = []
        while len(shots) < frames:
            if not self._grab():
                return None
            if self._number < write.latest:
                continue
            pixels = self._source.retrieve()
            if pixels is None or self._number != write.latest + len(shots):
                return None
            shots.append(Shot(len(shots), write.applied, self.slots.time_s, pixels))
        return shots

    @property
    def _number(self) -> int:
        assert self.slots.number is not None
        return self.slots.number

    def _grab(self) -> bool:
        """Take the next frame; False where its number is not sure."""
        return self.slots.see(self._source.grab())

    def _catch_up(self) -> None:
        """Throw away what has been waiting, until a slot has just begun."""
        for _ in range(_MOST_STALE):
            if self._is_time_to_write():
                return
            self._grab()
        raise self._irregular()

    def _is_time_to_write(self) -> bool:
        """Say whether controls may be written now, or in a moment, which is waited for."""
        opens, closes = self._window
        if self.slots.phase(self._clock.now()) > closes:
            return False
        self._clock.sleep_until(self.slots.at(opens))
        return True

    def _fill(
        self,
        written: deque[_Write],
        settings: Sequence[ExposureSetting],
        done: int,
        delay: int,
    ) -> None:
        """Write the next setting if this slot has none yet and has just begun."""
        index = done + len(written)
        if index >= len(settings) or (written and written[-1].error is not None):
            return
        if not self._is_time_to_write():
            return
        if written and self.slots.running(self._clock.now()) + 1 + delay <= written[-1].latest:
            return
        written.append(self._write(index, settings[index], delay))

    def _write(self, index: int, setting: ExposureSetting, delay: int) -> _Write:
        begun = self.slots.running(self._clock.now())
        applied, error = setting, None
        try:
            applied = self._source.write(setting)
        except CameraError as refusal:
            error = refusal
        margin = min(MARGIN, (1 - self._window[1] % 1) / 2)
        ended = self.slots.running(self._clock.now() + margin * self.slots.interval_s)
        return _Write(index, applied, begun + 1 + delay, ended + 1 + delay, error)

    def _must_write(self, index: int, setting: ExposureSetting, delay: int) -> _Write:
        write = self._write(index, setting, delay)
        if write.error is not None:
            raise write.error
        return write

    def _settled(self, write: _Write) -> Shot:
        """Return the second of two frames in a row that look alike and lie after the delay."""
        previous: tuple[int, float] | None = None
        for _ in range(write.latest - self._number + _TRIES):
            is_sure = self._grab()
            if self._number < write.latest:
                continue
            pixels = self._source.retrieve() if is_sure else None
            if pixels is None:
                previous = None
                continue
            light = self._light(pixels)
            if previous is not None and previous[0] + 1 == self._number:
                difference = abs(light - previous[1])
                if difference <= max(AGREES * light, AGREES_AT_LEAST * self._range_dn):
                    return Shot(write.index, write.applied, self.slots.time_s, pixels)
            previous = (self._number, light)
        raise CameraProtocolError(
            f"the picture does not come to rest: no two of {_TRIES} frames of one exposure agree",
            hint="keep scene and light still, or measure the delay with camctl calibrate delay",
        )

    @staticmethod
    def _light(pixels: Pixels) -> float:
        step = max(1, int((pixels.size / _SAMPLES) ** 0.5))
        return float(np.mean(pixels[::step, ::step]))

    @staticmethod
    def _irregular() -> CameraProtocolError:
        return CameraProtocolError(
            "frames are lost, spoilt, or come at irregular times",
            hint="give the camera a USB port of its own, or choose a smaller size or lower frame "
            "rate with -O size=... or -O fps=...",
        )


def _window(lateness: float) -> tuple[float, float]:
    """Return from when to when after a timestamp controls may be written, in slots.

    `lateness` is how long after its timestamp a frame arrives, in slots.
    """
    whole, part = divmod(max(lateness, 0.0), 1.0)
    if part > _TOO_NEAR:
        return whole + 1 + BEGIN, whole + 1 + WINDOW
    return 0.0, whole + max(WINDOW, min(part + AFTER_ARRIVAL, END))
