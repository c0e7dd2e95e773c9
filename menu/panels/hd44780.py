"""Character displays with an HD44780, 16 x 2 or 20 x 4, behind a PCF8574 on I2C."""

from __future__ import annotations

import os
import unicodedata
from typing import Any, Self

from camctl.errors import UsageError
from camctl.interface.clock import Clock
from camctl.menu.layout import SMALLEST, grid
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.keyed import KEY_OPTIONS, KeyedPanel, keys_of
from camctl.menu.ports import PanelDisconnectedError, Screen
from camctl.system.interrupts import uninterrupted

_TEXT, _READ, _ENABLE, _LIGHT = 0x01, 0x02, 0x04, 0x08
"""Outputs of the PCF8574: register select (1: text), read, enable, back light; data in the upper
four.  All modules that are sold for these displays are wired so."""

_CLEAR, _ENTRY_MODE, _DISPLAY_ON, _FUNCTION_SET = 0x01, 0x06, 0x0C, 0x28
"""Commands, data sheet table 6: clear; cursor moves right; display on without cursor; four data
lines, two lines of text, 5 x 8 dots."""

_SET_GLYPHS, _SET_PLACE = 0x40, 0x80
"""Commands that have an address in the lower bits: of the custom glyphs, and of the text."""

_START_S = ((0x3, 0.0041), (0x3, 0.0001), (0x3, 0.0001), (0x2, 0.0001))
"""Half bytes that set four data lines from any state, and the waits after them, s (figure 24)."""

_POWER_S, _CLEAR_S = 0.05, 0.002
"""After power the chip needs 40 ms, and 1.52 ms to clear (table 6, 270 kHz), s."""

_MOST_BYTES = 32
"""Data of an SMBus block write, bytes: the bus makes each byte at least 22 us long (400 kHz), and
the chip needs 37 us for a character, which takes four."""

_LOOK_S = 2.0
"""Interval in which a display that has nothing to show is asked whether it is there, s."""

GLYPHS = {
    "\\": (0x00, 0x10, 0x08, 0x04, 0x02, 0x01, 0x00, 0x00),
    "~": (0x00, 0x00, 0x08, 0x15, 0x02, 0x00, 0x00, 0x00),
    "µ": (0x00, 0x11, 0x11, 0x11, 0x13, 0x1D, 0x10, 0x10),
    "°": (0x0C, 0x12, 0x12, 0x0C, 0x00, 0x00, 0x00, 0x00),
    "é": (0x02, 0x04, 0x0E, 0x11, 0x1F, 0x10, 0x0E, 0x00),
    "×": (0x00, 0x00, 0x11, 0x0A, 0x04, 0x0A, 0x11, 0x00),
    "±": (0x04, 0x04, 0x1F, 0x04, 0x04, 0x00, 0x1F, 0x00),
    "…": (0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x15, 0x00),
}
"""Characters that the chip's memory lacks, or has at other places in its two versions (A00 has a
yen sign for the backslash and an arrow for the tilde); eight glyphs can be loaded."""


def encoded(text: str) -> bytes:
    r"""Return text in the characters of the chip; an accent that it lacks is left out.

    >>> encoded("a\\b é ä €")
    b'a\x08b \x0c a ?'
    """
    codes = {character: 8 + index for index, character in enumerate(GLYPHS)}
    found = bytearray()
    for character in text:
        plain = unicodedata.normalize("NFKD", character)[0]
        found.append(codes.get(character) or (ord(plain) if " " <= plain <= "}" else ord("?")))
    return bytes(found)


class Hd44780Panel(KeyedPanel):
    """The display on an I2C bus, with keys of GPIO lines or input devices; a context manager.

    A display that does not acknowledge has been unplugged: `PanelDisconnectedError`.  One that was
    without power meanwhile is started again.

    Args:
        address: the bus, and options: ``/dev/i2c-1,at=0x27,size=20x4``, and those of
            `camctl.menu.panels.keyed`
        clock: the clock of its waits
        bus: an open bus, as `smbus2.SMBus`; None: the one of `address` is opened
    """

    def __init__(
        self, address: str = "/dev/i2c-1", *, clock: Clock | None = None, bus: Any = None
    ) -> None:
        parsed = parse_address(address, ("at", "size", *KEY_OPTIONS))
        self._path = parsed.words[0]
        self._at = parsed.number("at", 0x27)
        self._columns, self._rows = parsed.size(SMALLEST)
        if not 0x03 <= self._at <= 0x77 or self._columns * self._rows > 80 or self._rows > 4:
            raise UsageError(
                f"no HD44780 of {self._columns} x {self._rows} characters at {self._at:#x}",
                hint="use at=0x20 to 0x27 or 0x38 to 0x3F, size=16x2, 20x2, 16x4, 20x4 or 40x2",
            )
        super().__init__(keys_of(parsed), clock)
        self._given_bus = bus
        self._bus: Any = None
        self._written: list[bytes] = []
        self._light = _LIGHT
        self._asked_s = 0.0

    def __enter__(self) -> Self:
        """Open the bus, start the display, and return the panel.

        Raises:
            UsageError: smbus2 is not installed
            PanelDisconnectedError: the bus is not there, or the display does not acknowledge
        """
        self._bus = self._given_bus or self._open_bus()
        try:
            self._start()
        except BaseException:
            self._close()
            raise
        return self

    @uninterrupted
    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Clear the display, switch its light off, and close the bus."""
        if kind is not PanelDisconnectedError and self._bus is not None:
            try:
                self._light = 0
                self._command(_CLEAR)
            except PanelDisconnectedError:
                pass  # it shows nothing any more
        self._close()

    def _open_bus(self) -> Any:
        try:
            import smbus2
        except ImportError as error:
            raise UsageError(
                "the panel hd44780 needs smbus2", hint="pip install 'camctl[hd44780]'"
            ) from error
        try:
            return smbus2.SMBus(self._path)
        except OSError as error:
            hint = "switch I2C on (raspi-config, or dtparam=i2c_arm=on), or name another bus"
            if isinstance(error, PermissionError):
                hint = "add the user to the group i2c, or run as root"
            raise PanelDisconnectedError(
                f"cannot open {self._path}: {os.strerror(error.errno or 0)}", hint=hint
            ) from error

    def _start(self) -> None:
        """Set the display up from any state, load the glyphs, and clear it."""
        self._light = _LIGHT
        self._send(bytes((self._light,)))
        self._wait(_POWER_S)
        for half, wait_s in _START_S:
            self._send(_pulses(half << 4, self._light))
            self._wait(wait_s)
        for command in (_FUNCTION_SET, _DISPLAY_ON, _ENTRY_MODE, _SET_GLYPHS):
            self._command(command)
        self._text(bytes(line for glyph in GLYPHS.values() for line in glyph))
        self._command(_CLEAR)
        self._wait(_CLEAR_S)
        self._written = [b" " * self._columns] * self._rows

    def _draw(self, screen: Screen) -> int:
        """Write the rows that differ, and set the light; return the last offset."""
        shown = grid(screen, self._columns, self._rows)
        light = 0 if screen.is_dark else _LIGHT
        if light != self._light:
            self._light = light
            self._send(bytes((light,)))
        for row, line in enumerate(shown.lines):
            text = encoded(line)
            if text != self._written[row]:
                # The chip has two lines; the third and fourth row are the ends of these.
                place = 0x40 * (row % 2) + self._columns * (row // 2)
                self._command(_SET_PLACE | place)
                self._text(text)
                self._written[row] = text
        return shown.last_offset

    def _check(self) -> None:
        """Ask the display whether it is there, and start it again where it was without power."""
        now_s = self._clock.now()
        if now_s - self._asked_s < _LOOK_S:
            return
        outputs = self._guarded(lambda: self._bus.read_byte(self._at))
        self._asked_s = now_s
        if outputs & _ENABLE:  # all outputs are high after power, and this one is low otherwise
            self._start()
            if self._shown is not None:
                self.show(self._shown)

    def _command(self, command: int) -> None:
        self._send(_byte(command, self._light))

    def _text(self, text: bytes) -> None:
        self._send(b"".join(_byte(each, self._light | _TEXT) for each in text))

    def _send(self, outputs: bytes) -> None:
        """Set the outputs of the PCF8574, one after the other."""
        for first in range(0, len(outputs), _MOST_BYTES + 1):
            head, *rest = outputs[first : first + _MOST_BYTES + 1]
            if rest:
                self._guarded(lambda h=head, r=rest: self._bus.write_i2c_block_data(self._at, h, r))
            else:
                self._guarded(lambda h=head: self._bus.write_byte(self._at, h))
        self._asked_s = self._clock.now()

    def _guarded(self, act: Any) -> Any:
        """Call `act`; turn an error of the bus into that of a panel that is gone."""
        try:
            return act()
        except OSError as error:
            raise PanelDisconnectedError(
                f"no display answers at {self._at:#x} of {self._path}: "
                f"{os.strerror(error.errno or 0)}",
                hint="check its four wires and its address (i2cdetect -y 1)",
            ) from error

    def _wait(self, wait_s: float) -> None:
        self._clock.sleep_until(self._clock.now() + wait_s)

    def _close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None and bus is not self._given_bus:
            bus.close()
        self._keys.close()


def _byte(value: int, control: int) -> bytes:
    """Return the outputs that transfer a byte, its upper half first."""
    return _pulses(value & 0xF0, control) + _pulses(value << 4 & 0xF0, control)


def _pulses(data: int, control: int) -> bytes:
    """Return the outputs that transfer half a byte: the chip reads it as enable falls."""
    return bytes((data | control | _ENABLE, data | control))
