"""What a browser asks of a page of camctl."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Mapping


def ask_site(
    url: str, *, body: bytes | None = None, headers: Mapping[str, str] | None = None
) -> tuple[int, bytes]:
    """Return (status, content) of a request; with a body it is sent by POST."""
    request = urllib.request.Request(url, data=body, headers=dict(headers or {}))
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()
