"""The summary of a capture, as it is printed."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.cli.output import (
    camera_text,
    format_duration,
    format_effective,
    format_fields,
    format_number,
    format_percent,
    format_request,
    format_table,
)
from camctl.records import REPORT
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.evidence.movement import FoundMovement
    from camctl.model.noise import MeasuredNoise
    from camctl.records.capture_plan import CapturePlan, PlannedLight
    from camctl.records.report import Achieved, CaptureReport

TIMES = {"planning_s": "planning", "shooting_s": "shooting", "writing_s": "writing"}
"""Keys of `CaptureReport.timing` that the summary shows, and their labels."""

#: Lamps and reflections: how far they are above the range at least, stops, and their share at most.
_LAMP_STOPS, _MOST_LAMPS = 2.0, 0.01
#: Share of the picture that metering cannot tell from black, and that may be darker than the range.
_NOTABLY_UNSEEN = 0.02

#: Characters of a histogram, from an empty bin to the fullest one.
_BARS = " \u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"

CHOSEN_BY = {
    "accuracy": "accuracy with the camera's noise",
    "xi": "missing levels (xi), without noise",
}


def light_text(light: PlannedLight) -> str:
    """Return one line on the light that was metered, and what of it the picture will not hold."""

    def spans(ratio: float, *, more: bool) -> str:
        return ("more than " if more else "") + range_text(float(f"{ratio:.2g}"))

    from camctl.exposure.light import NOTABLE_SHARE  # loads numpy

    text = f"the scene spans {spans(light.span, more=light.is_open or light.is_cut)}"
    if light.clips >= NOTABLE_SHARE:
        are_lamps = light.clips_stops >= _LAMP_STOPS and light.clips <= _MOST_LAMPS
        what = "lamps, reflections" if are_lamps else "the brightest parts"
        text += f"; {format_percent(light.clips)} ({what}) will clip"
        rest = light.span / 2.0**light.clips_stops
        if light.clips_stops >= _LAMP_STOPS and rest > 1:
            text += f", and the rest spans {spans(rest, more=light.is_open)}"
    if light.dark >= NOTABLE_SHARE:
        text += f"; {format_percent(light.dark)} will be darker than the range"
    if light.unseen > light.dark + _NOTABLY_UNSEEN:
        share = format_percent(light.unseen)
        text += f"; metering shows no light in {share}, all of which may be darker than the range"
    return text


def format_wall(seconds: float) -> str:
    """Return a predicted time with the two digits that it is known to."""
    return format_duration(float(f"{seconds:.2g}"))


def capture_text(report: CaptureReport, directory: Path, *, with_bars: bool = False) -> str:
    """Return the summary of a capture: its plan, its frames, its quality and its files.

    `with_bars` adds a histogram of its light, for a terminal.
    """
    plan = report.plan
    shortest = min(report.frames, key=lambda frame: frame.exposure)
    rows = [
        ("camera", camera_text(report.camera)),
        ("desired", format_request(plan.desired.name, plan.dynamic_range, len(plan.settings))),
        ("shortest exposure", f"{format_duration(shortest.applied_s)}, {_metering_text(report)}"),
    ]
    if plan.light is not None:
        rows.insert(1, ("light", light_text(plan.light)))
    if report.request.ratios is None:
        rows.insert(-1, ("chosen by", CHOSEN_BY[plan.objective]))
    parts = [format_fields(rows), "", _frames_text(report), ""]
    if with_bars:
        parts += [light_bars(report), ""]
    achieved = report.achieved
    rows = []
    if report.untrustworthy_because is not None:
        rows.append(("not trustworthy", report.untrustworthy_because))
    rows += [
        *_frame_rows(report),
        *_levels_rows(achieved, plan),
        # Photographs are not taken again, whatever more time would bring.
        *(_front_rows(plan, report.camera.id) if report.repeatable else ()),
        (
            "missing levels (xi)",
            f"{format_number(achieved.xi, 5)} of {format_number(plan.levels_wanted)}",
        ),
        (
            "outside the range",
            f"{format_percent(achieved.saturated_fraction)} saturated in every frame, "
            f"{format_percent(achieved.dark_fraction)} darker than "
            f"{range_text(report.plan.dynamic_range)} (of the samples)",
        ),
        *_movement_rows(report.movement),
        ("time", _timing_text(report)),
        *_wall_rows(report),
        ("result", str(directory)),
        *(("", name) for name in [*report.files.values(), REPORT, "frames/"]),
    ]
    return "\n".join([*parts, format_fields(rows)])


def _frame_rows(report: CaptureReport) -> list[tuple[str, str]]:
    """Return what happened to the frames, and which errors of their exposures would show."""
    from camctl.evidence.ratio_check import least_errors

    frames, rows = report.frames, []
    if lost := [number for number, frame in enumerate(frames, 1) if frame.lost]:
        rows.append(("lost", f"{_numbered(lost)}: lost on the way at first, and taken again"))
    if again := [number for number, frame in enumerate(frames, 1) if frame.attempts > 1]:
        text = f"{_numbered(again)}: the first one did not fit the other frames"
        rows.append(("shot again", text))
    least = least_errors([frame.ratio for frame in frames])
    found = [(error, number) for number, error in enumerate(least, 1) if math.isfinite(error)]
    if report.repeatable and found:
        parts = [
            f"{format_percent(error)} (frame {number})"
            for error, number in sorted({min(found), max(found)})
        ]
        unseen = [number for number, error in enumerate(least, 1) if not math.isfinite(error)]
        none = f"; none of {_numbered(unseen)}" if unseen else ""
        text = f"wrong exposures show from {' to '.join(parts)} on{none}"
        rows.append(("smallest error", text))
    return rows


def _numbered(numbers: Sequence[int]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def draws_bars() -> bool:
    """Return whether standard output is a terminal that shows the characters of `light_bars`."""
    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    try:
        _BARS.encode(encoding)
    except (UnicodeError, LookupError):
        return False
    return sys.stdout.isatty()


def light_bars(report: CaptureReport) -> str:
    """Return the histogram of a picture's light in two lines, from dark to bright."""
    shares, achieved = report.achieved.light_shares, report.achieved
    most = max(shares, default=0.0)
    heights = (0 if not share else 1 + round(share / most * (len(_BARS) - 2)) for share in shares)
    bars = "".join(_BARS[height] for height in heights)
    dark, bright = (
        format_percent(achieved.dark_fraction),
        format_percent(achieved.saturated_fraction),
    )
    lower = f"1/{report.plan.dynamic_range:,.0f}"
    scale = f"{lower}{'full scale':>{max(len(bars) - len(lower), 11)}}"
    return f"{dark:>8} darker |{bars}| brighter {bright}\n{'':15} {scale}"


def _timing_text(report: CaptureReport) -> str:
    if not report.repeatable:  # of photographs, nothing was planned and shot
        return format_duration(sum(report.timing.get(key, 0.0) for key in TIMES))
    return ", ".join(
        f"{label} {format_duration(report.timing[key])}"
        for key, label in TIMES.items()
        if key in report.timing
    )


def _wall_rows(report: CaptureReport) -> list[tuple[str, str]]:
    """Return planned and actual time until the last frame; virtual time is marked."""
    timing = report.timing
    if "actual_wall_s" not in timing or not report.repeatable:
        return []
    is_virtual = " of the simulated camera's own clock" if report.clock == "virtual" else ""
    at_least = "" if report.plan.is_wall_known else "at least "
    text = (
        f"until the last frame {format_duration(timing['actual_wall_s'])}{is_virtual} "
        f"(planned {at_least}{format_duration(timing['planned_wall_s'])})"
    )
    return [("", text)]


def _front_rows(plan: CapturePlan, camera_id: str) -> list[tuple[str, str]]:
    """Return what half and double the time would give, where the plan knows that, or why not."""
    from camctl.exposure.noise import noise_findings
    from camctl.messages.command_line import finding_line

    if findings := noise_findings(plan.noise, camera_id):
        return [("time / accuracy", finding_line(finding)) for finding in findings]
    if plan.front is None or plan.wall_s is None or not plan.is_wall_known:
        return []
    times = [plan.wall_s / 2, plan.wall_s, 2 * plan.wall_s]
    half, double = (plan.front.levels_within(time_s) for time_s in (times[0], times[2]))
    costs = [
        f"{format_wall(time_s)} {format_number(levels, 3)}"
        for time_s, levels in zip(times, (half, plan.effective_levels, double), strict=True)
        if levels is not None
    ]
    place = 0 if half is None else 1
    costs[0], costs[place] = f"{costs[0]} levels", f"{costs[place]}{' levels' * (not place)} (this)"
    return [("time / accuracy", ", ".join(costs))]


def _levels_rows(achieved: Achieved, plan: CapturePlan) -> list[tuple[str, str]]:
    """Return the effective levels, with the noise that is known or the one that the pixels show."""
    planned = format_number(plan.effective_levels, 4)
    measured, free = achieved.measured, achieved.effective_levels_noise_free
    rows = []
    if achieved.noise is None and measured is not None and free is not None:
        levels = format_number(measured.effective_levels, 4)
        text = f"{levels} with the noise that the pixels show, {format_number(free, 4)} without"
        rows.append(("effective levels", f"{text} (planned {planned} without)"))
        rows.append(("", _measured_text(measured)))
    else:
        text = format_effective(achieved, noise_known=achieved.noise is not None)
        rows.append(("effective levels", f"{text} (planned {planned})"))
        if measured is not None:
            levels = format_number(measured.effective_levels, 4)
            rows.append(
                ("  from the pixels", f"{levels} with the noise {_measured_text(measured)}")
            )
    if achieved.gain_over_sum is not None and len(plan.exposures) > 1:
        rows.append(("radiance", _radiance_text(achieved.gain_over_sum)))
    return rows


def _radiance_text(gain: float) -> str:
    """Return how the light was computed, and what the inverse of the sum would make of it."""
    times = format_number(gain, 3)
    is_alike = times == "1"
    than = "it would be as accurate" if is_alike else f"its error would be {times} times as large"
    return f"estimated from all frames; computed from their sum, {than}"


def _measured_text(measured: MeasuredNoise) -> str:
    share = format_percent(measured.uncertainty / measured.effective_levels)
    return f"measured in {measured.samples:,} pixels, +- {share}"


def _movement_rows(movement: FoundMovement | None) -> list[tuple[str, str]]:
    """Return how much moved or changed between the frames; a finding says where."""
    if movement is None:
        return []
    share, spread = format_percent(movement.share), []
    if movement.spread:
        bright = f"{format_percent(movement.spread)} of the picture is too bright"
        spread = [("", f"light that spread from saturated samples, or a thing there: {bright}")]
    if not movement.is_seen:
        compared = (
            f"no two frames have more than {format_percent(movement.compared)} of the samples"
        )
        return [("movement", f"not known: {compared} in range")]
    if not movement.places:
        return [("movement", f"none ({share} of the samples differ, as by noise)"), *spread]
    shares = (
        f"{share} of the samples differ between frames, "
        f"at most {format_percent(movement.false_alarms)} by noise"
    )
    return [("movement", shares), *spread]


def _metering_text(report: CaptureReport) -> str:
    metering = report.plan.metering
    if metering is None:
        return "as given"
    reached = (
        f"highlights reach {format_percent(metering.highlight)} of full scale, "
        f"{format_percent(metering.clipped)} are saturated"
    )
    if not report.repeatable:
        return f"in which {reached}"
    frames = "1 frame" if metering.frames == 1 else f"{metering.frames} frames"
    return f"metered in {frames}: at {format_duration(metering.setting.time_s)} {reached}"


def simulation_text(report: CaptureReport) -> str:
    """Return which effects of a simulated sensor the frames lack, and what that can change."""
    summary = report.simulation
    if summary is None:
        return "--explain: the camera is not simulated, so that no effect was left out."
    if not summary.left_out:
        return f"No effect was left out (tolerance {format_number(summary.tolerance_dn, 3)} DN)."
    lines = [
        (name, ", ".join(map(str, one.frames)), format_number(one.bound_dn, 3))
        for name, one in summary.left_out.items()
    ]
    header = ("effect left out", "in frames", "can change alone, DN")
    total = (
        f"All that was left out can change a sample of the sum by at most"
        f" {format_number(summary.joint_bound_dn, 3)} DN (tolerance"
        f" {format_number(summary.tolerance_dn, 3)} DN); 0 DN means that no bit differs."
    )
    return "\n\n".join((format_table(header, lines, right_aligned=(2,)), total))


def _frames_text(report: CaptureReport) -> str:
    headings = ("exposure", "planned", "time", "gain", "saturated")
    frames = sorted(report.frames, key=lambda frame: frame.exposure)
    rows = [
        (
            format_number(frame.exposure),
            format_number(ratio),
            format_duration(frame.applied_s),
            format_number(frame.applied.gain, 4),
            format_percent(frame.saturated_fraction),
        )
        for frame, ratio in zip(frames, sorted(report.plan.ratios), strict=False)
    ]
    return format_table(headings, rows, right_aligned=range(len(headings)))
