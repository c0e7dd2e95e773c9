"""How long a capture takes, from the camera's own figures: predicted before it is shot."""

from __future__ import annotations

import math
from collections.abc import Sequence

from camctl.clock import CaptureTiming
from camctl.controls import ExposureControls, ExposureSetting

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
    timing = controls.timing or CaptureTiming()
    times = [setting.time_s for setting in settings]
    if controls.frame_interval_s == 0:
        return _still_s(timing, times)
    usual = controls.frame_interval_s
    slots = [max(time_s, usual) for time_s in times]
    first = max(before.time_s, usual) if before and not timing.rests else usual
    if controls.delay_frames is not None:
        waiting_s = (timing.lead_frames + controls.delay_frames) * first
        return waiting_s + sum(max(slot, timing.readout_s) for slot in slots) + timing.readout_s
    lead_frames = math.ceil(timing.lead_frames) if first > usual else timing.lead_frames
    total, last = lead_frames * first, first
    for place, slot in enumerate(slots):
        # Each write after the first comes when a frame has been read, after a slot has begun.
        if place and timing.lead_frames:
            total += last * max(1, math.ceil(timing.readout_s / last))
        total += timing.old_frames * last + (timing.unsettled_frames + 1) * slot
        last = slot
    return total + timing.readout_s


def wall_time_warnings(
    controls: ExposureControls,
    settings: Sequence[ExposureSetting],
    *,
    planned_s: float,
    actual_s: float,
) -> list[str]:
    """Return a warning where a capture took another time than planned.

    A difference is one of more than `NOTABLE` of the planned time and of the time that no plan can
    know: a request comes at any time within a frame, and a varying control delay is known on
    average.
    """
    timing = controls.timing or CaptureTiming()
    usual = controls.frame_interval_s
    unknown_s = usual * (timing.lead_frames > 0)
    unknown_s += timing.unsettled_frames * sum(max(each.time_s, usual) for each in settings)
    if abs(actual_s - planned_s) <= NOTABLE * planned_s + unknown_s:
        return []
    return [
        f"the last frame arrived after {actual_s:.3g} s instead of the {planned_s:.3g} s planned: "
        "the computer was busy, or frames were lost"
    ]


def _still_s(timing: CaptureTiming, times: Sequence[float]) -> float:
    total = timing.download_s
    for place, time_s in enumerate(times):
        exposing_s, download_s = time_s + timing.readout_s, timing.download_s if place else 0.0
        together_s = max(exposing_s, download_s) if timing.overlaps else exposing_s + download_s
        total += timing.settling_s + together_s
    return total
