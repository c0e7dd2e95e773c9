"""The sections *Look* and *Time*: pictures of what can be chosen."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.menu.data import Cost
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.studio import Studio


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
