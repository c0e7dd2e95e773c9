"""The live picture in a page, and as MJPEG for programs that read that from a network.

Without a token the server listens on the loopback interface only, as the panel of the menu does.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np

from camctl.exposure.light import SHOWN_STOPS, counts_in_stops
from camctl.interface.controls import ExposureControls
from camctl.livestream.display import Display
from camctl.livestream.planning import Look
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Live
from camctl.messages.plain import sentence
from camctl.system.picture_operations import jpeg, required_opencv
from camctl.system.web_server import DEFAULT_PORT, Site, SiteHandler

TOKEN_VARIABLE = "CAMCTL_LIVE_TOKEN"

_PAGE = Path(__file__).with_name("live.html").read_bytes()
_BOUNDARY = "camctl"
#: Longest side of the picture, pixels: a page shows no more of it.
PAGE_PIXELS = 1280
#: Quality of its JPEG files, 1 to 100.
_QUALITY = 85
#: How long a reader waits for the next picture before it sends the last one again, s.
_SILENCE_S = 5.0
#: Results whose rate is stated.
_RATED = 30


def live_site(address: str = str(DEFAULT_PORT), token: str | None = None) -> Site:
    """Return what is served of a live camera.

    Args:
        address: ``PORT`` or ``HOST:PORT``
        token: what a browser must know; None: the token in the environment

    Raises:
        UsageError: see `Site`
    """
    return Site(address, token, TOKEN_VARIABLE, "http:", "the live page", _PAGE)


class WebOutput:
    """A server of the page, the stream and the numbers of a live camera.

    Args:
        live: the stream whose results are written
        site: see `live_site`
        display: makes the pictures

    Raises:
        UsageError: an address that cannot be used, or no OpenCV
    """

    def __init__(self, live: Live, site: Site, display: Display | None = None) -> None:
        required_opencv("a live picture in a page")
        self._live = live
        self._display = display or Display(most=PAGE_PIXELS)
        self._times: deque[float] = deque(maxlen=_RATED)
        self.changed = threading.Condition()
        self.version = 0
        self.jpeg = b""
        self.is_open = True
        self._result: LiveResult | None = None
        self._numbers: dict[str, Any] = {}
        self.viewers = 0  # requests that want pictures
        self.site = site
        self.site.start(_Handler, output=self)

    def write(self, result: LiveResult) -> None:
        """Show a result; the picture is compressed only where somebody looks."""
        self._times.append(result.time_s)
        data = b""
        if self.viewers or not self.jpeg:
            data = jpeg(self._display.picture(result), _QUALITY)
        with self.changed:
            self._numbers = self._state(result)
            if data:
                self.version += 1
                self.jpeg = data
                self.changed.notify_all()

    def close(self) -> None:
        """Stop serving."""
        self.is_open = False
        with self.changed:
            self.changed.notify_all()
        self.site.stop()

    @contextmanager
    def viewed(self) -> Iterator[int]:
        """Have results compressed; gives the version of the last picture, which may be old."""
        with self.changed:
            self.viewers += 1
            known = self.version
        try:
            yield known
        finally:
            with self.changed:
                self.viewers -= 1

    def picture(self, known: int, patience_s: float) -> tuple[int, bytes]:
        """Wait for another version than the known one; return version and picture of the last."""
        with self.changed:
            self.changed.wait_for(lambda: self.version != known or not self.is_open, patience_s)
            return self.version, self.jpeg

    def newest(self) -> bytes | None:
        """Wait for the next result and return its picture; None: there is none."""
        with self.viewed() as known:
            version, picture = self.picture(known, _SILENCE_S + 1 / self._live.planner.fps)
        return None if version == known else picture

    def state(self) -> dict[str, Any]:
        """Return the numbers of the last result, for JSON."""
        with self.changed:
            return {**self._numbers, "waiting": self._live.is_waiting, "lost": self._live.lost}

    def _state(self, result: LiveResult) -> dict[str, Any]:
        controls = self._live.controls
        seen = Look.at(result.sum, result.layout, result.tables)
        counts = counts_in_stops(seen.irradiance, seen.shares, SHOWN_STOPS)
        span = self._times[-1] - self._times[0]
        desired = result.plan.desired
        return {
            "number": result.number,
            "results_per_second": (len(self._times) - 1) / span if span > 0 else None,
            "age_s": result.age_s,
            "latency_s": result.latency_s,
            "response": result.plan.response,
            "dynamic_range": result.plan.dynamic_range,
            "first_stop": float(SHOWN_STOPS[0]),
            "last_stop": float(SHOWN_STOPS[-1]),
            "histogram": counts.tolist(),
            "range_stops": [float(np.log2(max(desired.e_min, 2.0 ** SHOWN_STOPS[0]))), 0.0],
            "dark": seen.dark,
            "clipped": seen.clipped,
            "exposures": _exposures(result, controls),
            "findings": [sentence(each) for each in result.findings],
        }


def _exposures(result: LiveResult, controls: ExposureControls) -> list[dict[str, Any]]:
    """Return the exposures of a cycle, and the light that each of them shows, in stops."""
    base = min(controls.exposure(each) for each in result.plan.settings)
    lowest = float(controls.levels.levels[0])
    return [
        {
            "time_s": each.setting.time_s,
            "gain": each.setting.gain,
            "age_s": each.age_s,
            "old": each.is_old,
            "stops": np.log2([lowest * base / each.exposure, base / each.exposure]).tolist(),
        }
        for each in sorted(result.exposures, key=lambda each: each.exposure)
    ]


class _Handler(SiteHandler):
    """Answers one request; `output` has what is shown."""

    output: WebOutput

    def do_GET(self) -> None:
        """Answer the page, the stream, one picture, or the numbers."""
        if not self.is_allowed():
            return
        match self.url.path:
            case "/":
                self.answer(_PAGE, "text/html; charset=utf-8")
            case "/state":
                self.answer(json.dumps(self.output.state()).encode(), "application/json")
            case "/picture.jpg":
                picture = self.output.newest()
                if picture is None:
                    self.refuse(HTTPStatus.SERVICE_UNAVAILABLE, "the camera sends no pictures")
                else:
                    self.answer(picture, "image/jpeg")
            case "/video":
                self._stream()
            case _:
                self.refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def _stream(self) -> None:
        """Send pictures as they come until the reader is gone."""
        output = self.output
        self.close_connection = True
        self.send_head(f"multipart/x-mixed-replace; boundary={_BOUNDARY}", None)
        with output.viewed() as sent:
            while output.is_open:
                sent, picture = output.picture(sent, _SILENCE_S)
                self.server.note_request(self.connection)
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: "
                self.wfile.write(f"{head}{len(picture)}\r\n\r\n".encode() + picture + b"\r\n")
                self.wfile.flush()
