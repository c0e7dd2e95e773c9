"""Each screen as a PNG file, for tests and documentation; keys come from a list of words."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Self

from camctl.errors import StorageError, UsageError
from camctl.interface.clock import Clock, RealClock
from camctl.menu.drawing import SMALLEST, draw
from camctl.menu.ports import Key, Screen
from camctl.system.files import make_folder, storage_error, write_bytes
from camctl.system.picture_operations import png

DEFAULT_SIZE = (480, 320)
"""(columns, rows) of the pictures, pixels."""

_ADDRESS = re.compile(r"(?P<folder>.+?)(?:,(?P<columns>\d{1,5})x(?P<rows>\d{1,5}))?", re.ASCII)


class ImagePanel:
    """Writes screen-0001.png, screen-0002.png, ... into a folder.

    Args:
        address: the folder, and a size after a comma: ``pictures,240x240``
        keys: the keys that it presses, one after the other; None: a pause of one look for a key
        clock: what it waits for keys with
    """

    def __init__(
        self, address: str, keys: Iterable[Key | None] = (), *, clock: Clock | None = None
    ) -> None:
        found = _ADDRESS.fullmatch(address)
        if found is None:
            raise UsageError(
                f"invalid address {address!r} of the panel image",
                hint="give a folder and a size, such as pictures,480x320",
            )
        self.folder = Path(found["folder"])
        self.size = DEFAULT_SIZE
        if found["columns"] is not None:
            self.size = (int(found["columns"]), int(found["rows"]))
        if self.size[0] < SMALLEST[0] or self.size[1] < SMALLEST[1]:
            raise UsageError(
                f"a picture of {self.size[0]} x {self.size[1]} pixels is too small for the menu",
                hint=f"use {SMALLEST[0]}x{SMALLEST[1]} or more",
            )
        self._keys = iter(keys)
        self._clock = clock or RealClock()
        self.count = 0

    def __enter__(self) -> Self:
        """Make the folder and return the panel; raises `StorageError`."""
        try:
            make_folder(self.folder)
        except OSError as error:
            found = storage_error(self.folder, error)
            raise StorageError(found.what, hint=found.hint) from error  # -o is the captures' folder
        if not self.folder.is_dir():
            raise StorageError(f"{self.folder} is no folder", hint="choose another one")
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: all pictures are written."""

    def show(self, screen: Screen) -> int:
        """Write the next picture; return its last offset."""
        drawing = draw(screen, *self.size)
        self.count += 1
        write_bytes(self.folder / f"screen-{self.count:04d}.png", png(drawing.pixels))
        return drawing.last_offset

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key of the list; None, after `timeout_s`, once there is none."""
        key = next(self._keys, None) if timeout_s else None
        if key is None:
            self._clock.sleep_until(self._clock.now() + timeout_s)
        return key
