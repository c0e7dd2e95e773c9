"""A job without a camera and a panel without a screen."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Self, TypeAlias

from camctl.errors import InterruptedCaptureError
from camctl.menu.data import (
    Calibrated,
    CameraEntry,
    Choice,
    Cost,
    Loaded,
    Past,
    Picture,
    Plan,
    Progress,
    Reading,
    SeriesChoice,
    Settings,
    Summary,
    Traced,
)
from camctl.menu.layout import grid
from camctl.menu.ports import Key, Screen

COST = Cost(3, 1.79, 1.88, 99.6, True)
FRONT = tuple(
    Cost(n, 0.9 * time_s, time_s, levels, True, dynamic_range=1000.0, is_recommended=n == 6)
    for n, time_s, levels in ((3, 0.72, 74.7), (6, 1.33, 105.1), (12, 3.14, 163.1))
)
CAMERA = CameraEntry("sim", "Simulated phone")
OTHER_CAMERA = CameraEntry("v4l2:/dev/video0", "HD Webcam")
PICTURE = Picture(4, 3, bytes(range(0, 252, 7)))
HISTOGRAM = tuple(index / 120 for index in range(16))
READING = Reading(0.0199, 0.0012, HISTOGRAM, PICTURE, 12_300_000_000, CAMERA)
SUMMARY = Summary(
    97.0, 390.0, True, 98.4, 0.0031, "captures/x", histogram=HISTOGRAM, picture=PICTURE
)
CAPTURES = (Past("capture-0002-20261122-083000", False), Past("capture-0001", True))

Script: TypeAlias = list[tuple[str, Key | Callable[[], object]]]
"""Texts to wait for on the screen, each with the key to press or the function to call then."""

TO_REVIEW: Script = [
    ("[Set]", Key.ENTER),
    ("Desired", Key.ENTER),
    ("Dynamic", Key.ENTER),
    ("Exposures", Key.ENTER),
]
"""The keys from the idle screen to the review, with the defaults."""

MOST_SILENCE_S = 20.0
"""A screen that does not change for this long, s, will never change: the script is wrong."""


def quit_from(title: str) -> Script:
    """Return the keys from a page whose exit key leads to the idle screen to the end."""
    return [(title, Key.EXIT), ("[Set]", Key.EXIT), ("Quit", Key.RIGHT), ("[Quit]", Key.ENTER)]


def plan_of(times: Sequence[float]) -> Plan:
    """Return a plan with these shutter times, s."""
    return Plan(
        frames=tuple((f"{time_s:.7g} s", time_s / min(times)) for time_s in times),
        shutter_s=sum(times),
        wall_s=sum(times) + 0.1,
        is_wall_known=True,
        effective_levels=98.4,
        effective_levels_noise_free=391.7,
        noise_known=True,
        xi=219.81,
        levels_wanted=255.0 * len(times),
        dynamic_range=1000.0,
        needed_bytes=40_000_000,
        free_bytes=12_300_000_000,
        handle=object(),
    )


class FakeJob:
    """A job that records its calls.

    `before` maps the name of a method to a function that is called first and may raise.  A capture
    stays at its first frame while `frame_may_end` is cleared.
    """

    def __init__(self) -> None:
        self.shot: list[Plan] = []
        self.planned: list[Choice] = []
        self.predicted: list[Choice] = []
        self.traced: list[Choice] = []
        self.resumed: list[Past] = []
        self.series_taken: list[SeriesChoice] = []
        self.calibrated: list[str] = []
        self.saved: list[Settings] = []
        self.opened: list[str] = []
        self.running = 0  # captures at the same time
        self.closed = False
        self.before: dict[str, Callable[[], object]] = {}
        self.frame_started = threading.Event()
        self.frame_may_end = threading.Event()
        self.frame_may_end.set()

    def _call_before(self, method: str) -> None:
        self.before.get(method, lambda: None)()

    def load(self) -> Loaded:
        """Return the defaults."""
        self._call_before("load")
        return Loaded(Settings())

    def save(self, settings: Settings) -> None:
        """Record the settings."""
        self._call_before("save")
        self.saved.append(settings)

    def find_cameras(self) -> tuple[CameraEntry, ...]:
        """Return two cameras."""
        self._call_before("find_cameras")
        return (CAMERA, OTHER_CAMERA)

    def open(self, camera_id: str) -> CameraEntry:
        """Return the camera of this id."""
        self.opened.append(camera_id)
        self._call_before("open")
        return OTHER_CAMERA if camera_id == OTHER_CAMERA.id else CAMERA

    def meter(self) -> Reading:
        """Return `READING`."""
        self._call_before("meter")
        return READING

    def predict(self, choices: Sequence[Choice], cancelled: Callable[[], bool]) -> Iterator[Cost]:
        """Yield `COST` for each choice."""
        self.predicted += choices
        self._call_before("predict")
        for _ in choices:
            yield COST

    def trace(self, choice: Choice, cancelled: Callable[[], bool]) -> Traced:
        """Return three points, the second recommended."""
        self.traced.append(choice)
        self._call_before("trace")
        return Traced(FRONT)

    def plan(self, choice: Choice, cancelled: Callable[[], bool]) -> Plan:
        """Return a plan with one exposure for each of `choice`."""
        self.planned.append(choice)
        self._call_before("plan")
        return plan_of([0.0033 * 9.91**index for index in range(choice.count or 3)])

    def shoot(
        self,
        plan: Plan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Return a summary once `frame_may_end` is set; raise when cancelled before."""
        self.shot.append(plan)
        self._call_before("shoot")
        return self._capture(len(plan.frames), on_progress, cancelled)

    def resume(
        self,
        past: Past,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Do as `shoot` does."""
        self.resumed.append(past)
        self._call_before("resume")
        return self._capture(2, on_progress, cancelled)

    def series(
        self,
        series: SeriesChoice,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Do as `shoot` does, with the pictures in place of frames."""
        self.series_taken.append(series)
        self._call_before("series")
        return self._capture(series.count, on_progress, cancelled)

    def calibrate(
        self,
        scene: str,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Calibrated:
        """Return one line once `frame_may_end` is set; raise when cancelled before."""
        self.calibrated.append(scene)
        self._call_before("calibrate")
        self._capture(2, on_progress, cancelled)
        return Calibrated((f"{scene}: 4 frames",))

    def _capture(
        self, count: int, on_progress: Callable[[Progress], None], cancelled: Callable[[], bool]
    ) -> Summary:
        self.running += 1
        assert self.running == 1, "two captures at the same time"
        try:
            for done in range(count):
                on_progress(Progress(done, count, "shooting", done / count))
                self.frame_started.set()
                while not self.frame_may_end.wait(0.005):
                    if cancelled():
                        raise InterruptedCaptureError(
                            f"stopped after {done} frames", remedies={"resume": "x"}
                        )
            return SUMMARY
        finally:
            self.running -= 1

    def captures(self) -> tuple[Past, ...]:
        """Return `CAPTURES`."""
        self._call_before("captures")
        return CAPTURES

    def look(self, past: Past) -> Summary:
        """Return `SUMMARY`."""
        self._call_before("look")
        return SUMMARY

    def close(self) -> None:
        """Record that the camera is closed."""
        self.closed = True


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

    def __exit__(self, *_: object) -> None:
        """Close the panel."""
        self.open = False

    def show(self, screen: Screen) -> int:
        """Record the lines."""
        assert self.open
        shown = grid(screen, *self.size)
        assert [len(line) for line in shown.lines] == [self.size[0]] * self.size[1]
        if shown.lines != self.lines:
            self._last_change = time.monotonic()
            self.lines = shown.lines
            self.screens.append(self.lines)
        return shown.last_offset

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
