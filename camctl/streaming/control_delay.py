"""The control delay of a stream: its bounds, how they are known, and what they cost in time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from camctl.findings import Finding
from camctl.interface.clock import CaptureTiming
from camctl.profiles.profile import DelayRecord

ASSUMED_LARGEST = 6
"""Largest delay, in frames, that is assumed where none was measured: usual webcams have half of it.
"""


class DelayOrigin(StrEnum):
    """How the bounds of a control delay are known."""

    GUARANTEED = "guaranteed"  # by the device's specification
    MEASURED = "measured"  # in a limited number of trials
    ASSUMED = "assumed"  # not at all


@dataclass(frozen=True)
class ControlDelay:
    """Bounds of a camera's control delay.

    Attributes:
        smallest, largest: of the delay, frames
        origin: how they are known
        readout_s: measured time from the end of an exposure until its frame is here, s
    """

    smallest: int
    largest: int
    origin: DelayOrigin = DelayOrigin.MEASURED
    readout_s: float = 0.0

    @classmethod
    def from_record(cls, record: DelayRecord | None) -> Self:
        """Return the delay that a profile records; None: the delay was never measured."""
        if record is None:
            return cls(0, ASSUMED_LARGEST, DelayOrigin.ASSUMED)
        readout_s = record.timing.readout_s if record.timing else 0.0
        return cls(record.smallest, record.largest, readout_s=readout_s)

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
