"""The hardware of a streaming camera: slots, a late control register, and a short queue of frames.

The device has no list of exposures, and whether it states which exposure a frame had is up to its
driver (`camctl.sim.camera`).  Like a V4L2 camera it

- streams one frame slot after another, each as long as the frame interval or the exposure,
  whichever is longer; exposures end with their slot;
- accepts a setting at any time, clamps it silently to its limits, and applies it `delay_frames`
  slots later, counted from the first slot that has not begun; with -1 the running exposure has it,
  and the gain may have another delay than the exposure time;
- keeps the newest `QUEUE` finished frames for a late consumer and drops older ones;
- may lose and delay frames, and state their times, as a recorded stream did.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from camctl.errors import CameraDisconnectedError
from camctl.interface.camera import Pixels
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureSetting
from camctl.sim.recorded_stream import Arrival, RecordedStream
from camctl.sim.sensors.sensor import Sensor

#: Finished frames that wait for the consumer at most: the default number of V4L2 buffers in OpenCV.
QUEUE = 4

_AT_ONCE = Arrival(0.0, 0.0)


@dataclass(frozen=True)
class Buffer:
    """One finished frame slot, not yet read out.

    Attributes:
        sequence: number of the slot since the stream began
        end_s: when its exposure ended
        stamp_s: the time that it states
        arrival_s: when it arrives
        exposed: its exposure, which few cameras state
    """

    sequence: int
    end_s: float
    stamp_s: float
    arrival_s: float
    exposed: ExposureSetting
    _before: ExposureSetting


@dataclass(frozen=True)
class Slot:
    """The exposure of a frame.

    Attributes:
        sequence: number of the slot since the stream began
        time_s, gain: its exposure
        start_s: when the exposure began, from the begin of the stream
        previous_s: exposure time of the slot before
    """

    sequence: int
    time_s: float
    gain: float
    start_s: float
    previous_s: float


class SimulatedDevice:
    """The hardware around a simulated sensor.

    Args:
        sensor: its times, gains, delay and frame interval
        render: returns the pixels of an exposure
        clock: of the stream
        late_frames: of each setting, more than the sensor says
        seed: of the variation of the control delay
        stream: when frames arrive; None: all of them, as soon as they are exposed

    Attributes:
        lost: number of frames that were dropped
    """

    def __init__(
        self,
        sensor: Sensor,
        render: Callable[[Slot], Pixels],
        clock: Clock,
        *,
        late_frames: int = 0,
        seed: int = 0,
        stream: RecordedStream | None = None,
    ) -> None:
        self._sensor = sensor
        self._stream = stream
        self._render = render
        self._clock = clock
        self._jitter = np.random.Generator(np.random.PCG64(seed))
        power_on = sensor.times.nearest(min(sensor.frame_interval_s, sensor.time_maximum_s) / 2)
        self._setting = ExposureSetting(power_on, 1.0)
        delay = sensor.delay
        assert delay.time is not None
        assert delay.gain is not None
        self._late = (delay.time[0] + late_frames, delay.gain[0] + late_frames)
        #: For the exposure time and the gain: the slots from which on a setting has them.
        self._pending: tuple[deque[tuple[int, ExposureSetting]], ...] = (deque(), deque())
        self._running = 0  # the slot that is being exposed, or begins at this instant
        self._start_s = clock.now()
        self._began_s = self._start_s
        self._before = self._setting
        self._finished: deque[Buffer] = deque()
        self._frozen = False
        self._plugged = True
        self._drops_next = False
        self.lost = 0

    @property
    def upcoming(self) -> int:
        """Sequence number of the first slot that has not begun, as of frame-start events."""
        self._advance()
        # Where a setting acts on the running exposure, one that begins now has begun; and where
        # frames take time to arrive, none arrives before.
        is_now = min(self._late) < 0 or self._stream is not None
        has_begun = self._clock.now() > self._start_s or is_now
        return self._running + has_begun

    def write(self, setting: ExposureSetting) -> tuple[int, ExposureSetting]:
        """Set the exposure; return `upcoming` at that moment and the setting read back."""
        upcoming = self.upcoming
        applied = ExposureSetting(
            self._sensor.times.nearest(setting.time_s), self._sensor.gains.nearest(setting.gain)
        )
        jitter = int(self._jitter.integers(0, self._sensor.delay_jitter_frames, endpoint=True))
        # Settings are applied in the order of their writes: of several that are due the last wins.
        for pending, late in zip(self._pending, self._late, strict=True):
            pending.append((upcoming + late + jitter, applied))
        return upcoming, applied

    def dequeue(self, silence_s: float) -> Buffer | None:
        """Return the oldest finished frame, or wait for the next.

        Returns:
            None if no frame arrives within `silence_s` beyond the time that the next frame takes.
        """
        self._advance()
        while not self._finished:
            if self._frozen:
                self._clock.sleep_until(self._clock.now() + self._slot_s() + silence_s)
                self._check_plug()
                return None
            self._clock.sleep_until(self._start_s + self._slot_s())
            self._advance()
        buffer = self._finished.popleft()
        self._clock.sleep_until(buffer.arrival_s)
        if self._drops_next:
            self._drops_next = False
            self.lost += 1
            return self.dequeue(silence_s)
        return buffer

    def abort(self, setting: ExposureSetting | None) -> None:
        """Stop the stream and start it again, with a setting: the running exposure is lost."""
        self._advance()
        for pending in self._pending:
            pending.clear()
        self._finished.clear()
        self._setting = setting or self._setting
        self._running += 1
        self._start_s = self._clock.now()

    def drop_next(self) -> None:
        """Lose the next frame."""
        self._drops_next = True

    def read_out(self, buffer: Buffer, *, light: float = 1.0) -> Pixels:
        """Return the pixels of a frame; the fault `light` multiplies its exposure."""
        self._check_plug()
        setting = buffer.exposed
        start_s = buffer.end_s - setting.time_s - self._began_s
        return self._render(
            Slot(
                buffer.sequence,
                setting.time_s * light,
                setting.gain,
                start_s,
                buffer._before.time_s,
            )
        )

    def unplug(self) -> None:
        """Pull the cable: every call from now on raises `CameraDisconnectedError`."""
        self._plugged = False

    def freeze(self) -> None:
        """Stop delivering frames, without an error."""
        self._advance()
        self._finished.clear()
        self._frozen = True

    def _check_plug(self) -> None:
        if not self._plugged:
            raise CameraDisconnectedError(
                "the simulated camera was unplugged", hint="plug it in and open it again"
            )

    def _slot_s(self) -> float:
        """Return the length of the running slot, after applying the settings that are due."""
        times, gains = self._pending
        while times and times[0][0] <= self._running:
            self._setting = replace(self._setting, time_s=times.popleft()[1].time_s)
        while gains and gains[0][0] <= self._running:
            self._setting = replace(self._setting, gain=gains.popleft()[1].gain)
        return max(self._sensor.frame_interval_s, self._setting.time_s)

    def _advance(self) -> None:
        """Advance the stream to the current time."""
        self._check_plug()
        now = self._clock.now()
        while not self._frozen:
            end_s = self._start_s + self._slot_s()
            if end_s > now:
                return
            arrival = self._stream.arrival(self._running) if self._stream else _AT_ONCE
            if arrival is None:
                self.lost += 1
            else:
                stamp_s, arrival_s = (
                    end_s + late * self._sensor.frame_interval_s for late in arrival
                )
                self._finished.append(
                    Buffer(self._running, end_s, stamp_s, arrival_s, self._setting, self._before)
                )
            self._before = self._setting
            self._running += 1
            self._start_s = end_s
            if len(self._finished) > QUEUE:
                self._finished.popleft()
                self.lost += 1
