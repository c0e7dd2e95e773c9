"""From a request to the settings that will be shot, and the result that they should give."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from camctl.camera import Camera
from camctl.captures.metering import light_histogram, meter
from camctl.captures.request import (
    AUTO,
    CURVE,
    CapturePlan,
    CaptureRequest,
    Metering,
    relative_exposures,
)
from camctl.captures.setting_selection import SettingChooser, search_choices
from camctl.controls import Choices, ExposureSetting
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import Objective, evaluate, xi
from camctl.exposure.solver import SearchOptions, solve
from camctl.exposure.table import ExposureTable
from camctl.response.auto import auto_response
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse

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
) -> CapturePlan:
    """Meter where needed, look the ratios up, and choose among the settings the camera has.

    Without `table` the ratios come from the shipped table or the user's cache; ratios that neither
    of them holds for this camera's levels are solved once, which takes seconds, and cached.

    Args:
        camera: an open camera
        request: what the user asks for
        table: the only table in which ratios are looked up
        progress: called with the share done, 0 to 1, while ratios are solved

    Raises:
        UsageError: the request cannot be met by any camera, or not with `table`
        DataError: `table` has no row for this camera and request
        CaptureError: an exposure is beyond the camera's controls
    """
    controls, real = camera.controls, camera.controls.levels
    warnings = [*controls.notes, *real.notes]
    desired, ratios = request.desired, None
    if request.ratios is None and (desired is None or request.time_budget_s is not None):
        if table is not None:
            raise UsageError(
                "a table has no exposures for a time budget or an automatic response",
                hint="leave the table (--table) out",
            )
    elif desired is not None:
        ratios = lookup_ratios(real, desired, request, table, progress)
    metering, limit_s = _metered_limit(camera, request, warnings)
    if desired is None:
        desired = _automatic(camera, request, metering)
    if ratios is None:
        longest_s = controls.time_s.maximum * controls.gain.maximum / controls.gain.nearest(1.0)
        ratios = _solve_ratios(real, desired, request, limit_s, longest_s, progress)
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)

    def missing_levels(settings: Sequence[ExposureSetting]) -> float:
        if sum(setting.time_s for setting in settings) > (request.time_budget_s or math.inf):
            return math.inf
        return xi(EffectiveCamera.of(real, relative_exposures(settings)), desired, levels_wanted)

    def deviation(settings: Sequence[ExposureSetting]) -> float:
        pairs = zip(relative_exposures(settings), ratios, strict=True)
        return max(abs(math.log(applied / requested)) for applied, requested in pairs)

    score = missing_levels if request.ratios is None else deviation
    chooser = SettingChooser(controls, request, ratios, score)
    if request.ratios is None and isinstance(controls.time_s, Choices) and chooser.sets_time_only:
        settings = search_choices(controls, request, desired, len(ratios), limit_s)
    else:
        evaluations = _MOST_LEVELS_SORTED // (len(ratios) * real.M)
        settings = chooser.best(limit_s, max(_LEAST_SETS, min(_MOST_SETS, evaluations)))
    if math.isinf(missing_levels(settings)):
        raise CaptureError(
            f"the camera's settings do not fit into {request.time_budget_s:.4g} s",
            hint="allow more time, or take fewer exposures",
        )
    objective, exposures = Objective(levels_wanted), relative_exposures(settings)
    expected = evaluate(real, desired, exposures, objective=objective)
    plan = CapturePlan(
        response=request.response,
        dynamic_range=desired.dynamic_range if request.response == CURVE else request.dynamic_range,
        ratios=ratios,
        settings=settings,
        exposures=exposures,
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=levels_wanted,
        xi=expected.xi,
        effective_levels=expected.effective_levels,
        metering=metering,
        curve=_samples(desired) if request.response == AUTO else request.desired_curve,
        gamma=request.gamma,
    )
    warnings += chooser.warnings(plan)
    possible = evaluate(real, desired, ratios, objective=objective).effective_levels
    warnings += _rounding_loss(plan, possible)
    return replace(plan, warnings=tuple(warnings))


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
        return _lookup_row(real, desired, request.count, request, table, progress)[0]
    missing = math.inf
    for count in range(1, request.count + 1):
        ratios, missing = _lookup_row(real, desired, count, request, table, progress)
        if missing <= request.tolerance:
            return ratios
    raise UsageError(
        f"{request.count} exposures leave {missing:.4g} of {request.levels_wanted:g} levels "
        f"missing, more than {request.tolerance:g}",
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
            f"1:{desired.dynamic_range:g}, n = {count}",
            hint="add it with 'camctl table build', or leave --table out",
        )
    return tuple(found.exposures), found.xi


def _solve_ratios(
    real: CameraResponse,
    desired: DesiredResponse,
    request: CaptureRequest,
    limit_s: float,
    longest_s: float,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return ratios solved now, for a shortest exposure of `limit_s`.

    Their sum is limited by `longest_s`, the longest exposure that shutter time and gain give
    together, and by the request's time budget.

    Raises:
        UsageError: the time budget is too short
    """
    total = max(longest_s / limit_s * _BUDGET_SHARE, float(request.count))
    if request.time_budget_s is not None:
        total = min(total, request.time_budget_s / limit_s * _BUDGET_SHARE)
        if not total >= request.count:
            raise UsageError(
                f"{request.count} exposures do not fit into {request.time_budget_s:.4g} s",
                hint=f"the least is {request.count * limit_s / _BUDGET_SHARE:.4g} s; allow more, "
                "or take fewer exposures",
            )
    found = solve(
        real,
        desired,
        request.count,
        objective=Objective(request.levels_wanted),
        total_limit=total,
        search=SearchOptions(effort=_QUICK_EFFORT if request.response == AUTO else 1.0),
        progress=progress,
    )
    return found.exposures


def _metered_limit(
    camera: Camera, request: CaptureRequest, warnings: list[str]
) -> tuple[Metering | None, float]:
    """Return how the light was metered, if it was, and the longest base exposure, s."""
    shift = 2.0**request.compensation_stops
    if request.base_s is not None:
        return None, request.base_s * shift
    metering = meter(
        camera, spend_shutter=request.spend_shutter, small_aperture=request.use_aperture
    )
    if metering.highlight >= 1.0:
        warnings.append(
            f"{metering.clipped:.2%} of the samples are clipped even at the shortest exposure"
        )
    return metering, metering.limit_s * shift


def _automatic(
    camera: Camera, request: CaptureRequest, metering: Metering | None
) -> DesiredResponse:
    assert metering is not None  # `CaptureRequest` refuses a base exposure with this response
    light, counts = light_histogram(
        camera, metering, request.dynamic_range, spend_shutter=request.spend_shutter
    )
    return auto_response(light, request.dynamic_range, weights=counts)


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
