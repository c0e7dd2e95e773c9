"""A signal at any point of an uninterrupted call takes effect when the call ends, not later."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest

from camctl.system import interrupts
from camctl.system.interrupts import Interrupt, run_interruptible, signal_handlers, uninterrupted


@pytest.fixture(autouse=True)
def python_handles_control_c() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def close_and_wait(k: int, *, with_signal: bool) -> tuple[list[str], list[str]]:
    """Close and then wait; send a signal at the k-th event in the code of camctl.system.interrupts.

    A profile function sends it, so that its handler finds the frame of that event.

    Args:
        k: 0 first
        with_signal: send another one while it closes

    Returns:
        what was done, and the events
    """
    done: list[str] = []
    events: list[str] = []

    @uninterrupted
    def close() -> None:
        if with_signal:
            signal.raise_signal(signal.SIGINT)
        done.append("closed")

    def profile(frame: FrameType, event: str, _argument: Any) -> None:
        if frame.f_globals is vars(interrupts) and frame.f_code.co_name != "_handle":
            events.append(f"{event} {frame.f_code.co_name}")
            if len(events) == k + 1:
                signal.raise_signal(signal.SIGINT)

    def work() -> None:
        sys.setprofile(profile)
        try:
            close()
        finally:
            sys.setprofile(None)
        done.append("waits")  # from here on nothing would raise a signal that was missed

    with signal_handlers():
        try:
            run_interruptible(work)
        except Interrupt:
            done.append("interrupted")
    return done, events


@pytest.mark.parametrize("with_signal", [False, True])
def test_a_signal_at_any_event_of_an_uninterrupted_call_is_raised_at_its_end(
    with_signal: bool,
) -> None:
    done, events = close_and_wait(1000, with_signal=with_signal)  # there are fewer
    assert done == ["closed", "interrupted" if with_signal else "waits"]
    assert {"call call", "call _raise_waiting", "return _raise_waiting"} <= set(events)
    for k in range(len(events)):
        done, _ = close_and_wait(k, with_signal=with_signal)
        assert done == ["closed", "interrupted"], events[k]
        # Nothing of it is left for the next command.
        assert close_and_wait(1000, with_signal=False)[0] == ["closed", "waits"], events[k]
