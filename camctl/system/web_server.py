"""A small server of HTTP: few connections, a token for all but this computer, safe headers."""

from __future__ import annotations

import hmac
import ipaddress
import math
import os
import re
import socket
import sys
import threading
import time
from base64 import b64encode
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, BinaryIO, Self
from urllib.parse import SplitResult, parse_qs, quote, unquote, urlsplit

from camctl.errors import UsageError
from camctl.system.interrupts import uninterrupted

DEFAULT_PORT = 8080  # http-alt (IANA)

_ADDRESS = re.compile(r"(?:(?P<host>[^:]+|\[[0-9a-fA-F:]+\]):)?(?P<port>\d{1,5})", re.ASCII)
_COOKIE = "camctl_token"

_GUESS_S = 0.5
"""Wrong tokens are refused one at a time, after this time each, s: two guesses a second in all."""

LEAST_TOKEN = math.ceil(math.log2(10 * 365.25 * 86400 / _GUESS_S / 1e-6) / 4)
"""Characters of a token: 13 random hexadecimal digits, of 4 bits each, are found with a probability
of 1e-6 by somebody who guesses for ten years, without a pause."""

MOST_CONNECTIONS = 32
"""A browser opens six connections at most; a new one ends the one that is silent for longest."""

_CLIENT_ERRORS = {
    HTTPStatus.NOT_IMPLEMENTED: HTTPStatus.METHOD_NOT_ALLOWED,
    HTTPStatus.HTTP_VERSION_NOT_SUPPORTED: HTTPStatus.BAD_REQUEST,
}
"""What http.server calls errors of its own: the client's request is wrong."""

_PART_BYTES = 1 << 20
"""Bytes of a file that are read at a time."""


class LimitedServer(ThreadingHTTPServer):
    """A thread for each connection, at most `MOST_CONNECTIONS`."""

    daemon_threads = True
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._used: dict[Any, float] = {}  # socket: time of its last request
        self._lock = threading.Lock()
        super().__init__(address, handler)

    def note_request(self, connection: Any) -> None:
        """Count `connection` as the one used last."""
        with self._lock:
            if connection in self._used:
                self._used[connection] = time.monotonic()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a new connection, instead of the one unused for longest where there are many."""
        with self._lock:
            if len(self._used) >= MOST_CONNECTIONS:
                oldest = min(self._used, key=self._used.__getitem__)
                del self._used[oldest]
                with suppress(OSError):  # it has ended by itself
                    oldest.shutdown(socket.SHUT_RDWR)
            self._used[request] = time.monotonic()
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock:
            self._used.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that have gone; everything else is a defect, and printed."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


@dataclass
class Site:
    """What a server serves, and who may see it.

    Attributes:
        address: ``PORT`` or ``HOST:PORT``
        token: what a browser must know; "": only this computer may see it; None: what the
            environment variable has
        variable: of the environment, in which the token is set
        name: what its port follows where it is given: ``web:`` in ``web:8080``
        what: the server in messages
        page: the page whose scripts and styles may run; others may not
        has_files: scripts and styles that the server sends as files may run, too, and scripts may
            make pictures
        is_open: whoever reaches it may use it: its protocol has no tokens

    Raises:
        UsageError: an invalid address, a host that others reach without a token, or a token that
            can be guessed
    """

    address: str
    token: str | None
    variable: str
    name: str
    what: str
    page: bytes
    has_files: bool = False
    is_open: bool = False
    host: str = field(init=False)
    port: int = field(init=False)
    headers: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        if self.token is None:
            self.token = os.environ.get(self.variable, "")
        found = _ADDRESS.fullmatch(self.address)
        if found is None or int(found["port"]) > 65535:
            raise UsageError(
                f"invalid address {self.address!r} of {self.what}",
                hint=f"use {self.name}8080 or {self.name}HOST:8080",
            )
        self.host, self.port = (found["host"] or "127.0.0.1").strip("[]"), int(found["port"])
        if not (self.token or self.is_open or is_loopback(self.host)):
            raise UsageError(
                f"{self.what} on {self.host} could be used by anybody",
                hint=f"set a token in {self.variable}, or leave the host out",
            )
        _check_token(self.token, self.variable)
        self.headers = _headers(self.page, has_files=self.has_files)
        self.guesses = threading.Lock()
        self._server: LimitedServer | None = None

    @property
    def url(self) -> str:
        """The address of the page."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.served_port}/"

    @property
    def served_port(self) -> int:
        """The port that is listened on, also where 0 was asked for."""
        return self.port if self._server is None else int(self._server.server_address[1])

    @property
    def shown_url(self) -> str:
        """The same, with a note that the token is needed."""
        return f"{self.url}{'?token=...' if self.token else ''}"

    def start(self, handler: type[SiteHandler], **attributes: Any) -> Self:
        """Serve in a thread of its own.

        Args:
            handler: answers requests
            attributes: of a handler

        Raises:
            UsageError: the address cannot be used
        """
        kind = type("Handler", (handler,), {"site": self, **attributes})
        try:
            self._server = LimitedServer((self.host, self.port), kind)
        except OSError as error:
            raise UsageError(
                f"cannot listen on {self.host}:{self.port}: {error.strerror}",
                hint=f"choose another port with {self.name}PORT",
            ) from error
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True
        ).start()
        return self

    @uninterrupted
    def stop(self) -> None:
        """Stop serving."""
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()


def _check_token(token: str, variable: str) -> None:
    """Raise `UsageError` for a token that can be guessed, or that no browser can send."""
    hint = f"openssl rand -hex {(LEAST_TOKEN + 1) // 2} prints one"
    if token and len(token) < LEAST_TOKEN:
        what = f"the token in {variable} is so short that it can be guessed"
        raise UsageError(what, hint=f"take {LEAST_TOKEN} characters or more: {hint}")
    try:
        token.encode()
    except UnicodeEncodeError:
        raise UsageError(f"the token in {variable} is no text in UTF-8", hint=hint) from None


def is_loopback(host: str) -> bool:
    """Return whether a host is this computer."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _own_names(host: str) -> tuple[str, ...]:
    """Return the names by which others may ask for this computer: no other site has them."""
    name = socket.gethostname()
    with suppress(ValueError):
        ipaddress.ip_address(host)
        return (host,)
    return name, f"{name}.local"


def _headers(page: bytes, *, has_files: bool) -> dict[str, str]:
    """Return what is sent with every answer: nothing is kept, framed or loaded from elsewhere."""

    def hashes(element: bytes) -> str:
        """Return the sources of a Content-Security-Policy that allow elements of the page."""
        found = re.findall(rb"<%b>(.*?)</%b>" % (element, element), page, re.DOTALL)
        allowed = ["'self'"] if has_files else []
        allowed += (f"'sha256-{b64encode(sha256(text).digest()).decode()}'" for text in found)
        return " ".join(allowed)

    return {
        "Cache-Control": "no-store",
        "Content-Security-Policy": (
            f"default-src 'none'; script-src {hashes(b'script')}; style-src {hashes(b'style')}; "
            f"img-src data: {'blob: ' if has_files else ''}'self'; connect-src 'self'; "
            "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        ),
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
    }


class SiteHandler(BaseHTTPRequestHandler):
    """Answers one request; a subclass has `do_GET`, which begins with `is_allowed`.

    Attributes:
        url: the address in the request
        length: bytes of its body
    """

    server: LimitedServer
    site: Site
    url: SplitResult
    length: int
    protocol_version = "HTTP/1.1"
    default_request_version = "HTTP/1.0"  # to older ones no headers would be sent
    server_version, sys_version = "camctl", ""
    timeout = 60
    # Header and body leave in one packet, at once: a second small packet would wait until the
    # browser acknowledges the first, which it delays by 40 ms.
    wbufsize = 1 << 20
    disable_nagle_algorithm = True

    def is_allowed(self) -> bool:
        """Return whether the request has the token, or comes to the loopback interface by name."""
        site = self.site
        self.server.note_request(self.connection)
        try:
            host = self._read_head()
        except ValueError as error:
            self.refuse(HTTPStatus.BAD_REQUEST, str(error))
            return False
        # A body that nobody reads is no next request.
        self._is_last = self.close_connection
        self.close_connection |= self.length > 0
        if not self._is_of_this_site():
            self.refuse(HTTPStatus.FORBIDDEN, "a page of another site asks for this")
            return False
        if site.token:
            given = parse_qs(self.url.query).get("token", [self._cookie()])[0]
            if hmac.compare_digest(given.encode(), site.token.encode()):
                return True
            with site.guesses:
                time.sleep(_GUESS_S if given else 0)
            self.refuse(
                HTTPStatus.FORBIDDEN, "the token is missing or wrong: open /?token=TOKEN once"
            )
            return False
        # A name that another site made point here would let its pages read the screen.
        if is_loopback(host) or (site.is_open and host in (site.host, *_own_names(host))):
            return True
        self.refuse(HTTPStatus.FORBIDDEN, "open the page by the address 127.0.0.1")
        return False

    def _read_head(self) -> str:
        """Read address and length; return the host; raises `ValueError` for what is ambiguous."""
        if self.headers.defects:
            raise ValueError("a line of the head is invalid")
        for name in ("Host", "Origin", "Content-Length"):
            if len(self.headers.get_all(name, ())) > 1:
                raise ValueError(f"{name} is given twice")
        length = self.headers.get("Content-Length", "0")
        if "Transfer-Encoding" in self.headers or not re.fullmatch(r"\d{1,15}", length, re.ASCII):
            raise ValueError("the length of the request is not given in bytes")
        self.length = int(length)
        try:
            self.url = urlsplit(self.path)
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        except ValueError:
            raise ValueError("the address or its host is invalid") from None
        if self.url.netloc or not self.path.startswith("/"):
            raise ValueError("the address does not begin with a slash")
        return host

    def _is_of_this_site(self) -> bool:
        """Return whether a browser that says which site sent the request says this one."""
        origin = self.headers.get("Origin")
        scheme, _, host = (origin or "").partition("://")
        return origin is None or (
            scheme in ("http", "https") and host.lower() == self.headers.get("Host", "").lower()
        )

    def read_body(self) -> bytes:
        """Return the body of the request; another request may follow it."""
        data = self.rfile.read(self.length)
        self.close_connection = self._is_last
        return data

    def is_from_page(self, reason: str) -> bool:
        """Return whether the page itself sent the request; else it is refused with `reason`.

        Pages of other sites cannot send this header without being allowed to.
        """
        if self.headers.get("X-Camctl") is not None:
            return True
        self.refuse(HTTPStatus.FORBIDDEN, reason)
        return False

    @property
    def known_version(self) -> int:
        """The version that the browser has, ``?after=VERSION``; 0: none."""
        after = parse_qs(self.url.query).get("after", [""])[0]
        return int(after) if re.fullmatch(r"\d{1,18}", after, re.ASCII) else 0

    def _cookie(self) -> str:
        try:
            found = SimpleCookie(self.headers.get("Cookie", "")).get(_COOKIE)
        except CookieError:
            return ""
        return unquote(found.value) if found is not None else ""

    def answer(
        self, data: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK, *, close: bool = False
    ) -> None:
        """Send data of a media type."""
        self.send_head(kind, len(data), status, close=close)
        if self.command != "HEAD":
            self.wfile.write(data)

    def send_file(
        self, file: BinaryIO, kind: str, *, more: Mapping[str, str] | None = None
    ) -> None:
        """Send an open file of a media type."""
        # A file that grows meanwhile must not be mixed with the next answer.
        left = os.fstat(file.fileno()).st_size
        self.send_head(kind, left, more=more)
        while left and (part := file.read(min(left, _PART_BYTES))):
            self.wfile.write(part)
            left -= len(part)
        self.close_connection |= left > 0

    def send_head(
        self,
        kind: str,
        size: int | None,
        status: HTTPStatus = HTTPStatus.OK,
        *,
        close: bool = False,
        more: Mapping[str, str] | None = None,
    ) -> None:
        """Send the header of an answer and `more`; without a `size` it ends with the connection."""
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if size is not None:
            self.send_header("Content-Length", str(size))
        for name, value in (more or {}).items():
            self.send_header(name, value)
        if close or size is None or self.close_connection:
            self.send_header("Connection", "close")
        token = self.site.token
        if token and status is HTTPStatus.OK:
            cookie = f"{_COOKIE}={quote(token, safe='')}; HttpOnly; SameSite=Strict; Path=/"
            self.send_header("Set-Cookie", cookie)
        self.end_headers()

    def refuse(self, status: HTTPStatus, reason: str) -> None:
        """Refuse a request; what else the client sends on this connection is not read."""
        self.answer(reason.encode(), "text/plain; charset=utf-8", status, close=True)

    def end_headers(self) -> None:
        """End the header of any answer, also of those that http.server sends, with the site's."""
        for name, value in self.site.headers.items():
            self.send_header(name, value)
        super().end_headers()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse in one line what http.server cannot read or has no method for."""
        status = _CLIENT_ERRORS.get(HTTPStatus(code), HTTPStatus(code))
        self.refuse(status, status.phrase.lower())

    def handle_expect_100(self) -> bool:
        """Ask for the body of a request, at once."""
        self.send_response_only(HTTPStatus.CONTINUE)
        super().end_headers()
        self.wfile.flush()
        return True

    def log_message(self, format: str, *arguments: Any) -> None:
        """Print nothing: the terminal belongs to the user."""
