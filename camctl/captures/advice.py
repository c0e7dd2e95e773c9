"""What helps where light is outside the range of a picture, or spread in it.

Advice is asked for: each change of the request is tried on the metered light first, which takes as
long as the plan did, or some times as long.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

from camctl.captures.plan import NOTABLE_DIFFERENCE, plan_for
from camctl.errors import CaptureError, DataError, UsageError
from camctl.evidence.ratio_check import LAMP_DEPTH, MOST, SMALL_THING
from camctl.exposure.goal import AUTO, CURVE, XI, CaptureRequest
from camctl.exposure.light import GAINED_FACTOR, LAMP_SHARE, MOST_UNSEEN_STOPS, Light
from camctl.exposure.search.best import Search
from camctl.findings import Detail, Finding
from camctl.interface.controls import ExposureControls
from camctl.model.response.names import RANGES
from camctl.records.capture_plan import MUCH, NEARLY_MUCH, CapturePlan

MUCH_SPREAD = 0.01
"""Share of the samples that are too bright by spread light, from which there is a finding."""

LOG = "log"

#: Fewest effective levels that are advised: with fewer a picture shows steps.
_LEAST_LEVELS = 16.0
#: Stops by which an exposure holds the brightest light of lamps, up to tenths.
_FLICKER_STOPS = math.ceil(10 * math.log2(1 + LAMP_DEPTH)) / 10
#: Numbers of exposures that are tried.
_COUNTS = (3, 6)


@dataclass(frozen=True)
class _Tried:
    """A changed request with its plan, and the share of the samples that stays outside."""

    request: CaptureRequest
    plan: CapturePlan
    outside: float


def range_findings(
    request: CaptureRequest,
    plan: CapturePlan,
    controls: ExposureControls,
    *,
    saturated: float,
    dark: float,
) -> list[Finding]:
    """Return a finding for each end of the range that more than `MUCH` of the samples are beyond.

    Where the light is not what was metered, more than `SMALL_THING` is enough.

    Args:
        request: what was asked for
        plan: of the capture
        controls: of the camera
        saturated: share of the samples that every frame saturated, or will
        dark: share of the samples with light below the range
    """
    found = []
    metered = _metered_clip(request, plan)
    if controls.repeatable and metered is not None and saturated > metered + SMALL_THING:
        found.append(
            Finding(
                code="light_changed",
                value=saturated,
                details={"metered": metered},
                remedies={"compensation_stops": request.compensation_stops - _FLICKER_STOPS},
            )
        )
    elif saturated > MUCH:
        remedies, details = _shorter(request, plan, controls)
        found.append(
            Finding(
                code="light_above_range",
                value=saturated,
                details={"photographs": not controls.repeatable, **details},
                remedies=remedies,
            )
        )
    if dark > MUCH:
        remedies, details = _wider(request, plan, controls)
        found.append(
            Finding(
                code="light_below_range",
                value=dark,
                details={
                    "dynamic_range": plan.dynamic_range,
                    "response": plan.desired.name,
                    "photographs": not controls.repeatable,
                    **details,
                },
                remedies=remedies,
            )
        )
    return found


_Advice = tuple[dict[str, Any], dict[str, Detail]]
"""Changed fields of the request, and details: what they leave outside, and how long they take."""


def _metered_clip(request: CaptureRequest, plan: CapturePlan) -> float | None:
    """Return the share that was expected to clip; None where the exposure was not metered."""
    if request.base_s is not None or plan.light is None or plan.metering is None:
        return None
    return max(plan.light.clips, plan.metering.clipped, request.clip or 0.0)


def _shorter(request: CaptureRequest, plan: CapturePlan, controls: ExposureControls) -> _Advice:
    """Return what helps where too much is saturated."""
    if request.base_s is not None:
        return {"base_s": False}, {}
    light = plan.light
    if light is None or light.clips <= NEARLY_MUCH:
        return {}, {}
    if plan.scene is None:  # a folder does not keep it: for a resumed capture nothing can be tried
        asked = [*_shorter_requests(request)] if controls.repeatable else []
        return _advice(request, _Tried(asked[-1], plan, 0.0)) if asked else ({}, {})
    best: _Tried | None = None
    for shorter in _shorter_requests(request):
        tried = _predict(shorter, plan.scene, controls)
        if tried is None or tried.light is None:
            continue
        if best is None or tried.light.clips < best.outside:
            best = _Tried(shorter, tried, tried.light.clips)
        if best.outside <= min(MUCH, MOST * light.clips):
            break
    if best is None or best.outside > MOST * light.clips:
        return {}, {}
    return _advice(request, best)


def _wider(request: CaptureRequest, plan: CapturePlan, controls: ExposureControls) -> _Advice:
    """Return what helps where too much is dark."""
    if request.response == CURVE:
        return {"desired_curve": None}, {}
    if not controls.repeatable:
        if plan.desired.name != LOG:
            return {"response": LOG}, {}
        # What is dark in the picture, and not in all photographs, a larger range shows.
        if plan.light is not None and plan.light.unseen <= MOST * plan.light.dark:
            left = plan.light.unseen
            return {"dynamic_range": AUTO}, {"left": left} if left > MUCH else {}
        return {}, {}
    if request.base_s is not None:
        return {"base_s": False, "dynamic_range": AUTO}, {}
    if request.ratios is not None:
        return {"ratios": False}, {}
    if plan.scene is not None and plan.scene.has_shadows:
        return _shown(request, plan, controls)
    return ({"dynamic_range": AUTO} if request.dynamic_range != AUTO else {}), {}


def _shown(request: CaptureRequest, plan: CapturePlan, controls: ExposureControls) -> _Advice:
    """Return the change that shows the dark light: it leaves little dark, or else the least."""
    light = plan.light
    assert light is not None  # it was metered
    if light.dark > MUCH:
        best = _most_shown(request, plan, plan.scene, controls)
        if best is not None and best.outside <= MOST * light.dark:
            if best.outside > MUCH:
                best = _with_another(best, plan.scene, controls)
            return _advice(request, best)
    elif light.unseen <= MUCH:
        return ({"dynamic_range": AUTO} if request.dynamic_range != AUTO else {}), {}
    if light.unseen <= MUCH:
        return {}, {}
    longest_s = max(setting.time_s for setting in plan.settings)
    reach = _reach(plan, controls) / GAINED_FACTOR
    for tried in _tried(request, plan, plan.scene, controls):
        if tried.outside <= MUCH and _reach(tried.plan, controls) <= reach:
            remedies, details = _advice(request, tried)
            return remedies, {**details, "unseen": True}
    if longest_s * (1 + NOTABLE_DIFFERENCE) >= controls.time_s.maximum:
        return {}, {"unseen": True, "longest_s": longest_s}
    return {}, {"unseen": True}


def _advice(request: CaptureRequest, best: _Tried) -> _Advice:
    """Return the changed fields, and the share that stays outside where it is still large."""
    names = [field.name for field in fields(request)]
    changed = {
        name: False if getattr(best.request, name) is None else getattr(best.request, name)
        for name in names
        if getattr(best.request, name) != getattr(request, name)
    }
    if "response" in changed:
        changed.pop("gamma", None)  # it was the exponent of the other response
    details: dict[str, Detail] = {}
    if best.outside > MUCH:
        details["left"] = best.outside
    if "time_budget_s" in changed:
        details["wall_s"] = best.plan.wall_s
    return changed, details


def _predict(
    request: CaptureRequest, light: Light, controls: ExposureControls
) -> CapturePlan | None:
    """Return what a request would give with the light; None: it cannot be met."""
    try:
        return plan_for(controls, Search(controls, request), light.limited(request, controls))
    except (CaptureError, DataError, UsageError):
        return None


def _tried(
    request: CaptureRequest, plan: CapturePlan, light: Light, controls: ExposureControls
) -> Iterator[_Tried]:
    """Yield the changes that give a picture with enough levels in which no more clips."""
    assert plan.light is not None  # it was metered
    for changed, predicted in _trials(request, plan, light, controls):
        tried = predicted or _predict(changed, light, controls)
        if tried is None or tried.light is None:
            continue
        if tried.effective_levels < min(_LEAST_LEVELS, MOST * plan.effective_levels):
            continue
        if tried.light.clips <= max(MUCH, plan.light.clips):
            yield _Tried(changed, tried, tried.light.dark)


def _most_shown(
    request: CaptureRequest, plan: CapturePlan, light: Light, controls: ExposureControls
) -> _Tried | None:
    """Return the first change that leaves little dark, or else the one that leaves least."""
    best = None
    for tried in _tried(request, plan, light, controls):
        if best is None or tried.outside < best.outside:
            best = tried
        if best.outside <= MUCH:
            break
    return best


def _with_another(first: _Tried, light: Light, controls: ExposureControls) -> _Tried:
    """Return a change with the one that helps most beside it, or alone if none does."""
    second = _most_shown(first.request, first.plan, light, controls)
    if second is None or second.outside > MOST * first.outside:
        return first
    return second


def _reach(plan: CapturePlan, controls: ExposureControls) -> float:
    """Return the least light that the exposures of a plan, and its range, can show."""
    exposures = [setting.exposure for setting in plan.settings]
    level = float(controls.levels.levels[0])
    return max(plan.desired.e_min / min(exposures), level / max(exposures))


def _shorter_requests(request: CaptureRequest) -> Iterator[CaptureRequest]:
    """Yield what shortens the exposures, in the order in which it is advised."""
    if request.compensation_stops > 0:
        yield replace(request, compensation_stops=0.0)
    if request.clip:
        yield replace(request, clip_percent=None)
    if request.compensation_stops > 0 and request.clip:
        yield replace(request, compensation_stops=0.0, clip_percent=None)


def _trials(
    request: CaptureRequest, plan: CapturePlan, light: Light, controls: ExposureControls
) -> Iterator[tuple[CaptureRequest, CapturePlan | None]]:
    """Yield what may help, in the order in which it is advised, and its plan where it is known."""
    if request.dynamic_range != AUTO:
        yield replace(request, dynamic_range=AUTO), None
    if request.compensation_stops < 0:
        yield replace(request, compensation_stops=0.0), None
    if request.clip is not None and request.clip < LAMP_SHARE:
        yield replace(request, clip_percent=None), None
    if request.time_budget_s is not None:
        # With a budget of the time that it takes it may be another one, of a smaller range.
        free = replace(request, time_budget_s=None)
        predicted = _predict(free, light, controls)
        if predicted is not None and predicted.wall_s is not None:
            yield free, predicted
    if request.count is not None or request.time_budget_s is None:
        for count in _COUNTS:
            # For the objective xi, solving more exposures may take minutes.
            if count > request.most_exposures and (plan.objective != XI or count == _COUNTS[0]):
                yield replace(request, count=count), None
    if request.accuracy is not None:
        yield replace(request, accuracy=None), None
    if request.dynamic_range == AUTO and plan.objective != XI:
        assert plan.light is not None  # it was metered
        levels = math.floor(plan.light.needed_levels or 0.0)
        if levels >= _LEAST_LEVELS and request.accuracy is None:
            yield replace(request, accuracy=float(levels)), None
        for stops in range(1, 1 + math.floor(MOST_UNSEEN_STOPS)):
            yield replace(request, dynamic_range=plan.dynamic_range * 2.0**stops), None
    if request.clip is None:
        for percent in range(1, math.ceil(100 * MUCH)):
            yield replace(request, clip_percent=float(percent)), None
    if plan.desired.name != LOG:
        yield replace(request, response=LOG, gamma=None), None


def spread_findings(
    request: CaptureRequest, plan: CapturePlan, spread: float, *, repeatable: bool = True
) -> list[Finding]:
    """Return a finding if at least `MUCH_SPREAD` of the samples are too bright by spread light.

    A bright thing beside saturated samples that moved looks the same.  What helps is a shorter
    longest exposure, and better still to keep the light that saturates out of the picture.  A range
    only a little smaller can have more spread light: another exposure of the bracket is then in the
    middle.

    Args:
        request: what was asked for
        plan: of the capture
        spread: share of the samples, see `FoundMovement`
        repeatable: frames can be shot at other settings
    """
    if spread < MUCH_SPREAD:
        return []
    remedies: dict[str, Any] = {}
    if repeatable:
        is_free = request.ratios is None and request.response != CURVE
        if is_free and plan.dynamic_range > RANGES["low"]:
            remedies["dynamic_range"] = RANGES["low"]
        if request.base_s is not None:
            remedies["base_s"] = request.base_s / GAINED_FACTOR
        else:
            remedies["compensation_stops"] = request.compensation_stops - math.log2(GAINED_FACTOR)
    details: dict[str, Detail] = {"photographs": not repeatable}
    return [Finding(code="light_spread", value=spread, details=details, remedies=remedies)]
