"""A display that the kernel drives (/dev/dri/card0), without X, Wayland or a frame buffer."""

from __future__ import annotations

import numpy as np

from camctl.errors import CamctlError, UsageError
from camctl.interface.clock import Clock
from camctl.menu.drawing import Pixels
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.drm_kernel import DrmDisplay
from camctl.menu.panels.keyed import KEY_OPTIONS, keys_of
from camctl.menu.panels.pixels import PixelPanel
from camctl.menu.ports import PanelDisconnectedError


class DrmPanel(PixelPanel):
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

    def _open(self) -> tuple[int, int]:
        try:
            self._display = DrmDisplay(self._path)
        except LookupError as error:
            raise PanelDisconnectedError(
                f"no display is connected to {self._path}", hint="connect it, or name another card"
            ) from error
        except OSError as error:
            raise _cannot_open(self._path, error) from error
        return self._display.columns, self._display.rows

    def _paint(self, pixels: Pixels, *, is_dark: bool) -> None:
        display = self._display
        assert display is not None  # it is open
        rows, columns, _ = pixels.shape
        lines = np.frombuffer(display.memory, np.uint8, rows * display.line_bytes)
        shown = lines.reshape(rows, -1)[:, : 4 * columns].reshape(rows, columns, 4)
        shown[..., :3] = pixels[..., ::-1]
        del lines, shown  # else the buffer cannot be closed
        try:
            display.flush()
        except OSError as error:
            raise PanelDisconnectedError(
                f"the display at {self._path} was disconnected: {error.strerror}",
                hint="connect it again",
            ) from error

    def _release(self) -> None:
        display, self._display = self._display, None
        if display is not None:
            display.close()


def _cannot_open(path: str, error: OSError) -> CamctlError:
    """Return the error for a device that cannot be used."""
    if error.errno == 25:  # ENOTTY
        return UsageError(f"{path} is no graphics device", hint="use drm:/dev/dri/card0")
    hint = "connect a display, or choose another panel"
    if isinstance(error, PermissionError):
        hint = "end the desktop that uses it, and add the user to the group video, or run as root"
    return CamctlError(f"cannot use {path}: {error.strerror}", hint=hint)
