"""What is chosen in the studio becomes keys of the menu, and nothing that six keys cannot do."""

from __future__ import annotations

from dataclasses import replace

import pytest
from panel_fakes import CAMERA, CAPTURES, FRONT, plan_of

from camctl.menu.machine import step
from camctl.menu.model import Action, Model, State
from camctl.menu.ports import Key
from camctl.menu.studio.commands import Command, keys_for

IDLE = Model(state=State.IDLE, camera=CAMERA, captures=CAPTURES, front=FRONT, plan=plan_of([0.1]))


def after(model: Model, command: Command) -> Model:
    """Return the state that the keys of a command lead to."""
    for key in keys_for(model, command):
        model, _ = step(model, key)
    return model


@pytest.mark.parametrize("begin", [State.IDLE, State.FRONT, State.REVIEW, State.PAST, State.SAVER])
@pytest.mark.parametrize(
    "target",
    [
        *(State.IDLE, State.RESPONSE, State.RANGE, State.CUSTOM, State.EXPOSURES, State.BUDGET),
        *(State.FRONT, State.PLANNING, State.BROWSING, State.SEARCHING, State.SETTINGS),
    ],
)
def test_keys_lead_to_each_state_that_has_a_view(begin: State, target: State) -> None:
    model = replace(IDLE, state=begin)
    assert after(model, Command(state=target)).state is target


def test_no_keys_lead_through_a_capture_or_to_its_end() -> None:
    for state in (State.SHOOTING, State.RESUMING, State.CANCELLING):
        assert keys_for(replace(IDLE, state=state), Command(state=State.BROWSING)) == ()
    assert keys_for(IDLE, Command(state=State.SHOOTING)) == ()


def test_command_on_a_page_that_is_gone_does_nothing() -> None:
    review = replace(IDLE, state=State.REVIEW)
    command = Command(seen=State.REVIEW, action=Action.SHOOT)
    assert after(review, command).state is State.SHOOTING
    assert keys_for(replace(IDLE, state=State.RESULT), command) == ()


def test_entry_is_selected_and_taken() -> None:
    model = after(IDLE, Command(state=State.RESPONSE))
    model = after(model, Command(index=2))
    assert (model.state, model.settings.response) == (State.RESPONSE, 2)
    model = after(model, Command(index=1, take=True))
    assert (model.state, model.settings.response) == (State.RANGE, 1)
    assert keys_for(model, Command(index=99, take=True)) == ()


def test_way_through_the_lists_keeps_what_is_selected() -> None:
    model = after(IDLE, Command(state=State.CUSTOM))
    before = model.settings
    assert after(model, Command(state=State.EXPOSURES)).settings == before


def test_action_and_key_are_pressed() -> None:
    assert after(IDLE, Command(action=Action.MENU)).state is State.MENU
    assert keys_for(IDLE, Command(key=Key.EXIT)) == (Key.EXIT,)
    assert keys_for(IDLE, Command(action=Action.RETRY)) == ()
