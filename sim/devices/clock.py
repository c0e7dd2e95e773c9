"""Clocks of virtual devices: what a device does by itself is a call scheduled on its clock.

A virtual device never sleeps.  A shutter that closes in 0.5 s, a frame slot that ends and a session
that times out are calls scheduled with `call_at`; a host that waits for bytes from the device waits
with `wait_for`.  With a `RealDeviceClock` the calls run in threads of their own.  With a
`VirtualDeviceClock` they run in the thread that waits, in the order of their times, so that a
driver and a device that are given the same clock share one virtual time.
"""

from __future__ import annotations

import heapq
import math
import threading
from collections.abc import Callable
from itertools import count
from typing import Protocol

from camctl.interface.clock import Clock, RealClock, VirtualClock


class ScheduledCall(Protocol):
    """A call that is due at some time."""

    def cancel(self) -> None:
        """Do not make the call, unless it has begun."""


class DeviceClock(Clock, Protocol):
    """A clock on which a virtual device schedules calls, and a host waits for the device."""

    def call_at(self, time_s: float, action: Callable[[], None]) -> ScheduledCall:
        """Call `action` once when `now()` has reached `time_s`; returns at once."""

    def wait_for(self, event: threading.Event, deadline_s: float = math.inf) -> bool:
        """Wait until `event` is set or `now()` has reached `deadline_s`; return whether it is."""


class RealDeviceClock(RealClock):
    """The machine's monotonic clock; each scheduled call has a thread of its own."""

    def call_at(self, time_s: float, action: Callable[[], None]) -> ScheduledCall:
        timer = threading.Timer(max(0.0, time_s - self.now()), action)
        timer.daemon = True
        timer.start()
        return timer

    def wait_for(self, event: threading.Event, deadline_s: float = math.inf) -> bool:
        if deadline_s == math.inf:
            return event.wait()
        return event.wait(max(0.0, deadline_s - self.now()))


class _VirtualCall:
    def __init__(self, action: Callable[[], None]) -> None:
        self.action: Callable[[], None] | None = action

    def cancel(self) -> None:
        self.action = None


class VirtualDeviceClock(VirtualClock):
    """A virtual time that a host and its virtual devices share.

    Time moves only while the host's thread is in `sleep_until` or `wait_for`, and goes from one
    scheduled call to the next, each made in that thread at exactly its time.  So a time-out of the
    host never comes before what a device does earlier, and a run has one outcome.  Everything else
    takes no virtual time.  One thread at a time may wait; other threads may schedule calls.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        super().__init__(start_s)
        self._calls: list[tuple[float, int, _VirtualCall]] = []  # a heap
        self._order = count()  # calls due at the same time run in the order of scheduling
        self._lock = threading.Lock()

    def sleep_until(self, deadline_s: float) -> None:
        """Make all calls due up to `deadline_s`, each at its time; then it is `deadline_s`."""
        while self._make_next_call(deadline_s):
            pass
        super().sleep_until(deadline_s)

    def call_at(self, time_s: float, action: Callable[[], None]) -> ScheduledCall:
        call = _VirtualCall(action)
        with self._lock:
            heapq.heappush(self._calls, (time_s, next(self._order), call))
        return call

    def wait_for(self, event: threading.Event, deadline_s: float = math.inf) -> bool:
        """Make calls due up to `deadline_s` until one of them sets `event`.

        Raises:
            RuntimeError: `deadline_s` is infinite and no scheduled call is left to set the event
        """
        while not event.is_set() and self._make_next_call(deadline_s):
            pass
        if event.is_set():
            return True
        if deadline_s == math.inf:
            raise RuntimeError(
                "endless wait in virtual time: no call is scheduled that could end it"
            )
        super().sleep_until(deadline_s)
        return False

    def _make_next_call(self, deadline_s: float) -> bool:
        """Make the first call due up to `deadline_s`; return whether there was one."""
        with self._lock:
            if not self._calls or self._calls[0][0] > deadline_s:
                return False
            time_s, _, call = heapq.heappop(self._calls)
        if call.action is not None:
            super().sleep_until(time_s)
            call.action()
        return True
