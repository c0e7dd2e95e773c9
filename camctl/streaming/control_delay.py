"""The control delay of a stream, what it costs in time, and what a stream needs for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Protocol, Self, TypeVar

import numpy as np

from camctl.errors import CameraProtocolError
from camctl.findings import Finding
from camctl.interface.camera import MeasuredDelay, Pixels
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.profiles.profile import DelayRecord

ASSUMED_LARGEST = 6
"""Largest delay, in frames, that is assumed where none was measured: usual webcams have half of it.
"""

#: Codes of `ControlDelay.findings`.
_FINDINGS = ("delay_unknown", "delay_varies")


class DelayOrigin(StrEnum):
    """How the bounds of a control delay are known."""

    GUARANTEED = "guaranteed"  # by the device's specification
    MEASURED = "measured"  # in a limited number of trials
    ASSUMED = "assumed"  # not at all


@dataclass(frozen=True)
class ControlDelay:
    """Bounds of a camera's control delay.

    Attributes:
        smallest, largest: of the delay, frames; -1 where a setting acts on the running exposure
        origin: how they are known
        readout_s: measured time from the end of an exposure until its frame is here, s
        time, gain: (smallest, largest) of a change of this control alone; None: as of all
    """

    smallest: int
    largest: int
    origin: DelayOrigin = DelayOrigin.MEASURED
    readout_s: float = 0.0
    time: tuple[int, int] | None = None
    gain: tuple[int, int] | None = None

    @classmethod
    def from_record(cls, record: DelayRecord | None) -> Self:
        """Return the delay that a profile records; None: the delay was never measured."""
        return cls.of(None if record is None else record.bounds)

    @classmethod
    def of(cls, measured: MeasuredDelay | None) -> Self:
        """Return a measured delay; None: it is not known."""
        if measured is None:
            return cls(0, ASSUMED_LARGEST, DelayOrigin.ASSUMED)
        return cls(**vars(measured))

    def over(self, settings: Sequence[ExposureSetting]) -> Self:
        """Return the delay of the changes in a list: of the controls that change, where known.

        The setting in force before the list has to be its first one.
        """
        bounds = []
        if any(before.time_s != after.time_s for before, after in pairwise(settings)):
            bounds.append(self.time)
        if any(before.gain != after.gain for before, after in pairwise(settings)):
            bounds.append(self.gain)
        known = [each for each in bounds if each is not None]
        if not known or len(known) < len(bounds):
            return self
        smallest, largest = min(low for low, _ in known), max(high for _, high in known)
        return replace(self, smallest=smallest, largest=largest)

    @property
    def frames(self) -> int | None:
        """The delay if it is known and constant, for `ExposureControls.delay_frames`; else None."""
        is_constant = self.smallest == self.largest and self.origin is not DelayOrigin.ASSUMED
        return self.largest if is_constant else None

    def timing(self, lead_frames: float) -> CaptureTiming:
        """Return what the delay costs beside its frames; see `CaptureTiming.lead_frames`."""
        if self.frames is not None:
            return CaptureTiming(lead_frames=lead_frames, readout_s=self.readout_s)
        old = (self.smallest + self.largest) / 2
        unsettled = self.largest - old + (self.origin is not DelayOrigin.GUARANTEED)
        return CaptureTiming(
            lead_frames=lead_frames,
            readout_s=self.readout_s,
            old_frames=old,
            unsettled_frames=unsettled,
        )

    def findings(self, camera_id: str) -> tuple[Finding, ...]:
        """Return what a person should know of the delay, for `ExposureControls.findings`."""
        if self.origin is DelayOrigin.ASSUMED:
            return (Finding(code="delay_unknown", remedies={"calibrate_delay": camera_id}),)
        if self.frames is None:
            return (
                Finding(
                    code="delay_varies", value=self.largest, details={"smallest": self.smallest}
                ),
            )
        return ()


def with_delay(controls: ExposureControls, delay: ControlDelay, camera_id: str) -> ExposureControls:
    """Return the controls of a camera for another control delay of its stream."""
    timing = controls.timing or CaptureTiming()
    others = [each for each in controls.findings if each.code not in _FINDINGS]
    return replace(
        controls,
        delay_frames=delay.frames,
        timing=replace(
            delay.timing(timing.lead_frames),
            readout_s=delay.readout_s or timing.readout_s,
            rests=delay.frames is not None,
        ),
        findings=(*others, *delay.findings(camera_id)),
    )


#: Two frames have the same exposure if their brightnesses differ by at most this share of the
#: brightness, or of full scale: more than the noise of a mean, less than a step of exposure.
_SAME_RELATIVE, _SAME_OF_FULL_SCALE = 0.02, 0.002
#: Samples of which `mean_brightness` takes the mean, about: noise averages out to 1/128.
_SAMPLES = 1 << 14

DataT_co = TypeVar("DataT_co", covariant=True)


@dataclass(frozen=True)
class FrameStamp:
    """Which frame arrived.

    Attributes:
        number: of its slot; larger than the number of every frame before it
        time_s: when its exposure ended, on the camera's clock, s
        is_certain: False where an unknown number of frames was lost, so that the number may
            be wrong in relation to the numbers before it
        applied: the exposure that the camera states of this very frame (metadata, chunk data); None
            where it states none.  Some state the exposure of another frame, so that it is used
            only after the pixels have agreed, see `StatedExposures`
    """

    number: int
    time_s: float
    is_certain: bool = True
    applied: ExposureSetting | None = None


@dataclass(frozen=True)
class Written:
    """A setting that was written.

    Attributes:
        applied: the setting as read back from the device
        first, last: bounds of the number of the first slot that had not begun at the write; equal
            where it is certain in which slot the write took place
    """

    applied: ExposureSetting
    first: int
    last: int


class NumberedSource(Protocol[DataT_co]):
    """A running stream whose frames have slot numbers.

    Slots are numbered in the order of their exposure; the number of a lost frame is skipped.
    `DataT_co` is whatever the stream delivers as a frame: an array of pixels, or a buffer that is
    decoded later.  Each method may raise `camctl.CameraError`.
    """

    def next_frame(self) -> FrameStamp:
        """Wait for the next frame and state its number.

        Raises:
            CameraTimeoutError: no frame arrived within the time-out of the stream
        """

    def read(self) -> DataT_co | None:
        """Return the frame that arrived last; None where it is damaged."""

    def upcoming(self, *, late: bool = False) -> int | None:
        """Return the number of the first slot that has not begun, if a setting may be written now.

        Where a write would have to wait a moment for the current slot, this method waits.  `late`
        asks for the latest moment in the slot at which a write is still allowed.

        Returns:
            None where the current slot is too far advanced: take a frame, then ask again.
        """

    def write(self, setting: ExposureSetting) -> Written:
        """Set the exposure and read it back.

        Raises:
            RefusedSettingError: the device applied another setting
        """


def irregular_frames() -> CameraProtocolError:
    """Return the error for a stream in which no setting can be assigned to a frame."""
    return CameraProtocolError(
        "frames are lost, damaged, or arrive at irregular times",
        hint="close other programs, give the camera a USB port of its own, or choose a smaller "
        "size or a lower frame rate",
    )


def mean_brightness(pixels: Pixels, full_scale: int) -> float:
    """Return the mean of about 16,000 samples of a frame, as a share of `full_scale`, DN."""
    step = max(1, int((pixels.size / _SAMPLES) ** 0.5))
    return float(np.mean(pixels[::step, ::step])) / full_scale


def same_brightness(one: float, other: float) -> bool:
    """Return whether two mean brightnesses, shares of full scale, are those of one exposure."""
    return abs(one - other) <= max(_SAME_RELATIVE * one, _SAME_OF_FULL_SCALE)
