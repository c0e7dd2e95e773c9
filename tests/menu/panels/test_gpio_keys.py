"""Buttons and encoders on simulated lines, with contacts that bounce."""

from __future__ import annotations

import pytest
from simulated_gpio import BOUNCES_S, Board

from camctl.interface.clock import VirtualClock
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.gpio_keys import GpioKeys
from camctl.menu.panels.keyed import KEY_OPTIONS
from camctl.menu.ports import Key, Line, Screen

A, B = 17, 18
LIST = Screen(Line(("list",)), lines=(Line(("one",)),), selected=0)
PAGE = Screen(Line(("page",)), actions=("Set", "Shoot"))


def keys_at(board: Board, options: str) -> GpioKeys:
    return GpioKeys(parse_address(f"device,{options}", KEY_OPTIONS), board.module)


def found(keys: GpioKeys, clock: VirtualClock, until_s: float) -> list[Key]:
    """Return the keys that come until a time."""
    pressed = []
    while until_s - clock.now() > 1e-6:  # what a timedelta can hold, s
        before_s = clock.now()
        key = keys.key(min(0.05, until_s - before_s), before_s)
        if key is not None:
            pressed.append(key)
        elif clock.now() == before_s and not keys.is_open:
            clock.sleep_until(before_s + 0.05)
    return pressed


def test_each_button_is_one_key_however_it_bounces() -> None:
    clock = VirtualClock()
    board = Board(clock, {"GPIO27": 27})
    keys = keys_at(board, "up=5,down=6,left=13,right=19,enter=26,exit=GPIO27")
    lines = (5, 6, 13, 19, 26, 27)
    for index, line in enumerate(lines):
        board.press(line, 0.1 + 0.3 * index)
    assert found(keys, clock, 3.0) == [Key.UP, Key.DOWN, Key.LEFT, Key.RIGHT, Key.ENTER, Key.EXIT]
    assert {each.bias for each in board.settings.values()} == {"pull up"}


def test_key_that_selects_repeats_while_it_is_held() -> None:
    clock = VirtualClock()
    board = Board(clock)
    keys = keys_at(board, "down=6,left=7,enter=9,exit=10")
    for line in (6, 7, 9):
        board.press(line, 0.1 if line == 6 else 2.0 + line, held_s=1.3)
    pressed = found(keys, clock, 20.0)
    assert pressed.count(Key.DOWN) == 1 + 6  # after 0.5 s each 0.15 s
    assert pressed[7:] == [Key.LEFT, Key.ENTER]


def test_enter_held_long_is_exit_where_there_is_no_button_for_it() -> None:
    clock = VirtualClock()
    board = Board(clock)
    keys = keys_at(board, "enter=9")
    board.press(9, 0.1)
    board.press(9, 1.0, held_s=2.0)
    board.press(9, 4.0)
    assert found(keys, clock, 6.0) == [Key.ENTER, Key.EXIT, Key.ENTER]


def turn(board: Board, at_s: float, clockwise: bool, quarter_s: float) -> float:
    """Turn the encoder by one step; return when it rests.  Its contacts bounce for 0.5 ms."""
    first, second = (A, B) if clockwise else (B, A)
    for line in (first, second, first, second):
        board.change(line, at_s, tuple(bounce / 6 for bounce in BOUNCES_S))
        at_s += quarter_s
    return at_s


@pytest.mark.parametrize("quarter_s", [0.02, 0.004, 0.0015])
def test_encoder_selects_entries_in_lists_and_buttons_on_pages(quarter_s: float) -> None:
    clock = VirtualClock()
    board = Board(clock)
    keys = keys_at(board, f"turn={A}:{B},enter=27")
    for screen, back, on in ((LIST, Key.UP, Key.DOWN), (PAGE, Key.LEFT, Key.RIGHT)):
        keys.shows(screen)
        at_s = clock.now() + 0.1
        for clockwise in (True, True, False, True, False, False):
            at_s = turn(board, at_s, clockwise, quarter_s)
        assert found(keys, clock, at_s + 0.1) == [on, on, back, on, back, back]


def test_encoder_between_two_steps_is_no_key() -> None:
    clock = VirtualClock()
    board = Board(clock)
    keys = keys_at(board, f"turn={A}:{B}")
    board.press(A, 0.1)
    board.press(B, 0.5)
    assert found(keys, clock, 1.0) == []


def test_chip_that_cannot_be_used_says_why_until_it_can() -> None:
    clock = VirtualClock()
    board = Board(clock)
    keys = keys_at(board, "enter=9,chip=/dev/gpiochip3")
    board.error = PermissionError(13, "Permission denied")
    assert found(keys, clock, 0.5) == []
    assert not keys.is_open
    assert keys.problem.startswith("cannot use the lines of /dev/gpiochip3: Permission denied; add")
    board.error = None
    board.press(9, 3.0)
    assert found(keys, clock, 4.0) == [Key.ENTER]
    assert (keys.is_open, keys.problem) == (True, "")
    board.error = OSError(19, "No such device")  # a chip on USB was unplugged
    assert found(keys, clock, 4.5) == []
    assert (keys.is_open, "No such device" in keys.problem) == (False, True)


def test_line_that_the_chip_does_not_have_is_named() -> None:
    keys = keys_at(Board(VirtualClock()), "enter=GPIO99")
    assert keys.key(0, 0.0) is None
    assert keys.problem.startswith("cannot use the lines of /dev/gpiochip0: no line GPIO99; name")


def test_keys_need_gpiod(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from camctl.errors import UsageError

    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(UsageError, match=r"need gpiod; pip install 'camctl\[gpio\]'"):
        GpioKeys(parse_address("device,enter=9", KEY_OPTIONS))
