"""What a panel shows: a pure function from the model to a grid of characters.

From the top: title; on a panel of eight rows and more the selection so far and column headings; the
body (a list or text); the actions of a page; on a panel of six rows and more the keys.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace

from camctl.captures.request import CapturePlan
from camctl.controls import ExposureSetting
from menu.machine import STATES, Kind
from menu.model import RANGES, RESPONSES, Model, State
from menu.ports import Cost, Highlight
from menu.text import (
    fit,
    format_exact_time,
    format_levels,
    format_percent,
    format_ratio,
    format_short_time,
    format_total,
    wrap,
)

_WIDE = 40
"""Columns from which there is room for words beside numbers."""

_ROWS_WITH_HELP = 6
"""Rows from which the last one shows the keys."""

_ROWS_WITH_SELECTION = 8
"""Rows from which two show the selection so far and column headings."""

_WAITING = {
    State.PREDICTING: "Takes a while the first time with a camera",
    State.PLANNING: "Measuring the highlights",
    State.SHOOTING: "Starting",
    State.CANCELLING: "Keeping the frames shot so far",
}
"""Text of a waiting screen until there is progress to show."""

_SELECTED_PARTS = {
    State.RESPONSE: 0,
    State.RANGE: 1,
    State.PREDICTING: 2,
    State.PREDICTION_FAILED: 2,
    State.EXPOSURES: 2,
    State.QUIT: 0,
}
"""How many of response, dynamic range and number are selected in a state; elsewhere all three."""


@dataclass(frozen=True)
class Grid:
    """The characters on a panel: lines of equal length, and the place of the selected entry."""

    lines: tuple[str, ...]
    highlight: Highlight | None


def screen(model: Model, columns: int, rows: int) -> Grid:
    """Return exactly `rows` lines of exactly `columns` characters, each one cell wide.

    Made for 20 x 4 to 60 x 16; text outside the panel is cut.
    """
    spec = STATES[model.state]
    top, bottom = _top(model, columns, rows), _bottom(model, columns, rows)
    height = max(0, rows - len(top) - len(bottom))
    body = _body(model, columns, rows)
    first = _first_line(model, len(body), height)
    shown = body[first : first + height]
    more = ("^" if first > 0 else " ") + ("v" if first + height < len(body) else " ")
    if more.strip():
        top[0] = f"{fit(top[0], columns - 3)} {more}"
    lines = [*top, *shown, *[""] * (height - len(shown)), *bottom]
    highlight = None
    if spec.kind is Kind.LIST:
        highlight = Highlight(len(top) + _selected_index(model) - first, 0, columns)
    elif spec.actions:
        before = sum(len(action.value) + 2 for action in spec.actions[: model.action])
        width = len(spec.actions[model.action].value) + 2
        highlight = Highlight(rows - len(bottom), before, width)
    return Grid(tuple(fit(line, columns) for line in lines[:rows]), highlight)


def limit_scrolling(model: Model, columns: int, rows: int) -> Model:
    """Return the model with a page's offset reduced to where its last line is on the panel."""
    if STATES[model.state].kind is not Kind.PAGE:
        return model
    height = rows - len(_top(model, columns, rows)) - len(_bottom(model, columns, rows))
    return replace(model, offset=_first_line(model, len(_body(model, columns, rows)), height))


def _top(model: Model, columns: int, rows: int) -> list[str]:
    title = STATES[model.state].title
    if model.state is State.REVIEW and model.plan is not None:
        levels = format_levels(model.plan.effective_levels)
        title = f"{title}: {levels} {_unit(columns, narrow='lv')}"
    if rows < _ROWS_WITH_SELECTION:
        return [title]
    return [title, _selection(model), _column_headings(model, columns)]


def _unit(columns: int, *, narrow: str) -> str:
    """Return the unit of effective levels, in full on a wide panel."""
    return "effective levels" if columns >= _WIDE else narrow


def _column_headings(model: Model, columns: int) -> str:
    """Return the headings of the list of exposures, on a wide panel."""
    if model.state is not State.EXPOSURES or columns < _WIDE:
        return ""
    return f"{'n':>3}{'total time':>14}{'effective':>14}   exposures"


def _bottom(model: Model, columns: int, rows: int) -> list[str]:
    spec = STATES[model.state]
    lines = []
    if spec.actions:
        texts = [action.value for action in spec.actions]
        lines.append(
            "".join(
                f"[{text}]" if index == model.action else f" {text} "
                for index, text in enumerate(texts)
            )
        )
    if rows >= _ROWS_WITH_HELP:
        lines += [""] * (rows >= _ROWS_WITH_SELECTION) + [_help(spec.help, columns)]
    return lines


def _help(keys: tuple[str, ...], columns: int) -> str:
    """Return what the keys do, as many as fit."""
    line = ""
    for key in keys:
        longer = f"{line}  {key}" if line else key
        line = longer if len(longer) <= columns else line
    return line


def _selection(model: Model) -> str:
    """Return what was selected on earlier screens."""
    plural = "s" * (model.count > 1)
    parts = (
        RESPONSES[model.response].label,
        f"1:{RANGES[model.range].value:,.0f}",
        f"{model.count} exposure{plural}",
    )
    return ", ".join(parts[: _SELECTED_PARTS.get(model.state, len(parts))])


def _selected_index(model: Model) -> int:
    match model.state:
        case State.RESPONSE:
            return model.response
        case State.RANGE:
            return model.range
        case _:
            return model.cost_index


def _first_line(model: Model, length: int, height: int) -> int:
    """Return the first line of the body to show, so that the selected one is among them."""
    first = model.offset
    if STATES[model.state].kind is Kind.LIST:
        first = _selected_index(model) - height // 2
    return max(0, min(first, length - height))


def _body(model: Model, columns: int, rows: int) -> list[str]:
    match model.state:
        case State.RESPONSE | State.RANGE:
            entries = RESPONSES if model.state is State.RESPONSE else RANGES
            lines = [
                f"{entry.label:<20}{entry.description}" if columns >= _WIDE else entry.label
                for entry in entries
            ]
            return _with_cursor(lines, _selected_index(model))
        case State.EXPOSURES:
            lines = [_cost_line(cost, model.base_s, columns) for cost in model.costs]
            return _with_cursor(lines, _selected_index(model))
        case State.PREDICTING | State.PLANNING | State.SHOOTING | State.CANCELLING:
            keys = [] if rows >= _ROWS_WITH_HELP else [_help(STATES[model.state].help, columns)]
            return [*_progress_lines(model, columns), *keys]
        case State.REVIEW:
            return [] if model.plan is None else wrap(_plan_lines(model.plan), columns)
        case State.RESULT:
            return wrap(_summary_lines(model, columns), columns)
        case State.QUIT:
            return []
        case _:
            return wrap([model.error], columns, indent="")


def _with_cursor(lines: list[str], selected: int) -> list[str]:
    return [f"{'>' if index == selected else ' '}{line}" for index, line in enumerate(lines)]


def _cost_line(cost: Cost, base_s: float | None, columns: int) -> str:
    """Return one number of exposures with its cost; at most 19 characters on a narrow panel."""
    is_wide = columns >= _WIDE
    if base_s is not None:
        time = f"~{format_short_time(cost.total_exposure * base_s)}"
    else:
        time = f"{format_total(cost.total_exposure)}{' x base' if is_wide else 'x'}"
    levels = format_levels(cost.effective_levels)
    if not is_wide:
        return f"{cost.count:>2}{time.replace(' ', ''):>8}{levels:>6} lv"
    line = f"{cost.count:>2}{time:>14}{levels:>7} levels  "
    ratios = " ".join(format_ratio(exposure) for exposure in cost.exposures)
    return f"{line} {textwrap.shorten(ratios, columns - len(line) - 2, placeholder=' ..')}"


def _plan_lines(plan: CapturePlan) -> list[str]:
    settings = [_setting_text(setting) for setting in plan.settings]
    width = max(map(len, settings), default=0)
    lines = [
        f"{index} {setting:>{width}} x{format_ratio(exposure)}"
        for index, (setting, exposure) in enumerate(
            zip(settings, plan.exposures, strict=True), start=1
        )
    ]
    lines.append(f"Total time {format_short_time(plan.shutter_s)}")
    missing, wanted = format_levels(plan.xi), format_levels(plan.levels_wanted)
    lines.append(f"{missing} of {wanted} desired levels missing")
    return lines + [f"! {warning}" for warning in plan.warnings]


def _setting_text(setting: ExposureSetting) -> str:
    parts = [format_exact_time(setting.time_s)]
    if setting.gain != 1:
        parts.append(f"gain {setting.gain:.7g}")
    if setting.f_number is not None:
        parts.append(f"f/{setting.f_number:.7g}")
    return " ".join(parts)


def _summary_lines(model: Model, columns: int) -> list[str]:
    if model.summary is None:
        return []
    summary = model.summary
    planned = (
        "" if model.plan is None else f", {format_levels(model.plan.effective_levels)} planned"
    )
    return [
        f"{format_levels(summary.effective_levels)} {_unit(columns, narrow='lv')}{planned}",
        f"{format_percent(summary.saturated)} saturated in all frames",
        f"Saved in {summary.folder}",
        *(f"! {note}" for note in summary.notes),
    ]


def _progress_lines(model: Model, columns: int) -> list[str]:
    progress = model.progress
    if progress is None:
        return wrap([_WAITING[model.state]], columns, indent="")
    if progress.total <= 0:
        return [f"{progress.done} {progress.stage}"]
    width = columns - 2
    filled = int(min(1.0, progress.done / progress.total) * width)
    bar = f"[{'#' * filled}{'.' * (width - filled)}]"
    return [f"{progress.done}/{progress.total} {progress.stage}", bar]
