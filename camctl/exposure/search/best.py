"""The search for the settings of a capture: controls, a request and light in, settings out.

Exposures are chosen by accuracy, with the camera's noise (`accurate`), or by xi: ratios from a
table or solved, then the settings near them (`settings`).  Where the light decides the range of the
picture, several ranges are compared (`ranges`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.goal import ACCURACY, AUTO, RANGE_WITHOUT_LIGHT, XI, CaptureRequest
from camctl.exposure.light import Light
from camctl.exposure.objective import Objective, xi
from camctl.exposure.search.accurate import accurate_settings, estimated_levels, objective_of
from camctl.exposure.search.ranges import Chosen, choose_range
from camctl.exposure.search.settings import (
    SettingChooser,
    at_most,
    reach_shadows,
    search_choices,
)
from camctl.exposure.search.wall_time import predicted_wall_s, time_costs
from camctl.exposure.solver import SearchOptions, solve
from camctl.exposure.table import ExposureTable
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.system.number_text import range_text

#: Effort of a search that the user waits for after metering: its xi is within 1 % of the full one.
_QUICK_EFFORT = 0.1
#: Share of a time budget that is solved for; the rest is for rounding to the camera's steps.
_BUDGET_SHARE = 0.995
#: Levels sorted while sets of settings are compared: about a second of work.
_MOST_LEVELS_SORTED = 8_000_000
#: Sets of settings that are compared at least and at most.
_LEAST_SETS, _MOST_SETS = 16, 400
#: Attempts to find settings within a time budget.
_ATTEMPTS = 6
#: Relative difference up to which a time is within the budget: more than that of float64.
_SAME = 1e-8

Found: TypeAlias = tuple[tuple[ExposureSetting, ...], tuple[float, ...]]
"""Settings, and the ratios that were asked of the camera."""

Progress: TypeAlias = Callable[[float], None] | None
"""Called with the share done, 0 to 1, while exposures are solved."""


class Search:
    """Finds the best settings of a camera for a request.

    It is made before light is metered, so that what no light makes possible is refused first.

    Args:
        controls: of the camera
        request: what the user asks for
        table: the only table in which ratios are looked up; None: the shipped one and the user's
            cache; ratios that neither holds are solved once, which takes seconds, and cached
        progress: called while exposures are solved

    Attributes:
        request: with the range of a table, where it leaves its range to the light
        objective: what the exposures are chosen by, "accuracy" or "xi"

    Raises:
        UsageError: the request cannot be met by any camera, or not with `table`
        DataError: `table` has no row for this camera and request
    """

    def __init__(
        self,
        controls: ExposureControls,
        request: CaptureRequest,
        table: ExposureTable | None = None,
        progress: Progress = None,
    ) -> None:
        if table is not None and request.given_range is None:
            request = replace(request, dynamic_range=RANGE_WITHOUT_LIGHT)
        self.request, self._table, self._progress = request, table, progress
        self.objective = objective_of(request, controls, has_table=table is not None)
        self._ratios: tuple[float, ...] | None = None
        desired = request.desired
        if request.ratios is None and (desired is None or request.time_budget_s is not None):
            if table is not None:
                raise UsageError(
                    "a table has no exposures for a time budget or an automatic response",
                    hint="leave the table out, or name the response",
                    remedies={"table": None},
                )
        elif desired is not None and self.objective == XI:
            self._ratios = lookup_ratios(controls.levels, desired, request, table, progress)

    def best(self, controls: ExposureControls, light: Light | None) -> Chosen:
        """Return the best settings, for light in units of what the request allows.

        Args:
            controls: of the camera; metering may have measured more of its times
            light: see `Light.limited`; None where the request has the base exposure

        Raises:
            UsageError, CaptureError: no settings of the camera meet the request
        """
        request = self.request
        limit_s = longest_base_s(request, light)
        before = None if light is None else light.last
        choose = partial(self._over, controls, limit_s=limit_s, before=before)
        given = request.desired
        if request.given_range is not None:
            if given is None:
                assert light is not None  # a request for the response "auto" has no base exposure
                given = light.desired(request, request.given_range)
            return choose(given)
        assert light is not None  # with a base exposure there is a range
        by_accuracy = None
        if self.objective == ACCURACY:
            by_accuracy = partial(
                estimated_levels, controls, request, limit_s=limit_s, before=before
            )
        return choose_range(controls, request, light, limit_s, choose, by_accuracy)

    def _over(
        self,
        controls: ExposureControls,
        desired: DesiredResponse,
        *,
        limit_s: float,
        before: ExposureSetting | None,
    ) -> Chosen:
        """Return the settings for one desired response."""
        request = self.request

        def within(allowed: CaptureRequest) -> Found:
            if self.objective == ACCURACY:
                return accurate_settings(
                    controls, allowed, desired, limit_s, self._progress, before=before
                )
            ratios = self._ratios or _ratios_by_xi(
                controls, allowed, desired, limit_s, self._progress
            )
            return _settings_by_xi(controls, allowed, desired, ratios, limit_s), ratios

        allowed = request
        if self.objective == XI:
            allowed = shutter_budget(controls, request, limit_s, before)
        wall_s = partial(predicted_wall_s, controls, before=before)
        chosen = Chosen(desired, *within_budget(request, allowed, within, wall_s))
        if request.given_range is not None or request.ratios is not None:
            return chosen
        longer = reach_shadows(controls, request, desired, chosen.settings)
        return chosen if longer is None else Chosen(desired, *longer)


def longest_base_s(request: CaptureRequest, light: Light | None) -> float:
    """Return the longest shutter time that the shortest exposure may have, s."""
    longest_s = request.base_s if light is None else light.metering.limit_s
    assert longest_s is not None  # without a base exposure the light is metered
    return float(longest_s * 2.0**request.compensation_stops)


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
    progress: Progress,
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
        hint="allow more exposures, or a larger tolerance",
        remedies={"count": None, "tolerance": None},
    )


def _lookup_row(
    real: CameraResponse,
    desired: DesiredResponse,
    count: int,
    request: CaptureRequest,
    table: ExposureTable | None,
    progress: Progress,
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
            hint="add it to the table, or leave the table out",
            remedies={"table_build": None, "table": None},
        )
    return tuple(found.exposures), found.xi


def _ratios_by_xi(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    limit_s: float,
    progress: Progress,
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
    progress: Progress,
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
