"""Waiting for live results: in this thread and others, in coroutines, and in real time."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from typing import Any

import pytest
from small_cameras import GIVEN

import camctl
from camctl.errors import CameraClosedError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Policy


def real_time() -> camctl.Camera:
    return camctl.open_camera("sim", scene="uniform", size="64x48", time="real", sensor="standard")


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until something has happened, for as long as a busy machine may take."""
    ends = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < ends
        time.sleep(0.01)


def test_a_slow_consumer_gets_the_latest_result_or_all() -> None:
    with real_time() as opened:
        with camctl.live(opened, GIVEN) as live:
            first = next(live)
            wait_for(lambda: live._count > first.number + 6)
            assert next(live).number > first.number + 5
        with camctl.live(opened, GIVEN, policy="all") as live:
            first = next(live)
            time.sleep(0.5)  # more frames than the camera's queue holds
            assert next(live).number == first.number + 1
            next(live)
            assert live.lost > 0


class Gate:
    """A cycle that gives some frames and then none until it is opened."""

    def __init__(self, cycle: Any, frames: int) -> None:
        self._cycle, self._left = cycle, frames
        self.waits, self.opened = threading.Event(), threading.Event()

    def __next__(self) -> Frame:
        self._left -= 1
        if self._left < 0:
            self.waits.set()
            self.opened.wait(60)
        frame: Frame = next(self._cycle)
        return frame

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cycle, name)


def test_a_result_that_is_there_is_given_while_the_next_frame_is_waited_for() -> None:
    with real_time() as opened, camctl.live(opened, GIVEN) as live:
        first = next(live)
        live._cycle = gate = Gate(live._cycle, 5)
        assert gate.waits.wait(60)
        found: list[LiveResult] = []
        consumer = threading.Thread(target=lambda: found.append(next(live)), daemon=True)
        consumer.start()
        consumer.join(10)
        gate.opened.set()
        assert not consumer.is_alive()
        assert found[0].number > first.number


def test_a_stream_in_real_time_states_its_latency_and_becomes_exact() -> None:
    with real_time() as opened, camctl.live(opened, GIVEN, policy="all") as live:
        for result in islice(live, 200):
            assert 0 < result.latency_s <= opened.clock.now() - result.time_s
            if result.is_exact:
                break
    assert result.is_exact


def test_another_thread_ends_the_stream() -> None:
    with real_time() as opened:
        live = camctl.live(opened, GIVEN)
        found: list[int] = []
        begun = threading.Event()

        def consume() -> None:
            for result in live:
                found.append(result.number)
                begun.set()

        consumer = threading.Thread(target=consume)
        consumer.start()
        assert begun.wait(10)
        live.change(CaptureRequest(base_s=0.002, ratios=(1, 5), dynamic_range=64))
        wait_for(lambda: live.plan is not None and len(live.plan.settings) == 2)
        live.close()
        consumer.join(10)
        assert not consumer.is_alive()
        live.close()
        assert next(iter(live), None) is None


def test_the_stream_is_an_async_iterator() -> None:
    async def consume() -> list[int]:
        found = []
        with real_time() as opened, camctl.live(opened, GIVEN, policy="all") as live:
            async for result in live:
                found.append(result.number)
                if len(found) == 5:
                    break
        return found

    assert asyncio.run(consume()) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("time_kind", ["virtual", "real"])
def test_a_cancelled_wait_loses_no_result(time_kind: str) -> None:
    """With a time-out for each, as programs wait for one thing among others."""
    options = {"scene": "uniform", "size": "64x48", "time": time_kind, "sensor": "standard"}

    async def consume() -> list[int]:
        found: list[int] = []
        with camctl.open_camera("sim", options) as opened:
            live = camctl.live(opened, GIVEN, policy="all")
            cancelled = 0
            while len(found) < 8:
                try:
                    found.append((await asyncio.wait_for(anext(live), 0.003)).number)
                except TimeoutError:
                    cancelled += 1
                waiting = asyncio.ensure_future(anext(live))
                await asyncio.sleep(0)
                waiting.cancel()
                with suppress(asyncio.CancelledError):
                    await waiting
                    found.append(waiting.result().number)
            if time_kind == "real":
                assert cancelled
            found.append(next(live).number)
            live.close()
            with pytest.raises(StopAsyncIteration):
                await anext(live)
        return found

    found = asyncio.run(consume())
    assert found == list(range(len(found)))


@pytest.mark.parametrize("policy", ["latest", "all"])
def test_a_camera_that_its_owner_closed_stays_closed(policy: Policy) -> None:
    with real_time() as opened:
        live = camctl.live(opened, GIVEN, policy=policy)
        next(live)
    with pytest.raises(CameraClosedError):
        list(islice(live, 100))
    assert not live.is_waiting
    live.close()
