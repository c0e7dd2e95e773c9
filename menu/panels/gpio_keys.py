"""Buttons and a rotary encoder at GPIO lines, through the kernel's debounced edges (libgpiod 2).

A button connects its line to ground; so do both contacts of an encoder.  The lines are pulled up
by the board.
"""

from __future__ import annotations

from collections import deque
from datetime import timedelta
from typing import Any

from camctl.errors import UsageError
from camctl.menu.panels.address import PanelAddress
from camctl.menu.ports import Key, Screen

BUTTONS = {key.name.lower(): key for key in Key}
"""Option of an address to the key of a button; its value is a line: 17 or GPIO17."""

TURN, CHIP = "turn", "chip"
"""Options for the two lines of an encoder, such as 17:18, and for the device of all lines."""

_DEFAULT_CHIP = "/dev/gpiochip0"

_BOUNCE = timedelta(milliseconds=10)
"""Contacts of buttons bounce for 1.5 ms on average, at most 6 ms (Ganssle, "A Guide to
Debouncing", 18 switches measured)."""

_MOST_EVENTS = 1024
"""Edges that the kernel keeps until they are read: the most that it does (16 of each of 64 lines,
include/uapi/linux/gpio.h)."""

_HELD_S, _REPEAT_S = 0.5, 0.15
"""A key that selects repeats after so long, and then this often, s: less than what keyboards do
(0.25 s, 0.033 s in the kernel), since each step is read."""

_LONG_S = 0.7
"""Without a button for exit, the enter button held this long is exit, s: three times a press."""

_LOOK_S = 2.0
"""Interval in which lines that cannot be used are tried again, s."""

_STEPS = {
    (0b00, 0b01): 1,
    (0b01, 0b11): 1,
    (0b11, 0b10): 1,
    (0b10, 0b00): 1,
    (0b01, 0b00): -1,
    (0b11, 0b01): -1,
    (0b10, 0b11): -1,
    (0b00, 0b10): -1,
}
"""(contacts before, contacts after) of an encoder to a quarter of a step clockwise; a contact that
bounces goes there and back.  Bit 0 is the first contact; 1 is closed."""


class GpioKeys:
    """Keys at lines of a GPIO chip.

    Args:
        address: its options `BUTTONS`, `TURN` and `CHIP` name the lines
        gpiod: the module, or a simulation of it; None: it is imported

    Attributes:
        problem: why the lines cannot be used; "" where they can

    Raises:
        UsageError: gpiod 2 is not installed, or `TURN` does not name two lines
    """

    def __init__(self, address: PanelAddress, gpiod: Any = None) -> None:
        self._gpiod = gpiod or _gpiod()
        self._path = address.options.get(CHIP, _DEFAULT_CHIP)
        self._buttons = {
            _line(address.options[n]): BUTTONS[n] for n in BUTTONS if n in address.options
        }
        turn = address.options.get(TURN)
        self._contacts = [_line(text) for text in turn.split(":")] if turn else []
        if turn and len(set(self._contacts)) != 2:
            raise UsageError(
                f"invalid turn={turn} of the panel", hint="name two lines, as turn=17:18"
            )
        self._has_exit = Key.EXIT in self._buttons.values()
        self._request: Any = None
        self._key_of: dict[int, Key] = {}
        self._bit_of: dict[int, int] = {}
        self._pressed_s: dict[Key, float] = {}
        self._repeat_s = 0.0
        self._contact_bits = self._quarters = 0
        self._found: deque[Key] = deque()
        self._next_look_s = float("-inf")
        self.problem = ""
        self.is_page = False

    @property
    def is_open(self) -> bool:
        """Whether keys can come."""
        return self._request is not None

    def shows(self, screen: Screen) -> None:
        """Take note of the screen: on a page with buttons an encoder selects among them."""
        self.is_page = screen.selected is None and bool(screen.actions)

    def close(self) -> None:
        request, self._request = self._request, None
        if request is not None:
            request.release()
        self._pressed_s.clear()
        self._found.clear()
        self._next_look_s = float("-inf")

    def key(self, timeout_s: float, now_s: float) -> Key | None:
        """Return the next key; None after `timeout_s` or earlier; `now_s` is the time, s."""
        if self._request is None and now_s >= self._next_look_s:
            self._open()
            self._next_look_s = now_s + _LOOK_S
        if self._request is None:
            return None
        self._take_held(now_s)
        if not self._found:
            try:
                wait_s = min(timeout_s, _REPEAT_S) if self._pressed_s else timeout_s
                if self._request.wait_edge_events(timedelta(seconds=wait_s)):
                    for event in self._request.read_edge_events():
                        self._take(event)
            except OSError as error:
                self.close()
                self.problem = _problem(self._path, error)
        return self._found.popleft() if self._found else None

    def _open(self) -> None:
        """Request the lines; `problem` says why that failed."""
        line, settings = self._gpiod.line, self._gpiod.LineSettings
        common = {
            "direction": line.Direction.INPUT,
            "edge_detection": line.Edge.BOTH,
            "bias": line.Bias.PULL_UP,
            "active_low": True,
        }
        config = {each: settings(debounce_period=_BOUNCE, **common) for each in self._buttons}
        # The kernel debounces in jiffies (4 ms where HZ is 250): a period of 1 ms takes up to 8 ms,
        # and loses the edges of an encoder that is turned fast.  Its bounces cancel in `_STEPS`.
        config |= {each: settings(**common) for each in self._contacts}
        try:
            with self._gpiod.Chip(self._path) as chip:
                places = {each: _place(chip, each) for each in config}
                self._request = chip.request_lines(
                    config=config, consumer="camctl", event_buffer_size=_MOST_EVENTS
                )
            values = [self._request.get_value(each) for each in self._contacts]
        except (OSError, ValueError) as error:
            self.problem = _problem(self._path, error)
            return
        self.problem = ""
        self._key_of = {places[each]: key for each, key in self._buttons.items()}
        self._bit_of = {places[each]: 1 << bit for bit, each in enumerate(self._contacts)}
        closed = [value is line.Value.ACTIVE for value in values]
        self._contact_bits = sum(is_closed << bit for bit, is_closed in enumerate(closed))
        self._quarters = 0

    def _take(self, event: Any) -> None:
        """Take an edge; rising ones close a contact, since the lines are active when low."""
        is_closed = event.event_type is self._gpiod.EdgeEvent.Type.RISING_EDGE
        if event.line_offset in self._bit_of:
            self._turn(self._bit_of[event.line_offset], is_closed)
            return
        key, time_s = self._key_of[event.line_offset], event.timestamp_ns / 1e9
        if is_closed:
            self._pressed_s[key] = time_s
            self._repeat_s = time_s + _HELD_S
            if key is not Key.ENTER or self._has_exit:
                self._found.append(key)
            return
        began_s = self._pressed_s.pop(key, None)
        if key is Key.ENTER and not self._has_exit and began_s is not None:
            self._found.append(Key.EXIT if time_s - began_s >= _LONG_S else Key.ENTER)

    def _turn(self, bit: int, is_closed: bool) -> None:
        """Take an edge of the encoder; a step is complete where both contacts are open again."""
        before = self._contact_bits
        self._contact_bits = before | bit if is_closed else before & ~bit
        self._quarters += _STEPS.get((before, self._contact_bits), 0)
        if self._contact_bits == 0:
            if abs(self._quarters) >= 3:  # a quarter may be lost
                clockwise = self._quarters > 0
                back, on = (Key.LEFT, Key.RIGHT) if self.is_page else (Key.UP, Key.DOWN)
                self._found.append(on if clockwise else back)
            self._quarters = 0

    def _take_held(self, now_s: float) -> None:
        """Add what buttons that are held down bring."""
        for key, began_s in list(self._pressed_s.items()):
            if key in (Key.UP, Key.DOWN) and now_s >= self._repeat_s:
                self._repeat_s = now_s + _REPEAT_S
                self._found.append(key)
            elif key is Key.ENTER and not self._has_exit and now_s - began_s >= _LONG_S:
                del self._pressed_s[key]  # its release does nothing more
                self._found.append(Key.EXIT)


def _line(text: str) -> int | str:
    return int(text) if text.isascii() and text.isdigit() else text


def _place(chip: Any, line: int | str) -> int:
    """Return the offset of a line; raise `ValueError` with its name where the chip has none."""
    try:
        return int(chip.line_offset_from_id(line))
    except (FileNotFoundError, ValueError):
        raise ValueError(f"no line {line}") from None


def _problem(path: str, error: OSError | ValueError) -> str:
    reason = getattr(error, "strerror", None) or str(error)
    hint = "name the device of the lines, as in chip=/dev/gpiochip0, and its lines (gpioinfo)"
    if isinstance(error, PermissionError):
        hint = "add the user to the group gpio, or run as root"
    return f"cannot use the lines of {path}: {reason}; {hint}"


def _gpiod() -> Any:
    try:
        import gpiod
    except ImportError as error:
        raise UsageError(
            "keys at GPIO lines need gpiod", hint="pip install 'camctl[gpio]'"
        ) from error
    if not hasattr(gpiod, "LineSettings"):
        raise UsageError("keys at GPIO lines need gpiod 2 or later", hint="pip install 'gpiod>=2'")
    return gpiod
