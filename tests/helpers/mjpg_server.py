"""A network camera: Motion JPEG over HTTP, from the standard library's server.

The address holds the exposure: ``/video?us=1000`` gives frames of 1,000 us.  Each pixel of the
scene has its own light; the frames are grey or colour JPEG files of quality 100.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlparse

import cv2
import numpy as np
from numpy.typing import NDArray

SHAPE = (48, 64)
#: Levels of 8 bits for each microsecond.
LIGHT = np.linspace(0.002, 0.1, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
_MIDDLE_US = 1000.0


def picture(exposure_us: float) -> NDArray[np.uint8]:
    """Return the picture of an exposure, in colour, before compression."""
    grey = np.minimum(np.rint(LIGHT * exposure_us), 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


class NetworkCamera(ThreadingHTTPServer):
    """The server.

    Attributes:
        requested: exposure times of the connections, us
        frames: of a connection, until it ends; None: without end
        is_silent: True: it accepts connections and sends nothing more
        old: frames of each connection that still have the exposure of the connection before
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.requested: list[float] = []
        self.frames: int | None = None
        self.is_silent = False
        self.old = 0
        self.stopped = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/video"


class _Handler(BaseHTTPRequestHandler):
    server: NetworkCamera

    def do_GET(self) -> None:
        camera = self.server
        query = parse_qs(urlparse(self.path).query)
        exposure_us = float(query.get("us", [str(_MIDDLE_US)])[0])
        before_us = camera.requested[-1] if camera.requested else exposure_us
        camera.requested.append(exposure_us)
        if not self.path.startswith("/video"):
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        number = 0
        try:
            while camera.frames is None or number < camera.frames:
                while camera.is_silent and not camera.stopped.wait(0.05):
                    pass
                if camera.stopped.wait(0.002):
                    return
                exposure = before_us if number < camera.old else exposure_us
                data = cv2.imencode(".jpg", picture(exposure), [cv2.IMWRITE_JPEG_QUALITY, 100])[1]
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data.tobytes() + b"\r\n")
                number += 1
        except OSError:
            return

    def log_message(self, format: str, *arguments: object) -> None:
        """Print nothing."""


@contextmanager
def network_camera() -> Iterator[NetworkCamera]:
    """Run a network camera."""
    with NetworkCamera() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.stopped.set()
            server.shutdown()
            thread.join()
