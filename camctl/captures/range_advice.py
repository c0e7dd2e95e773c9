"""What to say where much of a picture is outside its range, and which option mends it."""

from __future__ import annotations

from camctl.captures.advice_search import LOG, MUCH
from camctl.exposure.goal import AUTO, CURVE
from camctl.records.capture_plan import CapturePlan
from camctl.records.request import CaptureRequest
from camctl.system.number_text import range_text

UNEXPECTED = 0.02
"""Share of the samples that are saturated though metering did not show so much light, likewise."""

#: Stops by which a shorter exposure holds what lamps that flicker added, mostly.
_FLICKER_STOPS = 0.5

_OTHER_RESPONSE = "the {} response has few levels for it; take constant contrast (--response log)"


def outside_warnings(
    request: CaptureRequest,
    plan: CapturePlan,
    *,
    saturated: float,
    dark: float,
    repeatable: bool = True,
) -> list[str]:
    """Return a warning for each end of the range that more than `MUCH` of the samples are beyond.

    Where the light is not what was metered, more than `UNEXPECTED` is enough.

    Args:
        request: what was asked for
        plan: of the capture
        saturated: share of the samples that every frame saturated
        dark: share of the samples with light below the range
        repeatable: frames can be shot at other settings
    """
    found = []
    metered = _metered_clip(request, plan)
    if repeatable and metered is not None and saturated > metered + UNEXPECTED:
        stops = request.compensation_stops - _FLICKER_STOPS
        found.append(
            f"{saturated:.1%} of the picture is brighter than its range, and in the metering "
            f"frames {metered:.1%} was: the light changed, as that of lamps that flicker; expose "
            f"shorter (--compensation {stops:g})"
        )
    elif saturated > MUCH:
        advice = _shorter(request, plan, repeatable)
        found.append(f"{saturated:.1%} of the picture is brighter than its range: {advice}")
    if dark > MUCH:
        found.append(
            f"{dark:.1%} of the picture is darker than its range of "
            f"{range_text(plan.dynamic_range)}: "
            f"{_wider(request, plan, repeatable)}"
        )
    return found


def _metered_clip(request: CaptureRequest, plan: CapturePlan) -> float | None:
    """Return the share that was expected to clip; None where the exposure was not metered."""
    if request.base_s is not None or plan.light is None or plan.metering is None:
        return None
    return max(plan.light.clips, plan.metering.clipped, request.clip or 0.0)


def _shorter(request: CaptureRequest, plan: CapturePlan, repeatable: bool) -> str:
    """Return what to do where too much is saturated."""
    if request.base_s is not None:
        return "leave the base exposure (--base) out, so that it is metered"
    if plan.light is not None and plan.light.bright_advice is not None:
        return plan.light.bright_advice
    if not repeatable:
        return "a photograph with a shorter exposure would show it"
    return "close the aperture, or put a filter before the lens; no option makes the light less"


def _wider(request: CaptureRequest, plan: CapturePlan, repeatable: bool) -> str:
    """Return what to do where too much is dark."""
    if request.response == CURVE:
        return "it is that of the desired curve; give one of a larger range"
    if not repeatable:
        if plan.desired.name != LOG:
            return _OTHER_RESPONSE.format(plan.desired.name)
        return "photographs with longer exposures would show it"
    if request.base_s is not None:
        return (
            "leave the base exposure (--base) out, and take the range of the light (--range auto)"
        )
    if request.ratios is not None:
        return "these exposures do not show it; leave them (--ratios) out"
    if plan.light is not None and plan.light.advice is not None:
        return plan.light.advice
    if request.dynamic_range != AUTO:
        return (
            "let the light decide the range (--range auto), for which the shadows are metered, too"
        )
    return "open the aperture, or light the scene; the metering frames showed more light"
