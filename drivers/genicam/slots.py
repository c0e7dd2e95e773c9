"""The frames of a GenICam camera in their slots: released by software, or in free run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from camctl.drivers.genicam.controls import US_PER_S, ExposureControl
from camctl.drivers.genicam.port import OpenDevice, Received
from camctl.errors import CameraProtocolError, CameraTimeoutError
from camctl.interface.clock import Clock, check_cancelled
from camctl.interface.controls import ExposureSetting
from camctl.streaming import FrameStamp, Written

#: Numbers of frames have 16 bits in GigE Vision 1, without 0; larger ones never begin again.
_NUMBERS = 65535
#: How often a wait for a frame asks whether the capture was cancelled, s.
_POLL_S = 0.1
#: Time from the end of an exposure until its frame is here, at most, s: 100 MB at 100 MB/s.
_TRANSFER_S = 1.0
#: Times that a trigger is sent again where no frame follows it.
_TRIGGERS = 3
#: Frames of which the median shows what a released frame takes.
_TIMED_FRAMES = 4
#: Two crystals of usual quality (50 ppm each) drift apart by at most this share of the time.
_DRIFT = 1e-4
#: A clock that runs so many times as fast as the system's, or as slow, has not the unit it states.
_OTHER_UNIT = 2.0


def wait_for_frame(
    device: OpenDevice, clock: Clock, exposure_s: float, timeout_s: float
) -> Received | None:
    """Return the next frame; None where none comes within `timeout_s` beyond its exposure.

    Raises:
        InterruptedCaptureError: the capture of this thread was cancelled
    """
    deadline_s = clock.now() + exposure_s + timeout_s
    while (left_s := deadline_s - clock.now()) > 0:
        check_cancelled()
        frame = device.receive(min(left_s, _POLL_S))
        if frame is not None:
            return frame
    return None


def numbers_apart(before: int, after: int) -> int:
    """Return how many frames the camera has numbered from one to another, 1 or more."""
    passed = after - before
    return passed if passed > 0 else max(1, passed + _NUMBERS)


def silent(device: OpenDevice, name: str, silence_s: float) -> CameraTimeoutError:
    """Return the error for a camera that sends no frame, though it answers.

    Raises:
        CameraDisconnectedError: it does not answer either
    """
    device.read("PixelFormat")
    return CameraTimeoutError(
        f"no frame from {name} for {silence_s:.0f} s",
        hint="check cable, power and the settings of the network, and open it again",
    )


def no_complete_frame(name: str) -> CameraProtocolError:
    """Return the error for a camera of whose frames packets are missing."""
    return CameraProtocolError(f"{name} sends no complete frame", hint="check the network")


@dataclass(eq=False)
class TriggeredSlots:
    """A stream in which each frame is released by software; a `camctl.streaming.NumberedSource`.

    A slot is one exposure, from its trigger on.  A setting that is written between two triggers
    comes before the second, so that it is certain in which slot it was written.

    Args:
        device: its acquisition runs
        name: of the device, for errors
        exposure: sets its exposure
        clock: of the time stamps
        silence_s: how long the camera may send nothing, beyond an exposure
        stated: the exposure that a frame states; None: it states none
    """

    device: OpenDevice
    name: str
    exposure: ExposureControl
    clock: Clock
    silence_s: float
    stated: Callable[[Received], ExposureSetting | None]

    def __post_init__(self) -> None:
        self._next = 0  # slot of the next trigger
        self._settings_s: list[float] = []
        self._frame: Received | None = None

    def next_frame(self) -> FrameStamp:
        """Release a frame and wait for it.

        Its number is uncertain where a trigger before it was not followed by a frame: a late frame
        cannot be told from the one that was asked for.
        """
        device = self.device
        is_certain = True
        patience_s = min(_TRANSFER_S, self.silence_s / _TRIGGERS)
        for attempt in range(_TRIGGERS):
            while device.receive(0.0) is not None:
                is_certain = False  # a frame that came too late for its trigger
            device.execute("TriggerSoftware")
            is_last = attempt + 1 == _TRIGGERS
            used_s = attempt * patience_s
            frame = wait_for_frame(
                device,
                self.clock,
                max(self._settings_s, default=0.0),
                self.silence_s - used_s if is_last else patience_s,
            )
            if frame is not None:
                self._frame = frame
                number, self._next = self._next, self._next + 1
                stated = self.stated(frame) if frame.is_complete else None
                return FrameStamp(number, frame.arrived_s, is_certain, stated)
            is_certain = False
            self._next += 1
        raise silent(self.device, self.name, self.silence_s)

    def read(self) -> Received | None:
        """Return the frame that arrived last; None where packets of it are missing."""
        frame = self._frame
        return frame if frame is not None and frame.is_complete else None

    def upcoming(self, *, late: bool = False) -> int:
        """Return the slot of the next trigger."""
        return self._next

    def write(self, setting: ExposureSetting) -> Written:
        """Set the exposure of the next slot, or of a later one where the camera needs longer."""
        applied = self.exposure.write(setting)
        # Settings before this one may still be in force.
        self._settings_s = [*self._settings_s[-8:], applied.time_s]
        return Written(applied, self._next, self._next)

    def timed(self, gain: float, decode: Callable[[Received], object]) -> tuple[float, Received]:
        """Return what a released frame takes beyond its exposure, s, and a frame.

        Raises:
            CameraProtocolError: no frame is complete
        """
        exposure_s = float(self.device.read(self.exposure.time_name)) / US_PER_S
        taken_s: list[float] = []
        found: Received | None = None
        for _ in range(_TIMED_FRAMES):
            began_s = self.clock.now()
            self.exposure.forget()
            self.write(ExposureSetting(exposure_s, gain))
            self.next_frame()
            if (frame := self.read()) is not None:
                found = frame
                decode(frame)
                taken_s.append(self.clock.now() - began_s - exposure_s)
        if found is None:
            raise no_complete_frame(self.name)
        return max(0.0, median(taken_s)), found


class CameraClock:
    """When frames arrived, by the time stamps of the camera.

    They are as regular as its frames, while a busy computer receives a frame some ms late.  The
    frames that were received the least late show what lies between the two clocks.  A clock that
    was set meanwhile, or has another unit than it states, is not used.
    """

    def __init__(self) -> None:
        self._begin = self._last = (0.0, 0.0)  # time stamp and reception
        self._apart_s = 0.0  # from the camera's clock to the system's

    def arrival(self, stamp_s: float, received_s: float) -> float:
        """Return when a frame arrived, s; as received where it has no time stamp (0)."""
        if stamp_s <= 0:
            return received_s
        apart_s = received_s - stamp_s
        if self._goes_on(stamp_s, received_s):
            drift_s = _DRIFT * (received_s - self._last[1])
            self._apart_s = min(apart_s, self._apart_s + drift_s)
        else:
            self._begin, self._apart_s = (stamp_s, received_s), apart_s
        self._last = (stamp_s, received_s)
        return stamp_s + self._apart_s

    def _goes_on(self, stamp_s: float, received_s: float) -> bool:
        passed_s, waited_s = stamp_s - self._begin[0], received_s - self._begin[1]
        is_same_unit = waited_s / _OTHER_UNIT <= passed_s <= waited_s * _OTHER_UNIT
        late_s = received_s - stamp_s - self._apart_s
        return stamp_s > self._last[0] and is_same_unit and late_s <= _TRANSFER_S


class FreeRunFrames:
    """A stream in free run; a `camctl.streaming.TimestampedSource`.

    A frame is stamped when its transfer begins, after its exposure has ended: by the camera's clock
    where it has one, see `CameraClock`.

    Attributes:
        sequence: number of the frame that was taken last, counted on where the camera's begins anew
    """

    def __init__(
        self,
        device: OpenDevice,
        name: str,
        exposure: ExposureControl,
        clock: Clock,
        silence_s: float,
    ) -> None:
        self._device = device
        self._name = name
        self._clock = clock
        self._silence_s = silence_s
        self._frame: Received | None = None
        self._camera_clock = CameraClock()
        self.sequence = 0
        self.write = exposure.write

    def grab(self) -> float:
        """Wait for the next frame; return when it began to arrive, s."""
        frame = wait_for_frame(self._device, self._clock, 0.0, self._silence_s)
        if frame is None:
            raise silent(self._device, self._name, self._silence_s)
        last, self._frame = self._frame, frame
        if last is not None:
            self.sequence += numbers_apart(last.number, frame.number)
        return self._camera_clock.arrival(frame.stamp_s, frame.arrived_s)

    def retrieve(self) -> Received | None:
        """Return the frame that was taken last; None where packets of it are missing."""
        frame = self._frame
        return frame if frame is not None and frame.is_complete else None
