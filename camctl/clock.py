"""Clocks: real time for cameras, virtual time for tests that are exact and take no time."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """A monotonic clock: seconds since an arbitrary zero."""

    def now(self) -> float:
        """Return the time, s."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Return when `now()` has reached `deadline_s`, immediately if it already has."""
        ...


class RealClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep until the monotonic clock shows `deadline_s`."""
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            time.sleep(remaining_s)


class VirtualClock:
    """A clock that advances only by `sleep_until`, exactly to its deadline, without waiting.

    >>> clock = VirtualClock()
    >>> clock.sleep_until(3600.0)
    >>> clock.now()
    3600.0
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now(self) -> float:
        """Return the virtual time, s."""
        return self._now_s

    def sleep_until(self, deadline_s: float) -> None:
        """Jump to `deadline_s`."""
        self._now_s = max(self._now_s, deadline_s)
