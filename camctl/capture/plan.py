"""From a request to the very settings that will be shot, and what they will give."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from camctl.camera import Camera, Choices, ExposureSetting
from camctl.capture.choose import SettingChooser, best_of_choices
from camctl.capture.metering import light_histogram, meter
from camctl.capture.ratios import AUTO, looked_up, needs_light, solved
from camctl.capture.request import CaptureRequest, Metering, Plan
from camctl.errors import CaptureError, UsageError
from camctl.exposure.auto import auto_response
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.objective import xi
from camctl.exposure.response import DesiredResponse, desired_response
from camctl.exposure.table import ExposureTable

#: Levels that may be sorted in one search: about a second of work.
_LEVELS_SORTED = 8_000_000


def plan_capture(
    camera: Camera,
    request: CaptureRequest,
    *,
    table: ExposureTable | None = None,
    progress: Callable[[float], None] | None = None,
) -> Plan:
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
        ratios = looked_up(real, desired, request, table, progress)
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
    effective = EffectiveCamera.of(real, relative(settings))
    plan = Plan(
        response=request.response,
        dynamic_range=request.dynamic_range,
        ratios=ratios,
        settings=settings,
        exposures=relative(settings),
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=levels_wanted,
        xi=xi(effective, desired, levels_wanted),
        effective_levels=effective_levels(effective, desired),
        metering=metering,
        curve=_curve(desired) if request.response == AUTO else None,
    )
    warnings += chooser.warnings(plan)
    warnings += _against_ideal(plan, EffectiveCamera.of(real, ratios), desired)
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


def _against_ideal(plan: Plan, ideal: EffectiveCamera, desired: DesiredResponse) -> list[str]:
    possible = effective_levels(ideal, desired)
    if plan.effective_levels >= 0.9 * possible:
        return []
    return [
        f"the camera's steps allow {plan.effective_levels:.0f} effective levels, "
        f"the wanted ratios would give {possible:.0f}"
    ]
