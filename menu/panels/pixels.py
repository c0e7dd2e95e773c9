"""Displays of pixels without keys of their own: what they share."""

from __future__ import annotations

from abc import abstractmethod
from typing import Self

from camctl.errors import UsageError
from camctl.menu.drawing import SMALLEST, Pixels, draw
from camctl.menu.panels.keyed import KeyedPanel
from camctl.menu.ports import Screen
from camctl.system.interrupts import uninterrupted


class PixelPanel(KeyedPanel):
    """A display of pixels and its keys; a context manager."""

    @abstractmethod
    def _open(self) -> tuple[int, int]:
        """Open the display; return its (columns, rows), pixels."""

    @abstractmethod
    def _paint(self, pixels: Pixels, *, is_dark: bool) -> None:
        """Show a picture in the size of the display; the light is off for one that is dark.

        Raises:
            PanelDisconnectedError: the display is gone
        """

    @abstractmethod
    def _release(self) -> None:
        """Show what was shown before, and close the display, where it is open."""

    def __enter__(self) -> Self:
        """Open the display and return the panel.

        Raises:
            UsageError: the display is too small, or cannot be drawn on
            PanelDisconnectedError: it does not answer, or none is connected
            CamctlError: it is not there, or may not be opened
        """
        self.size = self._open()
        if self.size[0] < SMALLEST[0] or self.size[1] < SMALLEST[1]:
            self._close()
            raise UsageError(
                f"the display has only {self.size[0]} x {self.size[1]} pixels",
                hint=f"the menu needs {SMALLEST[0]} x {SMALLEST[1]}",
            )
        return self

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Show what was shown before, and close the display."""
        self._close()

    def _draw(self, screen: Screen) -> int:
        drawing = draw(screen, *self.size)
        self._paint(drawing.pixels, is_dark=screen.is_dark)
        return drawing.last_offset

    def _close(self) -> None:
        self._release()
        self._keys.close()
