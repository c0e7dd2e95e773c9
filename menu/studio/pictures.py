"""Pictures of the sections *Camera*, *Look* and *Time*: what is seen, and what can be chosen."""

from __future__ import annotations

import json
from collections.abc import Sequence

from camctl.menu.data import Cost
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.sight import Look, rendered
from camctl.menu.studio.studio import Studio

_LARGEST_SIDE = 4096
"""Pixels of the longest side of a picture for a browser: the largest displays have no more."""


def seen_picture(studio: Studio, request: Request) -> Answer:
    """Return what the camera sees next; its numbers are in the head ``X-Camctl-Facts``."""
    query = request.query
    try:
        after = int(query.get("after", "0"))
        width, height = (
            min(max(int(query.get(name, "960")), 16), _LARGEST_SIDE) for name in ("width", "height")
        )
        x, comma, y = query.get("at", "").partition(",")
        centre = (_share(x), _share(y)) if comma else None
    except ValueError:
        raise RefusedError(NOT_FOUND, "there is no such picture") from None
    view = studio.sight.wait(after)
    if view is None:
        raise RefusedError(NOT_FOUND, "there is no picture yet")
    look = Look(width, height, centre, query.get("clip") == "1", query.get("peak") == "1")
    data, kind, sharpness = rendered(view, look)
    facts = {"number": view.number, "focus": sharpness, **view.facts}
    return Answer(data, kind, head={"X-Camctl-Facts": json.dumps(facts)})


def _share(text: str) -> float:
    """Return a number between 0 and 1; raises ValueError."""
    value = float(text)
    if not 0 <= value <= 1:  # NaN is not, either
        raise ValueError(text)
    return value


def cost_picture(studio: Studio, request: Request) -> Answer:
    """Return the picture of an entry of the list: ``look/picture/INDEX``."""
    return _answer(studio.model.costs, request)


def point_picture(studio: Studio, request: Request) -> Answer:
    """Return the picture of a point of the front: ``time/picture/INDEX``."""
    return _answer(studio.model.front, request)


def _answer(costs: Sequence[Cost | None], request: Request) -> Answer:
    index = int(request.rest) if request.rest.isdecimal() and len(request.rest) < 4 else -1
    cost = costs[index] if 0 <= index < len(costs) else None
    if cost is None or cost.draw is None:
        raise RefusedError(NOT_FOUND, "there is no such picture")
    return Answer.of_picture(cost.draw())
