"""What a section of the page consists of: a script in ``static``, and answers to requests.

A section ``NAME`` has ``static/NAME.js``, a module whose default export is described at the top of
``static/studio.js``, and routes whose addresses begin with ``NAME/``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from io import BufferedIOBase
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from camctl.menu.data import Picture
from camctl.menu.model import State
from camctl.menu.studio.studio import Studio
from camctl.system.picture_operations import png

MOST_BODY = 1 << 16
"""Bytes of a request that are read at once: a choice has a few dozen."""


@dataclass(frozen=True)
class Request:
    """What a route is asked.

    Attributes:
        rest: what follows the address of the route, decoded, without a leading slash
        query: the last value of each name
        length: bytes of the body
        body: the body; no more than `length` bytes may be read
    """

    rest: str
    query: Mapping[str, str]
    length: int
    body: BufferedIOBase

    def json(self) -> Any:
        """Return the body; raises `RefusedError` where it is no JSON."""
        if self.length > MOST_BODY:
            raise RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the request is too long")
        try:
            return json.loads(self.body.read(self.length))
        except (ValueError, RecursionError):
            raise RefusedError(HTTPStatus.BAD_REQUEST, "the request is no JSON") from None


@dataclass(frozen=True)
class Answer:
    """What a route answers.

    Attributes:
        content: the bytes, or the file that has them
        kind: media type
        name: under which a browser keeps it; "": it is shown
        head: more lines of the head of the answer
    """

    content: bytes | Path
    kind: str = "application/json"
    name: str = ""
    head: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_picture(cls, picture: Picture) -> Answer:
        """Return a small picture."""
        pixels = np.frombuffer(picture.rgb, np.uint8).reshape(picture.rows, picture.columns, 3)
        return cls(png(pixels), "image/png")

    @classmethod
    def of(cls, value: object) -> Answer:
        """Return a value as JSON."""
        return cls(json.dumps(value, allow_nan=False).encode())


class RefusedError(Exception):
    """A request that is not answered, with a status of HTTP and one line."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


NOT_FOUND = HTTPStatus.NOT_FOUND

Route: TypeAlias = Callable[[Studio, Request], Answer]
"""Called on a thread of its own for each request; a `CamctlError` is answered as its text."""


@dataclass(frozen=True)
class Section:
    """One section of the page.

    Attributes:
        name: of its script and of its addresses, and in the address of the page
        title: in the bar of sections
        states: of the menu that it shows; the first is the one that opening it leads to.  A section
            without states is opened by the page alone, and stays while the menu goes on
        returns: its button in the bar leads back to its first state from its other states, too
        get, post: its routes, by what follows ``NAME/`` in the address; ``post`` changes something
    """

    name: str
    title: str
    states: tuple[State, ...] = ()
    returns: bool = False
    get: Mapping[str, Route] = field(default_factory=dict)
    post: Mapping[str, Route] = field(default_factory=dict)
