"""The menu in a web page: the screen as a picture, and six keys, also from a phone.

Without a token the server listens on the loopback interface only.  A token is set in the
environment variable CAMCTL_MENU_TOKEN, and given once as ``http://HOST:PORT/?token=TOKEN``.
"""

from __future__ import annotations

import hmac
import ipaddress
import json
import os
import queue
import re
import sys
import threading
import time
from base64 import b64encode
from hashlib import sha256
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any, Self
from urllib.parse import SplitResult, parse_qs, quote, unquote, urlsplit

from camctl.errors import UsageError
from camctl.menu.drawing import draw
from camctl.menu.layout import grid
from camctl.menu.panels.web_connections import LimitedServer
from camctl.menu.ports import Key, Screen
from camctl.system.interrupts import uninterrupted
from camctl.system.picture_operations import png

DEFAULT_PORT = 8080  # http-alt (IANA)
SIZE = (640, 480)
"""(columns, rows) of the picture, pixels."""
TOKEN_VARIABLE = "CAMCTL_MENU_TOKEN"

_PAGE = Path(__file__).with_name("web.html").read_bytes()
_ADDRESS = re.compile(r"(?:(?P<host>[^:]+|\[[0-9a-fA-F:]+\]):)?(?P<port>\d{1,5})", re.ASCII)
_POLL_S = 20.0
"""A request for the next screen is answered after this time, s, even if it is the same."""
_KEYS = {key.name.lower(): key for key in Key}
_COOKIE = "camctl_token"

_KINDS = {
    ".exr": "image/x-exr",
    ".json": "application/json",
    ".png": "image/png",
    ".tiff": "image/tiff",
}
"""Files of a capture that are handed over, by suffix, and their media types."""

_PART_BYTES = 1 << 20
"""Bytes of a file that are read at a time."""

_GUESS_S = 0.5
"""Wrong tokens are refused one at a time, after this time each, s: two guesses a second in all."""


def _hashes(element: bytes) -> str:
    """Return the sources of a Content-Security-Policy that allow these elements of the page."""
    found = re.findall(rb"<%b>(.*?)</%b>" % (element, element), _PAGE, re.DOTALL)
    return " ".join(f"'sha256-{b64encode(sha256(text).digest()).decode()}'" for text in found)


_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        f"default-src 'none'; script-src {_hashes(b'script')}; style-src {_hashes(b'style')}; "
        "img-src data: 'self'; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; "
        "form-action 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Sent with every answer: nothing is kept, framed, guessed or loaded from elsewhere."""


class WebPanel:
    """The panel; a context manager that serves the page while it is open.

    Args:
        address: ``PORT`` or ``HOST:PORT``; a host other than the loopback interface needs a token
        token: what a browser must know; None: the token in the environment, "": no token
    """

    def __init__(self, address: str = str(DEFAULT_PORT), *, token: str | None = None) -> None:
        found = _ADDRESS.fullmatch(address)
        if found is None or int(found["port"]) > 65535:
            raise UsageError(
                f"invalid address {address!r} of the panel web",
                hint="use web:8080 or web:HOST:8080",
            )
        self._host, self._port = (found["host"] or "127.0.0.1").strip("[]"), int(found["port"])
        self.token = os.environ.get(TOKEN_VARIABLE, "") if token is None else token
        if not self.token and not _is_loopback(self._host):
            raise UsageError(
                f"the panel web on {self._host} could be used by anybody",
                hint=f"set a token in {TOKEN_VARIABLE}, or leave the host out",
            )
        self.keys: queue.Queue[Key] = queue.Queue(64)
        self.changed = threading.Condition()
        self.version = 0
        self._screen: Screen | None = None
        self._picture = b""
        self._result: Path | None = None
        self.is_open = False
        self.guesses = threading.Lock()
        self._server: LimitedServer | None = None

    @property
    def url(self) -> str:
        host = f"[{self._host}]" if ":" in self._host else self._host
        port = self._port if self._server is None else self._server.server_address[1]
        return f"http://{host}:{port}/"

    def __enter__(self) -> Self:
        """Start the server and return the panel; raises `UsageError` where it cannot listen."""
        handler = type("Handler", (_Handler,), {"server_panel": self})
        try:
            self._server = LimitedServer((self._host, self._port), handler)
        except OSError as error:
            raise UsageError(
                f"cannot listen on {self._host}:{self._port}: {error.strerror}",
                hint="choose another port with web:PORT",
            ) from error
        self.is_open = True
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True
        ).start()
        needs = "?token=..." if self.token else ""
        print(f"the menu is at {self.url}{needs}", file=sys.stderr, flush=True)
        return self

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Stop the server."""
        server, self._server = self._server, None
        self.is_open = False
        with self.changed:
            self.changed.notify_all()
        if server is not None:
            server.shutdown()
            server.server_close()

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
            self.changed.wait_for(lambda: self.version != version or not self.is_open, _POLL_S)
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


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _Handler(BaseHTTPRequestHandler):
    """Answers one request; `server_panel` is the panel."""

    server: LimitedServer
    server_panel: WebPanel
    url: SplitResult
    protocol_version = "HTTP/1.1"
    timeout = 60
    # Header and body leave in one packet, at once: a second small packet would wait until the
    # browser acknowledges the first, which it delays by 40 ms.
    wbufsize = 1 << 20
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        """Answer the page, the next screen, or its picture."""
        if not self._is_allowed():
            return
        match self.url.path:
            case "/":
                self._answer(_PAGE, "text/html; charset=utf-8")
            case "/screen":
                after = parse_qs(self.url.query).get("after", ["0"])[0]
                known = int(after) if re.fullmatch(r"\d{1,18}", after, re.ASCII) else 0
                shown = self.server_panel.wait_for(known)
                self._answer(json.dumps(shown).encode(), "application/json")
            case path if path.startswith("/result/"):
                self._send_file(unquote(path.removeprefix("/result/")))
            case _:
                self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Take a key."""
        if not self._is_allowed():
            return
        # Pages of other sites cannot send this header without being allowed to.
        if self.headers.get("X-Camctl") is None:
            self._refuse(HTTPStatus.FORBIDDEN, "keys are taken from the page of the menu only")
            return
        name = self.url.path.removeprefix("/key/")
        if name not in _KEYS:
            self._refuse(HTTPStatus.NOT_FOUND, f"no key is called {name[:20]!r}")
            return
        try:
            self.server_panel.keys.put_nowait(_KEYS[name])
        except queue.Full:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many keys are waiting")
            return
        self._answer(b"", "text/plain")

    def _is_allowed(self) -> bool:
        """Return whether the request has the token, or comes to the loopback interface by name."""
        panel = self.server_panel
        self.server.note_request(self.connection)
        try:
            self.url = urlsplit(self.path)
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST, "the address or its host is invalid")
            return False
        if panel.token:
            given = parse_qs(self.url.query).get("token", [self._cookie()])[0]
            if hmac.compare_digest(given.encode(), panel.token.encode()):
                return True
            with panel.guesses:
                time.sleep(_GUESS_S if given else 0)
            self._refuse(
                HTTPStatus.FORBIDDEN, "the token is missing or wrong: open /?token=TOKEN once"
            )
            return False
        # A name that another site made point here would let its pages read the screen.
        if _is_loopback(host):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "open the page by the address 127.0.0.1")
        return False

    def _cookie(self) -> str:
        try:
            found = SimpleCookie(self.headers.get("Cookie", "")).get(_COOKIE)
        except CookieError:
            return ""
        return unquote(found.value) if found is not None else ""

    def _send_file(self, name: str) -> None:
        """Send a file of the result that was shown last."""
        try:
            file = self.server_panel.result_files()[name].open("rb")
        except (KeyError, OSError):
            self._refuse(HTTPStatus.NOT_FOUND, "the result has no such file")
            return
        with file:
            size = os.fstat(file.fileno()).st_size
            self._send_head(_KINDS[Path(name).suffix], size)
            # A file that grows meanwhile must not be mixed with the next answer.
            left = size
            while left and (part := file.read(min(left, _PART_BYTES))):
                self.wfile.write(part)
                left -= len(part)
            self.close_connection |= left > 0

    def _answer(
        self, data: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK, *, close: bool = False
    ) -> None:
        self._send_head(kind, len(data), status, close=close)
        self.wfile.write(data)

    def _send_head(
        self, kind: str, size: int, status: HTTPStatus = HTTPStatus.OK, *, close: bool = False
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if close:
            self.send_header("Connection", "close")
        token = self.server_panel.token
        if token and status is HTTPStatus.OK:
            cookie = f"{_COOKIE}={quote(token, safe='')}; HttpOnly; SameSite=Strict; Path=/"
            self.send_header("Set-Cookie", cookie)
        self.end_headers()

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        # What else the client sends on this connection is not read.
        self._answer(reason.encode(), "text/plain; charset=utf-8", status, close=True)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Print nothing: the terminal belongs to the user."""
