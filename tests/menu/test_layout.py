"""Screens on panels of text, from 16 x 2 to full size."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.menu.data import Progress, Settings
from camctl.menu.layout import binned, grid
from camctl.menu.model import Model, State
from camctl.menu.ports import Line, Screen
from camctl.menu.screens import screen
from tests.menu.test_machine import FULL

SIZES = [(16, 2), (20, 4), (24, 8), (40, 12), (60, 16)]


def texts_cut(model: Model, columns: int) -> list[str]:
    """Return the lines that are longer than a row, in their shortest form."""
    shown = screen(model)
    lines = [shown.title, *shown.lines, *([shown.detail] if shown.detail else [])]
    room = columns - 2 if shown.selected is not None or shown.actions else columns
    return [line.texts[-1] for line in lines if len(line.texts[-1]) > room]


@pytest.mark.parametrize("state", [s for s in State if s is not State.SAVER])
def test_every_screen_fits_its_panel_with_the_selected_entry_and_button(state: State) -> None:
    shown = screen(replace(FULL, state=state))
    if state is not State.CAMERAS:  # names of makers may be longer
        assert texts_cut(replace(FULL, state=state), 16) == []
    for size in SIZES:
        result = grid(shown, *size)
        assert [len(line) for line in result.lines] == [size[0]] * size[1]
        assert result.lines[0].strip()
        if shown.selected is not None:
            assert result.highlight is not None
            assert result.lines[result.highlight.row].startswith(">")
        elif shown.actions:
            assert result.highlight is not None
            row = result.lines[result.highlight.row]
            assert row[result.highlight.column] == "["


@given(
    st.builds(
        Settings,
        response=st.integers(0, 3),
        range=st.integers(0, 4),
        stops=st.integers(0, 16),
        count=st.integers(0, 8),
        budget=st.integers(0, 9),
    ),
    st.sampled_from(sorted(State)),
    st.tuples(st.integers(16, 100), st.integers(2, 40)),
    st.integers(0, 50),
)
def test_every_selection_can_be_shown(
    settings: Settings, state: State, size: tuple[int, int], offset: int
) -> None:
    shown = grid(screen(replace(FULL, state=state, settings=settings, offset=offset)), *size)
    assert [len(line) for line in shown.lines] == [size[0]] * size[1]


def test_page_scrolls_to_its_end_and_marks_where_more_is() -> None:
    page = Screen(Line(("Title",)), paragraphs=("one two three four five six",), actions=("Go",))
    first = grid(page, 16, 3)
    assert first.lines == ("Title           ", "one two three  v", "[Go]            ")
    assert first.last_offset == 1
    last = grid(replace(page, offset=9), 16, 3)
    assert last.lines[1] == " four five six ^"


def test_message_keeps_its_title_on_two_rows() -> None:
    page = Screen(Line(("Failed",)), paragraphs=("why",), actions=("Back",))
    assert grid(page, 16, 2).lines[0] == "Failed         v"


@pytest.mark.parametrize(
    ("planned", "columns", "line"),
    [
        (97.2, 60, "97 effective levels, as planned"),
        (97.2, 20, "97 levels"),
        (None, 60, "97 effective levels"),
        (120.0, 60, "97 effective levels, 120 planned"),
        (120.0, 20, "97 of 120 levels"),
    ],
)
def test_result_names_planned_levels_where_they_are_others(
    planned: float | None, columns: int, line: str
) -> None:
    assert FULL.summary is not None
    model = replace(
        FULL, state=State.RESULT, summary=replace(FULL.summary, planned_levels=planned, notes=())
    )
    assert line in [each.strip() for each in grid(screen(model), columns, 16).lines]


def test_capture_says_how_many_frames_are_taken() -> None:
    model = replace(FULL, state=State.SHOOTING, progress=Progress(1, 3, "shooting", 0.2))
    assert grid(screen(model), 24, 8).lines[1].strip() == "1 of 3 frames taken"
    assert grid(screen(model), 20, 4).lines[1].strip() == "1/3 frames taken"
    assert grid(screen(model), 16, 2).lines[1].strip() == "1/3 taken"


def test_histogram_is_drawn_in_one_row_or_several() -> None:
    page = Screen(Line(("T",)), histogram=(0.0, 0.25, 0.5, 1.0), actions=("Go",))
    assert grid(page, 16, 6).lines[3] == "    " + "----" + "++++" + "@@@@"
    tall = grid(page, 16, 14).lines
    assert tall[8].rstrip() == " " * 12 + "####"
    assert tall[11].rstrip() == "    " + "#" * 12


def test_binned_histogram_keeps_its_highest_at_one() -> None:
    assert binned((1.0, 3.0, 2.0, 2.0), 2) == [1.0, 1.0]
    assert binned((1.0, 2.0), 4) == [0.5, 0.5, 1.0, 1.0]
    assert binned((0.0, 0.0), 2) == [0.0, 0.0]


@pytest.mark.parametrize(
    ("action", "line"),
    [(0, "[Retry] Back   >"), (1, " Retry [Back]  >"), (2, "[Other camera] <")],
)
def test_buttons_that_do_not_fit_are_marked(action: int, line: str) -> None:
    page = Screen(Line(("T",)), actions=("Retry", "Back", "Other camera"), action=action)
    assert grid(page, 16, 2).lines[1] == line
