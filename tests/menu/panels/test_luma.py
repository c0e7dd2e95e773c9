"""Luma's displays: the pictures that luma is given, and whether display and light are on."""

from __future__ import annotations

import errno
import sys
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.menu.drawing import draw
from camctl.menu.panels.luma_display import LumaPanel
from camctl.menu.ports import PanelDisconnectedError
from camctl.menu.screens import screen
from tests.menu.test_machine import FULL

pytest.importorskip("luma.core", reason="luma is not installed")
smbus2: Any = pytest.importorskip("smbus2", reason="smbus2 is not installed")

pytestmark = pytest.mark.filterwarnings("ignore:Image.Image.getdata:DeprecationWarning")  # luma

NO_KEYS = "keys=/nowhere/event*"
SHOWN = screen(FULL)


class Bus:
    """An I2C bus with an SSD1306, as `smbus2.SMBus`; commands 0xAE and 0xAF switch it off, on."""

    def __init__(self) -> None:
        self.is_there, self.is_on = True, False

    def write_i2c_block_data(self, at: int, control: int, data: list[int]) -> None:
        if not self.is_there:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        for command in (0xAE, 0xAF):
            if control == 0 and command in data:
                self.is_on = command == 0xAF

    def i2c_rdwr(self, message: Any) -> None:
        control, *data = message
        self.write_i2c_block_data(message.addr, control, data)

    def close(self) -> None:
        pass


@pytest.fixture
def oled(monkeypatch: pytest.MonkeyPatch) -> Bus:
    bus = Bus()
    monkeypatch.setattr(smbus2, "SMBus", lambda port: bus)
    return bus


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[NDArray[np.uint8]]:
    """The pictures that luma has been given to display."""
    from luma.lcd.device import st7789
    from luma.oled.device import ssd1306

    pictures: list[NDArray[np.uint8]] = []
    for kind in (ssd1306, st7789):

        def display(device: Any, picture: Any, plain: Any = kind.display) -> None:
            plain(device, picture)
            pictures.append(np.asarray(picture))

        monkeypatch.setattr(kind, "display", display)
    return pictures


def test_ssd1306_shows_the_screen_as_text(oled: Bus, shown: list[NDArray[np.uint8]]) -> None:
    with LumaPanel(f"ssd1306,i2c-port=1,{NO_KEYS}") as panel:
        panel.show(SHOWN)
        np.testing.assert_array_equal(shown[-1], draw(SHOWN, 128, 64).pixels[..., 0] > 0)
        assert oled.is_on
        panel.show(replace(SHOWN, is_dark=True))
        assert not oled.is_on
        panel.show(SHOWN)
        assert oled.is_on
    assert not oled.is_on


def test_st7789_shows_the_screen_as_a_picture(
    monkeypatch: pytest.MonkeyPatch, shown: list[NDArray[np.uint8]]
) -> None:
    gpio = MagicMock(LOW=0, HIGH=1)
    for name, module in (
        ("RPi", MagicMock(GPIO=gpio)),
        ("RPi.GPIO", gpio),
        ("spidev", MagicMock()),
    ):
        monkeypatch.setitem(sys.modules, name, module)

    def has_light() -> bool:
        *_, (_, value) = [each.args for each in gpio.output.call_args_list if each.args[0] == 18]
        return bool(value)

    with LumaPanel(f"st7789,interface=spi,gpio-data-command=24,{NO_KEYS}") as panel:
        panel.show(SHOWN)
        np.testing.assert_array_equal(shown[-1], draw(SHOWN, 240, 240).pixels)
        assert has_light()
    assert not has_light()


def test_display_that_is_unplugged_is_one_line_and_comes_back(
    oled: Bus, shown: list[NDArray[np.uint8]]
) -> None:
    panel = LumaPanel(f"ssd1306,{NO_KEYS}")
    with panel:
        oled.is_there = False
        with pytest.raises(PanelDisconnectedError, match=r"ssd1306 was disconnected: .*; connect"):
            panel.show(SHOWN)
    with pytest.raises(
        PanelDisconnectedError, match=r"^cannot use the display ssd1306: .*0x3C; check"
    ):
        panel.__enter__()
    oled.is_there = True
    with panel:
        panel.show(SHOWN)
        assert shown[-1].any()


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("ssd1307", "invalid display of the panel luma: .*ssd1307"),
        ("ssd1306,i2c-prot=1", "unknown option of the panel 'i2c-prot'; did you mean i2c-port"),
        ("ssd1306,i2c-port=x", "invalid display of the panel luma: .*i2c-port"),
    ],
)
def test_invalid_address_is_refused(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        LumaPanel(address)


def test_display_that_cannot_be_used_is_refused_and_switched_off(oled: Bus) -> None:
    with pytest.raises(UsageError, match=r"luma cannot drive the display ssd1306: .*100 x 64"):
        LumaPanel(f"ssd1306,width=100,{NO_KEYS}").__enter__()
    with pytest.raises(UsageError, match="has only 64 x 48 pixels; the menu needs 96 x 16"):
        LumaPanel(f"ssd1306,width=64,height=48,{NO_KEYS}").__enter__()
    assert not oled.is_on


def test_panel_needs_luma(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "luma.core", None)
    with pytest.raises(
        UsageError, match=r"needs luma.oled and luma.lcd; pip install 'camctl\[luma\]'"
    ):
        LumaPanel("ssd1306")
