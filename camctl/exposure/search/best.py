"""The search for the settings of a capture: controls, a request and light in, settings out.

Exposures are chosen by accuracy, with the camera's noise (`front`), or by xi: ratios from a table
or solved, then the settings near them (`settings`).  Where the light decides the range of the
picture, several ranges are compared (`ranges`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

from camctl.errors import CaptureError, DataError, UnreachableExposureError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.goal import ACCURACY, AUTO, RANGE_WITHOUT_LIGHT, XI, CaptureRequest
from camctl.exposure.light import Light
from camctl.exposure.objective import Objective, xi
from camctl.exposure.search.front import ATTEMPTS, SAME_TIME, Front
from camctl.exposure.search.ranges import Chosen, choose_range
from camctl.exposure.search.settings import (
    SettingChooser,
    at_most,
    listed_up_to_longest,
    longest_base_on_list,
    reach_shadows,
    search_choices,
)
from camctl.exposure.search.wall_time import predicted_wall_s, time_costs
from camctl.exposure.solver import SearchOptions, solve
from camctl.exposure.table import ExposureTable
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.model.effective import MOST_SEARCHED, EffectiveCamera, check_count
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse
from camctl.system.number_text import range_text

#: Processor time of a search that the user waits for, s.  A plan makes two where it chooses the
#: range, and more within a budget of time; it rounds what they find, and may take 1 s in all.
_PLANNED_S = 0.2
#: Share of a time budget that is solved for; the rest is for rounding to the camera's steps.
_BUDGET_SHARE = 0.995
#: Levels sorted while sets of settings are compared: about a second of work.
_MOST_LEVELS_SORTED = 8_000_000
#: Sets of settings that are compared at least and at most.
_LEAST_SETS, _MOST_SETS = 16, 400

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
        if self.objective == XI and request.ratios is None:
            check_count(request.most_exposures, MOST_SEARCHED)
        self._fronts: list[tuple[tuple[Any, ...], Front]] = []
        self._ratios: tuple[float, ...] | None = None
        desired = request.desired
        if request.ratios is None and (desired is None or request.time_budget_s is not None):
            if table is not None:
                raise UsageError(
                    "a table has no exposures for a time budget or an automatic response",
                    hint="leave the table out, or name the response",
                    remedies={"table": False},
                )
        elif desired is not None and self.objective == XI:
            self._ratios = self._look_up(controls.levels, desired)

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
        if self.objective != ACCURACY:
            return choose_range(controls, request, light, limit_s, choose)

        def estimate(desired: DesiredResponse) -> float | None:
            return self._front(controls, desired, limit_s, before).estimated_levels

        return choose_range(controls, request, light, limit_s, choose, estimate)

    def _front(
        self,
        controls: ExposureControls,
        desired: DesiredResponse,
        limit_s: float,
        before: ExposureSetting | None,
    ) -> Front:
        """Return the front for a desired response; of each response only one is made."""
        key = controls, desired.key, desired.dynamic_range, limit_s, before
        for known, front in self._fronts:
            if known[0] is controls and known[1:] == key[1:]:
                return front
        front = Front(controls, desired, limit_s, request=self.request, before=before)
        self._fronts.append((key, front))
        return front

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
            ratios = self._ratios or self._solve(controls, allowed, desired, limit_s)
            return _settings_by_xi(controls, allowed, desired, ratios, limit_s)

        if self.objective == ACCURACY:
            front = self._front(controls, desired, limit_s, before)
            point = front.chosen
            chosen = Chosen(desired, point.settings, point.ratios, point.levels, front=front)
        else:
            allowed = _shutter_budget(controls, request, limit_s, before)
            wall_s = partial(predicted_wall_s, controls, before=before)
            chosen = Chosen(desired, *within_budget(request, allowed, within, wall_s))
        if request.given_range is not None or request.ratios is not None:
            return chosen
        longer = reach_shadows(controls, request, desired, chosen.settings)
        return chosen if longer is None else Chosen(desired, *longer, front=chosen.front)

    def _look_up(self, real: CameraResponse, desired: DesiredResponse) -> tuple[float, ...]:
        """Return ratios given or looked up, ascending and relative to the smallest.

        Raises:
            UsageError: no number of exposures meets the request's tolerance
            DataError: the table has no row for this camera and request
        """
        request, most = self.request, self.request.most_exposures
        if request.ratios is not None:
            smallest = min(request.ratios)
            return tuple(ratio / smallest for ratio in sorted(request.ratios))
        if request.tolerance is None:
            return self._row(real, desired, most)[0]
        missing = math.inf
        for count in range(1, most + 1):
            ratios, missing = self._row(real, desired, count)
            if missing <= request.tolerance:
                return ratios
        raise UsageError(
            f"{most} exposures leave {missing:.4g} of {request.levels_wanted:g} levels missing, "
            f"more than {request.tolerance:g}",
            hint="allow more exposures, or a larger tolerance",
            remedies={"count": None, "tolerance": None},
        )

    def _row(
        self, real: CameraResponse, desired: DesiredResponse, count: int
    ) -> tuple[tuple[float, ...], float]:
        """Return the ratios for `count` exposures, and their xi."""
        wanted = self.request.levels_wanted
        if self._table is None:
            found = look_up(
                real,
                desired,
                count,
                levels_wanted=wanted,
                processor_s=_PLANNED_S,
                progress=self._progress,
            )
            return tuple(found.exposures), found.xi
        row = self._table.find(real, desired, count, wanted)
        if row is None:
            raise DataError(
                f"the given table has no row for {real.name}, {desired.name}, "
                f"{range_text(desired.dynamic_range)}, n = {count}",
                hint="add it to the table, or leave the table out",
                remedies={"table_build": None, "table": False},
            )
        return tuple(row.exposures), row.xi

    def _solve(
        self,
        controls: ExposureControls,
        allowed: CaptureRequest,
        desired: DesiredResponse,
        limit_s: float,
    ) -> tuple[float, ...]:
        """Return ratios where the light or a time budget decides them.

        The sum of those that are solved is limited by the longest exposure that shutter time and
        gain give together, and by the time that is `allowed`.
        """
        is_in_table = allowed.response != AUTO and allowed.time_budget_s is None
        if allowed.ratios is not None or is_in_table:
            return self._look_up(controls.levels, desired)
        longest_s = controls.time_s.maximum * controls.gain.maximum / controls.gain.nearest(1.0)
        count = allowed.most_exposures
        total = max(longest_s / limit_s * _BUDGET_SHARE, float(count))
        if allowed.time_budget_s is not None:
            total = max(min(total, allowed.time_budget_s / limit_s * _BUDGET_SHARE), float(count))
        return solve(
            controls.levels,
            desired,
            count,
            objective=Objective(allowed.levels_wanted),
            total_limit=total,
            search=SearchOptions(processor_s=_PLANNED_S),
            progress=self._progress,
        ).exposures


def objective_of(request: CaptureRequest, controls: ExposureControls, *, has_table: bool) -> str:
    """Return by what the exposures are chosen: "accuracy" or "xi".

    Where the request leaves it open it is accuracy if the camera's noise is known, unless the
    request is one that only xi can answer: a tolerance, a number of levels, a table, the aperture.

    Raises:
        UsageError: accuracy is requested of a camera whose noise is unknown
    """
    requested = request.objective
    if request.accuracy is not None:
        requested = ACCURACY
    if requested == ACCURACY and controls.noise is None:
        raise UsageError(
            "the noise of this camera is unknown, so that exposures cannot be chosen by accuracy",
            hint="choose them by xi, without an accuracy",
            remedies={"objective": XI, "accuracy": False},
        )
    if requested == ACCURACY and has_table:
        raise UsageError(
            "a table has exposures chosen by xi, not by accuracy",
            hint="leave one of them out",
            remedies={"table": False, "accuracy": False},
        )
    if requested is not None:
        return requested
    only_xi = (
        request.tolerance is not None
        or request.levels_wanted is not None
        or request.ratios is not None
        or request.use_aperture
        or has_table
    )
    return XI if controls.noise is None or only_xi else ACCURACY


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
) -> Found:
    """Return the settings near `ratios` of the least xi; near given ratios the nearest ones.

    Where the camera's times are too short for a metered shortest exposure and these ratios, others
    of the least xi are searched up to its longest exposure: with a shorter shortest exposure all of
    them would have less light.
    """
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
    count = len(ratios)
    evaluations = _MOST_LEVELS_SORTED // (count * real.M)
    evaluations = max(_LEAST_SETS, min(_MOST_SETS, evaluations))
    if request.ratios is None and chooser.sets_time_only:
        is_beyond = request.base_s is None and not chooser.reaches(limit_s)
        listed = controls
        if is_beyond:
            listed = listed_up_to_longest(controls, limit_s, count, evaluations)
        if isinstance(listed.time_s, Choices):
            if request.base_s is None:  # a metered base is shortened until enough exposures follow
                limit_s = min(limit_s, longest_base_on_list(listed, count))
            found = search_choices(listed, request, desired, count, limit_s, ratios)
            return found, controls.relative_exposures(found) if is_beyond else ratios
    return chooser.best(limit_s, evaluations), ratios


def within_budget(
    request: CaptureRequest,
    allowed: CaptureRequest,
    choose: Callable[[CaptureRequest], Found],
    wall_s: Callable[[Sequence[ExposureSetting]], float],
) -> Found:
    """Return settings whose predicted time `wall_s` is within the budget of `request`.

    `choose`, which returns settings and ratios, does not count all that takes time: it is asked for
    less than `allowed` until its settings fit.

    Raises:
        UsageError: as `choose` does for `allowed`
        CaptureError: the same, or no settings that fit were found
    """
    budget_s, reduction = request.time_budget_s, 1.0
    found = choose(allowed)
    if budget_s is None:
        return found
    for _ in range(ATTEMPTS):
        over_s = wall_s(found[0]) - budget_s
        if over_s <= SAME_TIME * budget_s:
            return found
        assert allowed.time_budget_s is not None  # as in `request`, or less
        try:
            allowed = replace(allowed, time_budget_s=allowed.time_budget_s - reduction * over_s)
            found = choose(allowed)
        except (CaptureError, UsageError):  # nothing is as short as that
            break
        reduction *= 2
    raise UnreachableExposureError(
        f"no settings of this camera were found that fit into {budget_s:.4g} s",
        hint="allow more time, or take fewer exposures",
    )


def _shutter_budget(
    controls: ExposureControls,
    request: CaptureRequest,
    limit_s: float,
    before: ExposureSetting | None,
) -> CaptureRequest:
    """Return the request with its time budget reduced to what remains for shutter times.

    Raises:
        UsageError: the budget is too short for the number of exposures
    """
    if request.time_budget_s is None:
        return request
    count = len(request.ratios or ()) or request.most_exposures
    base_s = at_most(controls.time_s, limit_s)
    costs = time_costs(controls, before=before, shortest_s=base_s)
    left_s, least_s = request.time_budget_s - costs.fixed, costs.total([base_s] * count)
    if least_s > left_s + SAME_TIME * request.time_budget_s:
        raise UsageError(
            f"{count} exposures do not fit into {request.time_budget_s:.4g} s",
            hint=f"the least is {least_s + costs.fixed:.4g} s; allow more, or take fewer exposures",
        )
    return replace(request, time_budget_s=costs.shutter(left_s, count))
