"""Buttons and an encoder at lines of the kernel's gpio-sim, with contacts that bounce."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import guest_processes as guest
import pytest
import virtual_devices as rig
from simulated_gpio import BOUNCES_S

from camctl.menu.panels.address import parse_address
from camctl.menu.panels.gpio_keys import GpioKeys
from camctl.menu.panels.keyed import KEY_OPTIONS
from camctl.menu.ports import Key, Line, Screen

CONFIG = Path("/sys/kernel/config")
LIST = Screen(Line(("list",)), lines=(Line(("one",)),), selected=0)
PAGE = Screen(Line(("page",)), actions=("Set", "Shoot"))
A, B, ENTER, NAMED = 17, 18, 26, 27


class Lines:
    """A chip of gpio-sim; a contact to ground pulls its line down.

    Attributes:
        path: the device
    """

    def __init__(self) -> None:
        bank = CONFIG / "gpio-sim" / "camctl" / "bank0"
        (bank / f"line{NAMED}").mkdir(parents=True)
        (bank / "num_lines").write_text("32")
        (bank / f"line{NAMED}" / "name").write_text("EXIT")
        self._live = bank.parent / "live"
        self._live.write_text("1")
        name = (bank / "chip_name").read_text().strip()
        device = (bank.parent / "dev_name").read_text().strip()
        self.path = Path("/dev", name)
        self._lines = Path("/sys/devices/platform", device, name)
        guest.wait_for("gpio-sim", self.path.exists)

    def remove(self) -> None:
        """Unplug the chip, where it is still there."""
        if self.path.exists():
            self._live.write_text("0")

    def put(self, line: int, is_closed: bool) -> None:
        """Close or open the contact of a line."""
        pull = "pull-down" if is_closed else "pull-up"
        (self._lines / f"sim_gpio{line}" / "pull").write_text(pull)

    def change(self, line: int, is_closed: bool, slower: float = 1.0) -> None:
        """Close or open the contact of a line, which bounces; return when it rests."""
        began_s = time.monotonic()
        for count, at_s in enumerate(BOUNCES_S):
            time.sleep(max(0.0, began_s + at_s * slower - time.monotonic()))
            self.put(line, is_closed == (count % 2 == 0))

    def press(self, line: int, held_s: float = 0.1) -> None:
        self.change(line, is_closed=True)
        time.sleep(held_s)
        self.change(line, is_closed=False)

    def turn(self, clockwise: bool, quarter_s: float) -> None:
        """Turn the encoder by one step; its contacts bounce for 0.5 ms."""
        first, second = (A, B) if clockwise else (B, A)
        for line, is_closed in ((first, True), (second, True), (first, False), (second, False)):
            began_s = time.monotonic()
            self.change(line, is_closed, slower=1 / 6)
            time.sleep(max(0.0, began_s + quarter_s - time.monotonic()))


@pytest.fixture(scope="module")
def lines() -> Iterator[Lines]:
    module = os.environ.get("CAMCTL_GPIO_MODULE")
    if module is None:
        pytest.skip("no module gpio-sim: apt-get install gcc make")
    rig.modprobe("configfs")
    if not os.path.ismount(CONFIG):
        subprocess.run(["mount", "-t", "configfs", "configfs", CONFIG], check=True)
    subprocess.run(["insmod", module], check=True)
    board = Lines()
    yield board
    board.remove()


def keys_of(lines: Lines, options: str) -> GpioKeys:
    keys = GpioKeys(parse_address(f"device,{options},chip={lines.path}", KEY_OPTIONS))
    assert keys.key(0, time.monotonic()) is None
    return keys


@contextmanager
def keys_at(lines: Lines, options: str) -> Iterator[GpioKeys]:
    keys = keys_of(lines, options)
    assert keys.problem == ""
    try:
        yield keys
    finally:
        keys.close()


def found(keys: GpioKeys) -> list[Key]:
    """Return the keys that have come, and that come within 0.1 s."""
    pressed, end_s = [], time.monotonic() + 0.1
    while (now_s := time.monotonic()) < end_s:
        if (key := keys.key(end_s - now_s, now_s)) is not None:
            pressed.append(key)
            end_s = now_s + 0.1
    return pressed


def test_each_button_is_one_key_however_it_bounces(lines: Lines) -> None:
    options = f"up=5,down=6,left=13,right=19,enter={ENTER},exit=EXIT"
    with keys_at(lines, options) as keys:
        for line in (5, 6, 13, 19, ENTER, NAMED):
            lines.press(line)
            time.sleep(0.05)
        assert found(keys) == [Key.UP, Key.DOWN, Key.LEFT, Key.RIGHT, Key.ENTER, Key.EXIT]


def test_enter_held_long_is_exit_where_there_is_no_button_for_it(lines: Lines) -> None:
    with keys_at(lines, f"enter={ENTER}") as keys:
        for held_s, key in ((0.1, Key.ENTER), (0.8, Key.EXIT), (0.1, Key.ENTER)):
            lines.press(ENTER, held_s)
            assert found(keys) == [key]


@pytest.mark.parametrize("quarter_s", [0.02, 0.004, 0.002])
def test_encoder_selects_entries_in_lists_and_buttons_on_pages(
    lines: Lines, quarter_s: float
) -> None:
    with keys_at(lines, f"turn={A}:{B},enter={ENTER}") as keys:
        for screen, back, on in ((LIST, Key.UP, Key.DOWN), (PAGE, Key.LEFT, Key.RIGHT)):
            keys.shows(screen)
            for clockwise in (True, True, False, True, False, False):
                lines.turn(clockwise, quarter_s)
            assert found(keys) == [on, on, back, on, back, back]


def test_edges_are_kept_while_nobody_reads(lines: Lines) -> None:
    with keys_at(lines, f"turn={A}:{B}") as keys:
        keys.shows(LIST)
        for _ in range(20):  # 400 edges with their bounces, as while a screen is drawn
            lines.turn(clockwise=True, quarter_s=0.002)
        assert found(keys) == [Key.DOWN] * 20


def test_lines_that_are_taken_or_not_there_are_named(lines: Lines) -> None:
    with keys_at(lines, f"enter={ENTER}"):
        for options, problem in (
            (f"enter={ENTER}", "Device or resource busy"),
            ("enter=GPIO99", "no line GPIO99"),
            ("enter=32", "no line 32"),
        ):
            start = f"cannot use the lines of {lines.path}: {problem}; name"
            assert keys_of(lines, options).problem.startswith(start)


def test_chip_that_is_unplugged_is_named(lines: Lines) -> None:
    with keys_at(lines, f"enter={ENTER}") as keys:
        lines.remove()
        time.sleep(0.1)
        assert found(keys) == []
        assert (keys.is_open, str(lines.path) in keys.problem) == (False, True)
