"""A headless Chromium by W3C WebDriver, for tests of pages."""

from __future__ import annotations

import json
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Call = Callable[..., Any]


@contextmanager
def browser(window: str) -> Iterator[Call]:
    """Yield a function that sends a command to a browser of its own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    driver = subprocess.Popen(["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL)

    def send(method: str, path: str, **data: object) -> Any:
        request = urllib.request.Request(
            f"http://127.0.0.1:{port}{path}",
            method=method,
            data=json.dumps(data).encode() if method == "POST" else None,
        )
        with urllib.request.urlopen(request, timeout=120) as answer:
            return json.load(answer)["value"]

    try:
        while True:
            try:
                send("GET", "/status")
                break
            except OSError:
                time.sleep(0.1)
        options = {"args": ["--headless=new", "--no-sandbox", "--disable-gpu", window]}
        wanted = {"alwaysMatch": {"goog:chromeOptions": options}}
        session = send("POST", "/session", capabilities=wanted)["sessionId"]
        yield lambda method, path, **data: send(method, f"/session/{session}/{path}", **data)
        send("DELETE", f"/session/{session}")
    finally:
        driver.terminate()
        driver.wait()
