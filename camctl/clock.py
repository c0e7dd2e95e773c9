"""Time as a port: real for a person, virtual for a test that must be exact and at once."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds since an arbitrary zero, never going back."""

    def now(self) -> float:
        """Return the time, s."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Return once `now()` has reached `deadline_s`; at once if it already has."""
        ...


class RealClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep until the monotonic clock shows `deadline_s`."""
        while (left := deadline_s - time.monotonic()) > 0:
            time.sleep(left)


class VirtualClock:
    """A clock that moves only when somebody sleeps on it, exactly to where they asked."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now(self) -> float:
        """Return the virtual time, s."""
        return self._now_s

    def sleep_until(self, deadline_s: float) -> None:
        """Jump to `deadline_s`."""
        self._now_s = max(self._now_s, deadline_s)
