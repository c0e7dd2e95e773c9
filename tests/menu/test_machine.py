"""The tables of the menu, and single steps through them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path
from runpy import run_path

import pytest
from panel_fakes import CAMERA, CAPTURES, COST, FRONT, OTHER_CAMERA, READING, SUMMARY, plan_of

from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.menu.data import Progress, Settings
from camctl.menu.entries import RANGES, RESPONSES, choice, rows
from camctl.menu.machine import step
from camctl.menu.model import Action, Goal, Model, State
from camctl.menu.ports import Key
from camctl.menu.tables import (
    STATES,
    TRANSITIONS,
    Cancel,
    Event,
    Kind,
    Outcome,
    Start,
    Symbol,
    Work,
)
from camctl.model.response.names import RANGES as DEFINED_RANGES
from camctl.model.response.names import RESPONSES as DEFINED_RESPONSES

DOCS = Path(__file__).parents[2] / "docs"
_PROGRAM = run_path(str(DOCS / "draw_menu_states.py"))
diagram, states_page = _PROGRAM["diagram"], _PROGRAM["states_page"]
FULL = Model(
    costs=(COST,) * 20,
    front=FRONT,
    reading=READING,
    plan=plan_of([0.0033, 0.0327]),
    progress=Progress(1, 2, "shooting", 0.1),
    remaining_s=2,
    summary=SUMMARY,
    cameras=(CAMERA, OTHER_CAMERA),
    camera=CAMERA,
    captures=CAPTURES,
    error="the camera was disconnected; connect it again",
    request_id=7,
)
FAILURES = [state for state in State if state.value.endswith("failed")]


def leading_to(goal: State, symbols: Iterable[type]) -> set[State]:
    """Return the states from which symbols of these types lead to `goal`."""
    kinds = tuple(symbols)
    reached, queue = {goal}, deque([goal])
    while queue:
        target = queue.popleft()
        for state, row in TRANSITIONS.items():
            leads = any(row[s] is target for s in row if isinstance(s, kinds))
            if leads and state not in reached:
                reached.add(state)
                queue.append(state)
    return reached


def test_every_state_knows_every_key() -> None:
    assert set(TRANSITIONS) == set(STATES) == set(State)
    for state, row in TRANSITIONS.items():
        spec = STATES[state]
        keys: set[Symbol] = set(Key)
        if spec.kind is Kind.PAGE:
            keys = keys - {Key.ENTER} | set(spec.actions)
            assert spec.actions
        assert keys <= set(row), state
        assert {each for each in row if isinstance(each, Key)} == keys & set(Key), state


def test_every_state_is_reachable() -> None:
    for state in State:
        assert State.STARTING in leading_to(state, (Key, Action, Outcome)), state


def test_keys_alone_lead_from_every_state_to_the_end() -> None:
    assert leading_to(State.QUIT, (Key, Action)) == set(State)


def test_every_state_leads_back_to_the_idle_screen() -> None:
    found = leading_to(State.IDLE, (Key, Action, Outcome))
    assert found == set(State) - {State.QUIT}


def test_work_has_a_result_and_a_failure() -> None:
    for state, spec in STATES.items():
        if spec.work is not None:
            assert {Outcome.DONE, Outcome.FAILED} <= set(TRANSITIONS[state]), state


@pytest.mark.parametrize("state", FAILURES)
def test_every_error_offers_retry_and_back(state: State) -> None:
    actions = STATES[state].actions
    assert {Action.RETRY, Action.BACK} <= set(actions)
    if state is not State.SEARCH_FAILED:
        assert Action.OTHER in actions
        assert TRANSITIONS[state][Action.OTHER] is State.SEARCHING
    retried = TRANSITIONS[state][Action.RETRY]
    assert STATES[retried].work is not None


def test_actions_of_entries_are_in_the_table() -> None:
    for state in (each for each in State if STATES[each].kind is Kind.LIST):
        for entry in rows(replace(FULL, state=state)):
            if entry.action is not None:
                assert entry.action in TRANSITIONS[state], (state, entry)


@pytest.mark.parametrize("state", list(State))
def test_every_state_takes_every_key_and_event(state: State) -> None:
    for given in (*Key, *Outcome):
        event = Event(given, 7, "text") if isinstance(given, Outcome) else given
        after, effect = step(replace(FULL, state=state), event)
        assert after.state in {*TRANSITIONS[state].values(), state}, given
        if isinstance(effect, Start):
            assert after.request_id == effect.request_id == 8, given
        elif isinstance(effect, Cancel):
            assert effect.request_id == 7, given
            assert after.state in (State.CANCELLING, State.CALIBRATION_STOPPING), given
        else:
            assert after.request_id == 7, given


def test_events_of_earlier_work_change_nothing() -> None:
    for state in State:
        model = replace(FULL, state=state)
        for outcome in (Outcome.DONE, Outcome.PART, Outcome.FAILED):
            assert step(model, Event(outcome, 6, SUMMARY)) == (model, None), (state, outcome)


def test_only_reviewed_plans_and_the_self_timer_shoot() -> None:
    shooting = set()
    for state, given in product(State, [*Key, *(Event(each, 7, "x") for each in Outcome)]):
        for action in range(max(1, len(STATES[state].actions))):
            for remaining_s in (1, 2):
                model = replace(FULL, state=state, action=action, remaining_s=remaining_s)
                after, effect = step(model, given)
                if isinstance(effect, Start) and effect.work is Work.SHOOT:
                    shooting.add(state)
                    assert effect.argument is model.plan is after.plan
    assert shooting == {State.REVIEW, State.TIMER}


def test_idle_screen_is_metered_again_and_again() -> None:
    model = replace(FULL, state=State.IDLE)
    after, effect = step(model, Event(Outcome.TICK))
    assert isinstance(effect, Start)
    assert effect.work is Work.METER
    assert after.state is State.IDLE


def test_the_menu_has_the_defaults_of_a_request() -> None:
    asked, request = choice(Settings(), Goal.COUNT), CaptureRequest()
    assert (asked.response, asked.dynamic_range) == (request.response, request.given_range)
    assert asked.count == request.count
    assert asked.mains_hz == request.mains_hz


def test_menu_offers_all_responses_and_ranges() -> None:
    assert {entry.value for entry in RESPONSES} == {*DEFINED_RESPONSES, AUTO}
    values = {entry.value for entry in RANGES if isinstance(entry.value, float)}
    assert values == set(DEFINED_RANGES.values())


def test_labels_fit_on_the_smallest_panel() -> None:
    for state in State:
        assert len(STATES[state].title[-1]) <= 14, state
        for entry in rows(replace(FULL, state=state)):
            assert len(entry.labels[-1]) <= 14 or state is State.CAMERAS, entry


def test_diagram_has_every_state_and_every_transition() -> None:
    text = diagram()
    for state, row in TRANSITIONS.items():
        if state is State.SAVER:
            continue
        assert f'    {state} [label="{STATES[state].title[0]}"]' in text
        for target in set(row.values()) - {state, State.SAVER}:
            assert f"    {state} -> {target} [label=" in text
    assert 'review -> shooting [label="[Shoot]"]' in text
    assert 'shooting -> cancelling [label="EXIT"]' in text
    assert 'shooting -> result [label="done"]' in text


def test_page_of_the_documentation_is_up_to_date() -> None:
    """Update it with: python docs/draw_menu_states.py."""
    assert (DOCS / "reference/menu-states.md").read_text(encoding="utf-8") == states_page()


def test_drawing_of_the_documentation_is_up_to_date() -> None:
    """Update it with: python docs/draw_menu_states.py (needs graphviz)."""
    drawing = (DOCS / "pictures/menu-states.svg").read_text(encoding="utf-8")
    assert drawing.startswith(f"<!--\n{diagram()}-->\n<svg")
    assert drawing.count('class="edge"') == diagram().count(" -> ")


@pytest.mark.parametrize("begun", [State.PLANNING, State.RESUMING, State.SERIES_SHOOTING])
def test_retry_after_a_cancel_begins_the_same_again(begun: State) -> None:
    unfinished = [each.is_complete for each in CAPTURES].index(False)
    before = {
        State.PLANNING: replace(FULL, state=State.EXPOSURES),
        State.RESUMING: replace(FULL, state=State.CAPTURES, cursor=unfinished),
        State.SERIES_SHOOTING: replace(FULL, state=State.SERIES, cursor=2),
    }[begun]
    model, started = step(before, Key.ENTER)
    assert model.state is begun
    if begun is State.PLANNING:
        model, _ = step(replace(model, state=State.REVIEW), Key.ENTER)
    model, cancel = step(model, Key.EXIT)
    assert isinstance(cancel, Cancel)
    model, _ = step(model, Event(Outcome.CANCELLED, model.request_id, "cancelled"))
    assert model.state is State.CANCELLED
    retry = STATES[State.CANCELLED].actions.index(Action.RETRY)
    model, again = step(replace(model, action=retry), Key.ENTER)
    assert model.state is begun
    assert isinstance(started, Start)
    assert isinstance(again, Start)
    assert (again.work, again.argument) == (started.work, started.argument)


@pytest.mark.parametrize(
    ("begun", "again"),
    [
        (State.PLANNING, State.PLANNING),
        (State.RESUMING, State.PLANNING),  # nothing of it is missing now
        (State.SERIES_SHOOTING, State.SERIES_SHOOTING),
    ],
)
def test_again_after_a_result_takes_the_same_again(begun: State, again: State) -> None:
    before = replace(FULL, state=State.RESULT, begun=begun)
    first = STATES[State.RESULT].actions.index(Action.AGAIN)
    model, started = step(replace(before, action=first), Key.ENTER)
    assert model.state is again
    assert isinstance(started, Start)
    assert (started.work is Work.SERIES) is (begun is State.SERIES_SHOOTING)
    if started.work is Work.SERIES:
        _, whole = step(replace(FULL, state=State.SERIES, cursor=2), Key.ENTER)
        assert isinstance(whole, Start)
        assert started.argument == whole.argument
