"""What the frames of a capture lack if their camera is simulated: one summary of all frames."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import BaseModel, TypeAdapter, ValidationError

from camctl.evidence.ratio_check import ReportModel
from camctl.records.frame import StoredFrame

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
