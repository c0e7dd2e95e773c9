"""Where the settings of a plan differ from what was asked for."""

from __future__ import annotations

import math

from camctl.exposure.goal import XI, CaptureRequest
from camctl.exposure.light import NOTABLE_SHARE, Light
from camctl.exposure.search.settings import BASE_SLACK_ON_LIST_STOPS
from camctl.findings import Detail, Finding
from camctl.interface.controls import ExposureControls
from camctl.records.capture_plan import CapturePlan

NOTABLE_DIFFERENCE = 0.01
"""Relative difference between requested and applied exposure from which there is a finding."""

#: A plan below this share of the effective levels of the requested ratios has a finding.
_GOOD_SHARE = 0.9


def setting_findings(
    controls: ExposureControls,
    request: CaptureRequest,
    plan: CapturePlan,
    light: Light | None,
    possible: float,
) -> list[Finding]:
    """Return where the chosen settings differ from the request.

    Args:
        controls: of the camera
        request: what the user asks for
        plan: of it
        light: the metered light; None where the base exposure is given
        possible: effective levels that the requested ratios would give
    """
    found = []
    if light is not None:
        metering = light.metering
        if metering.highlight >= 1.0 and (
            NOTABLE_SHARE <= metering.clipped > light.share_above(1.0)
        ):
            found.append(Finding(code="highlights_cut", value=metering.clipped))
        found += _compensation_finding(controls, request, plan)
        found += _shortened_finding(controls, request, plan)
    if request.base_s is not None:
        requested_s = request.base_s * 2.0**request.compensation_stops
        if abs(plan.base_s / requested_s - 1) > NOTABLE_DIFFERENCE:
            found.append(_differs("base_s", requested_s, plan.base_s))
    if request.ratios is not None:
        found += [
            _differs("ratios", requested, applied)
            for requested, applied in zip(plan.ratios, plan.exposures, strict=True)
            if abs(applied / requested - 1) > NOTABLE_DIFFERENCE
        ]
    if request.mains_hz is not None:
        period_s = 0.5 / request.mains_hz
        for setting in plan.settings:
            count = setting.time_s / period_s
            if abs(count - round(count)) > NOTABLE_DIFFERENCE * max(1.0, count) or count < 0.5:
                found.append(
                    Finding(code="flicker", value=setting.time_s, details={"period_s": period_s})
                )
    if plan.effective_levels < _GOOD_SHARE * possible:
        found.append(
            Finding(
                code="steps_cost_levels",
                value=plan.effective_levels,
                details={"possible": possible},
            )
        )
    return found


def _differs(field: str, requested: float, applied: float) -> Finding:
    details: dict[str, Detail] = {"field": field, "requested": requested}
    return Finding(code="setting_differs", value=applied, details=details)


def _compensation_finding(
    controls: ExposureControls, request: CaptureRequest, plan: CapturePlan
) -> list[Finding]:
    """Return a finding where a compensation goes beyond the camera's shutter times."""
    assert plan.metering is not None  # as the caller has checked
    time, stops, near = controls.time_s, request.compensation_stops, 1 + NOTABLE_DIFFERENCE
    requested_s = plan.metering.limit_s * 2.0**stops
    if time.minimum <= requested_s * near and requested_s <= time.maximum * near:
        return []
    possible = math.log2(plan.base_s / plan.metering.limit_s)
    # In tenths, and within the camera's times: else the same finding would come again.
    tenths = round(10 * possible, 6)
    within = (math.ceil(tenths) if requested_s < time.minimum else math.floor(tenths)) / 10
    return [
        Finding(
            code="setting_differs",
            value=plan.base_s,
            details={
                "field": "compensation_stops",
                "requested": requested_s,
                "stops": stops,
                "possible_stops": possible,
                "least_s": time.minimum,
                "most_s": time.maximum,
            },
            remedies={"compensation_stops": within + 0.0},
        )
    ]


def _shortened_finding(
    controls: ExposureControls, request: CaptureRequest, plan: CapturePlan
) -> list[Finding]:
    """Return a finding where the shortest exposure is shorter than the light requires.

    By accuracy any shortest exposure may be the best; whole periods of lamps are shorter, too.
    """
    assert plan.metering is not None  # as the caller has checked
    allowed_s = plan.metering.limit_s * 2.0**request.compensation_stops
    # The search may choose it below its limit, to fit the camera's steps.
    slack = 2.0**BASE_SLACK_ON_LIST_STOPS * (1 + NOTABLE_DIFFERENCE)
    longer = controls.time_s.between(plan.base_s * slack, allowed_s, 1)
    if plan.objective != XI or request.mains_hz is not None or not longer:
        return []
    stops = math.log2(allowed_s / plan.base_s)
    return [Finding(code="base_shortened", value=plan.base_s, details={"stops": stops})]
