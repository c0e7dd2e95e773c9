"""What the page shows of the menu's state, for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from camctl.menu.data import Cost, Picture, Plan, Reading, Summary
from camctl.menu.entries import CHANGEABLE, KEPT, rows
from camctl.menu.model import Model
from camctl.menu.ports import Screen
from camctl.menu.tables import STATES


def state_of(model: Model, screen: Screen) -> dict[str, Any]:
    """Return the words of the screen, and the numbers behind them."""
    reading, summary, plan = model.reading, model.summary, model.plan
    return {
        "state": model.state,
        "request": model.request_id,
        "kind": STATES[model.state].kind.value,
        "mood": screen.mood.name.lower(),
        "title": screen.title.texts[0],
        "about": screen.title.note[0] if screen.title.note else "",
        "lines": [line.texts[0] for line in screen.lines],
        "paragraphs": screen.paragraphs,
        "detail": screen.detail.texts[0] if screen.detail is not None else "",
        "selected": screen.selected,
        "actions": [each.name.lower() for each in STATES[model.state].actions],
        "action": model.action,
        "share": screen.share,
        "entries": [_entry(each.action) for each in rows(model)],
        "costs": [None if each is None else _cost(each) for each in model.costs],
        "front": [_cost(each) for each in model.front],
        "chosen": _chosen(model),
        "camera": None if model.camera is None else asdict(model.camera),
        "cameras": [asdict(each) for each in model.cameras],
        "captures": [asdict(each) for each in model.captures],
        "reading": None if reading is None else _reading(reading),
        "plan": None if plan is None else _plan(plan),
        "progress": None if model.progress is None else asdict(model.progress),
        "remaining_s": model.remaining_s,
        "summary": None if summary is None else _summary(summary),
        "error": model.error,
        "note": model.note,
    }


def _entry(action: Any) -> str:
    return "" if action is None else action.name.lower()


def _chosen(model: Model) -> dict[str, str]:
    """Return the labels of what the settings select."""
    settings = model.settings
    names = ("response", "range", "stops", "count", "budget", *CHANGEABLE)
    return {name: KEPT[name][getattr(settings, name)].labels[0] for name in names}


def _fields(value: Any, *left_out: str) -> dict[str, Any]:
    """Return the fields of a dataclass but for pictures, handles, and those named."""
    return {
        name: each
        for name, each in vars(value).items()
        if name not in left_out and not isinstance(each, Picture) and name != "handle"
    }


def _cost(cost: Cost) -> dict[str, Any]:
    return {**_fields(cost), "has_picture": cost.picture is not None}


def _reading(reading: Reading) -> dict[str, Any]:
    return _fields(reading, "camera", "picture")


def _plan(plan: Plan) -> dict[str, Any]:
    return _fields(plan)


def _summary(summary: Summary) -> dict[str, Any]:
    return _fields(summary, "picture")
