"""A job without a camera and a panel without a screen."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from camctl.errors import InterruptedCaptureError
from menu.ports import Choice, Cost, Highlight, Key, Summary

COSTS = tuple(
    Cost(count, tuple(9.91**i for i in range(count)), 9.91**count / 9, 150.0 * count)
    for count in range(1, 7)
)


def plan_of(
    settings: Sequence[ExposureSetting], response: str = "log", dynamic_range: float = 1000.0
) -> CapturePlan:
    smallest = min(setting.exposure for setting in settings)
    exposures = tuple(setting.exposure / smallest for setting in settings)
    return CapturePlan(
        response=response,
        dynamic_range=dynamic_range,
        ratios=exposures,
        settings=tuple(settings),
        exposures=exposures,
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=255.0 * len(settings),
        xi=219.81,
        effective_levels=391.7,
    )


class FakeJob:
    """Does what it is told to do: each hook may raise."""

    def __init__(self) -> None:
        self.shot: list[CapturePlan] = []
        self.planned: list[Choice] = []
        self.predicted: list[tuple[str, float]] = []
        self.before: dict[str, Callable[[], object]] = {}
        self.frame_started = threading.Event()
        self.frame_may_end = threading.Event()
        self.frame_may_end.set()

    def _at(self, name: str) -> None:
        self.before.get(name, lambda: None)()

    def predict(self, response: str, dynamic_range: float) -> Sequence[Cost]:
        self.predicted.append((response, dynamic_range))
        self._at("predict")
        return COSTS

    def plan(self, choice: Choice) -> CapturePlan:
        self.planned.append(choice)
        self._at("plan")
        times = (0.0033 * 9.91**i for i in range(choice.count))
        settings = [ExposureSetting(time_s) for time_s in times]
        return plan_of(settings, choice.response, choice.dynamic_range)

    def shoot(
        self,
        plan: CapturePlan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        self.shot.append(plan)
        self._at("shoot")
        for done in range(len(plan.settings)):
            on_progress(Progress(done, len(plan.settings), "shooting"))
            self.frame_started.set()
            while not self.frame_may_end.wait(0.005):
                if cancelled():
                    raise InterruptedCaptureError(
                        f"stopped after {done} frames", hint="camctl shoot --resume x"
                    )
        return Summary(390.0, 0.0031, "captures/x")


class ScriptedPanel:
    """Presses each key once certain words are shown; fails where they never come.

    A callable in place of a key is called then.
    """

    def __init__(
        self,
        script: Sequence[tuple[str, Key | Callable[[], object]]],
        size: tuple[int, int] = (20, 4),
    ) -> None:
        self.script = list(script)
        self.size = size
        self.typed_ahead: list[Key] = []
        self.lines: tuple[str, ...] = ()
        self.seen: list[tuple[str, ...]] = []
        self.open = False
        self._deadline = time.monotonic() + 20

    def __enter__(self) -> Self:
        self.open = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.open = False

    def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
        assert self.open
        assert [len(line) for line in lines] == [self.size[0]] * self.size[1]
        self.lines = tuple(lines)
        self.seen.append(self.lines)

    def key(self, timeout_s: float) -> Key | None:
        assert time.monotonic() < self._deadline, f"waits for {self.script[:1]} at {self.lines}"
        if self.typed_ahead:
            return self.typed_ahead.pop(0)
        if timeout_s == 0 or not self.script or self.script[0][0] not in " ".join(self.lines):
            time.sleep(min(timeout_s, 0.002))
            return None
        _, key = self.script.pop(0)
        if isinstance(key, Key):
            return key
        key()
        return None
