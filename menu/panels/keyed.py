"""Displays without keys of their own: what they share, and where their keys come from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from camctl.interface.clock import Clock, RealClock
from camctl.menu.panels.address import PanelAddress
from camctl.menu.panels.gpio_keys import BUTTONS, CHIP, TURN, GpioKeys
from camctl.menu.panels.input_keys import InputKeys
from camctl.menu.ports import Key, Line, Mood, Screen

KEYS = "keys"
"""Option for a pattern of input devices, such as /dev/input/event*."""

KEY_OPTIONS = (*BUTTONS, TURN, CHIP, KEYS)
"""Options of an address that say where keys come from."""


class Keys(Protocol):
    """Where the keys of a display come from; they may come and go.

    Attributes:
        problem: why there are none; "" where there are
    """

    problem: str

    @property
    def is_open(self) -> bool:
        """Whether there is a device that keys can come from."""

    def shows(self, screen: Screen) -> None:
        """Take note of the screen that the keys are for."""

    def key(self, timeout_s: float, now_s: float) -> Key | None:
        """Return the next key; None after `timeout_s` or earlier; `now_s` is the time, s."""

    def close(self) -> None:
        """Release the devices."""


def keys_of(address: PanelAddress) -> Keys:
    """Return the keys that an address names, all input devices where it names none.

    Raises:
        UsageError: GPIO lines are named, and gpiod is not installed
    """
    if any(name in address.options for name in (*BUTTONS, TURN)):
        return GpioKeys(address)
    pattern = address.options.get(KEYS)
    return InputKeys(pattern) if pattern else InputKeys()


class KeyedPanel(ABC):
    """A display and its keys.

    Where no device of keys can be opened, the display says so: no key could leave what it shows.
    """

    def __init__(self, keys: Keys, clock: Clock | None = None) -> None:
        self._keys = keys
        self._clock = clock or RealClock()
        self._shown: Screen | None = None

    @abstractmethod
    def _draw(self, screen: Screen) -> int:
        """Show `screen` on the display; return its last offset."""

    def _check(self) -> None:  # noqa: B027  most displays are noticed when they are drawn on
        """Raise `PanelDisconnectedError` where the display is gone; called after each wait."""

    def show(self, screen: Screen) -> int:
        """Show `screen`, or why there are no keys; return the last offset."""
        self._shown = screen
        self._keys.shows(screen)
        if self._keys.problem and not self._keys.is_open:
            text = (self._keys.problem,)
            screen = Screen(Line(("No keys",)), paragraphs=text, mood=Mood.ERROR)
        return self._draw(screen)

    def key(self, timeout_s: float) -> Key | None:
        before = self._keys.problem, self._keys.is_open
        key = self._keys.key(timeout_s, self._clock.now())
        if key is None and timeout_s and not self._keys.is_open:
            self._clock.sleep_until(self._clock.now() + timeout_s)
        if self._shown is not None and before != (self._keys.problem, self._keys.is_open):
            self.show(self._shown)
        self._check()
        return key
