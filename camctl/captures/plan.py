"""From a request to the settings that will be shot, and the result that they should give."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from camctl.captures.accurate_settings import (
    accurate_settings,
    estimated_levels,
    objective_of,
)
from camctl.captures.advice_search import bright_advice, dark_advice
from camctl.captures.metering import MeteringFrames, light_histogram, meter
from camctl.captures.range_choice import Chosen, Metered, choose_range
from camctl.captures.setting_selection import (
    SettingChooser,
    reach_shadows,
    search_choices,
    setting_warnings,
)
from camctl.captures.time_budget import Found, shutter_budget, within_budget
from camctl.captures.wall_time import predicted_wall_s
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.evaluation import evaluate
from camctl.exposure.goal import ACCURACY, AUTO, RANGE_WITHOUT_LIGHT, XI
from camctl.exposure.objective import Objective, xi
from camctl.exposure.solver import SearchOptions, solve
from camctl.exposure.table import ExposureTable
from camctl.findings import note
from camctl.interface.camera import Camera, PreviewingCamera
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.records.capture_plan import CapturePlan, relative_exposures
from camctl.records.request import CaptureRequest
from camctl.records.scene_light import NOTABLE_SHARE
from camctl.system.number_text import range_text

#: Effort of a search that the user waits for after metering: its xi is within 1 % of the full one.
_QUICK_EFFORT = 0.1
#: Share of a time budget that is solved for; the rest is for rounding to the camera's steps.
_BUDGET_SHARE = 0.995
#: Levels sorted while sets of settings are compared: about a second of work.
_MOST_LEVELS_SORTED = 8_000_000
#: Sets of settings that are compared at least and at most.
_LEAST_SETS, _MOST_SETS = 16, 400
#: A plan below this share of the effective levels of the requested ratios gets a warning.
_GOOD_SHARE = 0.9

_Progress = Callable[[float], None] | None


def plan_capture(
    camera: Camera,
    request: CaptureRequest,
    *,
    table: ExposureTable | None = None,
    progress: Callable[[float], None] | None = None,
    metered: Metered | None = None,
) -> CapturePlan:
    """Meter where needed, look the ratios up, and choose among the settings the camera has.

    Without `table` the ratios come from the shipped table or the user's cache; ratios that neither
    of them holds for this camera's levels are solved once, which takes seconds, and cached.

    Args:
        camera: an open camera
        request: what the user asks for
        table: the only table in which ratios are looked up
        progress: called with the share done, 0 to 1, while ratios are solved
        metered: the light, where `meter_light` was called before

    Raises:
        UsageError: the request cannot be met by any camera, or not with `table`
        DataError: `table` has no row for this camera and request
        CaptureError: an exposure is beyond the camera's controls
    """
    plan, light = _plan(camera, request, table, progress, metered)
    if plan.light is None:
        return plan

    def predict(other: CaptureRequest) -> CapturePlan | None:
        try:
            return _plan(camera, other, table, None, light.limited(other, camera.controls))[0]
        except (CaptureError, DataError, UsageError):  # it cannot be met
            return None

    found = replace(plan.light, bright_advice=bright_advice(request, plan, predict))
    is_free = isinstance(camera, PreviewingCamera) or request.desired is None
    # Else its shadows were not metered, or there are no other frames.
    if is_free and camera.controls.repeatable:
        found = replace(found, advice=dark_advice(request, plan, camera.controls, predict))
    return replace(plan, light=found)


def _plan(
    camera: Camera,
    request: CaptureRequest,
    table: ExposureTable | None,
    progress: _Progress,
    metered: Metered | None,
) -> tuple[CapturePlan, Metered]:
    """Return a plan without advice, and the light that it is for; see `plan_capture`."""
    controls, real = camera.controls, camera.controls.levels
    if table is not None and request.given_range is None:
        request = replace(request, dynamic_range=RANGE_WITHOUT_LIGHT)
    warnings = [*real.notes]
    known = (*controls.response_findings, *controls.findings)
    kind = objective_of(request, controls, has_table=table is not None)
    desired, ratios = request.desired, None
    if request.ratios is None and (desired is None or request.time_budget_s is not None):
        if table is not None:
            raise UsageError(
                "a table has no exposures for a time budget or an automatic response",
                hint="leave the table (--table) out, or name the response",
            )
    elif desired is not None and kind == XI:
        ratios = lookup_ratios(real, desired, request, table, progress)
    metered = metered or meter_light(camera, request)
    warnings += metered.warnings
    metering, limit_s, before = metered.metering, metered.limit_s, metered.last
    controls = camera.controls  # metering may have measured more of the camera's times
    wall_s = partial(predicted_wall_s, controls, before=before)

    def choose(desired: DesiredResponse) -> Chosen:
        chosen = most_accurate(desired)
        if request.given_range is not None or request.ratios is not None:
            return chosen
        longer = reach_shadows(controls, request, desired, chosen.settings)
        return chosen if longer is None else Chosen(desired, *longer)

    def most_accurate(desired: DesiredResponse) -> Chosen:
        def within(allowed: CaptureRequest) -> Found:
            if kind == ACCURACY:
                return accurate_settings(
                    controls, allowed, desired, limit_s, progress, before=before
                )
            requested = ratios or _ratios_by_xi(controls, allowed, desired, limit_s, progress)
            return _settings_by_xi(controls, allowed, desired, requested, limit_s), requested

        by_shutter = (
            request if kind == ACCURACY else shutter_budget(controls, request, limit_s, before)
        )
        return Chosen(desired, *within_budget(request, by_shutter, within, wall_s))

    if request.given_range is None:
        estimate = partial(estimated_levels, controls, request, limit_s=limit_s, before=before)
        by_accuracy = estimate if kind == ACCURACY else None
        chosen = choose_range(controls, request, metered, choose, by_accuracy)
    else:
        chosen = choose(desired or metered.desired(request, request.given_range))
    desired, settings, ratios = chosen.desired, chosen.settings, chosen.ratios
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)
    objective, exposures = Objective(levels_wanted), controls.relative_exposures(settings)
    noise = None if controls.noise is None else controls.frame_noise(settings)
    expected = evaluate(real, desired, exposures, objective=objective, noise=noise)
    plan = CapturePlan(
        response=request.response,
        dynamic_range=desired.dynamic_range,
        ratios=ratios,
        settings=settings,
        exposures=relative_exposures(settings),
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=levels_wanted,
        xi=expected.xi,
        effective_levels=expected.effective_levels,
        effective_levels_noise_free=expected.effective_levels_noise_free,
        metering=metering,
        curve=_samples(desired) if request.response == AUTO else request.desired_curve,
        gamma=request.gamma,
        wall_s=wall_s(settings),
        is_wall_known=controls.timing is not None,
        noise=controls.noise,
        objective=kind,
        light=metered.planned(chosen, controls),
    )
    warnings += setting_warnings(controls, request, plan)
    possible = evaluate(real, desired, ratios, objective=objective, noise=noise).effective_levels
    warnings += _rounding_loss(plan, possible)
    return replace(plan, findings=(*known, *map(note, warnings))), metered


def _settings_by_xi(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    ratios: tuple[float, ...],
    limit_s: float,
) -> tuple[ExposureSetting, ...]:
    """Return the settings near `ratios` of the least xi; near given ratios the nearest ones."""
    real = controls.levels
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)

    def missing_levels(settings: Sequence[ExposureSetting]) -> float:
        if sum(setting.time_s for setting in settings) > (request.time_budget_s or math.inf):
            return math.inf
        exposures = controls.relative_exposures(settings)
        return xi(EffectiveCamera.of(real, exposures), desired, levels_wanted)

    def deviation(settings: Sequence[ExposureSetting]) -> float:
        pairs = zip(controls.relative_exposures(settings), ratios, strict=True)
        return max(abs(math.log(applied / requested)) for applied, requested in pairs)

    score = missing_levels if request.ratios is None else deviation
    chooser = SettingChooser(controls, request, ratios, score)
    if request.ratios is None and isinstance(controls.time_s, Choices) and chooser.sets_time_only:
        return search_choices(controls, request, desired, len(ratios), limit_s)
    evaluations = _MOST_LEVELS_SORTED // (len(ratios) * real.M)
    return chooser.best(limit_s, max(_LEAST_SETS, min(_MOST_SETS, evaluations)))


def lookup_ratios(
    real: CameraResponse,
    desired: DesiredResponse,
    request: CaptureRequest,
    table: ExposureTable | None,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return the ratios given, or those of `table`, or of the shipped table or the user's cache.

    They are in ascending order and relative to the smallest.

    Raises:
        UsageError: no number of exposures meets the request's tolerance
        DataError: `table` has no row for this camera and request
    """
    if request.ratios is not None:
        smallest = min(request.ratios)
        return tuple(ratio / smallest for ratio in sorted(request.ratios))
    if request.tolerance is None:
        return _lookup_row(real, desired, request.most_exposures, request, table, progress)[0]
    missing = math.inf
    for count in range(1, request.most_exposures + 1):
        ratios, missing = _lookup_row(real, desired, count, request, table, progress)
        if missing <= request.tolerance:
            return ratios
    raise UsageError(
        f"{request.most_exposures} exposures leave {missing:.4g} of {request.levels_wanted:g} "
        f"levels missing, more than {request.tolerance:g}",
        hint="allow more exposures with -n, or a larger tolerance",
    )


def _lookup_row(
    real: CameraResponse,
    desired: DesiredResponse,
    count: int,
    request: CaptureRequest,
    table: ExposureTable | None,
    progress: _Progress,
) -> tuple[tuple[float, ...], float]:
    """Return the ratios for `count` exposures, and their xi."""
    if table is None:
        entry = look_up(
            real, desired, count, levels_wanted=request.levels_wanted, progress=progress
        )
        return tuple(entry.exposures), entry.xi
    found = table.find(real, desired, count, request.levels_wanted)
    if found is None:
        raise DataError(
            f"the given table has no row for {real.name}, {desired.name}, "
            f"{range_text(desired.dynamic_range)}, n = {count}",
            hint="add it with 'camctl table build', or leave --table out",
        )
    return tuple(found.exposures), found.xi


def _ratios_by_xi(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    limit_s: float,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return ratios given or looked up; solved where the light or a time budget decides them."""
    is_in_table = request.response != AUTO and request.time_budget_s is None
    if request.ratios is not None or is_in_table:
        return lookup_ratios(controls.levels, desired, request, None, progress)
    return _solve_ratios(controls.levels, desired, request, limit_s, controls, progress)


def _solve_ratios(
    real: CameraResponse,
    desired: DesiredResponse,
    request: CaptureRequest,
    limit_s: float,
    controls: ExposureControls,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return ratios solved now, for a shortest exposure of `limit_s`.

    Their sum is limited by the longest exposure that shutter time and gain give together, and by
    the request's time budget.
    """
    longest_s = controls.time_s.maximum * controls.gain.maximum / controls.gain.nearest(1.0)
    count = request.most_exposures
    total = max(longest_s / limit_s * _BUDGET_SHARE, float(count))
    if request.time_budget_s is not None:
        total = max(min(total, request.time_budget_s / limit_s * _BUDGET_SHARE), float(count))
    found = solve(
        real,
        desired,
        count,
        objective=Objective(request.levels_wanted),
        total_limit=total,
        search=SearchOptions(effort=_QUICK_EFFORT if request.response == AUTO else 1.0),
        progress=progress,
    )
    return found.exposures


def meter_light(camera: Camera, request: CaptureRequest) -> Metered:
    """Return how the light was metered, if it was, and the longest base exposure, s."""
    if request.base_s is not None:
        return Metered(None, request.base_s * 2.0**request.compensation_stops, None)
    source = MeteringFrames(camera, spend_shutter=request.spend_shutter)
    metering = meter(source, small_aperture=request.use_aperture)
    # Actuations of a shutter are spent only where the light decides more than the base exposure.
    is_free = isinstance(camera, PreviewingCamera) or request.desired is None
    light = light_histogram(source, metering, lower_end=0.0 if is_free else 1.0)
    metering = replace(metering, frames=source.count)
    whole = Metered(metering, metering.limit_s, light, source.last)
    metered = whole.limited(request, camera.controls)
    assert metered.light is not None  # `whole` has it
    said = metered.light.share_above(1.0)
    if metering.highlight >= 1.0 and NOTABLE_SHARE <= metering.clipped > said:
        clipped = f"{metering.clipped:.2%} of the samples are clipped"
        return replace(metered, warnings=(f"{clipped} even at the shortest exposure",))
    return metered


def _samples(desired: DesiredResponse) -> tuple[tuple[float, float], ...]:
    """Return a sampled response as pairs (irradiance, u)."""
    irradiance = np.concatenate(([desired.e_min], desired.knots, [1.0]))
    return tuple(zip(irradiance.tolist(), desired.u(irradiance).tolist(), strict=True))


def _rounding_loss(plan: CapturePlan, possible: float) -> list[str]:
    """Return a warning where rounding to the camera's steps costs many effective levels."""
    if plan.effective_levels >= _GOOD_SHARE * possible:
        return []
    return [
        f"the camera's steps allow {plan.effective_levels:.0f} effective levels; "
        f"the requested ratios would give {possible:.0f}"
    ]
