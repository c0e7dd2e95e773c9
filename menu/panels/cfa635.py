"""The Crystalfontz CFA635: 20 x 4 characters, six keys and four lights, at a serial port."""

from __future__ import annotations

import os
from collections import deque
from typing import Any, Self

from camctl.errors import UsageError
from camctl.interface.clock import Clock, RealClock
from camctl.menu.layout import grid
from camctl.menu.panels.cfa635_packets import (
    BACKLIGHT,
    CLEAR,
    ERROR,
    KEY_ACTIVITY,
    KEY_REPORTING,
    LED,
    RESPONSE,
    TEXT,
    Packet,
    PacketReader,
)
from camctl.menu.ports import Key, Mood, PanelDisconnectedError, Screen
from camctl.system.interrupts import uninterrupted

try:
    from termios import error as TermiosError  # noqa: N812  an exception class
except ImportError:  # not a POSIX system: pyserial raises its own errors alone
    TermiosError = OSError  # type: ignore[assignment,misc]  # the same use, in except clauses

COLUMNS, ROWS = 20, 4  # characters

_ANSWER_S = 0.25
"""The panel answers within this time, s, or the packet was lost; its data sheet states 0.25 s."""
_ALL_KEYS = 0x3F  # a bit for each of six
_BRIGHT = 100  # per cent
_ANYONE_HOME_S = 2.0
"""Interval in which a panel that has nothing to show is asked whether it is there, s."""

_KEYS = (Key.UP, Key.DOWN, Key.LEFT, Key.RIGHT, Key.ENTER, Key.EXIT)
_LIGHTS = {Mood.READY: (0, 100), Mood.BUSY: (60, 100), Mood.ERROR: (100, 0)}
"""(red, green) of the lights, percent."""
_FIRST_LIGHT, _LIGHT_COUNT = 5, 4  # outputs from 5 on are lights


class Cfa635Panel:
    """The panel at a serial port; a context manager.

    A packet that is lost or damaged is sent again.  A panel that does not answer at all has been
    unplugged: `PanelDisconnectedError`.

    Args:
        url: the serial port, or any URL of pyserial
        clock: the clock of its time limits
    """

    def __init__(self, url: str, *, clock: Clock | None = None) -> None:
        self._url = url
        self._clock = clock or RealClock()
        self._port: Any = None
        self._reader = PacketReader()
        self._keys: deque[Key] = deque()
        self._shown: list[str] = []
        self._lights: tuple[int, int] | None = None
        self._is_dark = False
        self._last_answer_s = 0.0

    def __enter__(self) -> Self:
        """Open the port, clear the display, and return the panel.

        Raises:
            UsageError: no URL that pyserial knows
            PanelDisconnectedError: nothing is there, or something that does not answer
        """
        import serial

        try:
            self._port = serial.serial_for_url(self._url, 115200, timeout=0, write_timeout=1)
        except ValueError as error:
            raise UsageError(
                f"invalid serial port {self._url!r}", hint="use cfa635:/dev/ttyUSB0"
            ) from error
        except (OSError, TermiosError, serial.SerialException) as error:
            raise PanelDisconnectedError(
                f"cannot open the panel at {self._url}: {_reason(error)}",
                hint="connect it, and allow the user to open it (group dialout)",
            ) from error
        try:
            self._reader = PacketReader()
            self._shown, self._lights, self._is_dark = [" " * COLUMNS] * ROWS, None, False
            self._request(Packet(CLEAR))
            self._request(Packet(KEY_REPORTING, bytes((_ALL_KEYS, 0))))
            self._request(Packet(BACKLIGHT, bytes((_BRIGHT,))))
        except BaseException:
            self._close()
            raise
        return self

    @uninterrupted
    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Clear the display, switch the lights off, and close the port."""
        if self._port is not None and kind is not PanelDisconnectedError:
            try:
                self._set_lights((0, 0))
                self._request(Packet(CLEAR))
            except PanelDisconnectedError:
                pass  # it shows nothing any more
        self._close()

    def show(self, screen: Screen) -> int:
        """Write the rows that differ, and set the lights; return the last offset."""
        shown = grid(screen, COLUMNS, ROWS)
        for row, line in enumerate(shown.lines):
            if line != self._shown[row]:
                text = line.encode("ascii", "replace")
                self._request(Packet(TEXT, bytes((0, row)) + text))
                self._shown[row] = line
        self._set_lights((0, 0) if screen.is_dark else _LIGHTS[screen.mood])
        if screen.is_dark != self._is_dark:
            self._request(Packet(BACKLIGHT, bytes((0 if screen.is_dark else _BRIGHT,))))
            self._is_dark = screen.is_dark
        return shown.last_offset

    def key(self, timeout_s: float) -> Key | None:
        if not self._keys:
            self._receive(timeout_s)
        if self._clock.now() - self._last_answer_s > _ANYONE_HOME_S:
            self._request(Packet(KEY_REPORTING, bytes((_ALL_KEYS, 0))))
        return self._keys.popleft() if self._keys else None

    def _set_lights(self, lights: tuple[int, int]) -> None:
        """Set all lights to (red, green), percent; each light has one output for each colour."""
        if lights == self._lights:
            return
        for light in range(_LIGHT_COUNT):
            for colour, percent in enumerate(reversed(lights)):  # green comes first
                output = _FIRST_LIGHT + 2 * light + colour
                self._request(Packet(LED, bytes((output, percent))))
        self._lights = lights

    def _request(self, packet: Packet) -> None:
        """Send a packet until it is answered.

        Raises:
            PanelDisconnectedError: it was not answered
        """
        for _ in range(5):  # a packet or its answer may be lost
            self._guarded(lambda: self._port.write(packet.encoded()))
            deadline_s = self._clock.now() + _ANSWER_S
            while (left_s := deadline_s - self._clock.now()) > 0:
                for answer in self._receive(left_s):
                    kind, command = answer.command & 0xC0, answer.command & 0x3F
                    if command == packet.command and kind in (RESPONSE, ERROR):
                        self._last_answer_s = self._clock.now()
                        return
            self._reader.give_up()
        raise PanelDisconnectedError(
            f"the panel at {self._url} does not answer",
            hint="check its cable and its power, and that it is a CFA635",
        )

    def _receive(self, timeout_s: float) -> list[Packet]:
        """Wait for bytes; return the packets but for keys, which are kept."""
        # This asks the port for its settings, which fails once it is gone.
        self._guarded(lambda: setattr(self._port, "timeout", timeout_s))
        data = self._guarded(lambda: self._port.read(1))
        data += self._guarded(lambda: self._port.read(self._port.in_waiting) if data else b"")
        packets = []
        for packet in self._reader.feed(data):
            if packet.command == KEY_ACTIVITY and len(packet.data) == 1:
                if 1 <= packet.data[0] <= len(_KEYS):  # others are keys that are released
                    self._keys.append(_KEYS[packet.data[0] - 1])
            else:
                packets.append(packet)
        return packets

    def _guarded(self, act: Any) -> Any:
        """Call `act`; turn what pyserial raises for a port that is gone into the panel's error."""
        import serial

        try:
            return act()
        except (OSError, TermiosError, serial.SerialException) as error:
            raise PanelDisconnectedError(
                f"the panel at {self._url} was disconnected: {_reason(error)}",
                hint="connect it again",
            ) from error

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()


def _reason(error: Exception) -> str:
    """Return the reason in the words of the system; pyserial wraps it in its own."""
    if isinstance(number := getattr(error, "errno", None), int):
        return os.strerror(number)
    if isinstance(error.__context__, TermiosError):
        return "it is no serial port"
    return str(error).splitlines()[0]
