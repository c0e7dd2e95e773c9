"""Every state of the menu with every key and every event."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import pytest
from panel_fakes import COSTS, plan_of

from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from camctl.response.desired import RANGES as DEFINED_RANGES
from camctl.response.desired import RESPONSES as DEFINED_RESPONSES
from menu.machine import STATES, TRANSITIONS, Kind, diagram, states_page, step
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

DOCS = Path(__file__).parents[2] / "docs"
PLAN = plan_of([ExposureSetting(0.0033), ExposureSetting(0.0327)])
WORKING = {State.PREDICTING: Predict, State.PLANNING: MakePlan, State.SHOOTING: Shoot}
Graph: TypeAlias = dict[Model, dict[Key | type[Event], Model]]
EFFECTS: dict[State, type[Effect]] = {
    **WORKING,
    State.CANCELLING: Cancel,
    State.QUIT: Quit,
}


def events(request_id: int) -> list[Event]:
    """Return one event of each type."""
    return [
        Predicted(request_id, COSTS),
        Planned(request_id, PLAN),
        Progressed(request_id, Progress(1, 2, "shooting")),
        Done(request_id, Summary(390.0, 0.01, "x")),
        Cancelled(request_id, "cancelled"),
        Failed(request_id, "failed"),
    ]


def reduced(model: Model) -> Model:
    """Return the model without what only counts up, so that equal models behave equally."""
    return replace(model, request_id=0, offset=min(model.offset, 2))


def reachable() -> Graph:
    """Return all models that keys and events lead to, and where each leads next."""
    found: Graph = {}
    queue = deque([reduced(Model())])
    while queue:
        model = queue.popleft()
        if model in found:
            continue
        found[model] = {key: reduced(step(model, key)[0]) for key in Key}
        for event in events(model.request_id):
            if type(event) in TRANSITIONS[model.state]:
                found[model][type(event)] = reduced(step(model, event)[0])
        queue.extend(found[model].values())
    return found


@pytest.fixture(scope="module")
def graph() -> Graph:
    return reachable()


def leading_to(graph: Graph, goal: State, *, keys_only: bool = False) -> set[Model]:
    """Return the models from which a model in state `goal` can be reached."""
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


def test_every_state_is_reachable(graph: Graph) -> None:
    assert {model.state for model in graph} == set(State)


def test_keys_alone_lead_from_every_state_to_quit(
    graph: Graph,
) -> None:
    assert leading_to(graph, State.QUIT, keys_only=True) == set(graph)


def test_every_state_leads_back_to_the_start(
    graph: Graph,
) -> None:
    ended = {model for model in graph if model.state is State.QUIT}
    assert leading_to(graph, State.RESPONSE) == set(graph) - ended


def test_leading_to_detects_a_dead_end(
    graph: Graph,
) -> None:
    closed = {
        model: dict.fromkeys(row, model) if model.state is State.CAPTURE_FAILED else row
        for model, row in graph.items()
    }
    assert leading_to(closed, State.QUIT) != set(closed)


def test_every_combination_can_be_shot(graph: Graph) -> None:
    choices = {model.choice for model in graph if model.state is State.SHOOTING}
    assert len(choices) == len(RESPONSES) * len(RANGES) * len(COSTS)


def test_transitions_list_every_state_with_every_key() -> None:
    assert set(TRANSITIONS) == set(STATES) == set(State)
    for state, row in TRANSITIONS.items():
        spec = STATES[state]
        keys: set[object] = set(Key)
        if spec.kind is Kind.PAGE:
            assert Action.QUIT in spec.actions
            keys = keys - {Key.ENTER} | set(spec.actions)
        assert {s for s in row if not isinstance(s, type)} == keys


def test_working_states_accept_result_and_failure() -> None:
    for state, effect in WORKING.items():
        row = TRANSITIONS[state]
        assert Failed in row, f"{effect} may fail"
        assert {Predict: Predicted, MakePlan: Planned, Shoot: Done}[effect] in row


def test_failures_offer_to_retry() -> None:
    for state in (
        State.PREDICTION_FAILED,
        State.PLAN_FAILED,
        State.CAPTURE_FAILED,
        State.CANCELLED,
    ):
        retry = TRANSITIONS[state][Action.RETRY]
        assert retry in WORKING
        if state is not State.CANCELLED:
            assert TRANSITIONS[retry][Failed] is state


def all_steps(
    graph: Graph,
) -> Iterator[tuple[Model, Key | Event, Model, Effect | None]]:
    for model in graph:
        for given in [*Key, *events(model.request_id)]:
            after, effect = step(model, given)
            yield model, given, after, effect


def test_every_step_agrees_with_the_tables(
    graph: Graph,
) -> None:
    for model, given, after, effect in all_steps(graph):
        actions = STATES[model.state].actions
        symbol: Key | Action | type[Event] = type(given) if isinstance(given, Event) else given
        if actions and given is Key.ENTER:
            symbol = actions[model.action]
        assert after.state is TRANSITIONS[model.state].get(symbol, model.state)
        entered = after.state is not model.state
        expected = EFFECTS.get(after.state) if entered else None
        assert type(effect) is (expected or type(None))
        assert not entered or after.action == after.offset == 0
        assert after.request_id == model.request_id + (entered and after.state in WORKING)


def test_plan_that_is_shot_is_the_one_reviewed(
    graph: Graph,
) -> None:
    for model, _, after, effect in all_steps(graph):
        if isinstance(effect, Shoot):
            assert effect.plan is model.plan is after.plan
            assert model.state in (State.REVIEW, State.CANCELLED, State.CAPTURE_FAILED)
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


def test_late_events_change_nothing(graph: Graph) -> None:
    for model in graph:
        for event in [*events(model.request_id - 1), *events(model.request_id + 1)]:
            assert step(model, event) == (model, None)
        for event in events(model.request_id):
            if type(event) not in TRANSITIONS[model.state]:
                assert step(model, event) == (model, None)


def test_result_of_an_abandoned_prediction_is_ignored() -> None:
    model = replace(Model(), state=State.RANGE)
    asked, first = step(model, Key.ENTER)
    assert isinstance(first, Predict)
    back, _ = step(asked, Key.EXIT)
    moved, _ = step(back, Key.UP)
    again, second = step(moved, Key.ENTER)
    assert isinstance(second, Predict)
    assert second.dynamic_range == 16000.0
    assert step(again, Predicted(first.request_id, COSTS)) == (again, None)
    assert step(again, Predicted(second.request_id, COSTS))[0].state is State.EXPOSURES


def test_number_of_exposures_stays_among_those_predicted() -> None:
    model = replace(Model(), state=State.PREDICTING, count=6, request_id=4)
    model, _ = step(model, Predicted(4, COSTS[1:3]))
    assert model.count == 3
    assert step(model, Key.DOWN)[0].count == 3
    assert step(step(model, Key.UP)[0], Key.UP)[0].count == 2


def test_base_time_is_kept_only_if_gain_is_the_same_everywhere() -> None:
    model = replace(Model(), state=State.PLANNING, request_id=1)
    assert step(model, Planned(1, PLAN))[0].base_s == 0.0033
    amplified = plan_of([ExposureSetting(0.0033), ExposureSetting(0.0033, gain=8.0)])
    assert step(model, Planned(1, amplified))[0].base_s is None


def test_prediction_without_costs_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Predicted(1, ())


def test_menu_offers_all_responses_and_ranges() -> None:
    assert {entry.name for entry in RESPONSES} == set(DEFINED_RESPONSES)
    assert {entry.name: entry.value for entry in RANGES} == DEFINED_RANGES


def test_diagram_has_every_state_and_every_transition() -> None:
    text = diagram()
    for state, row in TRANSITIONS.items():
        assert f'    {state} [label="{STATES[state].title}"]' in text
        for target in set(row.values()) - {state}:
            assert f"    {state} -> {target} [label=" in text
    assert 'review -> shooting [label="[Shoot]"]' in text
    assert 'shooting -> cancelling [label="EXIT"]' in text
    assert 'shooting -> result [label="done"]' in text


def test_page_of_the_documentation_is_up_to_date() -> None:
    """Update it with: python -m menu.machine > docs/menu-states.md."""
    assert (DOCS / "menu-states.md").read_text(encoding="utf-8") == states_page()


def test_drawing_of_the_documentation_is_up_to_date() -> None:
    """Update it with: python docs/draw_menu_states.py (needs graphviz)."""
    drawing = (DOCS / "menu-states.svg").read_text(encoding="utf-8")
    assert drawing.startswith(f"<!--\n{diagram()}-->\n<svg")
    assert drawing.count('class="edge"') == diagram().count(" -> ")
