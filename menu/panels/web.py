"""The menu in a web page: the screen as a picture, and six keys, also from a phone.

Without a token the server listens on the loopback interface only.  A token is set in the
environment variable CAMCTL_MENU_TOKEN, and given once as ``http://HOST:PORT/?token=TOKEN``.
"""

from __future__ import annotations

import json
import queue
from base64 import b64encode
from http import HTTPStatus
from pathlib import Path
from typing import Any, Self
from urllib.parse import unquote

from camctl.menu.drawing import draw
from camctl.menu.layout import grid
from camctl.menu.panels.page import PagePanel
from camctl.menu.ports import Key, Screen
from camctl.system.picture_operations import png
from camctl.system.web_server import DEFAULT_PORT, Site, SiteHandler

SIZE = (640, 480)
"""(columns, rows) of the picture, pixels."""
TOKEN_VARIABLE = "CAMCTL_MENU_TOKEN"

_PAGE = Path(__file__).with_name("web.html").read_bytes()
_KEYS = {key.name.lower(): key for key in Key}
_KINDS = {
    ".dng": "image/x-adobe-dng",
    ".exr": "image/x-exr",
    ".jpg": "image/jpeg",
    ".json": "application/json",
    ".png": "image/png",
    ".tiff": "image/tiff",
}
"""Files of a capture that are handed over, by suffix, and their media types."""


class WebPanel(PagePanel):
    """The panel; a context manager that serves the page while it is open.

    Args:
        address: ``PORT`` or ``HOST:PORT``; a host other than the loopback interface needs a token
        token: what a browser must know; None: the token in the environment, "": no token
    """

    def __init__(self, address: str = str(DEFAULT_PORT), *, token: str | None = None) -> None:
        super().__init__(Site(address, token, TOKEN_VARIABLE, "web:", "the panel web", _PAGE))
        self.keys: queue.Queue[Key] = queue.Queue(64)
        self._screen: Screen | None = None
        self._picture = b""
        self._result: Path | None = None

    def __enter__(self) -> Self:
        """Start the server and return the panel; raises `UsageError` where it cannot listen."""
        self._open("the menu", _Handler, server_panel=self)
        return self

    def show(self, screen: Screen) -> int:
        """Make `screen` the one that browsers get; return the last offset."""
        drawing = draw(screen, *SIZE)
        with self.changed:
            self._screen = screen
            if screen.folder:
                self._result = Path(screen.folder)
            self.version += 1
            self._picture = png(drawing.pixels)
            self.changed.notify_all()
        return drawing.last_offset

    def key(self, timeout_s: float) -> Key | None:
        try:
            return self.keys.get(timeout=timeout_s) if timeout_s else self.keys.get_nowait()
        except queue.Empty:
            return None

    def wait_for(self, version: int) -> dict[str, Any]:
        """Return what the page shows, for JSON, once it is not `version`.

        That is: version, lines of text and PNG file (base64) of the screen, and the name of the
        capture whose result was shown last, with the names of its files.
        """
        with self.changed:
            self._wait_for_change(version)
            lines = [] if self._screen is None else list(grid(self._screen, 60, 16).lines)
            return {
                "version": self.version,
                "lines": [line.rstrip() for line in lines],
                "picture": b64encode(self._picture).decode(),
                "result": "" if self._result is None else self._result.name,
                "files": list(self.result_files()),
            }

    def result_files(self) -> dict[str, Path]:
        """Return the pictures and the report of the result that was shown last, by name."""
        if self._result is None:
            return {}
        try:
            found = {path.name: path for path in self._result.iterdir() if path.is_file()}
        except OSError:  # it was removed
            return {}
        return {name: found[name] for name in sorted(found) if Path(name).suffix in _KINDS}


class _Handler(SiteHandler):
    """Answers one request; `server_panel` is the panel."""

    server_panel: WebPanel

    def do_GET(self) -> None:
        """Answer the page, the next screen, or its picture."""
        if not self.is_allowed():
            return
        match self.url.path:
            case "/":
                self.answer(_PAGE, "text/html; charset=utf-8")
            case "/screen":
                shown = self.server_panel.wait_for(self.known_version)
                self.answer(json.dumps(shown).encode(), "application/json")
            case path if path.startswith("/result/"):
                self._send_file(unquote(path.removeprefix("/result/")))
            case _:
                self.refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Take a key."""
        wrong_page = "keys are taken from the page of the menu only"
        if not self.is_allowed() or not self.is_from_page(wrong_page):
            return
        name = self.url.path.removeprefix("/key/")
        if name not in _KEYS:
            self.refuse(HTTPStatus.NOT_FOUND, f"no key is called {name[:20]!r}")
            return
        try:
            self.server_panel.keys.put_nowait(_KEYS[name])
        except queue.Full:
            self.refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many keys are waiting")
            return
        self.answer(b"", "text/plain")

    def _send_file(self, name: str) -> None:
        """Send a file of the result that was shown last."""
        try:
            file = self.server_panel.result_files()[name].open("rb")
        except (KeyError, OSError):
            self.refuse(HTTPStatus.NOT_FOUND, "the result has no such file")
            return
        with file:
            self.send_file(file, _KINDS[Path(name).suffix])
