"""The control delay of a stream: its bounds, how they are known, and what they cost in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Self

from camctl.findings import Finding
from camctl.interface.camera import MeasuredDelay
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
