"""Graphic displays at simulated buses, from the data sheets of their controllers alone."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

SSD1306_ARGUMENTS = {
    **{0x20: 1, 0x21: 2, 0x22: 2, 0x81: 1, 0x8D: 1, 0xA8: 1},
    **{0xD3: 1, 0xD5: 1, 0xD9: 1, 0xDA: 1, 0xDB: 1},
}
"""Bytes that follow a command (SSD1306 data sheet, table 9); others have none."""


class SimulatedSsd1306:
    """An SSD1306 of 128 x 64 pixels on an I2C bus, as `smbus2.SMBus`."""

    def __init__(self, at: int = 0x3C) -> None:
        self._at = at
        self.is_there, self.is_on = True, False
        self._memory = np.zeros((8, 128), np.uint8)
        self._pending: list[int] = []
        self._columns, self._pages, self._place = (0, 127), (0, 7), [0, 0]

    def write_i2c_block_data(self, at: int, control: int, data: Sequence[int]) -> None:
        self._receive(at, [control, *data])

    def i2c_rdwr(self, message: Any) -> None:
        self._receive(message.addr, list(message))

    def close(self) -> None:
        """Do nothing."""

    def _receive(self, at: int, data: list[int]) -> None:
        if at != self._at or not self.is_there:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        control, *rest = data
        assert control in (0x00, 0x40), "commands or data"
        for value in rest:
            (self._store if control else self._command)(value)

    def _command(self, value: int) -> None:
        self._pending.append(value)
        command, *arguments = self._pending
        if len(arguments) < SSD1306_ARGUMENTS.get(command, 0):
            return
        self._pending = []
        match command:
            case 0x20:
                assert arguments == [0], "horizontal addressing"
            case 0x21:
                self._columns = (arguments[0], arguments[1])
                self._place[1] = arguments[0]
            case 0x22:
                self._pages = (arguments[0], arguments[1])
                self._place[0] = arguments[0]
            case 0xAE | 0xAF:
                self.is_on = bool(command & 1)

    def _store(self, value: int) -> None:
        page, column = self._place
        self._memory[page, column] = value
        if column < self._columns[1]:
            self._place = [page, column + 1]
        else:
            last = page == self._pages[1]
            self._place = [self._pages[0] if last else page + 1, self._columns[0]]

    @property
    def pixels(self) -> NDArray[np.bool_]:
        """What is lit, (64, 128)."""
        bits = self._memory[:, None, :] >> np.arange(8)[None, :, None] & 1
        return bits.reshape(64, 128).astype(bool)


class SimulatedSt7789:
    """An ST7789 with 18 bits a pixel at an SPI bus, and the line that tells commands from data.

    `modules` has stand-ins for spidev and RPi.GPIO.
    """

    def __init__(self, data_line: int = 24) -> None:
        self._is_data, self._command = False, 0
        self._arguments: list[int] = []
        self._memory = np.zeros((320, 320, 3), np.uint8)
        self.is_on = self.is_there = True
        self.has_light = False
        self._window = (0, 0, 0, 0)
        self._data: list[int] = []

        def output(line: int, value: int) -> None:
            if line == data_line:
                self._is_data = bool(value)
            elif line == 18:
                self.has_light = bool(value)

        gpio: Any = ModuleType("RPi.GPIO")
        gpio.LOW, gpio.HIGH, gpio.OUT, gpio.BCM = 0, 1, "out", "bcm"
        gpio.setmode = gpio.setup = gpio.cleanup = lambda *_: None
        gpio.output = output
        package: Any = ModuleType("RPi")
        package.GPIO = gpio
        spidev: Any = ModuleType("spidev")
        spidev.SpiDev = lambda: SimpleNamespace(
            open=lambda port, device: None, writebytes=self._receive, close=lambda: None
        )
        self.modules = {"RPi": package, "RPi.GPIO": gpio, "spidev": spidev}

    def _receive(self, data: Iterable[int]) -> None:
        if not self.is_there:
            raise OSError(errno.EIO, "Input/output error")
        if self._is_data:
            self._arguments += data
        else:
            self._end_command()
            for command in data:
                self._command, self._arguments = command, []

    def _end_command(self) -> None:
        """Do the last command, whose arguments are complete."""
        given = self._arguments
        match self._command:
            case 0x28 | 0x10:
                self.is_on = False
            case 0x29 | 0x11:
                self.is_on = True
            case 0x3A:
                assert given[0] & 7 == 6, "18 bits a pixel"
            case 0x2A:
                self._window = (
                    given[0] << 8 | given[1],
                    given[2] << 8 | given[3],
                    *self._window[2:],
                )
            case 0x2B:
                self._window = (
                    *self._window[:2],
                    given[0] << 8 | given[1],
                    given[2] << 8 | given[3],
                )
            case 0x2C:
                left, right, top, bottom = self._window
                area = self._memory[top : bottom + 1, left : right + 1]
                area[:] = np.array(given, np.uint8).reshape(area.shape) & 0xFC
        self._command = 0

    def pixels(self, columns: int, rows: int) -> NDArray[np.uint8]:
        """What is shown, (rows, columns, 3), six bits a channel."""
        self._end_command()
        return self._memory[:rows, :columns].copy()
