"""From a request to the very settings that will be shot, and what they will give."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from camctl.camera import Camera
from camctl.captures.metering import light_histogram, meter
from camctl.captures.request import CapturePlan, CaptureRequest, Metering
from camctl.captures.setting_selection import SettingChooser, best_of_choices
from camctl.controls import Choices, ExposureSetting
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import Objective, evaluate, xi
from camctl.exposure.solver import SearchOptions, solve
from camctl.exposure.table import ExposureTable
from camctl.response.auto import auto_response
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse, desired_response

AUTO = "auto"
#: Effort of a search that a person waits for with the light already metered: within 1 % in xi.
_QUICK = 0.1
#: Left of a time budget for rounding to the camera's steps.
_ROUNDING = 0.995

_Progress = Callable[[float], None] | None


def check_ratios(ratios: Iterable[float]) -> tuple[float, ...]:
    """Return ratios in ascending order relative to the smallest.

    Raises:
        UsageError: there is none, or one is not a positive, finite number

    """
    values = sorted(ratios)
    if not values:
        raise UsageError("no ratios", hint="give at least one, such as --ratios 1,2,4")
    for value in values:
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"a ratio of {value:g}", hint="exposures are positive, finite numbers")
    return tuple(value / values[0] for value in values)


def needs_light(request: CaptureRequest) -> bool:
    """Say whether the ratios depend on the metered light, and cannot be looked up before."""
    return request.ratios is None and (
        request.response == AUTO or request.time_budget_s is not None
    )


def lookup_ratios(
    real: CameraResponse,
    desired: DesiredResponse,
    request: CaptureRequest,
    table: ExposureTable | None,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return the ratios given, or those of `table`, or of the shipped table or the user's cache.

    Raises:
        UsageError: the request makes no sense, or no number of exposures meets its tolerance
        DataError: `table` has no row for this camera and wish

    """
    if request.ratios is not None:
        return check_ratios(request.ratios)
    if request.count < 1:
        raise UsageError(f"{request.count} exposures", hint="take at least one")
    if request.tolerance is None:
        return _row(real, desired, request.count, request, table, progress)[0]
    if request.levels_wanted is None:
        raise UsageError(
            "a tolerance needs the number of levels wanted", hint="say how many with --levels"
        )
    missing = math.inf
    for count in range(1, request.count + 1):
        ratios, missing = _row(real, desired, count, request, table, progress)
        if missing <= request.tolerance:
            return ratios
    raise UsageError(
        f"{request.count} exposures leave {missing:.4g} of {request.levels_wanted:g} levels "
        f"missing, more than {request.tolerance:g}",
        hint="allow more exposures with -n, or a larger tolerance",
    )


def _row(
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


def solved(
    real: CameraResponse,
    desired: DesiredResponse,
    request: CaptureRequest,
    limit_s: float,
    longest_s: float,
    progress: _Progress,
) -> tuple[float, ...]:
    """Return ratios solved now, for a shortest exposure of `limit_s`.

    They reach no further than `longest_s`, what the camera's time and gain give in all.

    Raises:
        UsageError: the time budget is too short, or is combined with a tolerance

    """
    if request.tolerance is not None:
        raise UsageError(
            "a tolerance goes with neither a time budget nor an automatic response",
            hint="leave one of them out",
        )
    total = max(longest_s / limit_s * _ROUNDING, float(request.count))
    if request.time_budget_s is not None:
        total = min(total, request.time_budget_s / limit_s * _ROUNDING)
        if not total >= request.count:
            raise UsageError(
                f"{request.count} exposures do not fit into {request.time_budget_s:.4g} s",
                hint=f"the least is {request.count * limit_s / _ROUNDING:.4g} s; allow more, or "
                "take fewer exposures",
            )
    found = solve(
        real,
        desired,
        request.count,
        objective=Objective(request.levels_wanted),
        total_limit=total,
        search=SearchOptions(effort=_QUICK if request.response == AUTO else 1.0),
        progress=progress,
    )
    return found.exposures


#: Levels that may be sorted in one search: about a second of work.
_LEVELS_SORTED = 8_000_000


def plan_capture(
    camera: Camera,
    request: CaptureRequest,
    *,
    table: ExposureTable | None = None,
    progress: Callable[[float], None] | None = None,
) -> CapturePlan:
    """Meter where needed, look the ratios up, and choose among the settings the camera has.

    The ratios come from `table` alone where one is given.  Otherwise those that the shipped table
    does not hold for this camera's levels are solved once and kept, which takes seconds; `progress`
    is then told the share done, 0 to 1.

    Raises:
        UsageError: the request makes no sense
        DataError: `table` has no row for this camera and wish
        CaptureError: an exposure lies beyond the camera's controls

    """
    controls, real = camera.controls, camera.controls.levels
    warnings = [*controls.notes, *real.notes]
    ratios = None
    if needs_light(request):
        if table is not None:
            raise UsageError(
                "a table holds no exposures for a time budget or an automatic response",
                hint="leave --table out",
            )
    else:
        desired = desired_response(request.response, request.dynamic_range)
        ratios = lookup_ratios(real, desired, request, table, progress)
    metering, limit_s = _limit(camera, request, warnings)
    if ratios is None:
        desired = _desired(camera, request, metering)
        longest_s = controls.time_s.maximum * controls.gain.maximum / controls.gain.nearest(1.0)
        ratios = solved(real, desired, request, limit_s, longest_s, progress)
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)

    def quality(settings: Sequence[ExposureSetting]) -> float:
        if sum(setting.time_s for setting in settings) > (request.time_budget_s or math.inf):
            return math.inf
        return xi(EffectiveCamera.of(real, relative(settings)), desired, levels_wanted)

    def fidelity(settings: Sequence[ExposureSetting]) -> float:
        applied = relative(settings)
        pairs = zip(applied, ratios, strict=True)
        return max(abs(math.log(is_ / wanted)) for is_, wanted in pairs)

    chooser = SettingChooser(
        controls, request, ratios, quality if request.ratios is None else fidelity
    )
    if request.ratios is None and isinstance(controls.time_s, Choices) and chooser.is_plain:
        settings = best_of_choices(controls, request, desired, len(ratios), limit_s)
    else:
        evaluations = max(16, min(400, _LEVELS_SORTED // (len(ratios) * real.M)))
        settings = chooser.best(limit_s, evaluations)
    if math.isinf(quality(settings)):
        raise CaptureError(
            f"the camera's settings do not fit into {request.time_budget_s:.4g} s",
            hint="allow more time, or take fewer exposures",
        )
    objective = Objective(levels_wanted)
    expected = evaluate(real, relative(settings), desired, objective=objective)
    plan = CapturePlan(
        response=request.response,
        dynamic_range=request.dynamic_range,
        ratios=ratios,
        settings=settings,
        exposures=relative(settings),
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=levels_wanted,
        xi=expected.xi,
        effective_levels=expected.effective_levels,
        metering=metering,
        curve=_curve(desired) if request.response == AUTO else None,
    )
    warnings += chooser.warnings(plan)
    possible = evaluate(real, ratios, desired, objective=objective).effective_levels
    warnings += _against_ideal(plan, possible)
    return replace(plan, warnings=tuple(warnings))


def _limit(
    camera: Camera, request: CaptureRequest, warnings: list[str]
) -> tuple[Metering | None, float]:
    """Return how the light was metered, if it was, and the longest base exposure, s."""
    shift = 2.0**request.compensation_stops
    if request.base_s is not None:
        if not (math.isfinite(request.base_s) and request.base_s > 0):
            raise UsageError(
                f"a base exposure of {request.base_s:g} s", hint="give seconds above 0"
            )
        return None, request.base_s * shift
    metering = meter(
        camera, spend_shutter=request.spend_shutter, small_aperture=request.use_aperture
    )
    if metering.highlight >= 1.0:
        warnings.append(
            f"{metering.clipped:.2%} of the samples are clipped even at the shortest exposure"
        )
    return metering, metering.limit_s * shift


def _desired(camera: Camera, request: CaptureRequest, metering: Metering | None) -> DesiredResponse:
    if request.response != AUTO:
        return desired_response(request.response, request.dynamic_range)
    if metering is None:
        raise UsageError(
            "an automatic response follows the metered light, and the base exposure is given",
            hint="leave --base out, or pick a response",
        )
    light, counts = light_histogram(
        camera, metering, request.dynamic_range, spend_shutter=request.spend_shutter
    )
    return auto_response(light, request.dynamic_range, weights=counts)


def _curve(desired: DesiredResponse) -> tuple[tuple[float, float], ...]:
    irradiance = np.concatenate(([desired.e_min], desired.knots, [1.0]))
    return tuple(zip(irradiance.tolist(), desired.u(irradiance).tolist(), strict=True))


def relative(settings: Sequence[ExposureSetting]) -> tuple[float, ...]:
    """Return the exposures of settings relative to the smallest."""
    smallest = min(setting.exposure for setting in settings)
    return tuple(setting.exposure / smallest for setting in settings)


def _against_ideal(plan: CapturePlan, possible: float) -> list[str]:
    if plan.effective_levels >= 0.9 * possible:
        return []
    return [
        f"the camera's steps allow {plan.effective_levels:.0f} effective levels, "
        f"the wanted ratios would give {possible:.0f}"
    ]
