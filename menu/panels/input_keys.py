"""Keys of Linux input devices: keyboards, remote controls, and buttons at GPIO lines.

A device delivers `struct input_event` records (linux/input.h): 24 bytes with 64-bit times.
"""

from __future__ import annotations

import glob
import os
import select
import struct
from contextlib import suppress

from camctl.menu.ports import Key, Screen

_EVENT = struct.Struct("@llHHi")
"""Seconds and microseconds, type, code, value; 24 bytes on 64-bit systems."""

_PRESSED, _REPEATED = 1, 2  # values of an event of a key

_KEYS = {
    103: Key.UP,
    108: Key.DOWN,
    105: Key.LEFT,
    106: Key.RIGHT,
    28: Key.ENTER,  # KEY_ENTER
    96: Key.ENTER,  # KEY_KPENTER
    353: Key.ENTER,  # KEY_SELECT
    352: Key.ENTER,  # KEY_OK
    212: Key.ENTER,  # KEY_CAMERA
    1: Key.EXIT,  # KEY_ESC
    158: Key.EXIT,  # KEY_BACK
    174: Key.EXIT,  # KEY_EXIT
    14: Key.EXIT,  # KEY_BACKSPACE
}
"""Codes of linux/input-event-codes.h."""

_LOOK_S = 2.0
"""Interval in which new devices are looked for, s."""


class InputKeys:
    """The keys of all input devices that match a pattern; devices may come and go.

    Attributes:
        problem: why a device could not be opened; "" where all could
    """

    def __init__(self, pattern: str = "/dev/input/event*") -> None:
        self._pattern = pattern
        self._open: dict[str, int] = {}
        self._rest: dict[int, bytes] = {}
        self._next_look_s = float("-inf")
        self.problem = ""

    @property
    def is_open(self) -> bool:
        """Whether there is a device that keys can come from."""
        return bool(self._open)

    def shows(self, screen: Screen) -> None:
        """Do nothing: a device has a key for each of the menu's."""

    def close(self) -> None:
        for descriptor in self._open.values():
            os.close(descriptor)
        self._open.clear()
        self._rest.clear()
        self._next_look_s = float("-inf")

    def key(self, timeout_s: float, now_s: float) -> Key | None:
        """Return the next key; None after `timeout_s`, or at once where no device is open.

        `now_s` is the time, s.
        """
        if now_s >= self._next_look_s:
            self._look()
            self._next_look_s = now_s + _LOOK_S
        for descriptor in self._open.values():
            if (key := self._parsed(descriptor)) is not None:
                return key
        if not self._open:
            return None
        ready, _, _ = select.select(list(self._open.values()), [], [], timeout_s)
        for descriptor in ready:
            self._read(descriptor)
            if (key := self._parsed(descriptor)) is not None:
                return key
        return None

    def _look(self) -> None:
        """Open devices that have appeared."""
        self.problem = ""
        for path in glob.glob(self._pattern):  # noqa: PTH207  device patterns are absolute
            if path not in self._open:
                try:
                    self._open[path] = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
                except OSError as error:
                    hint = "check the device"
                    if isinstance(error, PermissionError):
                        hint = "add the user to the group input, or run as root"
                    self.problem = f"cannot read {path}: {error.strerror}; {hint}"

    def _read(self, descriptor: int) -> None:
        """Add what a device has sent; forget a device that is gone."""
        data = b""
        with suppress(BlockingIOError):
            try:
                data = os.read(descriptor, 64 * _EVENT.size)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._forget(descriptor)
                return
        self._rest[descriptor] = self._rest.get(descriptor, b"") + data

    def _forget(self, descriptor: int) -> None:
        os.close(descriptor)
        self._open = {path: each for path, each in self._open.items() if each != descriptor}
        self._rest.pop(descriptor, None)

    def _parsed(self, descriptor: int) -> Key | None:
        """Return the first key press among the records of a device."""
        rest = self._rest.get(descriptor, b"")
        while len(rest) >= _EVENT.size:
            _, _, kind, code, value = _EVENT.unpack_from(rest)
            rest = rest[_EVENT.size :]
            if kind == 1 and value in (_PRESSED, _REPEATED) and code in _KEYS:
                self._rest[descriptor] = rest
                # A key that is held down selects on, but does nothing twice.
                if value == _PRESSED or _KEYS[code] in (Key.UP, Key.DOWN):
                    return _KEYS[code]
        self._rest[descriptor] = rest
        return None
