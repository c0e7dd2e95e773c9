"""A server of HTTP whose number of connections is limited."""

from __future__ import annotations

import socket
import sys
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

MOST_CONNECTIONS = 32
"""A browser opens six connections at most; a new one ends the one that is silent for longest."""


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
