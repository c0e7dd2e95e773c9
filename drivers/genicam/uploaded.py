"""Exposures that the camera takes by itself, from the sets of its sequencer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from typing import Self

from camctl.drivers.genicam import sequencer
from camctl.drivers.genicam.controls import ExposureControl
from camctl.drivers.genicam.evidence import Scale, first_in_order
from camctl.drivers.genicam.port import OpenDevice, Received
from camctl.drivers.genicam.slots import numbers_apart, silent, wait_for_frame
from camctl.errors import CameraClosedError, CameraError, CameraProtocolError
from camctl.interface.camera import CyclePlace, Frame, Pixels
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureSetting
from camctl.interface.cycle import CycleMethod, check_not_empty

#: Frames of an uploaded cycle that may come before its first set.
_LEAD = 8
#: Buffers that are filled while no frame is taken, beyond one cycle.
_BUFFERS = 8


@dataclass(eq=False)
class UploadedSequence:
    """The frames of an uploaded cycle, from its first set on.

    Args:
        device: an open device; no other stream of it runs
        name: of the device, for errors
        exposure: sets its exposure
        scale: of its samples
        samples: of a frame; None where it is damaged
        clock: for waiting
        silence_s: how long the camera may send nothing, beyond an exposure
        is_triggered: its triggers are on otherwise
    """

    device: OpenDevice
    name: str
    exposure: ExposureControl
    scale: Scale
    samples: Callable[[Received], Pixels | None]
    clock: Clock
    silence_s: float
    _: KW_ONLY
    is_triggered: bool

    def start(self, settings: Sequence[ExposureSetting]) -> None:
        """Upload a cycle and let the camera take it again and again."""
        self.device.stop()
        if self.is_triggered:
            self.device.write("TriggerMode", "Off")
        sequencer.upload(self.device, settings, self.exposure, self.name)
        self.device.start(len(settings) + _LEAD + _BUFFERS)

    def stop(self) -> None:
        """Leave the sequencer; other frames can be taken again."""
        device = self.device
        with suppress(CameraError):
            device.stop()
        sequencer.turn_off(device)
        if self.is_triggered:
            device.write("TriggerMode", "On")
        device.start(_BUFFERS)

    def frames(self, settings: Sequence[ExposureSetting]) -> Iterator[tuple[int, Received]]:
        """Yield the frames without end, with their numbers from the first set on.

        The first cycle is complete: its pixels have shown that it is one.  Later a number is left
        out where a frame is damaged or lost.
        """
        first = self._first_cycle(settings)
        yield from enumerate(first)
        number, last = len(first) - 1, first[-1]
        while True:
            received = self._next(settings)
            number += numbers_apart(last.number, received.number)
            last = received
            if received.is_complete:
                yield number, received

    def _next(self, settings: Sequence[ExposureSetting]) -> Received:
        longest_s = max(setting.time_s for setting in settings)
        received = wait_for_frame(self.device, self.clock, longest_s, self.silence_s)
        if received is None:
            raise silent(self.device, self.name, self.silence_s)
        return received

    def _first_cycle(self, settings: Sequence[ExposureSetting]) -> list[Received]:
        count = len(settings)
        taken: list[Received] = []
        for _ in range(2 * count + _LEAD):
            received = self._next(settings)
            is_gap = taken and numbers_apart(taken[-1].number, received.number) != 1
            if is_gap or not received.is_complete:
                taken.clear()  # a frame is missing: the cycle is counted anew
            if received.is_complete:
                taken.append(received)
            window = taken[-count:]
            pixels = [self.samples(each) for each in window]
            found = [each for each in pixels if each is not None]
            if len(found) == count and first_in_order(found, settings, self.scale) == 0:
                return window
        raise CameraProtocolError(
            f"the pixels do not show with which frame the sequencer of {self.name} begins",
            hint="keep the scene steady, light it, or leave the sequencer off",
            remedies={"option:sequencer": "off"},
        )


class UploadedCycle:
    """A `camctl.interface.cycle.FrameCycle` that the camera's sequencer repeats.

    Args:
        sequence: of the camera
        settings: the list
        check_open: raises where the camera is no longer open
        check: raises where the camera cannot take a list
        frame: makes a frame of what arrived: with its setting, its index and its place
        ended: called once, at the end
    """

    method = CycleMethod.SEQUENCER

    def __init__(
        self,
        sequence: UploadedSequence,
        settings: Sequence[ExposureSetting],
        check_open: Callable[[], None],
        check: Callable[[Sequence[ExposureSetting]], None],
        frame: Callable[[Received, ExposureSetting, int, CyclePlace], Frame],
        ended: Callable[[], None],
    ) -> None:
        self._sequence, self._frame, self._ended = sequence, frame, ended
        self._check_open, self._check = check_open, check
        self._settings = tuple(settings)
        self._waiting: tuple[ExposureSetting, ...] | None = None
        self._plan = self._last_plan = 0
        self._number = -1  # of the last frame, from the begin of the stream
        self._base = 0  # number of the first frame of the present list
        self._lock = threading.Lock()
        self._is_open = True
        self._received = self._begin()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Frame:
        if not self._is_open:
            raise StopIteration
        self._check_open()
        is_at_end = (self._number + 1 - self._base) % len(self._settings) == 0
        if self._number >= self._base and is_at_end:
            self._exchange_now()
        number, received = next(self._received)
        self._number = self._base + number
        index = number % len(self._settings)
        place = CyclePlace(self._number, self._plan)
        return self._frame(received, self._settings[index], index, place)

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        """See `FrameCycle.exchange`: the acquisition stops while the new list is uploaded."""
        check_not_empty(settings)
        self._check(settings)
        with self._lock:
            self._waiting = tuple(settings)
            self._last_plan += 1
            return self._last_plan

    def close(self) -> None:
        """See `FrameCycle.close`."""
        if self._is_open:
            self._is_open = False
            try:
                with suppress(CameraClosedError):  # its owner has left the sequencer
                    self._check_open()
                    self._sequence.stop()
            finally:
                self._ended()

    def _begin(self) -> Iterator[tuple[int, Received]]:
        self._sequence.start(self._settings)
        return self._sequence.frames(self._settings)

    def _exchange_now(self) -> None:
        """Go on with the list that waits, if there is one."""
        with self._lock:
            waiting, self._waiting, plan = self._waiting, None, self._last_plan
        if waiting is not None:
            self._settings, self._plan, self._base = waiting, plan, self._number + 1
            self._received = self._begin()
