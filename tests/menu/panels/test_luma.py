"""Luma's displays on simulated buses, which decode what the controllers would."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_displays import SimulatedSsd1306, SimulatedSt7789

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


@pytest.fixture
def oled(monkeypatch: pytest.MonkeyPatch) -> SimulatedSsd1306:
    chip = SimulatedSsd1306()
    monkeypatch.setattr(smbus2, "SMBus", lambda port: chip)
    return chip


@pytest.fixture
def lcd(monkeypatch: pytest.MonkeyPatch) -> SimulatedSt7789:
    chip = SimulatedSt7789()
    for name, module in chip.modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return chip


def test_ssd1306_shows_the_screen_as_text(oled: SimulatedSsd1306) -> None:
    with LumaPanel(f"ssd1306,i2c-port=1,{NO_KEYS}") as panel:
        panel.show(SHOWN)
        np.testing.assert_array_equal(oled.pixels, draw(SHOWN, 128, 64).pixels[..., 0] > 0)
        assert oled.is_on
        panel.show(replace(SHOWN, is_dark=True))
        assert not oled.is_on
        panel.show(SHOWN)
        assert oled.is_on
    assert not oled.is_on


def test_st7789_shows_the_screen_as_a_picture(lcd: SimulatedSt7789) -> None:
    with LumaPanel(f"st7789,interface=spi,gpio-data-command=24,{NO_KEYS}") as panel:
        panel.show(SHOWN)
        wanted = draw(SHOWN, 240, 240).pixels & 0xFC
        np.testing.assert_array_equal(lcd.pixels(240, 240), wanted)
        assert lcd.has_light
    assert not lcd.has_light


def test_display_that_is_unplugged_is_one_line_and_comes_back(oled: SimulatedSsd1306) -> None:
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
        assert oled.pixels.any()


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


@pytest.mark.usefixtures("oled")
def test_display_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(UsageError, match=r"luma cannot drive the display ssd1306: .*100 x 64"):
        LumaPanel(f"ssd1306,width=100,{NO_KEYS}").__enter__()
    with pytest.raises(UsageError, match="has only 64 x 48 pixels; the menu needs 96 x 16"):
        LumaPanel(f"ssd1306,width=64,height=48,{NO_KEYS}").__enter__()


def test_panel_needs_luma(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "luma.core", None)
    with pytest.raises(
        UsageError, match=r"needs luma.oled and luma.lcd; pip install 'camctl\[luma\]'"
    ):
        LumaPanel("ssd1306")
