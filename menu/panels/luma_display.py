"""Graphic displays of luma.oled and luma.lcd: SSD1306, SH1106, ST7789, ILI9341 and others."""

from __future__ import annotations

import importlib
from contextlib import suppress
from typing import Any

from camctl.errors import UsageError
from camctl.interface.clock import Clock
from camctl.menu.drawing import Pixels
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.keyed import KEY_OPTIONS, keys_of
from camctl.menu.panels.pixels import PixelPanel
from camctl.menu.ports import PanelDisconnectedError

_BUS_OPTIONS = ("interface", "i2c-", "spi-", "gpio", "ftdi-", "backlight-active")
"""Beginnings of those of luma's options that say how a display is connected."""

_DEVICE_OPTIONS = ("width", "height", "rotate", "mode", "bgr", "inverse", "h-offset", "v-offset")
"""Those of luma's options that a display is made with."""


class LumaPanel(PixelPanel):
    """A display that luma drives, with keys of GPIO lines or input devices; a context manager.

    Args:
        address: luma's name of the display, its options as luma's own programs have them, and
            those of `camctl.menu.panels.keyed`: ``ssd1306,i2c-port=1,height=32``,
            ``st7789,interface=spi,gpio-data-command=24,rotate=1``
        clock: the clock in which keys are looked for
    """

    def __init__(self, address: str, *, clock: Clock | None = None) -> None:
        parser = _parser()
        actions = {action.option_strings[0][2:]: action for action in parser._actions}
        known = {n for n in actions if n.startswith(_BUS_OPTIONS) or n in _DEVICE_OPTIONS}
        parsed = parse_address(address, (*known, *KEY_OPTIONS))
        super().__init__(keys_of(parsed), clock)
        given = {name: text for name, text in parsed.options.items() if name not in KEY_OPTIONS}
        self._name = parsed.words[0]
        words = [f"--{n}" if actions[n].nargs == 0 else f"--{n}={t}" for n, t in given.items()]
        self._options = parser.parse_args(["--display", self._name, *words])
        self._given = {n: getattr(self._options, n.replace("-", "_")) for n in given}
        self._device: Any = None
        self._is_dark = False

    def _open(self) -> tuple[int, int]:
        from luma.core import error

        try:
            self._device = self._made()
        except (error.DeviceNotFoundError, error.DevicePermissionError, OSError) as problem:
            raise PanelDisconnectedError(
                f"cannot use the display {self._name}: {problem}",
                hint="check its wires and its options, and allow the user to open the bus "
                "(groups i2c, spi and gpio)",
            ) from problem
        except (error.Error, ImportError, RuntimeError, TypeError, AssertionError) as problem:
            raise UsageError(
                f"luma cannot drive the display {self._name}: {str(problem) or 'invalid options'}",
                hint="see https://luma-oled.readthedocs.io for its options",
            ) from problem
        self._is_dark = False
        return self._device.width, self._device.height

    def _made(self) -> Any:
        """Return the display, started; `luma.core.cmdline.create_device` cannot make an ST7789."""
        from luma.core import cmdline

        library = cmdline.get_library_for_display_type(self._name)
        arguments = {n.replace("-", "_"): v for n, v in self._given.items() if n in _DEVICE_OPTIONS}
        if library in ("oled", "lcd"):
            make = getattr(cmdline.make_interface(self._options), self._options.interface)
            arguments["serial_interface"] = interface = make()
        if library == "lcd":
            arguments["gpio"] = getattr(interface, "_gpio", None)
            arguments["gpio_LIGHT"] = self._options.gpio_backlight
            arguments["active_low"] = self._given.get("backlight-active") == "low"
        kind = getattr(importlib.import_module(f"luma.{library}.device"), self._name)
        return kind(**arguments)

    def _paint(self, pixels: Pixels, *, is_dark: bool) -> None:
        from PIL import Image

        device = self._device
        picture = Image.fromarray(pixels).convert(device.mode)
        try:
            if is_dark != self._is_dark:
                (device.hide if is_dark else device.show)()
                self._is_dark = is_dark
            device.display(picture)
        except Exception as error:  # luma has an error of its own for some buses
            if isinstance(error, OSError) or type(error).__module__ == "luma.core.error":
                raise PanelDisconnectedError(
                    f"the display {self._name} was disconnected: {error}", hint="connect it again"
                ) from error
            raise

    def _release(self) -> None:
        """Clear the display, switch it off, and close its bus."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(Exception):  # it may be gone, and then shows nothing
                device.cleanup()


def _parser() -> Any:
    """Return luma's own parser of options; what it refuses is a `UsageError`."""
    try:
        from luma.core import cmdline
    except ImportError as error:
        raise UsageError(
            "the panel luma needs luma.oled and luma.lcd", hint="pip install 'camctl[luma]'"
        ) from error

    def refuse(message: str) -> None:
        hint = "see the list of displays in https://luma-oled.readthedocs.io"
        raise UsageError(f"invalid display of the panel luma: {message}", hint=hint)

    parser = cmdline.create_parser("camctl", autocomplete=False)
    parser.error = refuse
    return parser
