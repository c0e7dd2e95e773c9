"""A simulated CFA635 on a pseudo-terminal, with damaged and lost packets.

It is written from the data sheet, apart from the panel's own code: the CRC comes from a table, and
the parser is a state machine over single bytes.
"""

from __future__ import annotations

import os
import pty
import random
import select
import threading
import tty
from collections.abc import Callable
from typing import Self

COLUMNS, ROWS = 20, 4
KEYS = ("up", "down", "left", "right", "enter", "exit")


def _table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = (value >> 1) ^ 0x8408 if value & 1 else value >> 1
        table.append(value)
    return table


_CRC = _table()


def checksum(data: bytes) -> bytes:
    """Return the two bytes at the end of a packet."""
    value = 0xFFFF
    for byte in data:
        value = (value >> 8) ^ _CRC[(value ^ byte) & 0xFF]
    return (~value & 0xFFFF).to_bytes(2, "little")


class User(threading.Thread):
    """Somebody at the panel, who starts at once; `finish` raises what went wrong with them.

    An exception that ends a thread would fail the test that happens to run then.
    """

    def __init__(self, act: Callable[[], None]) -> None:
        super().__init__(daemon=True)
        self._act = act
        self._error: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            self._act()
        except BaseException as error:
            self._error = error

    def finish(self) -> None:
        """Wait until they have done everything."""
        self.join()
        if self._error is not None:
            raise self._error


class VirtualCfa635:
    """The device; `path` is its serial port.

    Args:
        loss: share of the packets of either direction that are lost
        damage: share of them in which a byte is changed
        seed: of both
    """

    def __init__(self, *, loss: float = 0.0, damage: float = 0.0, seed: int = 0) -> None:
        self._random = random.Random(seed)
        self._loss, self._damage = loss, damage
        self.cells = [bytearray(b" " * COLUMNS) for _ in range(ROWS)]
        self.outputs: dict[int, int] = {}
        self.backlight = 0
        self.commands: list[int] = []
        self.changed = threading.Condition()
        self._begin()

    def _begin(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._end_reader, self._end = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Take the device off its port."""
        if self._thread.is_alive():
            os.write(self._end, b"x")
            self._thread.join()
            for descriptor in (self._master, self._slave, self._end, self._end_reader):
                os.close(descriptor)

    def plug_in(self) -> None:
        """Connect the device again, after a power cycle, at another port."""
        self.cells = [bytearray(b" " * COLUMNS) for _ in range(ROWS)]
        self.outputs.clear()
        self._begin()

    def lines(self) -> list[str]:
        """Return what the display shows."""
        with self.changed:
            return [row.decode("ascii") for row in self.cells]

    def wait_for(self, text: str, timeout_s: float = 60.0) -> None:
        """Wait until the display shows `text`."""
        with self.changed:
            shown = self.changed.wait_for(
                lambda: text in " ".join(row.decode() for row in self.cells), timeout_s
            )
            assert shown, f"no {text!r} on {self.cells}"

    def lights(self) -> tuple[int, int]:
        """Return (red, green) of the first light."""
        return self.outputs.get(6, -1), self.outputs.get(5, -1)

    def press(self, key: str) -> None:
        """Press and release a key; its reports are never lost, as the person would repeat them."""
        code = KEYS.index(key) + 1
        for report in (code, code + 6):
            os.write(self._master, self._packet(0x80, bytes((report,))))

    def _serve(self) -> None:
        pending = bytearray()
        while True:
            # A pause ends a packet that was damaged in its length.
            ready, _, _ = select.select([self._master, self._end_reader], [], [], 0.05)
            if self._end_reader in ready:
                return
            if not ready:
                del pending[:1]
            else:
                pending += os.read(self._master, 4096)
            self._take(pending)

    def _take(self, pending: bytearray) -> None:
        while len(pending) >= 2:
            command, length = pending[0], pending[1]
            if length > 22 or command > 0x3F:
                del pending[0]
                continue
            if len(pending) < length + 4:
                return
            packet = bytes(pending[: length + 4])
            if checksum(packet[:-2]) != packet[-2:]:
                del pending[0]
                continue
            del pending[: length + 4]
            if self._random.random() >= self._loss:
                self._obey(command, packet[2:-2])

    def _obey(self, command: int, data: bytes) -> None:
        kind = 0x40
        with self.changed:
            self.commands.append(command)
            match command, len(data):
                case 0x06, 0:
                    self.cells = [bytearray(b" " * COLUMNS) for _ in range(ROWS)]
                case 0x0E, 1 | 2:
                    self.backlight = data[0]
                case 0x1F, _ if len(data) > 2 and data[0] < COLUMNS and data[1] < ROWS:
                    text = data[2:][: COLUMNS - data[0]]
                    self.cells[data[1]][data[0] : data[0] + len(text)] = text
                case 0x22, 2 if data[0] <= 12 and data[1] <= 100:
                    self.outputs[data[0]] = data[1]
                case 0x17, 2:
                    pass
                case 0x00, _ if len(data) <= 16:
                    self._answer(0x40, data)
                    return
                case 0x01, 0:
                    self._answer(0x41, b"CFA635:h1.0,v1.0")
                    return
                case _:
                    kind = 0xC0
            self.changed.notify_all()
        self._answer(kind | command, b"")

    def _answer(self, command: int, data: bytes) -> None:
        packet = bytearray(self._packet(command, data))
        if self._random.random() < self._loss:
            return
        if self._random.random() < self._damage:
            packet[self._random.randrange(len(packet))] ^= 1 << self._random.randrange(8)
        os.write(self._master, packet)

    def _packet(self, command: int, data: bytes) -> bytes:
        body = bytes((command, len(data))) + data
        return body + checksum(body)
