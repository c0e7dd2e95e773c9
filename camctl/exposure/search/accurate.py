"""The settings of a capture that give the most accurate picture with the camera's noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.accuracy import COUNTS, estimate_levels
from camctl.exposure.accuracy_lookup import look_up_accurate, without_idle_limits
from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures, TimeCosts
from camctl.exposure.goal import ACCURACY, DEFAULT_COUNT, XI, CaptureRequest
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.search.settings import BASE_SLACK_STOPS, at_most, given_base
from camctl.exposure.search.wall_time import predicted_wall_s, time_costs
from camctl.interface.controls import Choices, Control, ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.response.desired import DesiredResponse

#: Whole flicker periods that are tried as shutter times, at most.
_PERIODS = 200
#: Factors tried on all but the shortest exposure until an accuracy is reached.
_LENGTHENINGS = (1.0, 1.003, 1.01, 1.03)
#: Relative difference up to which two times are the same, in float64.
_SAME = 1e-9


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


def gain_choices(gain: Control) -> tuple[float, ...]:
    """Return gains to choose from: factors of two from the one nearest to 1, ascending."""
    first = gain.nearest(1.0)
    doublings = range(max(0, math.floor(math.log2(gain.maximum / first) + _SAME)) + 1)
    return tuple(sorted({gain.nearest(first * 2.0**power) for power in doublings}))


def accuracy_problem(
    controls: ExposureControls,
    desired: DesiredResponse,
    available: AvailableExposures | None = None,
) -> AccuracyProblem:
    """Return the problem of choosing exposures for a camera whose noise is known.

    Without `available`: any time at the gain nearest to 1, as is chosen where nothing limits time.
    """
    assert controls.noise is not None  # `objective_of` has checked it
    if available is None:
        available = AvailableExposures(gains=(controls.gain.nearest(1.0),))
    return AccuracyProblem(controls.levels, desired, controls.noise, available, controls.black)


def accurate_settings(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    limit_s: float,
    progress: Callable[[float], None] | None,
    *,
    before: ExposureSetting | None = None,
) -> tuple[tuple[ExposureSetting, ...], tuple[float, ...]]:
    """Return the settings, ascending in exposure, and the exposures that were asked of the camera.

    Gain is raised only where time is limited: by a budget, by an accuracy that is to be reached in
    the least time, or by the camera's longest time.

    Args:
        controls: of a camera whose noise is known
        request: what the user asks for
        desired: the desired response
        limit_s: the longest shutter time of the shortest exposure, s
        progress: called with the share done, 0 to 1
        before: the setting of the frame before, such as the metering frame

    Raises:
        UsageError: the time budget is too short, or no set reaches the accuracy
        CaptureError: the given base exposure is beyond the camera's shutter times
    """
    time = controls.time_s
    problem, counts, total_limit = _problem(controls, request, desired, limit_s, before)
    unit_s = problem.available.unit_s
    found = look_up_accurate(
        problem, counts, total_limit=total_limit, accuracy=request.accuracy, progress=progress
    )
    chosen = list(zip(found.times, found.gains, strict=True))
    settings = _nearest(controls, chosen, unit_s)
    if request.accuracy is not None:
        settings = _lengthened(controls, desired, chosen, unit_s, request.accuracy)
    settings.sort(key=lambda setting: setting.exposure)
    if predicted_wall_s(controls, settings, before=before) > (request.time_budget_s or math.inf):
        settings = [
            ExposureSetting(at_most(time, each * unit_s), controls.gain.nearest(gain))
            for each, gain in chosen
        ]
    return tuple(sorted(settings, key=lambda setting: setting.exposure)), found.exposures


def _nearest(
    controls: ExposureControls, chosen: list[tuple[float, float]], unit_s: float
) -> list[ExposureSetting]:
    """Return the settings nearest to shutter times in `unit_s` and gains."""
    found = [(each * unit_s, controls.gain.nearest(gain)) for each, gain in chosen]
    return [ExposureSetting(controls.nearest_time(time_s, gain), gain) for time_s, gain in found]


def _lengthened(
    controls: ExposureControls,
    desired: DesiredResponse,
    chosen: list[tuple[float, float]],
    unit_s: float,
    accuracy: float,
) -> list[ExposureSetting]:
    """Return the nearest settings; if they miss the accuracy, slightly longer ones that have it.

    They miss it by the camera's steps, and by what `look_up_accurate` leaves out.
    """
    best: tuple[float, list[ExposureSetting]] = (0.0, [])
    for factor in _LENGTHENINGS:
        longer = [(each if each <= 1 else each * factor, gain) for each, gain in chosen]
        settings = sorted(_nearest(controls, longer, unit_s), key=lambda each: each.exposure)
        camera = EffectiveCamera.of(controls.levels, controls.relative_exposures(settings))
        levels = noisy_effective_levels(camera, desired, controls.frame_noise(settings))
        best = max(best, (levels, settings), key=lambda each: each[0])
        if levels >= accuracy:
            break
    return best[1]


def estimated_levels(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    limit_s: float,
    *,
    before: ExposureSetting | None = None,
) -> float | None:
    """Return about the effective levels that `accurate_settings` can reach, in less time.

    They are within a few per cent; see `camctl.exposure.accuracy.estimate_levels`.
    """
    problem, counts, total_limit = _problem(controls, request, desired, limit_s, before)
    return estimate_levels(without_idle_limits(problem), counts, total_limit=total_limit)


def _problem(
    controls: ExposureControls,
    request: CaptureRequest,
    desired: DesiredResponse,
    limit_s: float,
    before: ExposureSetting | None,
) -> tuple[AccuracyProblem, Sequence[int], float]:
    """Return the problem, the numbers of exposures to choose from, and the limit of time."""
    time, base_s = controls.time_s, _base(controls, request, limit_s)
    times = _times(controls, request, base_s)
    chooses_time = request.time_budget_s is not None or request.accuracy is not None
    is_limited = chooses_time or time.maximum * desired.e_min < base_s
    gains = gain_choices(controls.gain) if is_limited else (controls.gain.nearest(1.0),)
    unit_s = base_s if times is None else 1.0
    costs = TimeCosts()
    if chooses_time:
        costs = time_costs(controls, before=before, shortest_s=base_s).in_unit(unit_s)
    available = AvailableExposures(
        times,
        gains,
        shortest=min(1.0, time.minimum / base_s),
        longest=max(1.0, time.maximum / base_s),
        base=(base_s * gains[0], base_s * gains[0]),
        unit_s=unit_s,
        costs=costs,
    )
    if request.count is not None:
        counts: Sequence[int] = (request.count,)
    else:
        counts = COUNTS if chooses_time else (DEFAULT_COUNT,)
    total_limit = (request.time_budget_s or math.inf) / unit_s * (1 + _SAME)
    return accuracy_problem(controls, desired, available), counts, total_limit


def _base(controls: ExposureControls, request: CaptureRequest, limit_s: float) -> float:
    """Return the shutter time of the shortest exposure at the smallest gain, s."""
    if request.base_s is not None:
        return given_base(controls.time_s, limit_s)
    base_s = at_most(controls.time_s, limit_s)
    if request.mains_hz is not None:
        period_s = 0.5 / request.mains_hz
        whole_s = at_most(controls.time_s, math.floor(base_s / period_s + _SAME) * period_s)
        if base_s * 2.0**-BASE_SLACK_STOPS <= whole_s:
            return whole_s
    return base_s


def _times(
    controls: ExposureControls, request: CaptureRequest, base_s: float
) -> tuple[float, ...] | None:
    """Return the shutter times to choose from where they are a list; None: any time."""
    time = controls.time_s
    if request.mains_hz is None:
        return time.values if isinstance(time, Choices) else None
    period_s = 0.5 / request.mains_hz
    counts = np.unique(np.geomspace(1, max(1.0, time.maximum / period_s), _PERIODS).astype(int))
    whole = {time.nearest(count * period_s) for count in counts.tolist()}
    return tuple(sorted({base_s, *(t for t in whole if t >= base_s)}))
