"""What is known of the frames of a capture: their part of ``report.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from camctl.evidence.ratio_check import RatioCheck, ReportModel
from camctl.interface.controls import ExposureSetting
from camctl.interface.orientation import Orientation

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class ExposureRatio(ReportModel):
    """A frame's exposure relative to the smallest one of the capture, and where it comes from.

    Attributes:
        exposure: with which the pictures are computed
        used: where `exposure` comes from: the label of the camera, its profile, or the estimate
        label: as the camera states it
        profile: as the camera's profile corrects it; None where it has no correction
        estimate: from the pixels; None where it was not estimated
        low: lower end of the 95 % confidence interval of the estimate, or of the profile's value if
            there is no estimate
        high: upper end
    """

    exposure: float
    used: Literal["label", "profile", "estimate"]
    label: float
    profile: float | None = None
    estimate: float | None = None
    low: float | None = None
    high: float | None = None


class StoredFrame(ReportModel):
    """One frame of a capture.

    Attributes:
        file: its samples in the capture's folder; None for a capture in memory
        sha256: checksum of that file, in hexadecimal
        original: the camera's own file there, where it made one
        original_sha256: checksum of that file
        requested: the setting that was asked for
        applied: the setting read back from the camera
        requested_s: shutter time of `requested`, s
        applied_s: shutter time of `applied`, s
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
        saturated_fraction: share of its samples at or above white
        timestamp_s: when the exposure ended, on the camera's clock, s
        ratio: its exposure compared with the frame before
        attempts: 2 where it was shot again because its exposure did not agree
        lost: frames of its setting that the camera lost, or sent unreadable, before this one
        details: what the camera reported besides
    """

    model_config = ConfigDict(extra="ignore")  # a frame of a complete capture has more fields

    file: str | None = None
    sha256: _Sha256 | None = None
    original: str | None = None
    original_sha256: _Sha256 | None = None
    requested: ExposureSetting
    applied: ExposureSetting
    requested_s: float
    applied_s: float
    black: int
    white: int
    saturated_fraction: float
    timestamp_s: float
    ratio: RatioCheck | None = None
    attempts: int = 1
    lost: int = 0
    details: dict[str, Any] = Field(default_factory=dict)

    @property
    def orientation(self) -> Orientation:
        """How its pixels lie."""
        return Orientation.of_details(self.details)


class FrameRecord(StoredFrame):
    """One frame of a complete capture.

    Attributes:
        exposure: with which the pictures are computed, relative to the smallest of the capture
        exposure_ratio: where it comes from
    """

    model_config = ConfigDict(extra="forbid")

    exposure: float
    exposure_ratio: ExposureRatio | None = None


_DETAIL = "simulation"


class _FramePlan(BaseModel):
    """What a simulated camera reports of one frame in its details."""

    tolerance_dn: float
    joint_bound_dn: float
    left_out: dict[str, float]


_PLANS: TypeAdapter[list[_FramePlan]] = TypeAdapter(list[_FramePlan])


class LeftOut(ReportModel):
    """An effect that some frames lack.

    Attributes:
        frames: numbers of these frames, 1 first
        bound_dn: the most that the effect alone can change in a sample of one of them, DN
    """

    frames: list[int]
    bound_dn: float


class SimulationSummary(ReportModel):
    """Which effects of a simulated sensor the frames lack, and what that can change in their sum.

    Attributes:
        tolerance_dn: tolerance of the sum, DN
        joint_bound_dn: the most that all that was left out can change in a sample of the sum, DN
        left_out: the effects that frames lack, by name
    """

    tolerance_dn: float
    joint_bound_dn: float
    left_out: dict[str, LeftOut]


def simulation_summary(frames: Sequence[StoredFrame]) -> SimulationSummary | None:
    """Return the summary of frames by a simulated camera; None if another camera took them."""
    try:
        plans = _PLANS.validate_python([frame.details.get(_DETAIL) for frame in frames])
    except ValidationError:
        return None
    lacking: dict[str, LeftOut] = {}
    for number, plan in enumerate(plans, 1):
        for name, bound_dn in plan.left_out.items():
            before = lacking.get(name, LeftOut(frames=[], bound_dn=0.0))
            lacking[name] = LeftOut(
                frames=[*before.frames, number], bound_dn=max(before.bound_dn, bound_dn)
            )
    return SimulationSummary(
        tolerance_dn=sum(plan.tolerance_dn for plan in plans),
        joint_bound_dn=sum(plan.joint_bound_dn for plan in plans),
        left_out=lacking,
    )


def without_plan(frame: StoredFrame) -> dict[str, object]:
    """Return the fields of a frame without those details that the summary has."""
    details = {name: value for name, value in frame.details.items() if name != _DETAIL}
    return {**dict(frame), "details": details}
