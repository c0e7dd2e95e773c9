"""Contacts at GPIO lines that bounce, and a kernel that debounces them, in place of `gpiod`.

The kernel reports a change once the line has been still for the debounce period
(Documentation/userspace-api/gpio, gpio-v2-line-attribute), by the time of that moment.  It counts
the period in jiffies and starts with the next one (drivers/gpio/gpiolib-cdev.c, debounce_setup, and
kernel/time/timer.c, calc_index), as tests/virtual_hardware/guest/test_gpio_keys.py shows on one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import timedelta
from enum import Enum, auto
from types import SimpleNamespace
from typing import Any, Self

from camctl.interface.clock import VirtualClock

BOUNCES_S = (0.0, 0.0004, 0.0009, 0.0012, 0.0031)
"""Times at which a contact changes until it rests; an odd number."""

JIFFY_S = 0.004
"""Of kernels with 250 ticks in a second, as Debian's are (CONFIG_HZ)."""


class Value(Enum):
    ACTIVE = auto()
    INACTIVE = auto()


class EdgeType(Enum):
    RISING_EDGE = auto()
    FALLING_EDGE = auto()


@dataclass(frozen=True)
class Settings:
    direction: str = ""
    edge_detection: str = ""
    bias: str = ""
    active_low: bool = False
    debounce_period: timedelta = timedelta()


@dataclass(frozen=True)
class Event:
    event_type: EdgeType
    timestamp_ns: int
    line_offset: int


@dataclass
class Line:
    """A line: when its contact changes, the state that was reported last, and what is not yet."""

    changes_s: list[float] = field(default_factory=list)
    is_closed: bool = False
    taken: int = 0


class Board:
    """A chip with lines, and contacts to ground; `module` stands for the module gpiod.

    Attributes:
        error: what opening the chip and reading it raise; None: they work
        settings: of each line that was requested
    """

    def __init__(self, clock: VirtualClock, names: Mapping[str, int] | None = None) -> None:
        self._clock, self._names = clock, names or {}
        self._lines = {offset: Line() for offset in range(32)}
        self.error: OSError | None = None
        self.settings: dict[int, Settings] = {}
        board = self

        class Chip:
            def __init__(self, path: str) -> None:
                board._fail()

            def __enter__(self) -> Self:
                return self

            def __exit__(self, *_: object) -> None:
                pass

            def line_offset_from_id(self, line: int | str) -> int:
                if isinstance(line, str):
                    if line not in board._names:
                        raise FileNotFoundError(2, "No such file or directory")
                    return board._names[line]
                return line

            def request_lines(
                self, config: Mapping[Any, Settings], consumer: str, event_buffer_size: int
            ) -> Board:
                board.settings = {
                    self.line_offset_from_id(line): each for line, each in config.items()
                }
                return board

        self.module = SimpleNamespace(
            Chip=Chip,
            LineSettings=Settings,
            EdgeEvent=SimpleNamespace(Type=EdgeType),
            line=SimpleNamespace(
                Direction=SimpleNamespace(INPUT="input"),
                Edge=SimpleNamespace(BOTH="both"),
                Bias=SimpleNamespace(PULL_UP="pull up"),
                Value=Value,
            ),
        )

    def change(self, line: int, at_s: float, bounces_s: tuple[float, ...] = BOUNCES_S) -> None:
        """Let the contact of a line change its state at a time, after the changes before."""
        self._lines[line].changes_s += [at_s + bounce for bounce in bounces_s]

    def press(self, line: int, at_s: float, held_s: float = 0.1) -> None:
        """Let the contact of a line close and open."""
        self.change(line, at_s)
        self.change(line, at_s + held_s)

    # The request.

    def get_value(self, line: int) -> Value:
        return Value.ACTIVE if self._lines[line].is_closed else Value.INACTIVE

    def wait_edge_events(self, timeout: timedelta) -> bool:
        self._fail()
        end_s = self._clock.now() + timeout.total_seconds()
        first_s = min((s for s, _ in self._still().values()), default=float("inf"))
        self._clock.sleep_until(min(first_s, end_s))
        return first_s <= end_s

    def read_edge_events(self) -> list[Event]:
        """Return the events until now, in the order of their times."""
        found = []
        for offset, (time_s, count) in self._still().items():
            if time_s <= self._clock.now():
                line = self._lines[offset]
                line.taken = count
                line.is_closed = not line.is_closed
                kind = EdgeType.RISING_EDGE if line.is_closed else EdgeType.FALLING_EDGE
                found.append(Event(kind, round(time_s * 1e9), offset))
        return sorted(found, key=lambda event: event.timestamp_ns)

    def release(self) -> None:
        self.settings = {}

    def _still(self) -> dict[int, tuple[float, int]]:
        """Return (time, number of changes) at which each line comes to rest in another state."""
        found = {}
        for offset, settings in self.settings.items():
            line = self._lines[offset]
            assert settings.active_low, "contacts to ground are closed when low"
            for count in range(line.taken + 1, len(line.changes_s) + 1):
                last_s = line.changes_s[count - 1]
                reported_s = _reported(last_s, settings.debounce_period.total_seconds())
                rests = count == len(line.changes_s) or line.changes_s[count] >= reported_s
                if rests and (count - line.taken) % 2:
                    found[offset] = (reported_s, count)
                    break
        return found

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error


def _reported(change_s: float, period_s: float) -> float:
    """Return when the kernel reports a change after which the line is still, s."""
    if not period_s:
        return change_s
    jiffies = math.floor(change_s / JIFFY_S) + math.ceil(period_s / JIFFY_S) + 1
    return jiffies * JIFFY_S
