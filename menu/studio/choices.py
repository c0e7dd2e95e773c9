"""The sections *Look* and *Time*: pictures of what can be chosen."""

from __future__ import annotations

from camctl.menu.data import Picture
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.studio import Studio


def cost_picture(studio: Studio, request: Request) -> Answer:
    """Return the picture of an entry of the list: ``look/picture/INDEX``."""
    costs = studio.model.costs
    return _answer([None if each is None else each.picture for each in costs], request)


def point_picture(studio: Studio, request: Request) -> Answer:
    """Return the picture of a point of the front: ``time/picture/INDEX``."""
    return _answer([each.picture for each in studio.model.front], request)


def _answer(pictures: list[Picture | None], request: Request) -> Answer:
    index = int(request.rest) if request.rest.isdecimal() and len(request.rest) < 4 else -1
    picture = pictures[index] if 0 <= index < len(pictures) else None
    if picture is None:
        raise RefusedError(NOT_FOUND, "there is no such picture")
    return Answer.of_picture(picture)
