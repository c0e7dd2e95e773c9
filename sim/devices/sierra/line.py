"""Serial lines with a virtual camera at one end and a host at the other: terminals."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from camctl.errors import CameraNotFoundError

_SPEEDS = {
    getattr(termios, f"B{speed}"): speed for speed in (9600, 19200, 38400, 57600, 115200, 230400)
}
_POLL_S = 0.05  # how often a thread looks whether it is to end
BITS_A_BYTE = 10  # start, eight, stop
BYTES_AT_ONCE = 256  # of a line with a speed
_UNREAD_S = 1.0  # after so long, bytes that the host does not read are lost


class Line(Protocol):
    """A serial line with a host at its other end.

    Attributes:
        path: the port's name or URL that the host opens
    """

    path: str

    @property
    def host_speed(self) -> int | None:
        """The speed that the host has set, bits a second; None where it cannot be known."""

    def open(self) -> None:
        """Open the camera's end (CameraNotFoundError: it cannot be opened)."""

    def close(self) -> None:
        """Close the camera's end: the host's next read or write fails."""

    def send(self, data: bytes, speed: int = 0) -> None:
        """Send bytes to the host at `speed` bits a second, or at once (0)."""


class TerminalLine(Line):
    """A pseudo-terminal or a device node; a thread reads what the host sends.

    Args:
        node: a device node (/dev/ttyGS0), or "pty": a new pseudo-terminal, whose host's end is
            `path` while it is open
        link: a symbolic link to keep at the host's end of a pseudo-terminal
        received: called with the bytes that the host sends
    """

    def __init__(self, node: str, link: str | None, received: Callable[[bytes], None]) -> None:
        self.path = node
        self._node = node
        self._link = Path(link) if link else None
        self._received = received
        self._file = self._host_end = -1
        self._thread: threading.Thread | None = None
        self._is_closing = threading.Event()

    @property
    def host_speed(self) -> int | None:
        """The speed of a pseudo-terminal; the other end of a device node cannot be asked."""
        if self._host_end < 0:
            return None
        with suppress(termios.error):
            return _SPEEDS.get(termios.tcgetattr(self._file)[5])
        return None

    def open(self) -> None:
        if self._node == "pty":
            self._file, self._host_end = os.openpty()
            tty.setraw(self._host_end)
            self.path = os.ttyname(self._host_end)
            if self._link is not None:
                self._link.unlink(missing_ok=True)
                self._link.symlink_to(self.path)
        else:
            self._file = _opened(self._node)
        self._is_closing.clear()
        self._thread = threading.Thread(target=self._run, name="serial-line", daemon=True)
        self._thread.start()

    def close(self) -> None:
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._is_closing.set()
        if thread is not threading.current_thread():
            thread.join()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        for file in (self._file, self._host_end):
            if file >= 0:
                os.close(file)
        self._file = self._host_end = -1

    def send(self, data: bytes, speed: int = 0) -> None:
        """Send bytes to the host; see `Line.send`.

        Bytes that the host does not read for a second are lost, as on a line without handshake.
        """
        rest = memoryview(data)
        unread_s = 0.0
        while rest and unread_s < _UNREAD_S and not self._is_closing.is_set() and self._file >= 0:
            _, writable, _ = select.select([], [self._file], [], _POLL_S)
            if not writable:
                unread_s += _POLL_S
                continue
            try:
                sent = os.write(self._file, rest[:BYTES_AT_ONCE])
            except OSError:
                return  # no host is there
            rest, unread_s = rest[sent:], 0.0
            if speed:
                self._is_closing.wait(sent * BITS_A_BYTE / speed)

    def _run(self) -> None:
        while not self._is_closing.is_set():
            readable, _, _ = select.select([self._file], [], [], _POLL_S)
            if not readable:
                continue
            try:
                data = os.read(self._file, 4096)
            except OSError:  # no host has opened the other end, or it has closed it
                data = b""
            if data:
                self._received(data)
            else:
                self._is_closing.wait(_POLL_S)


def _opened(node: str) -> int:
    try:
        file = os.open(node, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise CameraNotFoundError(
            f"cannot open the virtual camera's line {node}: {error.strerror}",
            hint="load the driver of that node, or use the line pty",
        ) from error
    try:
        tty.setraw(file)
    except termios.error as error:
        os.close(file)
        raise CameraNotFoundError(
            f"the virtual camera's line {node} is not a terminal",
            hint="give a serial node, or pty",
        ) from error
    return file
