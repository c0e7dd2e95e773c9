"""A display that the kernel drives (/dev/dri/card0), without X, Wayland or a frame buffer."""

from __future__ import annotations

from typing import Self

import numpy as np

from camctl.errors import CamctlError, UsageError
from camctl.interface.clock import Clock
from camctl.menu.drawing import SMALLEST, draw
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.drm_kernel import DrmDisplay
from camctl.menu.panels.keyed import KEY_OPTIONS, KeyedPanel, keys_of
from camctl.menu.ports import PanelDisconnectedError, Screen
from camctl.system.interrupts import uninterrupted


class DrmPanel(KeyedPanel):
    """A display in its preferred mode; a context manager.

    Args:
        address: the device, and after commas the options of `camctl.menu.panels.keyed`
        clock: the clock in which keys are looked for
    """

    def __init__(self, address: str = "/dev/dri/card0", *, clock: Clock | None = None) -> None:
        parsed = parse_address(address, KEY_OPTIONS)
        super().__init__(keys_of(parsed), clock)
        self._path = parsed.words[0]
        self._display: DrmDisplay | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) of the display, pixels."""
        return self._opened.columns, self._opened.rows

    @property
    def _opened(self) -> DrmDisplay:
        if self._display is None:
            raise PanelDisconnectedError(f"{self._path} is not open", hint="open it first")
        return self._display

    def __enter__(self) -> Self:
        """Show pictures on the display, and return the panel.

        Raises:
            UsageError: it is no graphics device, or the display is too small
            PanelDisconnectedError: no display is connected
            CamctlError: it is not there, it may not be opened, or another program shows pictures
        """
        try:
            self._display = DrmDisplay(self._path)
        except LookupError as error:
            raise PanelDisconnectedError(
                f"no display is connected to {self._path}", hint="connect it, or name another card"
            ) from error
        except OSError as error:
            raise _cannot_open(self._path, error) from error
        if self.size[0] < SMALLEST[0] or self.size[1] < SMALLEST[1]:
            columns, rows = self.size
            self._close()
            raise UsageError(
                f"the display has only {columns} x {rows} pixels",
                hint=f"the menu needs {SMALLEST[0]} x {SMALLEST[1]}",
            )
        return self

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Show again what the display showed before, and close it."""
        self._close()

    def _draw(self, screen: Screen) -> int:
        display = self._opened
        drawing = draw(screen, display.columns, display.rows)
        rows, columns, _ = drawing.pixels.shape
        lines = np.frombuffer(display.memory, np.uint8, rows * display.line_bytes)
        pixels = lines.reshape(rows, -1)[:, : 4 * columns].reshape(rows, columns, 4)
        pixels[..., :3] = drawing.pixels[..., ::-1]
        del lines, pixels  # else the buffer cannot be closed
        try:
            display.flush()
        except OSError as error:
            raise PanelDisconnectedError(
                f"the display at {self._path} was disconnected: {error.strerror}",
                hint="connect it again",
            ) from error
        return drawing.last_offset

    def _close(self) -> None:
        display, self._display = self._display, None
        if display is not None:
            display.close()
        self._keys.close()


def _cannot_open(path: str, error: OSError) -> CamctlError:
    """Return the error for a device that cannot be used."""
    if error.errno == 25:  # ENOTTY
        return UsageError(f"{path} is no graphics device", hint="use drm:/dev/dri/card0")
    hint = "connect a display, or choose another panel"
    if isinstance(error, PermissionError):
        hint = "end the desktop that uses it, and add the user to the group video, or run as root"
    return CamctlError(f"cannot use {path}: {error.strerror}", hint=hint)
