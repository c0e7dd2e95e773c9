"""The web panel: page, screens, keys, and who may use it."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request
from base64 import b64decode
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import quote

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from site_client import ask_site

from camctl.errors import UsageError
from camctl.menu.drawing import draw
from camctl.menu.panels.web import SIZE, WebPanel
from camctl.menu.ports import Key, Line, Screen
from camctl.system.picture_operations import png
from camctl.system.web_server import LEAST_TOKEN

SCREEN = Screen(Line(("Ready",)), lines=(Line(("one",)),), actions=("Set",))


@pytest.fixture
def panel() -> Iterator[WebPanel]:
    with WebPanel("0", token="") as opened:
        opened.show(SCREEN)
        yield opened


def ask(
    panel: WebPanel, path: str, *, post: bool = False, headers: dict[str, str] | None = None
) -> tuple[int, bytes]:
    """Return (status, content) of a request."""
    return ask_site(panel.url + path, body=b"" if post else None, headers=headers)


def press(panel: WebPanel, key: str, **headers: str) -> tuple[int, bytes]:
    """Send a key as the page does."""
    return ask(panel, f"key/{key}", post=True, headers={"X-Camctl": "1", **headers})


def test_page_and_screen_are_served(panel: WebPanel) -> None:
    status, page = ask(panel, "")
    assert (status, b"<html" in page) == (200, True)
    status, answer = ask(panel, "screen?after=0")
    shown = json.loads(answer)
    assert shown["version"] == 1
    assert shown["lines"][:2] == ["Ready", "one"]
    assert b64decode(shown["picture"]) == png(draw(SCREEN, *SIZE).pixels)


def test_keys_arrive_in_their_order(panel: WebPanel) -> None:
    for key in ("up", "down", "left", "right", "enter", "exit"):
        assert press(panel, key)[0] == 200
    assert [panel.key(1) for _ in range(6)] == list(Key)
    assert panel.key(0) is None


def test_unknown_key_is_refused(panel: WebPanel) -> None:
    assert press(panel, "fire") == (404, b"no key is called 'fire'")
    assert panel.key(0) is None


def test_page_of_another_site_cannot_press_keys(panel: WebPanel) -> None:
    assert ask(panel, "key/enter", post=True)[0] == 403
    assert press(panel, "enter", Host="evil.example")[0] == 403
    assert ask(panel, "screen?after=0", headers={"Host": "evil.example"})[0] == 403
    assert panel.key(0) is None


def test_keys_that_nobody_takes_are_limited(panel: WebPanel) -> None:
    statuses = {press(panel, "up")[0] for _ in range(70)}
    assert statuses == {200, 503}


def test_request_for_the_next_screen_waits_for_it(panel: WebPanel) -> None:
    panel.show(SCREEN)
    assert json.loads(ask(panel, "screen?after=1")[1])["version"] == 2
    assert ask(panel, "nothing")[0] == 404


def test_token_is_needed_where_one_is_set() -> None:
    with WebPanel("0.0.0.0:0", token="s3cret-of-this-page") as panel:
        panel.show(SCREEN)
        refused = (403, b"the token is missing or wrong: open /?token=TOKEN once")
        assert ask(panel, "") == refused
        assert ask(panel, "?token=wrong") == refused
        assert press(panel, "enter") == refused
        assert ask(panel, "?token=s3cret-of-this-page")[0] == 200
        cookie = {"Cookie": "camctl_token=s3cret-of-this-page"}
        assert ask(panel, "screen?after=0", headers=cookie)[0] == 200
        assert press(panel, "enter", **cookie)[0] == 200
        assert ask(panel, "", headers={"Cookie": "camctl_token=\u00e9"})[0] == 403


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("0.0.0.0:8080", "could be used by anybody; set a token in CAMCTL_MENU_TOKEN"),
        ("example.org:80", "could be used by anybody"),
        ("x", "invalid address 'x' of the panel web; use web:8080"),
        ("99999", "invalid address"),
    ],
)
def test_address_that_cannot_be_used_is_refused(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        WebPanel(address, token="")


def test_port_in_use_is_one_line(panel: WebPanel) -> None:
    port = panel.url.rstrip("/").rpartition(":")[2]
    with pytest.raises(UsageError, match=rf"cannot listen on 127.0.0.1:{port}: .* choose another"):
        WebPanel(port, token="").__enter__()


def connect(panel: WebPanel) -> socket.socket:
    """Return a connection to the server."""
    host, _, port = panel.url.removeprefix("http://").rstrip("/").rpartition(":")
    return socket.create_connection((host, int(port)), timeout=60)


@pytest.mark.parametrize(
    "token",
    ["one with space", 'quote"and;semicolon', "caf\u00e9 \u0142 of town", "a%41+b and others"],
)
def test_a_token_may_hold_any_character(token: str) -> None:
    with WebPanel("0", token=token) as panel:
        panel.show(SCREEN)
        url = f"{panel.url}?token={quote(token)}"
        with urllib.request.urlopen(url, timeout=60) as answer:
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert ask(panel, "screen?after=0", headers={"Cookie": cookie})[0] == 200


def test_a_token_that_can_be_guessed_is_refused() -> None:
    """Two guesses a second for ten years find 13 hexadecimal digits once in a million times."""
    assert LEAST_TOKEN == 13
    assert 10 * 365.25 * 86400 * 2 / 16**LEAST_TOKEN < 1e-6 < 10 * 365.25 * 86400 * 2 / 16**12
    for address in ("0.0.0.0:8080", "8080"):
        WebPanel(address, token="c" * LEAST_TOKEN)
        for token in ("c", "c" * (LEAST_TOKEN - 1)):
            with pytest.raises(
                UsageError, match=r"in CAMCTL_MENU_TOKEN is so short .* take 13 characters"
            ):
                WebPanel(address, token=token)
    with pytest.raises(UsageError, match="is no text in UTF-8"):
        WebPanel("8080", token="\udcff" * LEAST_TOKEN)


def send(panel: WebPanel, request: bytes) -> bytes:
    """Return all that the server answers to these bytes."""
    with connect(panel) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(1 << 16), b""))


@pytest.mark.parametrize(
    ("status", "request_"),
    [
        (200, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        (200, b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\n\r\n"),
        (403, b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"),
        (404, b"GET /nothing HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        # What http.server refuses by itself.
        (405, b"BREW / HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        (405, b"HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        (431, b"GET / HTTP/1.1\r\nA: " + b"b" * 70_000 + b"\r\n\r\n"),
        (414, b"GET /" + b"b" * 70_000 + b" HTTP/1.1\r\n\r\n"),
        (400, b"GET / HTTP/9.9\r\n\r\n"),
        (400, b"GET\r\n\r\n"),
        (403, b"GET /\r\n\r\n"),  # HTTP/0.9
        (403, b"POST /key/enter HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n\r\n"),
        # What it takes.
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n"),
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: \xb2\r\n\r\n"),
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\n" + b"Content-Length: 0\r\n" * 2 + b"\r\n"),
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"),
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n"),
        (400, b"GET / HTTP/1.1\r\nHost: localhost\r\nno colon\r\n\r\n"),
        (400, b"GET http://localhost/ HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        (403, b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n"),
        (403, b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\n\r\n"),
        (403, b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost:1\r\n\r\n"),
    ],
)
def test_every_answer_has_the_headers_and_an_odd_request_is_refused_in_one_line(
    panel: WebPanel, status: int, request_: bytes
) -> None:
    answer = send(panel, request_)
    if b"Expect" in request_:
        asked, answer = answer[:25], answer[25:]
        assert asked == b"HTTP/1.1 100 Continue\r\n\r\n"
    head, _, content = answer.partition(b"\r\n\r\n")
    first, *lines = head.decode("ascii").split("\r\n")
    assert first.startswith(f"HTTP/1.1 {status} ")
    headers = dict(line.split(": ", 1) for line in lines)
    assert len(headers) == len(lines)  # none is there twice
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'; script-src 'sha256-" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"
    assert headers["Server"].strip() == "camctl"
    if status != 200:
        assert headers["Content-Type"].startswith("text/plain")
        assert headers["Connection"] == "close"
        assert b"\n" not in content
        assert len(content) == (0 if b"HEAD" in request_ else int(headers["Content-Length"]))


def test_the_body_of_a_request_is_no_next_request(panel: WebPanel) -> None:
    inner = b"GET /screen?after=0 HTTP/1.1\r\nHost: localhost\r\n\r\n"
    head = b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(inner)
    assert send(panel, head + inner).count(b"HTTP/1.1 ") == 1


def test_many_silent_clients_do_not_shut_the_others_out(panel: WebPanel) -> None:
    with ExitStack() as stack:
        for _ in range(40):  # more wait for a second in the kernel
            stack.enter_context(connect(panel)).sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert ask(panel, "screen?after=0")[0] == 200
        assert panel._site._server is not None
        assert len(panel._site._server._used) <= 32


HOSTILE = (
    b"GET /screen?after=" + b"9" * 5000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: [::1\r\n\r\n",
    b"GET //[::1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"POST /key/%00 HTTP/1.1\r\nHost: localhost\r\nX-Camctl: 1\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: localhost\r\nCookie: =;\x00;camctl_token\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"\x16\x03\x01\x02\x00",
)


@pytest.mark.parametrize("token", ["", "s3cret-of-this-page"])
def test_no_request_ends_in_a_traceback(token: str, capsys: pytest.CaptureFixture[str]) -> None:
    with WebPanel("0", token=token) as panel:
        panel.show(SCREEN)

        for request in HOSTILE:
            assert not send(panel, request).startswith(b"HTTP/1.1 5"), request

        @settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
        @given(st.binary(max_size=60), st.sampled_from([b"GET /", b"POST /key/", b""]))
        def any_request(rest: bytes, before: bytes) -> None:
            send(
                panel, before + rest + b" HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
            )

        any_request()
        headers = {"Cookie": f"camctl_token={token}"}
        assert ask(panel, "screen?after=0", headers=headers)[0] == 200
    assert "Traceback" not in capsys.readouterr().err


def test_the_last_result_is_shown_and_handed_over(panel: WebPanel, tmp_path: Path) -> None:
    large = bytes(range(256)) * 20_000  # several parts
    handed = {"picture.dng": b"dng", "picture.jpg": b"jpg", "preview.png": b"png"}
    handed["radiance.exr"] = large
    for name, data in {**handed, "notes.txt": b"no"}.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "frames").mkdir()
    panel.show(Screen(Line(("Done",)), folder=str(tmp_path)))
    panel.show(SCREEN)  # the result stays
    shown = json.loads(ask(panel, "screen?after=0")[1])
    assert (shown["result"], shown["files"]) == (tmp_path.name, [*handed])
    for name, data in handed.items():
        assert ask(panel, f"result/{name}") == (200, data)
    assert ask(panel, "result/preview.png?of=1") == (200, b"png")
    for other in ("notes.txt", "frames", "..%2Fpreview.png", "%2Fetc%2Fhostname", "", "sum.tiff"):
        assert ask(panel, f"result/{other}")[0] == 404
    (tmp_path / "preview.png").unlink()
    assert ask(panel, "result/preview.png")[0] == 404


def test_a_result_needs_the_token(tmp_path: Path) -> None:
    (tmp_path / "preview.png").write_bytes(b"png")
    with WebPanel("0", token="secret-of-this-page") as opened:
        opened.show(Screen(Line(("Done",)), folder=str(tmp_path)))
        assert ask(opened, "result/preview.png")[0] == 403
        assert ask(opened, "result/preview.png?token=secret-of-this-page") == (200, b"png")
