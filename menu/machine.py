"""The state machine of the menu: a table of states and a table of transitions.

`step` alone leads from one `Model` to the next.  It is a pure function: work to be done is returned
as an effect, and its outcome comes in again as an event.  ``python -m menu.machine`` prints the
tables as the page docs/menu-states.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeAlias

from menu.messages import (
    Cancel,
    Cancelled,
    Done,
    Effect,
    Event,
    Failed,
    MakePlan,
    Planned,
    Predict,
    Predicted,
    Progressed,
    Quit,
    Shoot,
)
from menu.model import RANGES, RESPONSES, Action, Model, State
from menu.ports import Key

Symbol: TypeAlias = Key | Action | type[Event]
"""What can cause a transition."""


class Kind(Enum):
    """The kinds of screen; each gives the keys a meaning."""

    LIST = "list"  # up, down: select; right, enter: next; left, exit: back
    PAGE = "page"  # up, down: scroll; left, right: select an action; enter: do it; exit: back
    WAIT = "wait"  # exit: stop waiting


@dataclass(frozen=True)
class StateSpec:
    """The properties of a state.

    Attributes:
        kind: kind of screen
        title: first line of the screen, at most 20 characters
        help: what the keys do, the most important first
        actions: the buttons of a page
        effect: the work that starts on entering the state
    """

    kind: Kind
    title: str
    help: tuple[str, ...]
    actions: tuple[Action, ...] = ()
    effect: Callable[[Model], Effect] | None = None


def _predict(model: Model) -> Effect:
    return Predict(model.request_id, model.choice.response, model.choice.dynamic_range)


def _make_plan(model: Model) -> Effect:
    return MakePlan(model.request_id, model.choice)


def _shoot(model: Model) -> Effect:
    if model.plan is None:
        raise ValueError("there is no plan to shoot")
    return Shoot(model.request_id, model.plan)


def _cancel(model: Model) -> Effect:
    return Cancel(model.request_id)


def _quit(_: Model) -> Effect:
    return Quit()


_FIRST_LIST = ("enter: next", "exit: quit", "up/down: select")
_LIST = ("enter: next", "exit: back", "up/down: select")
_PAGE = ("enter: do it", "left/right: select", "up/down: scroll", "exit: back")
_AFTER_FAILURE = (Action.RETRY, Action.BACK, Action.QUIT)

STATES: dict[State, StateSpec] = {
    State.RESPONSE: StateSpec(Kind.LIST, "Desired response", _FIRST_LIST),
    State.RANGE: StateSpec(Kind.LIST, "Dynamic range", _LIST),
    State.PREDICTING: StateSpec(Kind.WAIT, "Computing exposures", ("exit: back",), effect=_predict),
    State.PREDICTION_FAILED: StateSpec(Kind.PAGE, "Computing failed", _PAGE, _AFTER_FAILURE),
    State.EXPOSURES: StateSpec(Kind.LIST, "Exposures", _LIST),
    State.PLANNING: StateSpec(Kind.WAIT, "Metering", ("exit: back",), effect=_make_plan),
    State.PLAN_FAILED: StateSpec(Kind.PAGE, "Planning failed", _PAGE, _AFTER_FAILURE),
    State.REVIEW: StateSpec(Kind.PAGE, "Review", _PAGE, (Action.SHOOT, Action.BACK, Action.QUIT)),
    State.SHOOTING: StateSpec(Kind.WAIT, "Shooting", ("exit: cancel",), effect=_shoot),
    State.CANCELLING: StateSpec(Kind.WAIT, "Cancelling", ("exit: quit now",), effect=_cancel),
    State.CANCELLED: StateSpec(Kind.PAGE, "Cancelled", _PAGE, _AFTER_FAILURE),
    State.CAPTURE_FAILED: StateSpec(Kind.PAGE, "Capture failed", _PAGE, _AFTER_FAILURE),
    State.RESULT: StateSpec(Kind.PAGE, "Done", _PAGE, (Action.AGAIN, Action.MENU, Action.QUIT)),
    State.QUIT: StateSpec(Kind.WAIT, "Quitting", (), effect=_quit),
}


def _list(here: State, *, left: State, exit: State, next: State) -> dict[Symbol, State]:
    return {
        Key.UP: here,
        Key.DOWN: here,
        Key.LEFT: left,
        Key.RIGHT: next,
        Key.ENTER: next,
        Key.EXIT: exit,
    }


def _page(here: State, *, exit: State, actions: dict[Symbol, State]) -> dict[Symbol, State]:
    stay: dict[Symbol, State] = dict.fromkeys((Key.UP, Key.DOWN, Key.LEFT, Key.RIGHT), here)
    return {**stay, Key.EXIT: exit, **actions}


def _failure(here: State, *, retry: State, back: State) -> dict[Symbol, State]:
    actions: dict[Symbol, State] = {
        Action.RETRY: retry,
        Action.BACK: back,
        Action.QUIT: State.QUIT,
    }
    return _page(here, exit=back, actions=actions)


def _wait(here: State, *, exit: State, events: dict[Symbol, State]) -> dict[Symbol, State]:
    stay: dict[Symbol, State] = dict.fromkeys(Key, here)
    return {**stay, Key.EXIT: exit, **events}


# A page lists its actions in place of the enter key, which performs the selected one.
# An event that a state does not list is late and changes nothing.
TRANSITIONS: dict[State, dict[Symbol, State]] = {
    State.RESPONSE: _list(State.RESPONSE, left=State.RESPONSE, exit=State.QUIT, next=State.RANGE),
    State.RANGE: _list(
        State.RANGE, left=State.RESPONSE, exit=State.RESPONSE, next=State.PREDICTING
    ),
    State.PREDICTING: _wait(
        State.PREDICTING,
        exit=State.RANGE,
        events={
            Progressed: State.PREDICTING,
            Predicted: State.EXPOSURES,
            Failed: State.PREDICTION_FAILED,
        },
    ),
    State.PREDICTION_FAILED: _failure(
        State.PREDICTION_FAILED, retry=State.PREDICTING, back=State.RANGE
    ),
    State.EXPOSURES: _list(
        State.EXPOSURES, left=State.RANGE, exit=State.RANGE, next=State.PLANNING
    ),
    State.PLANNING: _wait(
        State.PLANNING,
        exit=State.EXPOSURES,
        events={Planned: State.REVIEW, Failed: State.PLAN_FAILED},
    ),
    State.PLAN_FAILED: _failure(State.PLAN_FAILED, retry=State.PLANNING, back=State.EXPOSURES),
    State.REVIEW: _page(
        State.REVIEW,
        exit=State.EXPOSURES,
        actions={
            Action.SHOOT: State.SHOOTING,
            Action.BACK: State.EXPOSURES,
            Action.QUIT: State.QUIT,
        },
    ),
    State.SHOOTING: _wait(
        State.SHOOTING,
        exit=State.CANCELLING,
        events={
            Progressed: State.SHOOTING,
            Done: State.RESULT,
            Cancelled: State.CANCELLED,
            Failed: State.CAPTURE_FAILED,
        },
    ),
    State.CANCELLING: _wait(
        State.CANCELLING,
        exit=State.QUIT,
        events={
            Progressed: State.CANCELLING,
            Done: State.RESULT,
            Cancelled: State.CANCELLED,
            Failed: State.CAPTURE_FAILED,
        },
    ),
    State.CANCELLED: _failure(State.CANCELLED, retry=State.SHOOTING, back=State.REVIEW),
    State.CAPTURE_FAILED: _failure(State.CAPTURE_FAILED, retry=State.SHOOTING, back=State.REVIEW),
    State.RESULT: _page(
        State.RESULT,
        exit=State.RESPONSE,
        actions={
            Action.AGAIN: State.PLANNING,
            Action.MENU: State.RESPONSE,
            Action.QUIT: State.QUIT,
        },
    ),
    State.QUIT: _wait(State.QUIT, exit=State.QUIT, events={}),
}


def step(model: Model, given: Key | Event) -> tuple[Model, Effect | None]:
    """Return the menu's state after a key or an event, and the work that it starts, if any.

    An event of other work than that started last, or one that its state does not list, changes
    nothing.
    """
    row = TRANSITIONS[model.state]
    if isinstance(given, Event):
        if given.request_id != model.request_id or type(given) not in row:
            return model, None
        return _enter(_with_result(model, given), row[type(given)])
    actions = STATES[model.state].actions
    symbol = actions[model.action] if actions and given is Key.ENTER else given
    if row[symbol] is model.state:
        return _select_or_scroll(model, given), None
    return _enter(model, row[symbol])


def _enter(model: Model, state: State) -> tuple[Model, Effect | None]:
    """Go to `state`; the work that starts there has a new request id."""
    if state is model.state:
        return model, None
    model = replace(model, state=state, action=0, offset=0)
    if state in (State.PREDICTING, State.PLANNING, State.SHOOTING):
        model = replace(model, request_id=model.request_id + 1, progress=None)
    effect = STATES[state].effect
    return model, None if effect is None else effect(model)


def _with_result(model: Model, event: Event) -> Model:
    """Return the model with what an event reports."""
    match event:
        case Predicted(costs=costs):
            counts = [cost.count for cost in costs]
            nearest = min(counts, key=lambda count: abs(count - model.count))
            return replace(model, costs=costs, count=nearest)
        case Planned(plan=plan):
            # Where gain or aperture differ, times of other exposures do not follow from the first.
            only_time = len({(setting.gain, setting.f_number) for setting in plan.settings}) == 1
            return replace(model, plan=plan, base_s=plan.base_s if only_time else None)
        case Progressed(progress=progress):
            return replace(model, progress=progress)
        case Done(summary=summary):
            return replace(model, summary=summary)
        case Failed(message=message) | Cancelled(message=message):
            return replace(model, error=message)
    return model


def _select_or_scroll(model: Model, key: Key) -> Model:
    """Return the model after a key that stays in the same state."""
    down = (key is Key.DOWN) - (key is Key.UP)
    right = (key is Key.RIGHT) - (key is Key.LEFT)
    spec = STATES[model.state]
    if spec.kind is Kind.PAGE:
        action = _clamp(model.action + right, len(spec.actions))
        return replace(model, action=action, offset=max(0, model.offset + down))
    if model.state is State.RESPONSE:
        return replace(model, response=_clamp(model.response + down, len(RESPONSES)))
    if model.state is State.RANGE:
        return replace(model, range=_clamp(model.range + down, len(RANGES)))
    if model.state is State.EXPOSURES:
        index = _clamp(model.cost_index + down, len(model.costs))
        return replace(model, count=model.costs[index].count)
    return model


def _clamp(index: int, length: int) -> int:
    return min(max(index, 0), length - 1)


def diagram() -> str:
    """Return the tables as a state diagram in the language of graphviz."""
    lines = ["digraph menu {", "    node [shape=box, style=rounded, fontname=sans, fontsize=12]"]
    lines.append("    edge [fontname=sans, fontsize=10]")
    lines.append("    start [shape=point, width=0.15]")
    lines += [f'    {state} [label="{STATES[state].title}"]' for state in State]
    lines.append(f"    start -> {Model().state}")
    for state, row in TRANSITIONS.items():
        labels: dict[State, list[str]] = {}
        for symbol, target in row.items():
            if target is not state:
                labels.setdefault(target, []).append(_label(symbol))
        lines += [
            f'    {state} -> {target} [label="{", ".join(ls)}"]' for target, ls in labels.items()
        ]
    return "\n".join([*lines, "}", ""])


def _label(symbol: Symbol) -> str:
    """Return a key in capitals, an action in brackets, or an event in small letters."""
    if isinstance(symbol, Key):
        return symbol.name
    return f"[{symbol.value}]" if isinstance(symbol, Action) else symbol.__name__.lower()


def states_page() -> str:
    """Return the Markdown page with the diagram and the table of states."""
    rows = [
        f"| {spec.title} | {spec.kind.value} | {', '.join(spec.help)} "
        f"| {', '.join(action.value for action in spec.actions)} |"
        for spec in STATES.values()
    ]
    return "\n".join(
        [
            "# States of the menu",
            "",
            "This page and its diagram are generated from the tables of the menu:",
            "`python -m menu.machine > docs/menu-states.md` and `python docs/draw_menu_states.py`.",
            "",
            "An arrow names what causes the transition: a key in capitals, a button in brackets, "
            "or an",
            "event from the camera in small letters. A key that is not shown selects or scrolls.",
            "",
            "![state diagram of the menu](menu-states.svg)",
            "",
            "| screen | kind | keys | buttons |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


if __name__ == "__main__":
    print(states_page(), end="")
