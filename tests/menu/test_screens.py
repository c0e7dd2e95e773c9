"""Screens fill the panel exactly, and the review shows the settings that will be shot."""

from __future__ import annotations

import doctest
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from panel_fakes import COSTS, plan_of

import menu.text
from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from menu.machine import STATES, Kind, step
from menu.model import RANGES, RESPONSES, Action, Model, State
from menu.ports import Cost, Key, Summary
from menu.screens import limit_scrolling, screen
from menu.text import (
    format_exact_time,
    format_levels,
    format_percent,
    format_ratio,
    format_short_time,
    format_total,
)

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
        total_exposure=st.floats(1, 1e7),
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
        error=draw(text),
        action=draw(st.integers(0, max(0, len(STATES[state].actions) - 1))),
        offset=draw(st.integers(0, 50)),
    )


@given(models(), sizes)
def test_screen_has_the_size_of_the_panel(model: Model, size: tuple[int, int]) -> None:
    columns, rows = size
    grid = screen(model, columns, rows)
    assert [len(line) for line in grid.lines] == [columns] * rows
    assert all(character.isprintable() for line in grid.lines for character in line)
    assert grid.lines[0].strip()


@given(models(), sizes)
def test_selected_entry_is_visible_and_highlighted(model: Model, size: tuple[int, int]) -> None:
    grid = screen(model, *size)
    spec = STATES[model.state]
    if spec.kind is Kind.WAIT:
        assert grid.highlight is None
        return
    place = grid.highlight
    assert place is not None
    shown = grid.lines[place.row][place.column : place.column + place.width]
    if spec.kind is Kind.LIST:
        assert shown.startswith(">")
        assert [line.startswith(">") for line in grid.lines].count(True) == 1
        if model.state is State.EXPOSURES:
            assert int(shown[1:3]) == model.count
    else:
        assert shown == f"[{spec.actions[model.action].value}]"


@given(models(), sizes)
def test_scrolling_stops_at_the_last_line(model: Model, size: tuple[int, int]) -> None:
    if STATES[model.state].kind is not Kind.PAGE:
        return
    model = limit_scrolling(replace(model, offset=10**6), *size)
    last = screen(model, *size)
    assert last.lines[0][-3:] not in (" ^v", "  v")
    down, _ = step(model, Key.DOWN)
    assert limit_scrolling(down, *size) == model
    up, _ = step(model, Key.UP)
    assert (screen(limit_scrolling(up, *size), *size) != last) == (model.offset > 0)


_ROW = re.compile(
    r"(?<![\d.])(\d+) +([\d.]+) (s|ms|us)(?: +gain +([\d.e+-]+))?(?: +f/([\d.]+))? +x([\d.]+)"
)
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def whole_page(model: Model, columns: int, rows: int) -> str:
    """Return all text of a page, read while scrolling from its top to its end."""
    lines: list[str] = []
    model = limit_scrolling(replace(model, offset=0), columns, rows)
    while True:
        grid = screen(model, columns, rows)
        assert grid.highlight is not None
        top = 1 if rows < 8 else 3
        body = list(grid.lines[top : grid.highlight.row])
        lines = [*lines[: model.offset], *body]
        following = limit_scrolling(step(model, Key.DOWN)[0], columns, rows)
        if following == model:
            return re.sub(r"\s+", " ", " ".join(lines))
        model = following


def settings_on(model: Model, columns: int, rows: int) -> list[ExposureSetting]:
    """Return the settings that the review shows."""
    body = whole_page(model, columns, rows).split("Total time")[0]
    found = _ROW.findall(body)
    assert [int(row[0]) for row in found] == list(range(1, len(found) + 1))
    return [
        ExposureSetting(float(time) * _UNITS[unit], float(gain or 1), float(stop) if stop else None)
        for _, time, unit, gain, stop, _ in found
    ]


@given(plans, sizes)
def test_review_shows_the_settings_of_the_plan(plan: CapturePlan, size: tuple[int, int]) -> None:
    model = Model(state=State.REVIEW, plan=plan, count=len(plan.settings), costs=COSTS)
    shown = settings_on(model, *size)
    assert len(shown) == len(plan.settings)
    for seen, planned in zip(shown, plan.settings, strict=True):
        assert seen.time_s == pytest.approx(planned.time_s, rel=1e-6, abs=0)
        assert seen.gain == pytest.approx(planned.gain, rel=1e-6, abs=0)
        assert seen.f_number == (
            planned.f_number and pytest.approx(planned.f_number, rel=1e-6, abs=0)
        )


def test_review_distinguishes_exposures_that_differ_by_a_millionth() -> None:
    near = [ExposureSetting(0.0123456), ExposureSetting(0.01234562)]
    model = Model(state=State.REVIEW, plan=plan_of(near))
    first, second = settings_on(model, 20, 4)
    assert first.time_s < second.time_s


def test_cost_line_on_the_smallest_and_the_widest_panel() -> None:
    cost = Cost(3, (1.0, 9.91, 88.38), 99.29, 391.7)
    model = Model(state=State.EXPOSURES, costs=(cost,))
    assert screen(model, 20, 4).lines[1] == "> 3   99.3x   392 lv"
    with_base = replace(model, base_s=0.0033)
    assert screen(with_base, 20, 4).lines[1] == "> 3  ~328ms   392 lv"
    wide = " ".join(screen(model, 60, 4).lines[1].split())
    assert wide == "> 3 99.3 x base 392 levels 1 9.91 88.38"


@given(cost_lists, st.none() | st.floats(1e-6, 3))
def test_cost_line_is_never_cut(costs: list[Cost], base_s: float | None) -> None:
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


def test_long_list_of_ratios_ends_after_a_complete_number() -> None:
    cost = Cost(6, (1.0, 3.979, 16.01, 64.22, 305.4, 1130.0), 1520.0, 500.0)
    line = screen(Model(state=State.EXPOSURES, costs=(cost,), count=6), 56, 4).lines[1]
    assert line.rstrip().endswith("1 3.979 16.01 64.22 ..")


def test_progress_bar_fills() -> None:
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


def test_all_actions_fit_on_the_smallest_panel() -> None:
    for state, spec in STATES.items():
        if spec.actions:
            grid = screen(Model(state=state, plan=plan_of([ExposureSetting(1.0)])), 20, 4)
            assert all(action.value in grid.lines[3] for action in spec.actions)


def test_characters_wider_or_narrower_than_a_cell_are_replaced() -> None:
    model = Model(state=State.CAPTURE_FAILED, error="日本 \x1b[31m e\u0301 \u200b é", action=0)
    body = "".join(screen(model, 60, 6).lines[1:4])
    assert "?? ?[31m e? ? é" in body


def test_page_without_data_is_shown() -> None:
    for state in State:
        if state is not State.EXPOSURES:
            assert len(screen(Model(state=state), 20, 4).lines) == 4
    assert Action.SHOOT.value in screen(Model(state=State.REVIEW), 20, 4).lines[3]


def test_titles_fit_on_the_smallest_panel() -> None:
    """Lists and pages also need three characters for the marks that more lines follow."""
    for spec in STATES.values():
        assert len(spec.title) <= (20 if spec.kind is Kind.WAIT else 17)


def test_examples_of_the_number_formats() -> None:
    assert doctest.testmod(menu.text).failed == 0


@pytest.mark.parametrize(
    ("time_s", "expected"),
    [
        (1e-6, "1 us"),
        (999.6e-6, "1 ms"),
        (999.4e-6, "999 us"),
        (0.9996, "1 s"),
        (1 / 30, "33.3 ms"),
        (3599.6, "3600 s"),
        (100.0, "100 s"),
        (86400.0, "24 h"),
    ],
)
def test_short_time_changes_unit_where_rounding_does(time_s: float, expected: str) -> None:
    assert format_short_time(time_s) == expected


@given(st.floats(1e-6, 3600))
def test_times_are_rounded_to_their_number_of_digits(time_s: float) -> None:
    for write, digits in ((format_short_time, 3), (format_exact_time, 7)):
        number, unit = write(time_s).split()
        value = float(number) * {"s": 1.0, "ms": 1e-3, "us": 1e-6}[unit]
        assert value == pytest.approx(time_s, rel=0.51 * 10.0 ** (1 - digits), abs=0)
        assert len(number) <= digits + 1


@given(st.floats(1e-3, 9.9e7))
def test_levels_take_at_most_five_characters(levels: float) -> None:
    assert len(format_levels(levels)) <= 5


@given(st.floats(1, 1e7))
def test_ratios_are_rounded_to_their_number_of_digits(ratio: float) -> None:
    assert len(format_total(ratio)) <= 6
    assert float(format_total(ratio).replace("k", "e3")) == pytest.approx(ratio, rel=0.0051)
    assert float(format_ratio(ratio)) == pytest.approx(ratio, rel=0.00051)


def test_small_percentages_are_not_shown_as_zero() -> None:
    assert [format_percent(share) for share in (0.0, 1e-9, 1.0)] == ["0 %", "<0.01 %", "100 %"]
