"""The state machine of the menu, which follows the tables of `camctl.menu.tables`.

`step` alone leads from one `Model` to the next.  It is a pure function: work to be done is returned
as an effect, and its outcome comes in again as an event.  The page docs/reference/menu-states.md
shows the tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from camctl.menu.data import (
    Calibrated,
    CameraEntry,
    Cost,
    Loaded,
    Plan,
    Progress,
    Reading,
    Settings,
    Summary,
    Traced,
)
from camctl.menu.entries import (
    CALIBRATIONS,
    KEPT,
    TIMERS,
    TOGETHER,
    choice,
    chosen_cameras,
    requested,
    rows,
    seconds,
    series,
)
from camctl.menu.model import Action, Goal, Model, State
from camctl.menu.ports import Key
from camctl.menu.tables import (
    STATES,
    TRANSITIONS,
    Cancel,
    Effect,
    Event,
    Kind,
    Outcome,
    Start,
    Symbol,
    Work,
)


def step(model: Model, given: Key | Event) -> tuple[Model, Effect | None]:
    """Return the menu's state after a key or an event, and the work that it starts, if any.

    An event of other work than that started last, or one that its state does not list, changes
    nothing, as does a key that the state does not know.
    """
    if isinstance(given, Event):
        return _after_event(model, given)
    return _after_key(model, given)


def _after_key(model: Model, key: Key) -> tuple[Model, Effect | None]:
    row, spec = TRANSITIONS[model.state], STATES[model.state]
    symbol: Symbol = key
    if spec.kind is Kind.PAGE and key is Key.ENTER:
        symbol = spec.actions[model.action]
    elif spec.kind is Kind.LIST and key in (Key.ENTER, Key.RIGHT):
        entries = rows(model)
        if not entries:
            return model, None
        symbol = entries[selected(model)].action or key
    target = row.get(symbol, model.state)
    if symbol is Action.RETRY and target is State.PLANNING:
        target = model.begun
    if symbol is Action.AGAIN and model.begun is State.SERIES_SHOOTING:
        target = model.begun
    if symbol is Action.CHANGE:
        return _with_changed_setting(model), None
    if target is model.state:
        return _select_or_scroll(model, key), None
    return _enter(_with_goal(model, symbol, target), target)


def _after_event(model: Model, event: Event) -> tuple[Model, Effect | None]:
    outcome, row = event.outcome, TRANSITIONS[model.state]
    if outcome is Outcome.NOTE:
        return replace(model, note=str(event.value)), None
    is_of_work = outcome not in (Outcome.TICK, Outcome.UNUSED)
    if outcome not in row or (is_of_work and event.request_id != model.request_id):
        return model, None
    if outcome is Outcome.TICK:
        return _after_tick(model)
    model = _with_value(model, event)
    return _enter(model, row[outcome]) if row[outcome] is not model.state else (model, None)


def _after_tick(model: Model) -> tuple[Model, Effect | None]:
    """Count the self-timer down, or start the repeated work of a state."""
    if model.state is State.TIMER:
        if model.remaining_s > 1:
            return replace(model, remaining_s=model.remaining_s - 1), None
        return _enter(model, TRANSITIONS[State.TIMER][Outcome.ELAPSED])
    work = Work.OPEN if model.state is State.CAMERA_FAILED else Work.METER
    return _started(model, work)


_BEGINNINGS = {State.PLANNING, State.RESUMING, State.SERIES_SHOOTING}
"""States that taking pictures begins with."""


def _enter(model: Model, state: State) -> tuple[Model, Effect | None]:
    """Go to `state`; the work that starts there has a new request id."""
    model = replace(model, state=state, action=0, offset=0)
    if state in _BEGINNINGS:
        model = replace(model, begun=state)
    if state in (State.CANCELLING, State.CALIBRATION_STOPPING):
        return model, Cancel(model.request_id)
    if state is State.TIMER:
        return replace(model, remaining_s=seconds(TIMERS[model.settings.timer])), None
    work = STATES[state].work
    if work is None:
        return model, None
    if work is Work.PREDICT:
        model = replace(model, costs=(None,) * len(rows(model)))
    if work is Work.TRACE:
        model = replace(model, front=(), rivals=(), note="")
    return _started(replace(model, progress=None), work)


def _started(model: Model, work: Work) -> tuple[Model, Effect | None]:
    model = replace(model, request_id=model.request_id + 1)
    argument = _ARGUMENTS[work](model) if work in _ARGUMENTS else None
    return model, Start(model.request_id, work, argument)


def choices(model: Model) -> tuple[object, ...]:
    """Return what each entry of a list of choices asks for; None: it leads to another list."""
    name, goal = STATES[model.state].cursor, _goal(model)
    return tuple(
        None if entry.action else choice(_with_index(model.settings, name, index), goal)
        for index, entry in enumerate(rows(model))
    )


def _with_index(settings: Settings, name: str, index: int) -> Settings:
    """Return the settings with the field `name`, which holds an index, changed."""
    changed: dict[str, Any] = {name: index}
    return replace(settings, **changed)


def _goal(model: Model) -> Goal:
    goals = {State.BUDGET: Goal.BUDGET, State.FRONT: Goal.FRONT}
    return goals.get(model.state, Goal.COUNT)


_ARGUMENTS: dict[Work, Callable[[Model], object]] = {
    Work.OPEN: lambda model: model.settings.camera,
    Work.PREDICT: choices,
    Work.TRACE: lambda model: choice(model.settings, Goal.FRONT),
    Work.PLAN: requested,
    Work.SHOOT: lambda model: model.plan,
    Work.RESUME: lambda model: model.captures[model.cursor],
    Work.SERIES: series,
    Work.LOOK: lambda model: model.captures[model.cursor],
    Work.CALIBRATE: lambda model: CALIBRATIONS[model.cursor].value,
}


def _with_goal(model: Model, symbol: Symbol, target: State) -> Model:
    """Return the model with what leaving a list by a key decides."""
    if model.state is State.FRONT and target is State.PLANNING:
        point = model.front[model.cursor], choice(model.settings, Goal.FRONT)
        return replace(model, goal=Goal.FRONT, point=point)
    if model.state in (State.EXPOSURES, State.BUDGET) and target is State.PLANNING:
        return replace(model, goal=_goal(model))
    if model.state in (State.CAMERAS, State.SEVERAL) and target is State.OPENING:
        ids = chosen_cameras(model) if model.state is State.SEVERAL else ()
        camera = TOGETHER.join(ids) or model.cameras[model.cursor].id
        return replace(model, settings=replace(model.settings, camera=camera), camera=None)
    return model if target in _KEEPS_CURSOR else replace(model, cursor=0)


_KEEPS_CURSOR = {
    *(State.LOOKING, State.RESUMING, State.CAPTURES, State.CANCELLING, State.STOPPING),
    *(State.CALIBRATING, State.CALIBRATION_STOPPING),
}
"""States whose work, or its repetition, is for the selected entry of the list before."""


def _with_value(model: Model, event: Event) -> Model:
    """Return the model with what an event reports."""
    value = event.value
    match event.outcome, value:
        case Outcome.FAILED | Outcome.CANCELLED, _:
            lost = model.state in (State.IDLE, State.OPENING, State.CAMERA_FAILED)
            if STATES[model.state].work in (Work.PREDICT, Work.TRACE):
                return replace(model, note=str(value))
            return replace(model, error=str(value), camera=None if lost else model.camera)
        case _, Loaded():
            note = value.remark
            if not note and value.unfinished:
                note = f"{value.unfinished} unfinished: Menu, Captures"
            return replace(model, settings=value.settings, note=note)
        case _, CameraEntry():
            return replace(model, camera=value, reading=None)
        case _, Reading():
            return replace(model, reading=value, camera=value.camera or model.camera)
        case _, (int(index), Cost() as cost):
            return replace(model, costs=(*model.costs[:index], cost, *model.costs[index + 1 :]))
        case _, Plan():
            return replace(model, plan=value)
        case _, Progress():
            return replace(model, progress=value)
        case _, Calibrated():
            return replace(model, calibrated=value.lines)
        case _, Summary():
            return replace(model, summary=value)
        case Outcome.DONE, Traced():
            cursor = _recommended(value.points)
            return replace(model, front=value.points, rivals=value.rivals, cursor=cursor)
        case Outcome.DONE, tuple() if model.state is State.SEARCHING:
            found = [each for each in value if isinstance(each, CameraEntry)]
            ids = [each.id for each in found]
            cursor = ids.index(model.settings.camera) if model.settings.camera in ids else 0
            return replace(model, cameras=tuple(found), cursor=cursor, marked=())
        case Outcome.DONE, tuple() if model.state is State.BROWSING:
            return replace(model, captures=value, cursor=0)
    return model


def selected(model: Model) -> int:
    """Return the index of the selected entry of a list."""
    name = STATES[model.state].cursor
    return getattr(model.settings, name) if name else model.cursor


def _recommended(front: tuple[Cost, ...]) -> int:
    """Return the place of the recommended point."""
    places = [place for place, each in enumerate(front) if each.is_recommended]
    return places[0] if places else 0


def _with_changed_setting(model: Model) -> Model:
    name = rows(model)[selected(model)].value
    assert isinstance(name, str)  # the entries of `CHANGE` have the name of a setting, or a camera
    if model.state is State.SEVERAL:
        return replace(model, marked=tuple(sorted({*model.marked} ^ {name})))
    index = (getattr(model.settings, name) + 1) % len(KEPT[name])
    return replace(model, settings=_with_index(model.settings, name, index))


def _select_or_scroll(model: Model, key: Key) -> Model:
    """Return the model after a key that stays in the same state."""
    down = (key is Key.DOWN) - (key is Key.UP)
    right = (key is Key.RIGHT) - (key is Key.LEFT)
    spec = STATES[model.state]
    if spec.kind is Kind.PAGE:
        action = min(max(model.action + right, 0), len(spec.actions) - 1)
        return replace(model, action=action, offset=max(0, model.offset + down))
    if spec.kind is Kind.LIST and (count := len(rows(model))):
        index = min(max(selected(model) + down, 0), count - 1)
        if spec.cursor:
            return replace(model, settings=_with_index(model.settings, spec.cursor, index))
        return replace(model, cursor=index)
    return model
