"""A signal at any point of an uninterrupted call takes effect when the call ends, not later."""

from __future__ import annotations

import concurrent.futures
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
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


def locked_after(k: int, wait: Callable[[list[Future[int]]], object]) -> int | None:
    """Return how many futures are locked after a signal at the k-th event of a wait for them.

    None: there are fewer events.
    """
    futures: list[Future[int]] = [Future(), Future()]
    futures[0].set_result(1)
    counted = 0

    def profile(frame: FrameType, _event: str, _argument: Any) -> None:
        nonlocal counted
        if frame.f_code.co_filename in (concurrent.futures._base.__file__, threading.__file__):
            counted += 1
            if counted == k + 1:
                interrupts._handle(signal.SIGINT, frame)

    def work() -> None:
        sys.setprofile(profile)
        try:
            wait(futures)
        finally:
            sys.setprofile(None)
        if counted > k:
            time.sleep(10)  # a signal that waits interrupts it
            raise AssertionError("no signal")

    with signal_handlers(), suppress(Interrupt):
        run_interruptible(work)
    if counted <= k:
        return None

    def is_locked(future: Future[int]) -> bool:
        is_free = future._condition.acquire(blocking=False)
        if is_free:
            future._condition.release()
        return not is_free

    with ThreadPoolExecutor(1) as another:
        return sum(another.map(is_locked, futures))


@pytest.mark.parametrize(
    "wait",
    [
        lambda futures: concurrent.futures.wait(
            futures, return_when=concurrent.futures.FIRST_COMPLETED
        ),
        lambda futures: next(concurrent.futures.as_completed(futures)),
    ],
    ids=["wait", "as_completed"],
)
def test_a_signal_at_any_event_of_a_wait_leaves_no_future_locked(
    monkeypatch: pytest.MonkeyPatch, wait: Callable[[list[Future[int]]], object]
) -> None:
    monkeypatch.setattr(interrupts, "_REPEAT_S", 1e-3)
    for k in range(1000):
        locked = locked_after(k, wait)
        if locked is None:
            break
        assert locked == 0, k
    assert 10 < k < 1000
