"""What the page shows of the menu's state, for JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from camctl.menu.data import Cost, Summary
from camctl.menu.entries import CHANGEABLE, KEPT, rows
from camctl.menu.model import Model
from camctl.menu.ports import Screen
from camctl.menu.tables import STATES


def state_of(model: Model, screen: Screen, parent: Path) -> dict[str, Any]:
    """Return the words of the screen, and the numbers behind them.

    Captures have the names of their folders below `parent`.
    """
    return {
        "state": model.state,
        "request": model.request_id,
        "kind": STATES[model.state].kind.value,
        "mood": screen.mood.name.lower(),
        "title": screen.title.texts[0],
        "lines": [line.texts[0] for line in screen.lines],
        "paragraphs": screen.paragraphs,
        "detail": _detail(screen),
        "selected": screen.selected,
        "actions": [each.name.lower() for each in STATES[model.state].actions],
        "action": model.action,
        "share": screen.share,
        "entries": [_entry(each.action) for each in rows(model)],
        "costs": [_cost(each) for each in model.costs],
        "front": [_cost(each) for each in model.front],
        "rivals": [_fields(each) for each in model.rivals],
        "chosen": _chosen(model),
        "camera": _fields(model.camera),
        "captures": [_fields(each) for each in model.captures],
        "reading": _fields(model.reading, "camera"),
        "plan": _fields(model.plan),
        "progress": _fields(model.progress),
        "summary": _summary(model.summary, parent),
        "error": model.error,
        "note": model.note,
    }


def _detail(screen: Screen) -> str:
    """Return what the selected entry costs, but not what a key does with it."""
    text = "" if screen.detail is None else screen.detail.texts[0]
    return "" if text.startswith("enter: ") else text


def _entry(action: Any) -> str:
    return "" if action is None else action.name.lower()


def _chosen(model: Model) -> dict[str, str]:
    """Return the labels of what the settings select."""
    settings = model.settings
    names = ("response", "range", "stops", "count", "budget", *CHANGEABLE)
    return {name: KEPT[name][getattr(settings, name)].labels[0] for name in names}


def _fields(value: Any, *left_out: str) -> dict[str, Any] | None:
    """Return the fields of a dataclass but for picture, handle, and those named; None of None."""
    if value is None:
        return None
    return {
        name: each
        for name, each in vars(value).items()
        if name not in (*left_out, "handle", "picture")
    }


def _summary(summary: Summary | None, parent: Path) -> dict[str, Any] | None:
    if summary is None:
        return None
    folder = Path(summary.folder)
    name = folder.relative_to(parent) if folder.is_relative_to(parent) else folder.name
    return {**(_fields(summary) or {}), "name": str(name)}


def _cost(cost: Cost | None) -> dict[str, Any] | None:
    found = _fields(cost, "draw")
    return found and {**found, "has_picture": cost is not None and cost.draw is not None}
