"""Virtual time that a host and virtual devices share: order of calls, waits and time-outs."""

import math
import threading
from functools import partial

import pytest

from camctl.sim.devices.clock import RealDeviceClock, VirtualDeviceClock


def test_scheduled_calls_are_made_at_their_times_and_in_their_order() -> None:
    clock = VirtualDeviceClock(10.0)
    made: list[tuple[str, float]] = []

    def record(name: str) -> None:
        made.append((name, clock.now()))

    for name, time_s in (("late", 13.0), ("first", 11.0), ("second", 11.0), ("after", 15.5)):
        clock.call_at(time_s, partial(record, name))
    assert made == []
    clock.sleep_until(15.0)
    assert made == [("first", 11.0), ("second", 11.0), ("late", 13.0)]
    assert clock.now() == 15.0


def test_a_wait_ends_when_its_event_is_set() -> None:
    clock, event = VirtualDeviceClock(), threading.Event()
    clock.call_at(2.0, event.set)
    clock.call_at(3.0, lambda: pytest.fail("this call is due after the end of the wait"))
    assert clock.wait_for(event, 5.0)
    assert clock.now() == 2.0


def test_a_wait_without_its_event_lasts_until_the_deadline() -> None:
    clock, event = VirtualDeviceClock(), threading.Event()
    clock.call_at(2.0, event.set)
    assert not clock.wait_for(event, 1.5)
    assert clock.now() == 1.5
    assert clock.wait_for(event, 2.0)


def test_a_call_may_schedule_the_next_one() -> None:
    clock, times = VirtualDeviceClock(), []

    def tick() -> None:
        times.append(clock.now())
        clock.call_at(clock.now() + 1.0, tick)

    clock.call_at(1.0, tick)
    clock.sleep_until(3.5)
    assert times == [1.0, 2.0, 3.0]


def test_a_cancelled_call_is_not_made() -> None:
    clock = VirtualDeviceClock()
    clock.call_at(1.0, lambda: pytest.fail("it was cancelled")).cancel()
    clock.sleep_until(2.0)
    assert clock.now() == 2.0


def test_a_wait_that_nothing_can_end_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="endless wait in virtual time"):
        VirtualDeviceClock().wait_for(threading.Event(), math.inf)


def test_in_real_time_calls_are_made_by_other_threads() -> None:
    clock, event = RealDeviceClock(), threading.Event()
    callers: list[threading.Thread] = []

    def call() -> None:
        callers.append(threading.current_thread())
        event.set()

    due_s = clock.now() + 0.01
    clock.call_at(due_s, lambda: pytest.fail("it was cancelled")).cancel()
    clock.call_at(due_s, call)
    assert clock.wait_for(event)
    assert clock.now() >= due_s
    assert callers != [threading.current_thread()]
    event.clear()
    assert not clock.wait_for(event, clock.now() + 0.001)
