"""Screens have the panel's size, and say what will be done."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from panel_fakes import COSTS, plan_of

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from menu.machine import STATES, Kind, step
from menu.model import RANGES, RESPONSES, Action, Model, State
from menu.ports import Cost, Key, Summary
from menu.screens import screen, settled

text = st.text(max_size=120)
settings_lists = st.lists(
    st.builds(
        ExposureSetting,
        time_s=st.floats(1e-6, 3600),
        gain=st.just(1.0) | st.floats(0.1, 1000),
        f_number=st.none() | st.floats(0.9, 64),
    ),
    min_size=1,
    max_size=8,
)
plans = settings_lists.map(plan_of)
cost_lists = st.lists(
    st.builds(
        Cost,
        count=st.integers(1, 16),
        exposures=st.lists(st.floats(1, 1e6), min_size=1, max_size=16).map(tuple),
        shutter_time=st.floats(1, 1e7),
        effective_levels=st.floats(0.1, 1e6),
    ),
    min_size=1,
    max_size=16,
    unique_by=lambda cost: cost.count,
)
sizes = st.tuples(st.integers(20, 60), st.integers(4, 16))


@st.composite
def models(draw: st.DrawFn) -> Model:
    costs = tuple(draw(cost_lists))
    state = draw(st.sampled_from(State))
    return Model(
        state=state,
        response=draw(st.integers(0, len(RESPONSES) - 1)),
        range=draw(st.integers(0, len(RANGES) - 1)),
        count=draw(st.sampled_from(costs)).count,
        costs=costs,
        base_s=draw(st.none() | st.floats(1e-6, 60)),
        plan=draw(plans),
        progress=draw(
            st.none() | st.builds(Progress, st.integers(0, 99), st.integers(0, 99), text)
        ),
        summary=Summary(
            draw(st.floats(0, 1e6)), draw(st.floats(0, 1)), draw(text), (draw(text), draw(text))
        ),
        trouble=draw(text),
        action=draw(st.integers(0, max(0, len(STATES[state].actions) - 1))),
        offset=draw(st.integers(0, 50)),
    )


@given(models(), sizes)
def test_a_screen_is_as_large_as_the_panel(model: Model, size: tuple[int, int]) -> None:
    columns, rows = size
    grid = screen(model, columns, rows)
    assert [len(line) for line in grid.lines] == [columns] * rows
    assert all(character.isprintable() for line in grid.lines for character in line)
    assert grid.lines[0].strip()


@given(models(), sizes)
def test_the_selected_entry_is_on_the_panel(model: Model, size: tuple[int, int]) -> None:
    grid = screen(model, *size)
    face = STATES[model.state]
    if face.kind is Kind.WAIT:
        assert grid.highlight is None
        return
    mark = grid.highlight
    assert mark is not None
    shown = grid.lines[mark.row][mark.column : mark.column + mark.width]
    if face.kind is Kind.LIST:
        assert shown.startswith(">")
        assert [line.startswith(">") for line in grid.lines].count(True) == 1
        if model.state is State.EXPOSURES:
            assert int(shown[1:3]) == model.count
    else:
        assert shown == f"[{face.actions[model.action].value}]"


@given(models(), sizes)
def test_scrolling_shows_all_and_comes_back_at_once(model: Model, size: tuple[int, int]) -> None:
    if STATES[model.state].kind is not Kind.PAGE:
        return
    model = settled(replace(model, offset=10**6), *size)
    last = screen(model, *size)
    assert last.lines[0][-3:] not in (" ^v", "  v")
    down, _ = step(model, Key.DOWN)
    assert settled(down, *size) == model
    up, _ = step(model, Key.UP)
    assert (screen(settled(up, *size), *size) != last) == (model.offset > 0)


_ROW = re.compile(
    r"(?<![\d.])(\d+) +([\d.]+) (s|ms|us)(?: +gain +([\d.e+-]+))?(?: +f/([\d.]+))? +x([\d.]+)"
)
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def everything_on(model: Model, columns: int, rows: int) -> str:
    """All the text of a page, as somebody reads it who scrolls from its top to its end."""
    roll: list[str] = []
    model = settled(replace(model, offset=0), columns, rows)
    while True:
        grid = screen(model, columns, rows)
        assert grid.highlight is not None
        top = 1 if rows < 8 else 3
        body = list(grid.lines[top : grid.highlight.row])
        roll = [*roll[: model.offset], *body]
        following = settled(step(model, Key.DOWN)[0], columns, rows)
        if following == model:
            return re.sub(r"\s+", " ", " ".join(roll))
        model = following


def settings_on(model: Model, columns: int, rows: int) -> list[ExposureSetting]:
    """The settings that the review names."""
    body = everything_on(model, columns, rows).split("Shutter open")[0]
    found = _ROW.findall(body)
    assert [int(row[0]) for row in found] == list(range(1, len(found) + 1))
    return [
        ExposureSetting(float(time) * _UNITS[unit], float(gain or 1), float(stop) if stop else None)
        for _, time, unit, gain, stop, _ in found
    ]


@given(plans, sizes)
def test_the_review_names_the_settings_of_the_plan(
    plan: CapturePlan, size: tuple[int, int]
) -> None:
    model = Model(state=State.REVIEW, plan=plan, count=len(plan.settings), costs=COSTS)
    shown = settings_on(model, *size)
    assert len(shown) == len(plan.settings)
    for seen, meant in zip(shown, plan.settings, strict=True):
        assert seen.time_s == pytest.approx(meant.time_s, rel=1e-6, abs=0)
        assert seen.gain == pytest.approx(meant.gain, rel=1e-6, abs=0)
        assert seen.f_number == (meant.f_number and pytest.approx(meant.f_number, rel=1e-6, abs=0))


def test_the_review_tells_exposures_apart_that_differ_by_a_millionth() -> None:
    near = [ExposureSetting(0.0123456), ExposureSetting(0.01234562)]
    model = Model(state=State.REVIEW, plan=plan_of(near))
    first, second = settings_on(model, 20, 4)
    assert first.time_s < second.time_s


def test_costs_on_the_smallest_panel() -> None:
    cost = Cost(3, (1.0, 9.91, 88.38), 99.29, 391.7)
    model = Model(state=State.EXPOSURES, costs=(cost,))
    assert screen(model, 20, 4).lines[1] == "> 3   99.3x   392 lv"
    known = replace(model, base_s=0.0033)
    assert screen(known, 20, 4).lines[1] == "> 3  ~328ms   392 lv"
    wide = " ".join(screen(model, 60, 4).lines[1].split())
    assert wide == "> 3 99.3 x base 392 levels 1 9.91 88.38"


@given(cost_lists, st.none() | st.floats(1e-6, 3))
def test_costs_are_never_cut(costs: list[Cost], base_s: float | None) -> None:
    for columns in (20, 40, 60):
        for cost in costs:
            model = Model(
                state=State.EXPOSURES, costs=tuple(costs), count=cost.count, base_s=base_s
            )
            grid = screen(model, columns, 4)
            assert grid.highlight is not None
            line = grid.lines[grid.highlight.row]
            time = r"~[\d.]+ ?(h|s|ms|us)" if base_s else r"[\d.]+k?( x base|x)"
            pattern = rf">[ \d]\d +{time} +[\d.]+[kM]? (lv|levels)( .*)?"
            assert re.fullmatch(pattern, line), line


def test_a_long_list_of_ratios_ends_at_a_whole_number() -> None:
    cost = Cost(6, (1.0, 3.979, 16.01, 64.22, 305.4, 1130.0), 1520.0, 500.0)
    line = screen(Model(state=State.EXPOSURES, costs=(cost,), count=6), 56, 4).lines[1]
    assert line.rstrip().endswith("1 3.979 16.01 64.22 ..")


def test_progress_is_a_bar_that_fills() -> None:
    model = Model(state=State.SHOOTING)
    bars = [
        screen(replace(model, progress=Progress(done, 4, "shooting")), 20, 4).lines[2]
        for done in range(5)
    ]
    assert [bar.count("#") for bar in bars] == [0, 4, 9, 13, 18]
    assert screen(replace(model, progress=Progress(1, 4, "shooting")), 20, 4).lines[1:] == (
        "1/4 shooting        ",
        "[####..............]",
        "exit: cancel        ",
    )


def test_every_action_fits_on_the_smallest_panel() -> None:
    for state, face in STATES.items():
        if face.actions:
            grid = screen(Model(state=state, plan=plan_of([ExposureSetting(1.0)])), 20, 4)
            assert all(action.value in grid.lines[3] for action in face.actions)


def test_characters_that_would_shift_a_line_are_replaced() -> None:
    model = Model(state=State.SHOT_FAILED, trouble="日本 \x1b[31m e\u0301 \u200b é", action=0)
    body = "".join(screen(model, 60, 6).lines[1:4])
    assert "?? ?[31m e? ? é" in body


def test_a_page_without_its_data_is_still_a_page() -> None:
    for state in State:
        if state is not State.EXPOSURES:
            assert len(screen(Model(state=state), 20, 4).lines) == 4
    assert Action.SHOOT.value in screen(Model(state=State.REVIEW), 20, 4).lines[3]
