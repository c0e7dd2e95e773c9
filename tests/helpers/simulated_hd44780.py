"""An HD44780 behind a PCF8574 on an I2C bus, from the two data sheets alone."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence

BYTE_S = 22.5e-6
"""Nine clock periods at 400 kHz, the fastest that the bus may be."""
EXECUTION_S = 37e-6
CLEAR_S = 1.52e-3
# How the module connects the PCF8574's outputs.
RS, RW, E, LIGHT = 0x01, 0x02, 0x04, 0x08
LINE_BYTES, SECOND_LINE = 40, 0x40
ROM_A00 = {0x5C: "¥", 0x7E: "→", 0x7F: "←"}
"""Codes of the common character memory that are not ASCII (table 4)."""


class SimulatedHd44780:
    """The bus, as `smbus2.SMBus`; what the display shows is `rows`.

    What is sent while the chip is busy is lost, as on the device.

    Args:
        now: the time, s; the bytes on the bus take time beside it

    Attributes:
        is_there: False: nothing acknowledges
        lost: number of instructions that came while the chip was busy
    """

    def __init__(self, now: Callable[[], float], at: int = 0x27) -> None:
        self._now, self._at = now, at
        self.is_there = True
        self.lost = 0
        self._bus_s = 0.0
        self.power_up()

    def power_up(self) -> None:
        """Set everything as after power."""
        self._outputs = 0xFF
        self._busy_until_s = 0.0
        self._is_four_bit = False
        self._upper: int | None = None
        self._ddram, self._cgram = bytearray(b" " * 0x80), bytearray(64)
        self._address, self._is_cgram = 0, False
        self._is_two_lines, self.is_on, self._step = False, False, 1

    # The bus.

    def write_byte(self, at: int, value: int) -> None:
        self._receive(at, [value])

    def write_i2c_block_data(self, at: int, first: int, data: Sequence[int]) -> None:
        assert len(data) <= 32, "SMBus has no longer blocks"
        self._receive(at, [first, *data])

    def read_byte(self, at: int) -> int:
        self._acknowledge(at)
        return self._outputs

    def close(self) -> None:
        """Do nothing."""

    def _acknowledge(self, at: int) -> None:
        if at != self._at or not self.is_there:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")

    def _receive(self, at: int, data: Sequence[int]) -> None:
        self._acknowledge(at)
        self._bus_s += BYTE_S  # the address
        for value in data:
            self._bus_s += BYTE_S
            was, self._outputs = self._outputs, value
            if was & E and not value & E and not value & RW:
                self._latch(value)

    # The chip.

    def _latch(self, outputs: int) -> None:
        """Read the four upper data lines; without a lower half the chip's lower four are open."""
        half = outputs >> 4
        if not self._is_four_bit:
            self._execute(half << 4, bool(outputs & RS))
        elif self._upper is None:
            self._upper = half
        else:
            value, self._upper = self._upper << 4 | half, None
            self._execute(value, bool(outputs & RS))

    def _execute(self, value: int, is_data: bool) -> None:
        time_s = self._now() + self._bus_s
        if time_s < self._busy_until_s:
            self.lost += 1
            return
        self._busy_until_s = time_s + (CLEAR_S if not is_data and value < 4 else EXECUTION_S)
        if is_data:
            (self._cgram if self._is_cgram else self._ddram)[self._address] = value
            self._advance()
        else:
            self._command(value)

    def _command(self, value: int) -> None:
        """Do an instruction of table 6, known by its highest bit."""
        match value.bit_length():
            case 8:
                self._address, self._is_cgram = value & 0x7F, False
            case 7:
                self._address, self._is_cgram = value & 0x3F, True
            case 6:
                was_four_bit, self._is_four_bit = self._is_four_bit, not value & 0x10
                self._upper = None
                if was_four_bit or not self._is_four_bit:
                    self._is_two_lines = bool(value & 0x08)
            case 4:
                self.is_on = bool(value & 0x04)
            case 3:
                self._step = 1 if value & 0x02 else -1
            case 2:
                self._address, self._is_cgram = 0, False
            case 1:
                self._ddram[:] = b" " * len(self._ddram)
                self._address, self._is_cgram, self._step = 0, False, 1

    def _advance(self) -> None:
        if self._is_cgram:
            self._address = (self._address + self._step) % 64
            return
        self._address += self._step
        if self._address == LINE_BYTES:
            self._address = SECOND_LINE
        elif self._address == SECOND_LINE + LINE_BYTES:
            self._address = 0

    @property
    def has_light(self) -> bool:
        """Whether the back light is on."""
        return bool(self._outputs & LIGHT)

    def codes(self, columns: int, rows: int) -> list[bytes]:
        """Return the codes of the characters of a display of this size."""
        assert self.is_on
        assert self._is_two_lines
        starts = (0, SECOND_LINE, columns, SECOND_LINE + columns)[:rows]
        return [bytes(self._ddram[start : start + columns]) for start in starts]

    def rows(self, columns: int, rows: int) -> list[str]:
        """Return the text; custom glyphs are "?"."""
        return [
            "".join("?" if code < 16 else ROM_A00.get(code, chr(code)) for code in line)
            for line in self.codes(columns, rows)
        ]

    def dots(self, code: int) -> tuple[str, ...]:
        """Return the eight rows of a custom glyph, five dots each."""
        rows = self._cgram[8 * (code & 7) :][:8]
        return tuple(f"{row & 0x1F:05b}".replace("0", ".").replace("1", "#") for row in rows)
