"""A job without a camera and a panel without a screen."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType
from typing import Self, TypeAlias

from camctl.captures.request import CapturePlan
from camctl.captures.sequencer import Progress
from camctl.controls import ExposureSetting
from camctl.errors import InterruptedCaptureError
from menu.ports import Choice, Cost, Highlight, Key, Summary

COSTS = tuple(
    Cost(count, tuple(9.91**i for i in range(count)), 9.91**count / 9, 150.0 * count)
    for count in range(1, 7)
)

Script: TypeAlias = list[tuple[str, Key | Callable[[], object]]]
"""Texts to wait for on the screen, each with the key to press or the function to call then."""

MOST_SILENCE_S = 60.0
"""A screen that does not change for this long, s, will never change: the script is wrong."""


def plan_of(
    settings: Sequence[ExposureSetting], response: str = "log", dynamic_range: float = 1000.0
) -> CapturePlan:
    """Return a plan with these settings."""
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
    """A job that records its calls.

    `before` maps the name of a method to a function that is called first and may raise.  A capture
    stays at its first frame while `frame_may_end` is cleared.
    """

    def __init__(self) -> None:
        self.shot: list[CapturePlan] = []
        self.planned: list[Choice] = []
        self.predicted: list[tuple[str, float]] = []
        self.before: dict[str, Callable[[], object]] = {}
        self.frame_started = threading.Event()
        self.frame_may_end = threading.Event()
        self.frame_may_end.set()

    def _call_before(self, method: str) -> None:
        self.before.get(method, lambda: None)()

    def predict(self, response: str, dynamic_range: float) -> Iterable[Cost]:
        """Return `COSTS`."""
        self.predicted.append((response, dynamic_range))
        self._call_before("predict")
        return COSTS

    def plan(self, choice: Choice) -> CapturePlan:
        """Return a plan with one setting for each exposure of `choice`."""
        self.planned.append(choice)
        self._call_before("plan")
        times = (0.0033 * 9.91**i for i in range(choice.count))
        settings = [ExposureSetting(time_s) for time_s in times]
        return plan_of(settings, choice.response, choice.dynamic_range)

    def shoot(
        self,
        plan: CapturePlan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Return a summary once `frame_may_end` is set; raise when cancelled before."""
        self.shot.append(plan)
        self._call_before("shoot")
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
    """A panel that presses the keys of a script, each once its text is on the screen."""

    def __init__(self, script: Script, size: tuple[int, int] = (20, 4)) -> None:
        self.script: Script = list(script)
        self.size = size
        self.typed_ahead: list[Key] = []
        self.lines: tuple[str, ...] = ()
        self.screens: list[tuple[str, ...]] = []
        self.open = False
        self._last_change = time.monotonic()

    def __enter__(self) -> Self:
        """Open the panel."""
        self.open = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the panel."""
        self.open = False

    def show(self, lines: Sequence[str], highlight: Highlight | None = None) -> None:
        """Record the lines."""
        assert self.open
        assert [len(line) for line in lines] == [self.size[0]] * self.size[1]
        self.lines = tuple(lines)
        self.screens.append(self.lines)
        self._last_change = time.monotonic()

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key of the script once its text is shown, else None."""
        silence_s = time.monotonic() - self._last_change
        assert silence_s < MOST_SILENCE_S, f"waits for {self.script[:1]}, shows {self.lines}"
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
