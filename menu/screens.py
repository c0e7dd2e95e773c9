"""What a panel shows: a pure function from the model to a grid of characters.

From the top: title, on a roomy panel what is picked so far, the body (a list, or text), the actions
of a page, and on a panel of six rows and more the keys.
"""

from __future__ import annotations

import textwrap
import unicodedata
from dataclasses import dataclass, replace

from camctl.captures.request import CapturePlan
from camctl.controls import ExposureSetting
from menu.machine import STATES, Kind
from menu.model import RANGES, RESPONSES, Model, State
from menu.numbers import count_of, exact_time, multiple, share, short_time, times
from menu.ports import Cost, Highlight

_WIDE = 40  # columns from which there is room for words beside numbers
_HELPFUL = 6  # rows from which the keys are told at the bottom
_ROOMY = 8  # rows from which there is room for what was picked so far

_WAITING = {
    State.PREDICTING: "The first time with a camera this takes a while",
    State.PLANNING: "Looking for the highlights",
    State.SHOOTING: "Starting",
    State.CANCELLING: "Keeping what was shot",
}


@dataclass(frozen=True)
class Grid:
    """What a panel shows: `lines`, all of one length, and where the selected entry is."""

    lines: tuple[str, ...]
    highlight: Highlight | None


def screen(model: Model, columns: int, rows: int) -> Grid:
    """Return exactly `rows` lines of exactly `columns` characters, each one cell wide.

    Made for 20 x 4 to 60 x 16; what is outside of that is cut or padded.
    """
    face = STATES[model.state]
    top, bottom = _top(model, columns, rows), _bottom(model, columns, rows)
    room = max(0, rows - len(top) - len(bottom))
    body = _body(model, columns, rows)
    first = _first(model, len(body), room)
    shown = body[first : first + room]
    more = ("^" if first > 0 else " ") + ("v" if first + room < len(body) else " ")
    if more.strip():
        top[0] = f"{_fit(top[0], columns - 3)} {more}"
    lines = [*top, *shown, *[""] * (room - len(shown)), *bottom]
    highlight = None
    if face.kind is Kind.LIST:
        highlight = Highlight(len(top) + _cursor(model) - first, 0, columns)
    elif face.actions:
        before = sum(len(action.value) + 2 for action in face.actions[: model.action])
        width = len(face.actions[model.action].value) + 2
        highlight = Highlight(rows - len(bottom), before, width)
    return Grid(tuple(_fit(line, columns) for line in lines[:rows]), highlight)


def settled(model: Model, columns: int, rows: int) -> Model:
    """Return the model with its page scrolled no further than the last line is on the panel."""
    if STATES[model.state].kind is not Kind.PAGE:
        return model
    room = rows - len(_top(model, columns, rows)) - len(_bottom(model, columns, rows))
    return replace(model, offset=_first(model, len(_body(model, columns, rows)), room))


def _top(model: Model, columns: int, rows: int) -> list[str]:
    title = STATES[model.state].title
    if model.state is State.REVIEW and model.plan is not None:
        word = "levels" if columns >= _WIDE else "lv"
        title = f"{title}: {count_of(model.plan.effective_levels)} {word}"
    if rows < _ROOMY:
        return [title]
    return [title, _picked(model), _heads(model, columns)]


def _heads(model: Model, columns: int) -> str:
    """Return what stands in the columns of a list, where that needs saying."""
    if model.state is not State.EXPOSURES or columns < _WIDE:
        return ""
    return f"{'n':>3}{'shutter open':>14}{'effective':>14}   exposures"


def _bottom(model: Model, columns: int, rows: int) -> list[str]:
    face = STATES[model.state]
    lines = []
    if face.actions:
        words = [action.value for action in face.actions]
        lines.append(
            "".join(
                f"[{word}]" if index == model.action else f" {word} "
                for index, word in enumerate(words)
            )
        )
    if rows >= _HELPFUL:
        lines += [""] * (rows >= _ROOMY) + [_help(face.help, columns)]
    return lines


def _help(keys: tuple[str, ...], columns: int) -> str:
    """Return what the keys do, as far as it fits."""
    line = ""
    for key in keys:
        longer = f"{line}  {key}" if line else key
        line = longer if len(longer) <= columns else line
    return line


def _picked(model: Model) -> str:
    """Return what was picked on the way to here."""
    way = [RESPONSES[model.response].label, f"1:{RANGES[model.range].value:,.0f}"]
    way.append(f"{model.count} exposure{'s' * (model.count > 1)}")
    known = {State.RESPONSE: 0, State.RANGE: 1, State.EXPOSURES: 2, State.QUIT: 0}
    known |= {State.PREDICTING: 2, State.PREDICTION_FAILED: 2}
    return ", ".join(way[: known.get(model.state, 3)])


def _cursor(model: Model) -> int:
    match model.state:
        case State.RESPONSE:
            return model.response
        case State.RANGE:
            return model.range
        case _:
            return model.row


def _first(model: Model, length: int, room: int) -> int:
    """Return the first line of the body that is shown: the selected one is always among them."""
    wanted = model.offset
    if STATES[model.state].kind is Kind.LIST:
        wanted = _cursor(model) - room // 2
    return max(0, min(wanted, length - room))


def _body(model: Model, columns: int, rows: int) -> list[str]:
    match model.state:
        case State.RESPONSE | State.RANGE:
            entries = RESPONSES if model.state is State.RESPONSE else RANGES
            lines = [
                f"{entry.label:<20}{entry.gloss}" if columns >= _WIDE else entry.label
                for entry in entries
            ]
            return _marked(lines, _cursor(model))
        case State.EXPOSURES:
            lines = [_cost(cost, model.base_s, columns) for cost in model.costs]
            return _marked(lines, _cursor(model))
        case State.PREDICTING | State.PLANNING | State.SHOOTING | State.CANCELLING:
            keys = [] if rows >= _HELPFUL else [_help(STATES[model.state].help, columns)]
            return [*_progress(model, columns), *keys]
        case State.REVIEW:
            return [] if model.plan is None else _wrapped(_plan_lines(model.plan), columns)
        case State.RESULT:
            return _wrapped(_summary_lines(model), columns)
        case State.QUIT:
            return []
        case _:
            return _wrapped([model.trouble], columns, indent="")


def _marked(lines: list[str], cursor: int) -> list[str]:
    return [f"{'>' if index == cursor else ' '}{line}" for index, line in enumerate(lines)]


def _cost(cost: Cost, base_s: float | None, columns: int) -> str:
    """Return one number of exposures with what it costs; 19 characters where it must be short."""
    wide = columns >= _WIDE
    if base_s is not None:
        time = f"~{short_time(cost.shutter_time * base_s)}"
    else:
        time = f"{times(cost.shutter_time)}{' x base' if wide else 'x'}"
    levels = count_of(cost.effective_levels)
    if not wide:
        return f"{cost.count:>2}{time.replace(' ', ''):>8}{levels:>6} lv"
    line = f"{cost.count:>2}{time:>14}{levels:>7} levels  "
    ratios = " ".join(multiple(exposure) for exposure in cost.exposures)
    return f"{line} {textwrap.shorten(ratios, columns - len(line) - 2, placeholder=' ..')}"


def _plan_lines(plan: CapturePlan) -> list[str]:
    settings = [_setting(setting) for setting in plan.settings]
    width = max(map(len, settings), default=0)
    lines = [
        f"{index} {setting:>{width}} x{multiple(exposure)}"
        for index, (setting, exposure) in enumerate(
            zip(settings, plan.exposures, strict=True), start=1
        )
    ]
    lines.append(f"Shutter open {short_time(plan.shutter_s)} in all")
    lines.append(f"{count_of(plan.xi)} of {count_of(plan.levels_wanted)} wanted levels missing")
    return lines + [f"! {warning}" for warning in plan.warnings]


def _setting(setting: ExposureSetting) -> str:
    words = [exact_time(setting.time_s)]
    if setting.gain != 1:
        words.append(f"gain {setting.gain:.7g}")
    if setting.f_number is not None:
        words.append(f"f/{setting.f_number:.7g}")
    return " ".join(words)


def _summary_lines(model: Model) -> list[str]:
    if model.summary is None:
        return []
    summary = model.summary
    planned = "" if model.plan is None else f", {count_of(model.plan.effective_levels)} planned"
    return [
        f"{count_of(summary.effective_levels)} levels{planned}",
        f"Saturated {share(summary.saturated)}",
        f"In {summary.folder}",
        *(f"! {note}" for note in summary.notes),
    ]


def _progress(model: Model, columns: int) -> list[str]:
    progress = model.progress
    if progress is None:
        return _wrapped([_WAITING[model.state]], columns, indent="")
    if progress.total <= 0:
        return [f"{progress.done} {progress.stage}"]
    part = min(1.0, progress.done / progress.total)
    width = columns - 2
    filled = int(part * width)
    bar = f"[{'#' * filled}{'.' * (width - filled)}]"
    return [f"{progress.done}/{progress.total} {progress.stage}", bar]


def _wrapped(paragraphs: list[str], columns: int, indent: str = " ") -> list[str]:
    lines: list[str] = []
    for paragraph in paragraphs:
        lines += textwrap.wrap(paragraph, columns, subsequent_indent=indent) or [""]
    return lines


def _fit(line: str, columns: int) -> str:
    """Return `line` as exactly `columns` characters that take one cell each."""
    cells = "".join(character if _is_one_cell(character) else "?" for character in line)
    return cells[:columns].ljust(columns)


def _is_one_cell(character: str) -> bool:
    return (
        character.isprintable()
        and unicodedata.east_asian_width(character) not in "WF"
        and not unicodedata.category(character).startswith("M")
    )
