"""The problem of choosing the settings of a camera for a capture: times, gains, and their costs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures, TimeCosts
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.settings import BASE_SLACK_STOPS, at_most, given_base
from camctl.exposure.search.wall_time import time_costs
from camctl.interface.controls import Choices, Control, ExposureControls, ExposureSetting, Steps
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse

NO_NOISE = NoiseModel(1.0, photon_noise=False)
"""What is assumed of a camera whose noise is unknown."""

#: Whole flicker periods that are tried as shutter times, at most.
_PERIODS = 200
#: Relative difference up to which two times are the same, in float64.
_SAME = 1e-8


def timed_problem(
    controls: ExposureControls,
    desired: DesiredResponse,
    limit_s: float,
    *,
    request: CaptureRequest,
    before: ExposureSetting | None,
) -> AccuracyProblem:
    """Return the problem of choosing settings, with what they take in a capture.

    Args:
        controls: of the camera
        desired: the desired response
        limit_s: longest shutter time of the shortest exposure, s
        request: a given base exposure, and the frequency of the mains
        before: the setting of the frame before

    Raises:
        CaptureError: the given base exposure is beyond the camera's shutter times
    """
    time, base_s = controls.time_s, _base(controls, request, limit_s)
    times, gains = _times(controls, request, base_s), gain_choices(controls.gain)
    unit_s = base_s if times is None else 1.0
    costs = time_costs(controls, before=before, shortest_s=base_s).in_unit(unit_s)
    available = AvailableExposures(
        times,
        gains,
        shortest=min(1.0, time.minimum / base_s),
        longest=max(1.0, time.maximum / base_s),
        step=time.step / base_s if isinstance(time, Steps) else 0.0,
        base=(base_s * gains[0], base_s * gains[0]),
        unit_s=unit_s,
        costs=costs,
    )
    # Unknown noise counts as none.
    noise = NO_NOISE if controls.noise is None else controls.noise
    return AccuracyProblem(controls.levels, desired, noise, available, controls.black)


def without_costs(problem: AccuracyProblem, controls: ExposureControls) -> AccuracyProblem:
    """Return a problem where shutter time alone counts, at the lowest gain if that is enough."""
    available = problem.available
    base = available.unit_s if available.times is None else (available.base or (0.0,))[0]
    is_limited = controls.time_s.maximum * problem.desired.e_min < base
    gains = available.gains if is_limited else available.gains[:1]
    return replace(problem, available=replace(available, gains=gains, costs=TimeCosts()))


def gain_choices(gain: Control) -> tuple[float, ...]:
    """Return gains to choose from: factors of two from the one nearest to 1, ascending."""
    first = gain.nearest(1.0)
    doublings = range(max(0, math.floor(math.log2(gain.maximum / first) + _SAME)) + 1)
    return tuple(sorted({gain.nearest(first * 2.0**power) for power in doublings}))


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
