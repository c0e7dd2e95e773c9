"""Which ratios of exposures a request wants: given, looked up, or solved for the light there is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from camctl.capture.request import CaptureRequest
from camctl.errors import DataError, UsageError
from camctl.exposure.response import DesiredResponse, RealResponse
from camctl.exposure.solver import solve
from camctl.exposure.table import ExposureTable, look_up

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


def looked_up(
    real: RealResponse,
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
    real: RealResponse,
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
    real: RealResponse,
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
        levels_wanted=request.levels_wanted,
        total_limit=total,
        effort=_QUICK if request.response == AUTO else 1.0,
        progress=progress,
    )
    return found.exposures
