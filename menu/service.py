"""Reports to the service manager: ready, alive, stopping, and the screen that is shown.

systemd passes the address of a datagram socket in NOTIFY_SOCKET, and the interval in which it
wants to hear from the service in WATCHDOG_USEC; see sd_notify(3).  Without them nothing is sent.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from contextlib import suppress


class ServiceNotifier:
    """Sends reports; one that cannot be sent is left out, since the menu works without it."""

    def __init__(self, now: Callable[[], float]) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._now = now
        self._interval_s = _watchdog_s() / 2
        self._next_s = now()
        self._status = ""

    def ready(self, status: str) -> None:
        """Report the screen that is shown; the first one means that the service is ready."""
        if status != self._status:
            first = "" if self._status else "READY=1\n"
            self._status = status
            self._send(f"{first}STATUS={status}")

    def alive(self) -> None:
        """Report that the loop runs, twice in each interval of the watchdog."""
        if self._interval_s and self._now() >= self._next_s:
            self._next_s = self._now() + self._interval_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the service ends."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as connection:
            connection.sendto(message.encode(), self._address)


def _watchdog_s() -> float:
    """Return the interval of the watchdog, s; 0 where there is none, or it is another process's."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0.0
    text = os.environ.get("WATCHDOG_USEC", "0")
    return int(text) / 1e6 if text.isascii() and text.isdigit() else 0.0
