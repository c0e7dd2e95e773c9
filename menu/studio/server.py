"""The server of the studio: the page, its files, the state, wishes, and the sections' routes."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote, unquote

from camctl.errors import CamctlError
from camctl.menu.model import Action, State
from camctl.menu.ports import Key
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request, Route
from camctl.menu.studio.sections import SECTIONS
from camctl.menu.studio.studio import Studio
from camctl.menu.studio.wishes import Wish
from camctl.messages.menu import error_text
from camctl.system.web_server import SiteHandler

_STATIC = Path(__file__).with_name("static")
PAGE = (_STATIC / "index.html").read_bytes()
_KINDS = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_PART_BYTES = 1 << 20
"""Bytes of a file that are read at a time."""
_KEYS = {key.name.lower(): key for key in Key}
_SECTIONS = [{"name": each.name, "title": each.title, "states": each.states} for each in SECTIONS]
_ACTIONS = {action.name.lower(): action for action in Action}


class StudioHandler(SiteHandler):
    """Answers one request; `studio` is the panel."""

    studio: Studio

    def do_GET(self) -> None:
        """Answer the page, one of its files, the next state, or a route of a section."""
        if not self.is_allowed():
            return
        match self.url.path:
            case "/":
                self.answer(PAGE, "text/html; charset=utf-8")
            case "/state":
                after = dict(parse_qsl(self.url.query)).get("after", "")
                known = int(after) if re.fullmatch(r"\d{1,18}", after, re.ASCII) else 0
                state = {"sections": _SECTIONS, **self.studio.wait_for(known)}
                self.answer(json.dumps(state).encode(), "application/json")
            case path if path.startswith("/static/"):
                self._send_static(path.removeprefix("/static/"))
            case _:
                self._send_answer({each.name: each.get for each in SECTIONS})

    def do_POST(self) -> None:
        """Take a wish, or answer a route of a section."""
        if not self.is_allowed():
            return
        # Pages of other sites cannot send this header without being allowed to.
        if self.headers.get("X-Camctl") is None:
            self.refuse(HTTPStatus.FORBIDDEN, "this is taken from the page of the studio only")
            return
        self._send_answer({"": {"wish": _take_wish}, **{each.name: each.post for each in SECTIONS}})

    def _send_static(self, name: str) -> None:
        path = _STATIC / name
        if path.suffix not in _KINDS or path.parent != _STATIC or not path.is_file():
            self.refuse(NOT_FOUND, "there is no such file")
            return
        self.answer(path.read_bytes(), f"{_KINDS[path.suffix]}; charset=utf-8")

    def _send_answer(self, tables: Mapping[str, Mapping[str, Route]]) -> None:
        """Answer with the route that the address names in one of the tables."""
        parts = self.url.path[1:].split("/")
        table, place = (tables[""], 0) if parts[0] in tables.get("", {}) else ({}, 1)
        table = table or tables.get(parts[0], {})
        route = table.get(parts[place]) if len(parts) > place else None
        length = self.headers.get("Content-Length", "0")
        if route is None or not re.fullmatch(r"\d{1,15}", length, re.ASCII):
            self.refuse(NOT_FOUND, "there is no such page")
            return
        request = Request(
            unquote("/".join(parts[place + 1 :])),
            dict(parse_qsl(self.url.query)),
            int(length),
            self.rfile,
        )
        # What a refused request still sends is not read.
        self.close_connection |= request.length > 0
        try:
            answer = route(self.studio, request)
        except RefusedError as refused:
            self.refuse(refused.status, refused.reason)
        except CamctlError as error:
            self.refuse(HTTPStatus.UNPROCESSABLE_ENTITY, error_text(error))
        else:
            self._send(answer)

    def _send(self, answer: Answer) -> None:
        more = dict(answer.head)
        if answer.name:
            more["Content-Disposition"] = f"attachment; filename*=UTF-8''{quote(answer.name)}"
        if isinstance(answer.content, bytes):
            self.send_head(answer.kind, len(answer.content), more=more)
            self.wfile.write(answer.content)
            return
        try:
            file = answer.content.open("rb")
        except OSError:
            self.refuse(NOT_FOUND, "the file is gone")
            return
        with file:
            # A file that grows meanwhile must not be mixed with the next answer.
            left = os.fstat(file.fileno()).st_size
            self.send_head(answer.kind, left, more=more)
            while left and (part := file.read(min(left, _PART_BYTES))):
                self.wfile.write(part)
                left -= len(part)
            self.close_connection |= left > 0


def _take_wish(studio: Studio, request: Request) -> Answer:
    """Take what was chosen: the fields of `Wish` that are not their defaults, by name."""
    wish = _wish(request.json())
    if not studio.wish(wish):
        raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many keys are waiting")
    return Answer.of({})


def _wish(value: Any) -> Wish:
    """Return what JSON describes; raises `RefusedError`."""
    try:
        given = dict(value)
        wish = Wish(
            seen=State(given.pop("seen")) if "seen" in given else None,
            state=State(given.pop("state")) if "state" in given else None,
            action=_ACTIONS[given.pop("action")] if "action" in given else None,
            index=int(given.pop("index")) if "index" in given else None,
            take=given.pop("take", False) is True,
            key=_KEYS[given.pop("key")] if "key" in given else None,
        )
    except (TypeError, ValueError, KeyError):
        raise RefusedError(HTTPStatus.BAD_REQUEST, "there is no such choice") from None
    if given:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "there is no such choice")
    return wish
