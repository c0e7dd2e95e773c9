"""What is chosen in the page, as keys of the menu.

The keys are found by trying them: `camctl.menu.machine.step` is a pure function.  So the page can
do what a person with six keys can, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from camctl.menu.entries import rows
from camctl.menu.machine import selected, step
from camctl.menu.model import Action, Model, State
from camctl.menu.ports import Key
from camctl.menu.tables import STATES, Kind

_ONLY_ASKED = {
    State.SHOOTING,
    State.RESUMING,
    State.TIMER,
    State.CANCELLING,
    State.STOPPING,
    State.PLANNING,
    State.CALIBRATING,
    State.CALIBRATION_STOPPING,
    State.CONFIRM,
    State.QUIT,
}
"""States that no way to another state leads through."""


@dataclass(frozen=True)
class Command:
    """What is chosen in the page.

    Attributes:
        seen: the state that the page showed; None: it holds in each state
        state: to go to this state; None: stay
        action: to press this button, or take the entry of the list that does it
        index: to select this entry of the list, of this length
        take: and take it
        key: to press this key
    """

    seen: State | None = None
    state: State | None = None
    action: Action | None = None
    index: int | None = None
    take: bool = False
    key: Key | None = None


def keys_for(model: Model, command: Command) -> tuple[Key, ...]:
    """Return the keys that lead from `model` to what is asked for; () where none do.

    A command for another state than the present one was meant for a page that is gone: () as well.
    """
    if command.seen not in (None, model.state):
        return ()
    keys: list[Key] = []
    if command.state is not None:
        way = _way(model, command.state)
        if way is None:
            return ()
        keys += way
        model = _after(model, way)
    if command.action is not None:
        found = [way for action, way in _actions(model) if action is command.action]
        keys += found[0] if found else ()
    if command.index is not None and 0 <= command.index < len(rows(model)):
        keys += _moves(model, command.index)
        keys += [Key.ENTER] if command.take else []
    if command.key is not None:
        keys.append(command.key)
    return tuple(keys)


def _after(model: Model, keys: tuple[Key, ...]) -> Model:
    for key in keys:
        model, _ = step(model, key)
    return model


def _moves(model: Model, index: int) -> tuple[Key, ...]:
    """Return the keys that select an entry of a list."""
    distance = index - selected(model)
    return (Key.DOWN if distance > 0 else Key.UP,) * abs(distance)


def _actions(model: Model) -> Iterator[tuple[Action, tuple[Key, ...]]]:
    """Yield each action that the screen offers, with the keys that do it."""
    spec = STATES[model.state]
    if spec.kind is Kind.PAGE:
        for place, action in enumerate(spec.actions):
            distance = place - model.action
            aside = (Key.RIGHT if distance > 0 else Key.LEFT,) * abs(distance)
            yield action, (*aside, Key.ENTER)
    elif spec.kind is Kind.LIST:
        for place, entry in enumerate(rows(model)):
            if entry.action is not None:
                yield entry.action, (*_moves(model, place), Key.ENTER)


def _way(model: Model, target: State) -> tuple[Key, ...] | None:
    """Return the fewest screens' keys to a state; None where they would shoot, cancel or quit."""
    if model.state is target:
        return ()
    known = {model.state}
    front: list[tuple[Model, tuple[Key, ...]]] = [(model, ())]
    while front:
        following: list[tuple[Model, tuple[Key, ...]]] = []
        for here, before in front:
            # A list is left by its entries before its plain keys: those keep what is selected.
            for keys in (*((key,) for key in (Key.ENTER, Key.EXIT)), *_ways_by_action(here)):
                there = _after(here, keys)
                if there.state is target:
                    return (*before, *keys)
                if there.state not in known and there.state not in _ONLY_ASKED:
                    known.add(there.state)
                    following.append((there, (*before, *keys)))
        front = following
    return None


def _ways_by_action(model: Model) -> Iterator[tuple[Key, ...]]:
    for _, keys in _actions(model):
        yield keys
