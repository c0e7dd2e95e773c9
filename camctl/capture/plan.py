"""From a request to the very settings that will be shot, and what they will give."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from camctl.camera import Camera, ExposureSetting
from camctl.capture.choose import SettingChooser
from camctl.capture.metering import meter
from camctl.capture.request import CaptureRequest, Plan
from camctl.errors import DataError, UsageError
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.objective import xi
from camctl.exposure.response import DesiredResponse, RealResponse, desired_response
from camctl.exposure.table import ExposureTable, TableEntry, look_up

#: Levels that may be sorted in one search: about a second of work.
_LEVELS_SORTED = 8_000_000


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
    desired = desired_response(request.response, request.dynamic_range)
    if request.ratios is not None:
        ratios = check_ratios(request.ratios)
    else:
        if request.count < 1:
            raise UsageError(f"{request.count} exposures", hint="take at least one")
        if table is None:
            entry = look_up(
                real,
                desired,
                request.count,
                levels_wanted=request.levels_wanted,
                progress=progress,
            )
        else:
            entry = _row_of(table, real, desired, request)
        ratios = tuple(entry.exposures)
    levels_wanted = request.levels_wanted or float(len(ratios) * real.M)
    metering = None
    warnings = [*controls.notes, *real.notes]
    if request.base_s is None:
        metering = meter(
            camera, spend_shutter=request.spend_shutter, small_aperture=request.use_aperture
        )
        if metering.highlight >= 1.0:
            warnings.append(
                f"{metering.clipped:.2%} of the samples are clipped even at the shortest exposure"
            )
        limit_s = metering.limit_s * 2.0**request.compensation_stops
    else:
        if not (math.isfinite(request.base_s) and request.base_s > 0):
            raise UsageError(
                f"a base exposure of {request.base_s:g} s", hint="give seconds above 0"
            )
        limit_s = request.base_s * 2.0**request.compensation_stops

    def quality(settings: Sequence[ExposureSetting]) -> float:
        return xi(EffectiveCamera.of(real, relative(settings)), desired, levels_wanted)

    def fidelity(settings: Sequence[ExposureSetting]) -> float:
        applied = relative(settings)
        pairs = zip(applied, ratios, strict=True)
        return max(abs(math.log(is_ / wanted)) for is_, wanted in pairs)

    chooser = SettingChooser(
        controls, request, ratios, quality if request.ratios is None else fidelity
    )
    evaluations = max(16, min(400, _LEVELS_SORTED // (len(ratios) * real.M)))
    settings = chooser.best(limit_s, evaluations)
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
    )
    warnings += chooser.warnings(plan)
    warnings += _against_ideal(plan, EffectiveCamera.of(real, ratios), desired)
    return replace(plan, warnings=tuple(warnings))


def _row_of(
    table: ExposureTable, real: RealResponse, desired: DesiredResponse, request: CaptureRequest
) -> TableEntry:
    entry = table.find(real, desired, request.count, request.levels_wanted)
    if entry is None:
        raise DataError(
            f"the given table has no row for {real.name}, {desired.name}, "
            f"1:{desired.dynamic_range:g}, n = {request.count}",
            hint="add it with 'camctl table build', or leave --table out",
        )
    return entry


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
