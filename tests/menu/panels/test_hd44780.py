"""The HD44780 panel on a simulated bus that decodes what the chip would."""

from __future__ import annotations

import pytest
from simulated_gpio import Board
from simulated_hd44780 import SimulatedHd44780

from camctl.errors import UsageError
from camctl.interface.clock import VirtualClock
from camctl.menu.layout import grid
from camctl.menu.panels import gpio_keys
from camctl.menu.panels.hd44780 import GLYPHS, Hd44780Panel, encoded
from camctl.menu.ports import Line, PanelDisconnectedError, Screen

SCREEN = Screen(Line(("Ready",)), lines=(Line(("one",)), Line(("two",))), selected=1)
NO_KEYS = "keys=/nowhere/event*"


def opened(size: str = "20x4") -> tuple[Hd44780Panel, SimulatedHd44780, VirtualClock]:
    clock = VirtualClock()
    chip = SimulatedHd44780(clock.now)
    address = f"/dev/i2c-1,at=0x27,size={size},{NO_KEYS}"
    return Hd44780Panel(address, clock=clock, bus=chip), chip, clock


@pytest.mark.parametrize(("columns", "rows"), [(16, 2), (20, 2), (16, 4), (20, 4), (40, 2)])
def test_display_shows_the_screen(columns: int, rows: int) -> None:
    panel, chip, _ = opened(f"{columns}x{rows}")
    with panel:
        for selected in (1, 0):
            shown = Screen(SCREEN.title, lines=SCREEN.lines, selected=selected)
            panel.show(shown)
            assert chip.rows(columns, rows) == list(grid(shown, columns, rows).lines)
        assert chip.has_light
        panel.show(Screen(SCREEN.title, is_dark=True))
        assert not chip.has_light
    assert chip.lost == 0
    assert chip.rows(columns, rows) == [" " * columns] * rows


@pytest.mark.parametrize("halves", [(), (0x2,), (0x2, 0x0)])
def test_display_is_started_from_any_state(halves: tuple[int, ...]) -> None:
    """After power; with four data lines, as a program before left it; and within a byte."""
    panel, chip, _ = opened()
    for half in halves:
        for outputs in (half << 4 | 0x04, half << 4):
            chip.write_byte(0x27, outputs)
    with panel:
        panel.show(SCREEN)
        assert chip.rows(20, 4) == list(grid(SCREEN, 20, 4).lines)


def test_characters_that_the_chip_lacks_are_glyphs_or_without_accent() -> None:
    panel, chip, _ = opened()
    with panel:
        panel.show(Screen(Line(("a\\b~c é ä €",))))
        (first, *_) = chip.codes(20, 4)
        assert chip.rows(20, 4)[0] == "a?b?c ? a ?         "
        backslash, tilde = first[1], first[3]
        assert chip.dots(backslash)[1:6] == ("#....", ".#...", "..#..", "...#.", "....#")
        assert chip.dots(tilde)[2:5] == (".#...", "#.#.#", "...#.")
        for glyph, rows in GLYPHS.items():
            shown = [
                int(row.replace("#", "1").replace(".", "0"), 2)
                for row in chip.dots(encoded(glyph)[0])
            ]
            assert shown == list(rows)


def test_unplugged_display_is_one_line_and_comes_back() -> None:
    panel, chip, clock = opened()
    with panel:
        panel.show(SCREEN)
        chip.is_there = False
        clock.sleep_until(clock.now() + 3)
        with pytest.raises(
            PanelDisconnectedError, match=r"^no display answers at 0x27 of /dev/i2c-1: .*; check"
        ):
            panel.key(0)
    chip.power_up()
    chip.is_there = True
    with panel:
        panel.show(SCREEN)
        assert chip.rows(20, 4) == list(grid(SCREEN, 20, 4).lines)


def test_display_that_lost_its_power_is_started_again() -> None:
    panel, chip, clock = opened()
    with panel:
        panel.show(SCREEN)
        chip.power_up()
        clock.sleep_until(clock.now() + 3)
        assert panel.key(0) is None
        assert chip.rows(20, 4) == list(grid(SCREEN, 20, 4).lines)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("/dev/i2c-1,at=0x99", "no HD44780 of 16 x 2 characters at 0x99"),
        ("/dev/i2c-1,at=x", "invalid at=x"),
        ("/dev/i2c-1,size=8x2", "invalid size=8x2 of the panel; use 16x2"),
        ("/dev/i2c-1,size=40x4", "no HD44780 of 40 x 4"),
        ("/dev/i2c-1,sise=20x4", "unknown option of the panel 'sise'; did you mean size"),
        ("/dev/i2c-1,turn=17", "invalid turn=17 of the panel"),
    ],
)
def test_invalid_address_is_refused(
    address: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpio_keys, "_gpiod", lambda: Board(VirtualClock()).module)
    with pytest.raises(UsageError, match=message):
        Hd44780Panel(address)


def test_bus_that_is_not_there_is_one_line() -> None:
    pytest.importorskip("smbus2", reason="smbus2 is not installed")
    with pytest.raises(PanelDisconnectedError, match=r"cannot open /dev/i2c-99: No such file"):
        Hd44780Panel("/dev/i2c-99").__enter__()
