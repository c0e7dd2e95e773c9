"""The frames of a GenICam camera in their slots: released by software, or in free run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from camctl.drivers.genicam.port import OpenDevice, Received
from camctl.errors import CameraTimeoutError
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


class WritesExposures(Protocol):
    """What sets the exposure of a device."""

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the exposure and return it as read back."""


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

    def __init__(
        self,
        device: OpenDevice,
        name: str,
        exposure: WritesExposures,
        clock: Clock,
        silence_s: float,
        stated: Callable[[Received], ExposureSetting | None],
    ) -> None:
        self._device = device
        self._name = name
        self._stated = stated
        self._exposure = exposure
        self._clock = clock
        self._silence_s = silence_s
        self._next = 0  # slot of the next trigger
        self._longest_s = 0.0  # of the settings that may be in force
        self._settings_s: list[float] = []
        self._frame: Received | None = None

    def next_frame(self) -> FrameStamp:
        """Release a frame and wait for it.

        Its number is uncertain where a trigger before it was not followed by a frame: a late frame
        cannot be told from the one that was asked for.
        """
        device = self._device
        is_certain = True
        patience_s = min(_TRANSFER_S, self._silence_s / _TRIGGERS)
        for attempt in range(_TRIGGERS):
            while device.receive(0.0) is not None:
                is_certain = False  # a frame that came too late for its trigger
            device.execute("TriggerSoftware")
            is_last = attempt + 1 == _TRIGGERS
            used_s = attempt * patience_s
            frame = wait_for_frame(
                device,
                self._clock,
                max(self._settings_s, default=0.0),
                self._silence_s - used_s if is_last else patience_s,
            )
            if frame is not None:
                self._frame = frame
                number, self._next = self._next, self._next + 1
                stated = self._stated(frame) if frame.is_complete else None
                return FrameStamp(number, frame.arrived_s, is_certain, stated)
            is_certain = False
            self._next += 1
        raise silent(self._device, self._name, self._silence_s)

    def read(self) -> Received | None:
        """Return the frame that arrived last; None where packets of it are missing."""
        frame = self._frame
        return frame if frame is not None and frame.is_complete else None

    def upcoming(self, *, late: bool = False) -> int:
        """Return the slot of the next trigger."""
        return self._next

    def write(self, setting: ExposureSetting) -> Written:
        """Set the exposure of the next slot, or of a later one where the camera needs longer."""
        applied = self._exposure.write(setting)
        # Settings before this one may still be in force.
        self._settings_s = [*self._settings_s[-8:], applied.time_s]
        return Written(applied, self._next, self._next)


class FreeRunFrames:
    """A stream in free run; a `camctl.streaming.TimestampedSource`.

    A frame is stamped when its transfer begins, after its exposure has ended.

    Attributes:
        sequence: number of the frame that was taken last, counted on where the camera's begins anew
    """

    def __init__(
        self,
        device: OpenDevice,
        name: str,
        exposure: WritesExposures,
        clock: Clock,
        silence_s: float,
    ) -> None:
        self._device = device
        self._name = name
        self._clock = clock
        self._silence_s = silence_s
        self._frame: Received | None = None
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
        return frame.arrived_s

    def retrieve(self) -> Received | None:
        """Return the frame that was taken last; None where packets of it are missing."""
        frame = self._frame
        return frame if frame is not None and frame.is_complete else None
