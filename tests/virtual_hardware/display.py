"""The host's side of the guest with a display: QEMU's keyboard, and pictures of its screen."""

from __future__ import annotations

import socket
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PROMPT = b"(qemu) "


def devices(out: Path) -> tuple[str, ...]:
    """Return the words for QEMU that add a display, and its monitor at `out`/monitor."""
    return ("-device", "bochs-display", "-monitor", f"unix:{out}/monitor,server,nowait")


class Display:
    """Obeys the lines of `display_in_guest` and compares what the display shows.

    Args:
        out: the folder /guest_out of the guest

    Attributes:
        compared: names of the pictures that were taken
        wrong: how a picture differs, one line each
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._monitor: socket.socket | None = None
        self.compared: list[str] = []
        self.wrong: list[str] = []

    def obey(self, line: str) -> bool:
        """Do what a line of the guest asks for; return whether it asks for anything."""
        match line.split():
            case ["press", key]:
                self._command(f"sendkey {key}")
            case ["picture", name]:
                self._command(f"screendump {self._out}/{name}.ppm")
                self._compare(name)
                (self._out / f"{name}.done").touch()
            case _:
                return False
        return True

    def _command(self, text: str) -> None:
        """Give a command to QEMU's monitor and wait until it is done."""
        if self._monitor is None:
            self._monitor = socket.socket(socket.AF_UNIX)
            self._monitor.connect(str(self._out / "monitor"))
            self._read_to_prompt()
        self._monitor.sendall(text.encode() + b"\n")
        self._read_to_prompt()

    def _read_to_prompt(self) -> None:
        assert self._monitor is not None
        answer = b""
        while not answer.endswith(PROMPT):
            more = self._monitor.recv(4096)
            assert more, "QEMU has ended"
            answer += more

    def _compare(self, name: str) -> None:
        shown = read_ppm(self._out / f"{name}.ppm")
        wanted = np.load(self._out / f"{name}.npy")
        self.compared.append(name)
        if shown.shape != wanted.shape:
            self.wrong.append(f"{name}: {shown.shape} instead of {wanted.shape}")
        elif differing := int((shown != wanted).any(axis=2).sum()):
            self.wrong.append(f"{name}: {differing} pixels differ")


def read_ppm(path: Path) -> NDArray[np.uint8]:
    """Return the picture of a binary PPM file as QEMU writes it, (rows, columns, 3)."""
    kind, size, most, data = path.read_bytes().split(b"\n", 3)
    assert (kind, most) == (b"P6", b"255")
    columns, rows = map(int, size.split())
    return np.frombuffer(data, np.uint8).reshape(rows, columns, 3)
