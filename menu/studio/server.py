"""The server of the studio: the page, its files, the state, commands, and the sections' routes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote, unquote

from camctl.errors import CamctlError
from camctl.menu.model import Action, State
from camctl.menu.ports import Key
from camctl.menu.studio.commands import Command
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request, Route
from camctl.menu.studio.sections import SECTIONS
from camctl.menu.studio.studio import Studio
from camctl.messages.menu import error_text
from camctl.system.web_server import SiteHandler

_STATIC = Path(__file__).with_name("static")
PAGE = (_STATIC / "index.html").read_bytes()
_KINDS = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_KEYS = {key.name.lower(): key for key in Key}
_SECTIONS = [
    {name: getattr(each, name) for name in ("name", "title", "states", "returns")}
    for each in SECTIONS
]
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
                state = {"sections": _SECTIONS, **self.studio.wait_for(self.known_version)}
                self.answer(json.dumps(state).encode(), "application/json")
            case path if path.startswith("/static/"):
                self._send_static(path.removeprefix("/static/"))
            case _:
                self._send_answer({each.name: each.get for each in SECTIONS})

    def do_POST(self) -> None:
        """Take a command, or answer a route of a section."""
        wrong_page = "this is taken from the page of the studio only"
        if not self.is_allowed() or not self.is_from_page(wrong_page):
            return
        self._send_answer(
            {"": {"command": _take_command}, **{each.name: each.post for each in SECTIONS}}
        )

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
        if route is None:
            self.refuse(NOT_FOUND, "there is no such page")
            return
        request = Request(
            unquote("/".join(parts[place + 1 :])),
            dict(parse_qsl(self.url.query)),
            self.length,
            self.rfile,
        )
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
            self.send_file(file, answer.kind, more=more)


def _take_command(studio: Studio, request: Request) -> Answer:
    """Take what was chosen: the fields of `Command` that are not their defaults, by name."""
    command = _command(request.json())
    if not studio.command(command):
        raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many keys are waiting")
    return Answer.of({})


def _command(value: Any) -> Command:
    """Return what JSON describes; raises `RefusedError`."""
    try:
        given = dict(value)
        command = Command(
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
    return command
