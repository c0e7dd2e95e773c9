"""How long a capture takes, from the camera's own figures; and the problem of its settings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures, TimeCosts
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.settings import BASE_SLACK_STOPS, at_most, given_base
from camctl.findings import Finding
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import Choices, Control, ExposureControls, ExposureSetting, Steps
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse

NOTABLE = 0.1
"""Relative difference between planned and actual time of a capture from which it is reported."""


def predicted_wall_s(
    controls: ExposureControls,
    settings: Sequence[ExposureSetting],
    *,
    before: ExposureSetting | None = None,
) -> float:
    """Return the time from the request of `settings` until their last frame is here, s.

    A stream spends a slot of max(exposure, frame interval) on each frame.  With a constant control
    delay of d frames there are n of them, d before them that still have the exposure before, and
    `CaptureTiming.lead_frames`; without one, each exposure waits until it has settled.  The slots
    before are as long as the exposure before unless the stream `rests`; a request that follows a
    long one waits for all of the next such slot.  A still camera makes its settings, exposes,
    stores, and downloads, during the next exposure if it can.

    Where `controls.timing` is None the result counts exposures, frame intervals and a constant
    delay alone: it is a lower bound.

    Args:
        controls: of the camera
        settings: in the order of shooting
        before: the setting of the frame before, such as the metering frame; None: one that is no
            longer than the frame interval
    """
    if not settings:
        return 0.0
    times = [setting.time_s for setting in settings]
    costs = time_costs(controls, before=before, shortest_s=times[0])
    total = costs.fixed + costs.total(times)
    timing, usual = controls.timing or CaptureTiming(), controls.frame_interval_s
    if usual and controls.delay_frames is None and timing.lead_frames:
        slots = [max(time_s, usual) for time_s in times[:-1]]
        total += sum(_missed_s(timing, slot) - costs.extra for slot in slots)
    return total


def time_costs(
    controls: ExposureControls, *, before: ExposureSetting | None, shortest_s: float
) -> TimeCosts:
    """Return what exposures take by `predicted_wall_s`, in seconds, before they are chosen.

    Where the control delay is not constant, a readout before a later exposure is counted in frame
    intervals: longer frames hold more of it.

    Args:
        controls: of the camera
        before: the setting of the frame before
        shortest_s: shutter time of the first exposure, which is the shortest, or more
    """
    timing, usual = controls.timing or CaptureTiming(), controls.frame_interval_s
    readout_s, download_s = timing.readout_s, timing.download_s
    if usual == 0:
        extra_s = timing.settling_s + readout_s
        if not timing.overlaps:
            # A camera that is triggered takes frames that are not used until a setting has settled.
            frames = 1 + timing.old_frames + timing.unsettled_frames
            return TimeCosts(frames, extra=frames * (extra_s + download_s))
        # No download runs during the first exposure.
        least_s = max(0.0, download_s - readout_s)
        return TimeCosts(1.0, least_s, extra_s, download_s - max(0.0, least_s - shortest_s))
    first = _first_slot_s(controls, before)
    if controls.delay_frames is not None:
        waiting_s = (timing.lead_frames + controls.delay_frames) * first
        return TimeCosts(least=max(usual, readout_s), fixed=waiting_s + readout_s)
    waiting = timing.old_frames + bool(timing.lead_frames)
    extra_s = _missed_s(timing, usual) if timing.lead_frames else 0.0
    first_s = (_lead_frames(controls, first) + timing.old_frames) * first
    fixed_s = first_s + readout_s - extra_s  # the first one has no slot before it
    return TimeCosts(timing.unsettled_frames + 1 + waiting, usual, extra_s, fixed_s, waiting)


def _missed_s(timing: CaptureTiming, slot_s: float) -> float:
    """Return the time of the slots that pass while a frame is read, but for one, s.

    Each setting after the first is written when a frame has been read, after a slot has begun.
    """
    return slot_s * max(0, math.ceil(timing.readout_s / slot_s) - 1)


def _first_slot_s(controls: ExposureControls, before: ExposureSetting | None) -> float:
    """Return how long the frames before the first exposure take each, s."""
    rests = controls.timing is not None and controls.timing.rests
    return max(controls.frame_interval_s, 0.0 if rests or before is None else before.time_s)


def _lead_frames(controls: ExposureControls, first_s: float) -> float:
    """Return the frames that pass before the first setting is written, without constant delay."""
    frames = 0.0 if controls.timing is None else controls.timing.lead_frames
    return math.ceil(frames) if first_s > controls.frame_interval_s else frames


def wall_time_findings(
    controls: ExposureControls,
    settings: Sequence[ExposureSetting],
    *,
    planned_s: float,
    actual_s: float,
) -> list[Finding]:
    """Return a finding where a capture took another time than planned, more or less.

    A difference is one of more than `NOTABLE` of the planned time and of the time that no plan can
    know: a request comes at any time within a frame, and where the control delay varies, frames
    before an exposure has settled may be as long as the one before or as this one.  What the plan
    adds for long frames before the first exposure is unknown in the same way.
    """
    timing = controls.timing or CaptureTiming()
    usual = controls.frame_interval_s
    slots = [usual, *(max(each.time_s, usual) for each in settings)]
    unknown_s = usual * (timing.lead_frames > 0)
    unknown_s += timing.unsettled_frames * sum(abs(a - b) for a, b in itertools.pairwise(slots))
    if timing.unsettled_frames:
        unknown_s += abs(planned_s - predicted_wall_s(controls, settings))
    if abs(actual_s - planned_s) <= NOTABLE * planned_s + unknown_s:
        return []
    return [Finding(code="time_differs", value=actual_s, details={"planned_s": planned_s})]


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
