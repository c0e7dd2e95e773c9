"""The menu as two tables: what each state is, and where each key or event leads from it.

`step` is the only way from one `Model` to the next.  It is a pure function: work that has to be
done comes back as an effect, and what became of that work comes in again as an event.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto
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


class Kind(Enum):
    """How a state is shown, and so what its keys do."""

    LIST = auto()  # up, down: select; right, enter: on; left, exit: back
    PAGE = auto()  # up, down: scroll; left, right: select an action; enter: do it; exit: back
    WAIT = auto()  # exit: call it off


@dataclass(frozen=True)
class StateSpec:
    """What a state is.

    Attributes:
        kind: how it is shown
        title: its first line
        help: what its keys do, what matters most first
        actions: what it offers
        effect: what is to be done on coming here
    """

    kind: Kind
    title: str
    help: tuple[str, ...]
    actions: tuple[Action, ...] = ()
    effect: Callable[[Model], Effect] | None = None


def _predict(model: Model) -> Effect:
    return Predict(model.ticket, model.choice.response, model.choice.dynamic_range)


def _shoot(model: Model) -> Effect:
    if model.plan is None:
        raise ValueError("nothing is planned")
    return Shoot(model.ticket, model.plan)


_PICK = ("enter: next", "exit: back", "up/down: select")
_READ = ("enter: do it", "left/right: select", "up/down: scroll", "exit: back")
_WAY_ON = (Action.RETRY, Action.BACK, Action.QUIT)

STATES: dict[State, StateSpec] = {
    State.RESPONSE: StateSpec(
        Kind.LIST, "Desired response", ("enter: next", "exit: quit", "up/down: select")
    ),
    State.RANGE: StateSpec(Kind.LIST, "Dynamic range", _PICK),
    State.PREDICTING: StateSpec(Kind.WAIT, "Working out costs", ("exit: back",), effect=_predict),
    State.PREDICTION_FAILED: StateSpec(Kind.PAGE, "No costs", _READ, _WAY_ON),
    State.EXPOSURES: StateSpec(Kind.LIST, "Exposures: cost", _PICK),
    State.PLANNING: StateSpec(
        Kind.WAIT,
        "Metering",
        ("exit: back",),
        effect=lambda model: MakePlan(model.ticket, model.choice),
    ),
    State.PLAN_FAILED: StateSpec(Kind.PAGE, "No plan", _READ, _WAY_ON),
    State.REVIEW: StateSpec(Kind.PAGE, "Review", _READ, (Action.SHOOT, Action.BACK, Action.QUIT)),
    State.SHOOTING: StateSpec(Kind.WAIT, "Shooting", ("exit: cancel",), effect=_shoot),
    State.CANCELLING: StateSpec(
        Kind.WAIT, "Cancelling", ("exit: quit now",), effect=lambda model: Cancel(model.ticket)
    ),
    State.CANCELLED: StateSpec(Kind.PAGE, "Cancelled", _READ, _WAY_ON),
    State.SHOT_FAILED: StateSpec(Kind.PAGE, "Failed", _READ, _WAY_ON),
    State.RESULT: StateSpec(Kind.PAGE, "Done", _READ, (Action.AGAIN, Action.MENU, Action.QUIT)),
    State.QUIT: StateSpec(Kind.WAIT, "Good-bye", (), effect=lambda model: Quit()),
}


def _list(here: State, *, left: State, exit: State, on: State) -> dict[Symbol, State]:
    return {
        Key.UP: here,
        Key.DOWN: here,
        Key.LEFT: left,
        Key.RIGHT: on,
        Key.ENTER: on,
        Key.EXIT: exit,
    }


def _page(here: State, *, exit: State, actions: dict[Symbol, State]) -> dict[Symbol, State]:
    return {
        Key.UP: here,
        Key.DOWN: here,
        Key.LEFT: here,
        Key.RIGHT: here,
        Key.EXIT: exit,
        **actions,
    }


def _wait(here: State, *, exit: State, events: dict[Symbol, State]) -> dict[Symbol, State]:
    return {
        Key.UP: here,
        Key.DOWN: here,
        Key.LEFT: here,
        Key.RIGHT: here,
        Key.ENTER: here,
        Key.EXIT: exit,
        **events,
    }


# Enter on a page stands here as the action that is selected: so the table alone says where it goes.
# An event that a state does not list has come too late and changes nothing.
TRANSITIONS: dict[State, dict[Symbol, State]] = {
    State.RESPONSE: _list(State.RESPONSE, left=State.RESPONSE, exit=State.QUIT, on=State.RANGE),
    State.RANGE: _list(State.RANGE, left=State.RESPONSE, exit=State.RESPONSE, on=State.PREDICTING),
    State.PREDICTING: _wait(
        State.PREDICTING,
        exit=State.RANGE,
        events={
            Progressed: State.PREDICTING,
            Predicted: State.EXPOSURES,
            Failed: State.PREDICTION_FAILED,
        },
    ),
    State.PREDICTION_FAILED: _page(
        State.PREDICTION_FAILED,
        exit=State.RANGE,
        actions={
            Action.RETRY: State.PREDICTING,
            Action.BACK: State.RANGE,
            Action.QUIT: State.QUIT,
        },
    ),
    State.EXPOSURES: _list(State.EXPOSURES, left=State.RANGE, exit=State.RANGE, on=State.PLANNING),
    State.PLANNING: _wait(
        State.PLANNING,
        exit=State.EXPOSURES,
        events={Planned: State.REVIEW, Failed: State.PLAN_FAILED},
    ),
    State.PLAN_FAILED: _page(
        State.PLAN_FAILED,
        exit=State.EXPOSURES,
        actions={
            Action.RETRY: State.PLANNING,
            Action.BACK: State.EXPOSURES,
            Action.QUIT: State.QUIT,
        },
    ),
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
            Failed: State.SHOT_FAILED,
        },
    ),
    State.CANCELLING: _wait(
        State.CANCELLING,
        exit=State.QUIT,
        events={
            Progressed: State.CANCELLING,
            Done: State.RESULT,
            Cancelled: State.CANCELLED,
            Failed: State.SHOT_FAILED,
        },
    ),
    State.CANCELLED: _page(
        State.CANCELLED,
        exit=State.REVIEW,
        actions={
            Action.RETRY: State.SHOOTING,
            Action.BACK: State.REVIEW,
            Action.QUIT: State.QUIT,
        },
    ),
    State.SHOT_FAILED: _page(
        State.SHOT_FAILED,
        exit=State.REVIEW,
        actions={
            Action.RETRY: State.SHOOTING,
            Action.BACK: State.REVIEW,
            Action.QUIT: State.QUIT,
        },
    ),
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
    """Return what the menu is after a key or an event, and what has to be done for it, if anything.

    An event of other work than that started last, or one that its state does not wait for, changes
    nothing.
    """
    row = TRANSITIONS[model.state]
    if isinstance(given, Event):
        if given.ticket != model.ticket or type(given) not in row:
            return model, None
        return _enter(_learn(model, given), row[type(given)])
    actions = STATES[model.state].actions
    symbol = actions[model.action] if actions and given is Key.ENTER else given
    if row[symbol] is model.state:
        return _move(model, given), None
    return _enter(model, row[symbol])


def _enter(model: Model, state: State) -> tuple[Model, Effect | None]:
    """Go to `state`; what is started there has a ticket of its own."""
    if state is model.state:
        return model, None
    model = replace(model, state=state, action=0, offset=0)
    if state in (State.PREDICTING, State.PLANNING, State.SHOOTING):
        model = replace(model, ticket=model.ticket + 1, progress=None)
    effect = STATES[state].effect
    return model, None if effect is None else effect(model)


def _learn(model: Model, event: Event) -> Model:
    """Take in what an event tells."""
    match event:
        case Predicted(costs=costs):
            counts = [cost.count for cost in costs]
            nearest = min(counts, key=lambda count: abs(count - model.count))
            return replace(model, costs=costs, count=nearest)
        case Planned(plan=plan):
            # Where gain varies too, the shortest time says nothing about other exposures' times.
            alone = len({(setting.gain, setting.f_number) for setting in plan.settings}) == 1
            return replace(model, plan=plan, base_s=plan.base_s if alone else None)
        case Progressed(progress=progress):
            return replace(model, progress=progress)
        case Done(summary=summary):
            return replace(model, summary=summary)
        case Failed(line=line) | Cancelled(line=line):
            return replace(model, trouble=line)
    return model


def _move(model: Model, key: Key) -> Model:
    """Select or scroll within a state."""
    down = (key is Key.DOWN) - (key is Key.UP)
    right = (key is Key.RIGHT) - (key is Key.LEFT)
    face = STATES[model.state]
    if face.kind is Kind.PAGE:
        action = _within(model.action + right, len(face.actions))
        return replace(model, action=action, offset=max(0, model.offset + down))
    if model.state is State.RESPONSE:
        return replace(model, response=_within(model.response + down, len(RESPONSES)))
    if model.state is State.RANGE:
        return replace(model, range=_within(model.range + down, len(RANGES)))
    if model.state is State.EXPOSURES:
        row = _within(model.row + down, len(model.costs))
        return replace(model, count=model.costs[row].count)
    return model


def _within(index: int, length: int) -> int:
    return min(max(index, 0), length - 1)


def diagram() -> str:
    """Return the tables as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {Model().state}"]
    for state, row in TRANSITIONS.items():
        words: dict[State, list[str]] = {}
        for symbol, target in row.items():
            if target is not state:
                words.setdefault(target, []).append(_word(symbol))
        lines += [f"    {state} --> {target}: {', '.join(w)}" for target, w in words.items()]
    return "\n".join([*lines, f"    {State.QUIT} --> [*]", ""])


def _word(symbol: Symbol) -> str:
    return symbol.name.lower() if isinstance(symbol, Key | Action) else symbol.__name__
