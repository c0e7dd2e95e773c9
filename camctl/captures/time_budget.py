"""Settings whose predicted time is within a budget, where not all of that time is known before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

from camctl.captures.setting_selection import at_most
from camctl.captures.wall_time import time_costs
from camctl.errors import CaptureError, UsageError
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.records.request import CaptureRequest

#: Attempts to find settings within a time budget.
_ATTEMPTS = 6
#: Relative difference up to which a time is within the budget: more than that of float64.
_SAME = 1e-8

Found: TypeAlias = tuple[tuple[ExposureSetting, ...], tuple[float, ...]]
"""Settings, and the ratios that were asked of the camera."""


def within_budget(
    request: CaptureRequest,
    allowed: CaptureRequest,
    choose: Callable[[CaptureRequest], Found],
    wall_s: Callable[[Sequence[ExposureSetting]], float],
) -> Found:
    """Return settings whose predicted time is within the budget of `request`, and their ratios.

    `choose` does not count all that takes time: it is asked for less until its settings fit.

    Args:
        request: what the user asks for
        allowed: the request to `choose` first
        choose: returns settings and ratios
        wall_s: returns the predicted time of settings, s

    Raises:
        UsageError: as `choose` does for `allowed`
        CaptureError: the same, or no settings that fit were found
    """
    budget_s, reduction = request.time_budget_s, 1.0
    found = choose(allowed)
    if budget_s is None:
        return found
    for _ in range(_ATTEMPTS):
        over_s = wall_s(found[0]) - budget_s
        if over_s <= _SAME * budget_s:
            return found
        assert allowed.time_budget_s is not None  # it is that of `request`, or less
        try:
            allowed = replace(allowed, time_budget_s=allowed.time_budget_s - reduction * over_s)
            found = choose(allowed)
        except (CaptureError, UsageError):  # nothing is as short as that
            break
        reduction *= 2
    raise CaptureError(
        f"no settings of this camera were found that fit into {budget_s:.4g} s",
        hint="allow more time, or take fewer exposures",
    )


def shutter_budget(
    controls: ExposureControls,
    request: CaptureRequest,
    limit_s: float,
    before: ExposureSetting | None,
) -> CaptureRequest:
    """Return the request with its time budget reduced to what remains for shutter times.

    Args:
        controls: of the camera
        request: what the user asks for
        limit_s: the longest shutter time of the shortest exposure, s
        before: the setting of the frame before

    Raises:
        UsageError: the budget is too short for the number of exposures
    """
    if request.time_budget_s is None:
        return request
    count = len(request.ratios or ()) or request.most_exposures
    base_s = at_most(controls.time_s, limit_s)
    costs = time_costs(controls, before=before, shortest_s=base_s)
    left_s, least_s = request.time_budget_s - costs.fixed, costs.total([base_s] * count)
    if least_s > left_s + _SAME * request.time_budget_s:
        raise UsageError(
            f"{count} exposures do not fit into {request.time_budget_s:.4g} s",
            hint=f"the least is {least_s + costs.fixed:.4g} s; allow more, or take fewer exposures",
        )
    return replace(request, time_budget_s=costs.shutter(left_s, count))
