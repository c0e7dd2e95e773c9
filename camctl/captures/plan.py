"""From a request to the settings that will be shot, and where they differ from the request."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from camctl.captures.metering import meter_light
from camctl.exposure.accurate.judge import JUDGED_FRAMES
from camctl.exposure.evaluation import evaluate
from camctl.exposure.goal import AUTO, XI, CaptureRequest
from camctl.exposure.light import NOTABLE_SHARE, Light
from camctl.exposure.noise import DITHERS, coarser
from camctl.exposure.objective import xi
from camctl.exposure.search.best import Search
from camctl.exposure.search.front import SAME_LEVELS
from camctl.exposure.search.ranges import Chosen
from camctl.exposure.search.settings import BASE_SLACK_ON_LIST_STOPS, relative_exposures
from camctl.exposure.search.wall_time import predicted_wall_s
from camctl.exposure.table import ExposureTable
from camctl.findings import Detail, Finding
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.inverse import posterior_of
from camctl.model.response.desired import DesiredResponse
from camctl.records.capture_plan import CapturePlan, PlannedLight

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


#: Irradiances at which the share below the range is computed: 20 in each of 20 stops.
_NODES = 400
#: Levels of a camera up to which the plan is rated with all of them: 14 bits and more take seconds.
_MOST_EXACT = 8191


def plan_capture(
    camera: Camera,
    request: CaptureRequest,
    *,
    table: ExposureTable | None = None,
    progress: Callable[[float], None] | None = None,
    light: Light | None = None,
) -> CapturePlan:
    """Meter where needed, look the ratios up, and choose among the settings the camera has.

    Without `table` the ratios come from the shipped table or the user's cache; ratios that neither
    of them holds for this camera's levels are solved once, which takes seconds, and cached.

    Args:
        camera: an open camera
        request: what the user asks for
        table: the only table in which ratios are looked up
        progress: called with the share done, 0 to 1, while ratios are solved
        light: of the scene, where `meter_light` was called before

    Raises:
        UsageError: the request cannot be met by any camera, or not with `table`
        DataError: `table` has no row for this camera and request
        CaptureError: an exposure is beyond the camera's controls
    """
    search = Search(camera.controls, request, table, progress)
    light = light or meter_light(camera, search.request)
    return plan_for(camera.controls, search, light)


def plan_for(
    controls: ExposureControls,
    search: Search,
    light: Light | None,
    whole: ExposureControls | None = None,
) -> CapturePlan:
    """Return the plan for a light that is limited by the request of `search`.

    Args:
        controls: what may be set
        search: for the request
        light: of the scene; None where the base exposure is given
        whole: what the camera could set, where `controls` are a part of it

    Raises:
        UsageError, CaptureError: no settings of the camera meet the request
    """
    request, real = search.request, controls.levels
    chosen = search.best(controls, light)
    desired, settings, ratios = chosen.desired, chosen.settings, chosen.ratios
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)
    exposures = controls.relative_exposures(settings)
    noise = None if controls.noise is None else controls.frame_noise(settings)

    # Before the levels, which follow from the same table.
    planned = None if light is None else planned_light(light, chosen, controls)

    front, levels = chosen.front, chosen.levels

    def levels_of(some: Sequence[float]) -> float:
        """Return the effective levels of exposures, kept where there is a front."""
        if front is None or noise is None:
            return evaluate(real, desired, some, noise=noise).effective_levels
        if levels is None or not front.is_smooth or _is_rated_by_all(controls, settings):
            return front.levels_with(some, noise)
        return front.levels_like(levels, settings, some)  # in much less time

    if levels is None or noise is None or _is_rated_by_all(controls, settings):
        levels = levels_of(exposures)
    camera = EffectiveCamera.of(real, exposures)
    plan = CapturePlan(
        response=request.response,
        dynamic_range=desired.dynamic_range,
        ratios=ratios,
        settings=settings,
        exposures=relative_exposures(settings),
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=levels_wanted,
        xi=xi(camera, desired, levels_wanted),
        effective_levels=levels,
        effective_levels_noise_free=effective_levels(camera, desired),
        metering=None if light is None else light.metering,
        curve=_samples(desired) if request.response == AUTO else request.desired_curve,
        gamma=request.gamma,
        wall_s=predicted_wall_s(controls, settings, before=None if light is None else light.last),
        is_wall_known=controls.timing is not None,
        noise=controls.noise,
        objective=search.objective,
        light=planned,
        scene=light if planned is not None and planned.needs_advice else None,
        front=chosen.front,
    )
    possible = levels
    if noise is None or not np.allclose(exposures, ratios, rtol=SAME_LEVELS, atol=0.0):
        possible = levels_of(ratios)
    return replace(
        plan,
        findings=(
            *controls.response_findings,
            *controls.findings,
            *(Finding(code="curve_repaired", details={"repair": each}) for each in real.notes),
            *setting_findings(whole or controls, request, plan, light, possible),
        ),
    )


def planned_light(light: Light, chosen: Chosen, controls: ExposureControls) -> PlannedLight:
    """Return how much of the light the chosen exposures hold."""
    end, metering = light.saturating(chosen.settings[0].exposure), light.metering
    return PlannedLight(
        span=light.brightest / light.seen_shadows,
        is_open=light.is_open,
        unseen=light.unseen,
        clips=light.share_above(end),
        clips_stops=max(0.0, math.log2(light.brightest / end)),
        dark=_dark_share(light, end, chosen, controls),
        needed=light.needed_from(chosen.settings[0]),
        needed_levels=chosen.needed_levels,
        is_cut=metering.highlight >= 1.0 and metering.clipped > 0,
    )


def _dark_share(light: Light, end: float, chosen: Chosen, controls: ExposureControls) -> float:
    """Return the share of the light that the masks of the pictures will say is too dark.

    Args:
        light: of the scene
        end: light that just saturates the shortest exposure
        chosen: the exposures
        controls: of the camera
    """
    settings, irradiance = chosen.settings, light.irradiance / end
    camera = EffectiveCamera.of(controls.levels, relative_exposures(settings))
    dithers = DITHERS if controls.levels.M <= _MOST_EXACT else 0.0
    camera, noise = coarser(camera, controls.frame_noise(settings), dithers)
    posterior = posterior_of(camera, chosen.desired, noise)
    has_noise = controls.noise is not None and not controls.noise.is_none
    E = np.geomspace(irradiance[0], irradiance[-1], _NODES)
    if has_noise and _is_rated_by_all(controls, settings):
        dark = posterior.shares(E, posterior.inverse.dark)  # levels and pictures need the inverse
    else:
        dark = posterior.dark_shares(E)
    return float(np.interp(irradiance, E, dark) @ light.shares)


def _is_rated_by_all(controls: ExposureControls, settings: Sequence[ExposureSetting]) -> bool:
    """Return whether a plan is rated by all levels, once more than by the search.

    The search has done so for many frames, and does nearly as well for many levels.
    """
    return controls.levels.M <= _MOST_EXACT and len(settings) <= JUDGED_FRAMES


def _samples(desired: DesiredResponse) -> tuple[tuple[float, float], ...]:
    """Return a sampled response as pairs (irradiance, u)."""
    irradiance = np.concatenate(([desired.e_min], desired.knots, [1.0]))
    return tuple(zip(irradiance.tolist(), desired.u(irradiance).tolist(), strict=True))
