"""Every state with every key and every event."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import pytest
from panel_fakes import COSTS, plan_of

from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from camctl.response.desired import RANGES as KNOWN_RANGES
from camctl.response.desired import RESPONSES as KNOWN_RESPONSES
from menu.machine import STATES, TRANSITIONS, Kind, diagram, step
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
from menu.ports import Key, Summary

PLAN = plan_of([ExposureSetting(0.0033), ExposureSetting(0.0327)])
WORKING = {State.PREDICTING: Predict, State.PLANNING: MakePlan, State.SHOOTING: Shoot}
EFFECTS: dict[State, type[Effect]] = {
    **WORKING,
    State.CANCELLING: Cancel,
    State.QUIT: Quit,
}


def events(ticket: int) -> list[Event]:
    """One event of each type."""
    return [
        Predicted(ticket, COSTS),
        Planned(ticket, PLAN),
        Progressed(ticket, Progress(1, 2, "shooting")),
        Done(ticket, Summary(390.0, 0.01, "x")),
        Cancelled(ticket, "cancelled"),
        Failed(ticket, "failed"),
    ]


def same(model: Model) -> Model:
    """The model without what only counts up: two that are the same then behave the same."""
    return replace(model, ticket=0, offset=min(model.offset, 2))


def reachable() -> dict[Model, dict[Key | type[Event], Model]]:
    """All models that keys and events lead to, and where each leads next."""
    found: dict[Model, dict[Key | type[Event], Model]] = {}
    queue = deque([same(Model())])
    while queue:
        model = queue.popleft()
        if model in found:
            continue
        found[model] = {key: same(step(model, key)[0]) for key in Key}
        for event in events(model.ticket):
            if type(event) in TRANSITIONS[model.state]:
                found[model][type(event)] = same(step(model, event)[0])
        queue.extend(found[model].values())
    return found


@pytest.fixture(scope="module")
def graph() -> dict[Model, dict[Key | type[Event], Model]]:
    return reachable()


def leading_to(
    graph: dict[Model, dict[Key | type[Event], Model]], goal: State, *, keys_only: bool = False
) -> set[Model]:
    """The models from which a model in state `goal` can be reached."""
    back: dict[Model, set[Model]] = {model: set() for model in graph}
    for model, row in graph.items():
        for symbol, target in row.items():
            if isinstance(symbol, Key) or not keys_only:
                back[target].add(model)
    reached = {model for model in graph if model.state is goal}
    queue = deque(reached)
    while queue:
        for model in back[queue.popleft()] - reached:
            reached.add(model)
            queue.append(model)
    return reached


def test_every_state_is_reached(graph: dict[Model, dict[Key | type[Event], Model]]) -> None:
    assert {model.state for model in graph} == set(State)


def test_from_everywhere_keys_alone_lead_out(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> None:
    assert leading_to(graph, State.QUIT, keys_only=True) == set(graph)


def test_from_everywhere_there_is_a_way_back_to_the_start(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> None:
    left = {model for model in graph if model.state is State.QUIT}
    assert leading_to(graph, State.RESPONSE) == set(graph) - left


def test_a_dead_end_would_be_found(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> None:
    closed = {
        model: dict.fromkeys(row, model) if model.state is State.SHOT_FAILED else row
        for model, row in graph.items()
    }
    assert leading_to(closed, State.QUIT) != set(closed)


def test_every_choice_can_be_shot(graph: dict[Model, dict[Key | type[Event], Model]]) -> None:
    choices = {model.choice for model in graph if model.state is State.SHOOTING}
    assert len(choices) == len(RESPONSES) * len(RANGES) * len(COSTS)


def test_the_table_holds_every_state_with_every_key() -> None:
    assert set(TRANSITIONS) == set(STATES) == set(State)
    for state, row in TRANSITIONS.items():
        face = STATES[state]
        keys: set[object] = set(Key)
        if face.kind is Kind.PAGE:
            assert Action.QUIT in face.actions
            keys = keys - {Key.ENTER} | set(face.actions)
        assert {s for s in row if not isinstance(s, type)} == keys


def test_what_is_awaited_can_come() -> None:
    for state, effect in WORKING.items():
        row = TRANSITIONS[state]
        assert Failed in row, f"{effect} may fail"
        assert {Predict: Predicted, MakePlan: Planned, Shoot: Done}[effect] in row


def test_failures_offer_to_try_again() -> None:
    for state in (State.PREDICTION_FAILED, State.PLAN_FAILED, State.SHOT_FAILED, State.CANCELLED):
        retry = TRANSITIONS[state][Action.RETRY]
        assert retry in WORKING
        if state is not State.CANCELLED:
            assert TRANSITIONS[retry][Failed] is state


def all_steps(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> Iterator[tuple[Model, Key | Event, Model, Effect | None]]:
    for model in graph:
        for given in [*Key, *events(model.ticket)]:
            after, effect = step(model, given)
            yield model, given, after, effect


def test_every_step_agrees_with_the_table(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> None:
    for model, given, after, effect in all_steps(graph):
        actions = STATES[model.state].actions
        symbol = type(given) if isinstance(given, Event) else given
        if actions and given is Key.ENTER:
            symbol = actions[model.action]  # type: ignore[assignment]
        assert after.state is TRANSITIONS[model.state].get(symbol, model.state)
        entered = after.state is not model.state
        expected = EFFECTS.get(after.state) if entered else None
        assert type(effect) is (expected or type(None))
        assert not entered or after.action == after.offset == 0
        assert after.ticket == model.ticket + (entered and after.state in WORKING)


def test_what_is_shot_is_the_plan_that_was_reviewed(
    graph: dict[Model, dict[Key | type[Event], Model]],
) -> None:
    for model, _, after, effect in all_steps(graph):
        if isinstance(effect, Shoot):
            assert effect.plan is model.plan is after.plan
            assert model.state in (State.REVIEW, State.CANCELLED, State.SHOT_FAILED)
        if isinstance(effect, MakePlan):
            assert effect.choice == after.choice
        if isinstance(effect, Predict):
            choice = after.choice
            assert (effect.response, effect.dynamic_range) == (
                choice.response,
                choice.dynamic_range,
            )
        if model.state is State.EXPOSURES and after.state is State.PLANNING:
            assert after.count in [cost.count for cost in model.costs]


def test_late_events_change_nothing(graph: dict[Model, dict[Key | type[Event], Model]]) -> None:
    for model in graph:
        for event in [*events(model.ticket - 1), *events(model.ticket + 1)]:
            assert step(model, event) == (model, None)
        for event in events(model.ticket):
            if type(event) not in TRANSITIONS[model.state]:
                assert step(model, event) == (model, None)


def test_the_answer_to_a_question_taken_back_is_not_believed() -> None:
    model = replace(Model(), state=State.RANGE)
    asked, first = step(model, Key.ENTER)
    assert isinstance(first, Predict)
    back, _ = step(asked, Key.EXIT)
    moved, _ = step(back, Key.UP)
    again, second = step(moved, Key.ENTER)
    assert isinstance(second, Predict)
    assert second.dynamic_range == 16000.0
    assert step(again, Predicted(first.ticket, COSTS)) == (again, None)
    assert step(again, Predicted(second.ticket, COSTS))[0].state is State.EXPOSURES


def test_the_number_of_exposures_stays_among_those_offered() -> None:
    model = replace(Model(), state=State.PREDICTING, count=6, ticket=4)
    model, _ = step(model, Predicted(4, COSTS[1:3]))
    assert model.count == 3
    assert step(model, Key.DOWN)[0].count == 3
    assert step(step(model, Key.UP)[0], Key.UP)[0].count == 2


def test_times_are_in_seconds_once_the_shutter_alone_says_them() -> None:
    model = replace(Model(), state=State.PLANNING, ticket=1)
    assert step(model, Planned(1, PLAN))[0].base_s == 0.0033
    amplified = plan_of([ExposureSetting(0.0033), ExposureSetting(0.0033, gain=8.0)])
    assert step(model, Planned(1, amplified))[0].base_s is None


def test_nothing_to_choose_from_is_no_prediction() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Predicted(1, ())


def test_the_menu_offers_what_the_mathematics_knows() -> None:
    assert {entry.name for entry in RESPONSES} == set(KNOWN_RESPONSES)
    assert {entry.name: entry.value for entry in RANGES} == KNOWN_RANGES


def test_the_diagram_draws_every_state_and_every_way() -> None:
    text = diagram()
    for state, row in TRANSITIONS.items():
        for target in set(row.values()) - {state}:
            assert f"    {state} --> {target}: " in text
    assert "review --> shooting: shoot" in text
