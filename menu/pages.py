"""What the pages with buttons show, but for their title and buttons; see `camctl.menu.screens`."""

from __future__ import annotations

import re
from dataclasses import replace

import camctl
from camctl.menu.data import Plan, Reading, Summary
from camctl.menu.entries import RESPONSES, requested
from camctl.menu.model import Model
from camctl.menu.ports import Line, Screen
from camctl.menu.text import (
    format_bytes,
    format_levels,
    format_ratio,
    format_short_time,
)
from camctl.system.number_text import percent_text, range_text

BLANK = Screen(Line(("",)))


def idle(model: Model) -> Screen:
    """Return the exposure meter, the selection, and the free space."""
    reading = model.reading
    lines: list[Line] = []
    if reading is None:
        lines.append(Line(("Reading the exposure meter", "Metering ...")))
    elif reading.remark:
        lines.append(Line((reading.remark, "No light meter")))
    elif reading.is_late:
        lines.append(Line(("The camera meters when it shoots", "No live meter")))
    else:
        time, clipped = format_short_time(reading.time_s), percent_text(reading.clipped)
        if reading.rate is None:
            words: tuple[str, ...] = (
                f"Shortest exposure {time}, {clipped} clipped",
                f"{time}  {clipped} clip",
                f"{clipped} clipped",
                f"{clipped} clip",
            )
        else:
            rate = f"{reading.rate:.1f}" if reading.rate else "..."
            words = (
                f"Live {rate}/s, shortest {time}, {clipped} clipped",
                f"{time}  live {rate}/s",
                f"live {rate}/s",
            )
        lines.append(Line(words))
    asked = requested(model)
    name = RESPONSES[model.settings.response].labels[-1]
    wide = "auto" if asked.dynamic_range is None else range_text(asked.dynamic_range)
    narrow = wide.replace(",", "")
    count = "" if asked.count is None else f" x{asked.count}"
    lines.append(Line((f"{name}, {wide},{count or ' auto'}", f"{name[:6]} {narrow}{count}"[:14])))
    if reading is not None:
        lines += _stated(reading)
        free = format_bytes(reading.free_bytes)
        lines.append(Line((f"Free space {free}", f"Free {free}")))
    return replace(
        BLANK,
        lines=tuple(lines),
        paragraphs=(f"! {model.note}",) if model.note else (),
        histogram=() if reading is None else reading.histogram,
        picture=None if reading is None else reading.picture,
    )


def _stated(reading: Reading) -> list[Line]:
    """Return focus, and battery, card, lens and mode dial where the camera states them."""
    lines = []
    if (percent := reading.focus_percent) is not None:
        lines.append(Line((f"Focus {percent} % of the best seen", f"Focus {percent} %")))
    battery, images = reading.battery_percent, reading.free_images
    if battery is not None:
        lines.append(Line((f"Battery {battery} %",)))
    if images is not None:
        lines.append(Line((f"{images} pictures free on the card", f"Card {images} free")))
    if reading.lens is not None:
        lines.append(Line((f"Lens {reading.lens}", reading.lens)))
    if reading.mode is not None:
        lines.append(Line((f"Mode dial at {reading.mode}", f"Mode {reading.mode}")))
    return lines


def failure(model: Model) -> Screen:
    """Return the message of the last failure."""
    return replace(BLANK, paragraphs=(model.error,))


def confirm(_: Model) -> Screen:
    """Return what quitting leaves."""
    return replace(BLANK, paragraphs=("Selections and captures are kept.",))


def review(model: Model) -> Screen:
    """Return the plan that will be shot."""
    return BLANK if model.plan is None else _plan(model.plan)


def _plan(plan: Plan) -> Screen:
    width = max((len(text) for text, _ in plan.frames), default=0)
    head = [
        Line(
            (
                f"{format_levels(plan.effective_levels)} effective levels",
                f"{format_levels(plan.effective_levels)} levels",
            )
        )
    ]
    if plan.wall_s is not None:
        quality = "" if plan.is_wall_known else "at least "
        time = format_short_time(plan.wall_s)
        head.append(Line((f"Total time {quality}{time}", f"Total {time}")))
    head.append(
        Line(
            (
                f"Exposure time {format_short_time(plan.shutter_s)}",
                f"Exp. {format_short_time(plan.shutter_s)}",
            )
        )
    )
    frames = [
        Line(
            (
                f"{index} {text:>{width}} x{format_ratio(ratio)}",
                f"{index} {text}",
                f"{index} {_rounded(text)}",
                f"{index} {_rounded(text).replace(' s', 's').replace('gain ', 'gain')}",
            )
        )
        for index, (text, ratio) in enumerate(plan.frames, start=1)
    ]
    needed, free = format_bytes(plan.needed_bytes), format_bytes(plan.free_bytes)
    space = Line((f"Needs {needed}, {free} free", f"Needs {needed}"))
    missing = f"{format_levels(plan.xi)} of {format_levels(plan.levels_wanted)}"
    return replace(
        BLANK,
        lines=(*head, *frames, space),
        paragraphs=(
            f"{missing} desired levels missing",
            _noise_text(plan.effective_levels_noise_free, plan.noise_known),
            *(f"! {warning}" for warning in plan.warnings),
        ),
    )


def _rounded(text: str) -> str:
    """Return the setting of a frame with three digits of each number.

    >>> _rounded("1.72274 s gain 2.828427")
    '1.72 s gain 2.83'
    """
    return re.sub(r"\d+\.\d+", lambda found: f"{float(found[0]):.3g}", text)


def _noise_text(noise_free: float | None, noise_known: bool) -> str:
    """Return what the number of effective levels above counts."""
    if not noise_known or noise_free is None:
        return "Noise unknown: effective levels count quantisation only"
    return f"{format_levels(noise_free)} effective levels without noise"


def result(model: Model) -> Screen:
    """Return the result of a capture."""
    return BLANK if model.summary is None else _summary(model.summary)


def _beside_plan(levels: str, planned_levels: float | None) -> tuple[str, ...]:
    """Return the effective levels beside those of the plan, from the longest text on."""
    if planned_levels is None:
        return (f"{levels} effective levels",)
    planned = format_levels(planned_levels)
    if planned == levels:
        return f"{levels} effective levels, as planned", f"{levels} levels, as planned"
    return (
        f"{levels} effective levels, {planned} planned",
        f"{levels} levels, {planned} planned",
        f"{levels} of {planned} levels",
    )


def _summary(summary: Summary) -> Screen:
    levels = format_levels(summary.effective_levels)
    clipped = percent_text(summary.saturated)
    distrust = summary.untrustworthy_because
    head = [Line(("! Not trustworthy",))] if distrust else []
    return replace(
        BLANK,
        lines=(
            *head,
            Line((*_beside_plan(levels, summary.planned_levels), f"{levels} levels")),
            Line((f"{clipped} clipped in all frames", f"{clipped} clipped", clipped)),
        ),
        paragraphs=(
            *([distrust] if distrust else []),
            _noise_text(summary.effective_levels_noise_free, summary.noise_known),
            f"Saved in {summary.folder}",
            *(f"! {note}" for note in summary.notes),
        ),
        histogram=summary.histogram,
        picture=summary.picture,
        folder=summary.folder,
    )


def calibrated(model: Model) -> Screen:
    """Return what a calibration has measured, which the camera's profile keeps."""
    return replace(BLANK, paragraphs=(*model.calibrated, "Kept in the camera's profile."))


def about(model: Model) -> Screen:
    """Return what this is, and the camera."""
    camera = "no camera" if model.camera is None else f"{model.camera.name} ({model.camera.id})"
    return replace(
        BLANK,
        lines=(Line((f"camctl {camctl.__version__}", camctl.__version__)),),
        paragraphs=(
            camera,
            "Takes several exposures and sums them; the sum is the picture of another, effective "
            "camera.",
            *([model.note] if model.note else []),
        ),
    )


def stopping(_: Model) -> Screen:
    """Return the question whether to quit while the camera is busy."""
    return replace(BLANK, paragraphs=("The camera finishes its frame. Quit the menu now?",))
