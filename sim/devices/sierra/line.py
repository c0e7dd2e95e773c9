"""A serial line with a virtual camera at its far end: a pseudo-terminal or a device node."""

from __future__ import annotations

import os
import select
import termios
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from camctl.errors import CameraNotFoundError

_SPEEDS = {
    getattr(termios, f"B{speed}"): speed for speed in (9600, 19200, 38400, 57600, 115200, 230400)
}
_TICK_S = 0.05
_BITS_A_BYTE = 10  # start, eight, stop


class SerialLine:
    """Reads and writes bytes; what comes is handed to `received` by a thread of its own.

    Args:
        node: a device node (/dev/ttyGS0), or "pty": a new pseudo-terminal, whose host's end is
            `path` while it is open
        link: a symbolic link to keep at the host's end of a pseudo-terminal
        received: takes bytes
        tick: called every 50 ms or so

    Attributes:
        path: what the host opens; for a node, the node itself
    """

    def __init__(
        self,
        node: str,
        link: str | None,
        received: Callable[[bytes], None],
        tick: Callable[[], None],
    ) -> None:
        self.path = node
        self._node = node
        self._link = Path(link) if link else None
        self._received = received
        self._tick = tick
        self._file = self._hosts_end = -1
        self._thread: threading.Thread | None = None
        self._is_closing = threading.Event()

    @property
    def host_speed(self) -> int | None:
        """The speed that the host has set, where that can be known."""
        if self._hosts_end < 0:
            return None  # the far end of a real line cannot be asked
        with suppress(termios.error):
            return _SPEEDS.get(termios.tcgetattr(self._file)[5])
        return None

    def open(self) -> None:
        """Plug it in (CameraNotFoundError: the node cannot be opened)."""
        if self._node == "pty":
            self._file, self._hosts_end = os.openpty()
            tty.setraw(self._hosts_end)
            self.path = os.ttyname(self._hosts_end)
            if self._link is not None:
                self._link.unlink(missing_ok=True)
                self._link.symlink_to(self.path)
        else:
            self._file = _opened(self._node)
        self._is_closing.clear()
        self._thread = threading.Thread(target=self._run, name="serial-line", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Pull the plug: the host's next read or write fails."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._is_closing.set()
        if thread is not threading.current_thread():
            thread.join()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        for file in (self._file, self._hosts_end):
            if file >= 0:
                os.close(file)
        self._file = self._hosts_end = -1

    def send(self, data: bytes, speed: int = 0) -> None:
        """Write bytes; at `speed` bits a second, or as fast as it takes them (0).

        What a host does not take for a second is lost, as on a line without handshake.
        """
        rest = memoryview(data)
        last = time.monotonic()
        while rest and not self._is_closing.is_set() and self._file >= 0:
            _, writable, _ = select.select([], [self._file], [], _TICK_S)
            if writable:
                try:
                    sent = os.write(self._file, rest[:256])
                except OSError:
                    return  # nobody there
                rest, last = rest[sent:], time.monotonic()
                if speed:
                    time.sleep(sent * _BITS_A_BYTE / speed)
            elif time.monotonic() - last > 1.0:
                return

    def _run(self) -> None:
        while not self._is_closing.is_set():
            readable, _, _ = select.select([self._file], [], [], _TICK_S)
            if readable:
                try:
                    data = os.read(self._file, 4096)
                except OSError:  # the far end is not there yet, or no more
                    data = b""
                if data:
                    self._received(data)
                else:
                    time.sleep(_TICK_S)
            self._tick()


def _opened(node: str) -> int:
    try:
        file = os.open(node, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise CameraNotFoundError(
            f"a virtual camera's line {node}: {error.strerror}", hint="is its driver loaded?"
        ) from error
    try:
        tty.setraw(file)
    except termios.error as error:
        os.close(file)
        raise CameraNotFoundError(
            f"a virtual camera's line {node} is no terminal", hint="give a serial node, or pty"
        ) from error
    return file
