"""What each state shows: a pure function from the model to a `Screen` of any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, runtime_checkable

from camctl.menu import pages
from camctl.menu.data import Cost, Progress
from camctl.menu.entries import RESPONSES, TIMERS, requested, rows, seconds
from camctl.menu.machine import choices, selected
from camctl.menu.model import Action, Goal, Model, State
from camctl.menu.ports import Line, Mood, Panel, Screen
from camctl.menu.tables import KEYS, STATES, Kind
from camctl.menu.text import format_levels, format_short_time, format_total, gain_in_words
from camctl.messages.calibration import COVERED, STILL_SCENE
from camctl.system.number_text import range_text

#: Text of a waiting screen until there is progress to show.
_WAITING = {
    State.STARTING: ("Reading settings",),
    State.OPENING: ("Loading the controller", "Loading"),
    State.PLANNING: ("Measuring the light", "Measuring"),
    State.SHOOTING: ("Starting",),
    State.RESUMING: ("Reading frames", "Reading"),
    State.SERIES_SHOOTING: ("Measuring the light", "Measuring"),
    State.CALIBRATING: ("Loading the steps", "Loading"),
    State.CALIBRATION_STOPPING: ("The step ends first", "Ending"),
    State.CANCELLING: ("Keeping the frames", "Keeping frames"),
    State.SEARCHING: ("Asking each backend", "Asking"),
    State.BROWSING: ("Reading the folder", "Folder"),
    State.LOOKING: ("Reading the files", "Files"),
    State.QUIT: ("The menu has ended", "Ended"),
}
_FAILED = {state for state, spec in STATES.items() if Action.RETRY in spec.actions}


@runtime_checkable
class ModelPanel(Panel, Protocol):
    """A panel that shows more of the menu's state than its screens hold."""

    def show_model(self, model: Model) -> None:
        """Take the state whose screen is shown next."""


def screen(model: Model) -> Screen:
    """Return what the panel shows."""
    spec = STATES[model.state]
    if model.state is State.SAVER:
        return Screen(Line(spec.title), is_dark=True)
    by_kind = {Kind.LIST: _list, Kind.WAIT: _wait}
    otherwise = pages.failure if model.state in _FAILED else _nothing
    body = by_kind.get(spec.kind) or _BODIES.get(model.state, otherwise)
    is_loading = model.state is State.IDLE and model.camera is None
    return replace(
        body(model),
        title=Line(spec.title, _title_note(model)),
        keys=KEYS[spec.kind],
        mood=Mood.BUSY if is_loading else spec.mood,
        actions=tuple(action.value for action in spec.actions),
        action=model.action,
        offset=model.offset,
    )


def _title_note(model: Model) -> tuple[str, ...]:
    """Return what was selected before, or the camera."""
    if model.state in (State.IDLE, State.MENU, State.ABOUT):
        name = "" if model.camera is None else model.camera.name
        return (name, "")
    if model.state in (State.RESPONSE, State.CAPTURES, State.CAMERAS, State.SETTINGS):
        return ("",)
    return (_selection(model), "") if model.state in _AFTER_RESPONSE else ("",)


_AFTER_RESPONSE = {
    State.RANGE: 1,
    State.CUSTOM: 1,
    State.EXPOSURES: 2,
    State.BUDGET: 2,
    State.FRONT: 2,
    State.PLANNING: 3,
    State.REVIEW: 3,
    State.TIMER: 3,
    State.SHOOTING: 3,
    State.RESULT: 3,
}
"""How many of response, range and number of exposures are decided in a state."""


def _selection(model: Model) -> str:
    asked = requested(model)
    if asked.count is not None:
        goal = f"{asked.count} exposures"
    elif asked.time_budget_s is not None:
        about = model.goal is Goal.FRONT
        time = format_short_time(float(f"{asked.time_budget_s:.2g}"))
        goal = f"about {time}" if about else f"{time} at most"
    else:
        goal = ""
    span = "auto range" if asked.dynamic_range is None else range_text(asked.dynamic_range)
    parts = (RESPONSES[model.settings.response].labels[0], span, goal)
    return ", ".join(filter(None, parts[: _AFTER_RESPONSE[model.state]]))


def _list(model: Model) -> Screen:
    entries, index = rows(model), selected(model)
    has_costs = bool(STATES[model.state].cursor)
    notes = [_cost_note(model, place) if has_costs else ("",) for place in range(len(entries))]
    lines = tuple(Line(entry.labels, note) for entry, note in zip(entries, notes, strict=True))
    if not entries:
        return replace(pages.BLANK, paragraphs=(model.note or _EMPTY[model.state],))
    return replace(
        pages.BLANK,
        lines=lines,
        selected=index,
        detail=Line(_cost_detail(model, index)) if has_costs else _list_detail(model, index),
        paragraphs=_remarks(model, index),
    )


def _remarks(model: Model, index: int) -> tuple[str, ...]:
    """Return what stands below a list where there is room."""
    if model.state is State.EXPOSURES:
        return _gain(model, index)
    if model.state is State.CALIBRATION:
        return (*STILL_SCENE, COVERED)
    return ()


_EMPTY = {
    State.CAPTURES: "No captures yet",
    State.CAMERAS: "No cameras found",
    State.FRONT: "computing ...",
}


def _list_detail(model: Model, index: int) -> Line | None:
    if model.state is State.CAPTURES:
        done = model.captures[index].is_complete
        return Line(
            ("complete; enter shows it", "complete")
            if done
            else ("unfinished; enter takes what is missing", "enter: resume")
        )
    if model.state is State.FRONT:
        return Line(_point_detail(model.front[index]))
    if model.state is State.CALIBRATION:
        return Line(("enter: begin",))
    if rows(model)[index].action is Action.SEVERAL:
        return Line(("one picture with each, at once", "at once"))
    if model.state is State.CAMERAS:
        return Line((model.cameras[index].id, model.cameras[index].id[-16:]))
    if model.state in (State.SETTINGS, State.SERIES, State.SEVERAL):
        starts = rows(model)[index].action is Action.START
        return Line(("enter: start" if starts else "enter: change",))
    return None


def _point_detail(point: Cost) -> tuple[str, ...]:
    levels, count = format_levels(point.effective_levels), f"{point.count} exposures"
    if point.is_recommended:
        count += ", recommended"
    return (
        f"{count}: {levels} effective levels, noise counted",
        count,
        f"{levels} levels, {point.count} exp.",
        f"{levels} levels",
    )


def _gain(model: Model, index: int) -> tuple[str, ...]:
    """Return what a number of exposures costs and brings beside one less, where both are known."""
    cost, before = _cost(model, index), _cost(model, index - 1) if index else None
    costs = [each for each in (cost, before) if each is not None and not each.problem]
    if cost is None or before is None or len(costs) < 2 or cost.count != before.count + 1:
        return ()
    seconds = [each.shutter_s if each.wall_s is None else each.wall_s for each in (cost, before)]
    more = format_short_time(max(seconds[0] - seconds[1], 0.0))
    if cost.is_relative:
        more = f"{format_total(seconds[0] - seconds[1])}x base"
    words = gain_in_words(cost.count, more, cost.effective_levels, before.effective_levels)
    return (words,)


def _cost(model: Model, index: int) -> Cost | None:
    return model.costs[index] if index < len(model.costs) else None


def _cost_note(model: Model, index: int) -> tuple[str, ...]:
    cost = _cost(model, index)
    if choices(model)[index] is None:
        return ("",)
    if cost is None:
        return ("...", "")
    if cost.problem:
        return ("not possible", "-", "")
    levels = format_levels(cost.effective_levels)
    shutter, wall = _times(cost)
    return (
        f"{shutter:>9}{wall:>9}{levels:>6} levels",
        f"{shutter} {levels:>4} levels",
        f"{levels} levels",
        levels,
        "",
    )


def _times(cost: Cost) -> tuple[str, str]:
    if cost.is_relative:
        return f"{format_total(cost.shutter_s)}x", ""
    wall = "" if cost.wall_s is None else format_short_time(cost.wall_s)
    return format_short_time(cost.shutter_s), wall


def _cost_detail(model: Model, index: int) -> tuple[str, ...]:
    cost = _cost(model, index)
    if choices(model)[index] is None:
        return ("enter: choose it", "enter: choose")
    if cost is None:
        return (model.note, "computing ...") if model.note else ("computing ...",)
    if cost.problem:
        return (cost.problem, "not possible")
    levels, (shutter, wall) = format_levels(cost.effective_levels), _times(cost)
    quality = "effective levels" + (", noise counted" if cost.noise_known else ", noise unknown")
    time, count = wall or shutter, f"{cost.count} frames: "
    exposed = f"{shutter} the shortest exposure" if cost.is_relative else f"{shutter} exposed"
    total = f", {wall} in all" if wall else ""
    return (
        f"{count}{exposed}{total}, {levels} {quality}",
        f"{exposed}{total}, {levels} {quality}",
        f"{shutter} exposed{total}, {levels} levels",
        f"{time}, {levels} levels",
        f"{time.replace(' ', '')} {levels} levels",
        f"{levels} levels",
    )


def _wait(model: Model) -> Screen:
    progress = model.progress
    if model.state is State.TIMER:
        text = f"in {model.remaining_s} s"
        share = 1 - model.remaining_s / seconds(TIMERS[model.settings.timer])
        return replace(pages.BLANK, lines=(Line((f"shooting {text}", text)),), share=share)
    if progress is None or progress.total <= 0:
        return replace(pages.BLANK, lines=(Line(_WAITING.get(model.state, ("",))),))
    return replace(
        pages.BLANK,
        lines=(Line(_progress_texts(model, progress)),),
        paragraphs=progress.lines,
        share=min(1.0, progress.share),
    )


def _progress_texts(model: Model, progress: Progress) -> tuple[str, ...]:
    """Return how far a capture or a calibration is, from the longest text to the shortest."""
    stage, of = progress.stage, f"{progress.done} of {progress.total}"
    short = f"{progress.done}/{progress.total}"
    if model.state in (State.CALIBRATING, State.CALIBRATION_STOPPING):
        return f"Measuring {stage}", stage
    if stage in ("writing", "metering"):
        return (stage,)
    if stage == "shooting":
        return f"{of} frames taken", f"{short} frames taken", f"{short} taken"
    return f"{of} {stage}", f"{short} {stage}"


def _nothing(_: Model) -> Screen:
    return pages.BLANK


_BODIES: dict[State, Callable[[Model], Screen]] = {
    State.IDLE: pages.idle,
    State.REVIEW: pages.review,
    State.RESULT: pages.result,
    State.PAST: pages.result,
    State.CALIBRATED: pages.calibrated,
    State.ABOUT: pages.about,
    State.STOPPING: pages.stopping,
    State.CONFIRM: pages.confirm,
}
