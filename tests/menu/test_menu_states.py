"""A model of the menu against the implementation: random keys, faults, reconnects and time.

The implementation is the real loop with its screens, on a panel that may be unplugged at any call.
Work ends when a run says so, and is that of a fake job; `test_app` has the real worker and its
thread, `test_camera_job` a camera.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Self, cast

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from panel_fakes import FakeJob

from camctl.errors import (
    CameraDisconnectedError,
    CaptureError,
    InterruptedCaptureError,
)
from camctl.menu.app import Session
from camctl.menu.data import Calibrated, Settings
from camctl.menu.layout import grid
from camctl.menu.model import State
from camctl.menu.ports import Key, PanelDisconnectedError, Screen
from camctl.menu.screens import screen
from camctl.menu.tables import STATES, Cancel, Effect, Event, Outcome, Start, Work
from camctl.menu.worker import Worker

SIZE = (20, 4)
CAPTURES = (Work.SHOOT, Work.RESUME, Work.SERIES)


class HandWorker:
    """A worker whose work ends when the test says so."""

    def __init__(self) -> None:
        self.running: list[Start] = []
        self.cancelled: set[int] = set()
        self.started: list[Start] = []
        self.events: list[Event] = []

    def start(self, effect: Effect) -> None:
        """Start or cancel work."""
        if isinstance(effect, Cancel):
            self.cancelled.add(effect.request_id)
            return
        if effect.work in CAPTURES:
            assert not [each for each in self.running if each.work in CAPTURES], "two captures"
        # Work that the user has left ends without a result, but a capture never does.
        self.running = [each for each in self.running if each.work in CAPTURES]
        self.running.append(effect)
        self.started.append(effect)

    def save(self, settings: Settings) -> None:
        """Do nothing."""

    def poll_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self.events = self.events, []
        return events

    def stop(self) -> None:
        """Do nothing."""


class _ScriptEndedError(Exception):
    """The panel has no more keys for now."""


class FlakyPanel:
    """A panel that returns the keys of a script, and is unplugged at each None in it."""

    def __init__(self, script: list[Key | None]) -> None:
        self.script = script
        self.shown: Screen | None = None
        self.on_key: Callable[[], None] = lambda: None

    def __enter__(self) -> Self:
        """Open the panel, dark, where it is plugged in again."""
        self._unplug_if_next()
        self.shown = None
        return self

    def __exit__(self, *_: object) -> None:
        """Close the panel."""

    def show(self, screen: Screen) -> int:
        """Keep the screen."""
        self._unplug_if_next()
        self.shown = screen
        return grid(screen, *SIZE).last_offset

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key; without a timeout no key has been pressed before."""
        if timeout_s == 0:
            return None
        self.on_key()
        self._unplug_if_next()
        if not self.script:
            raise _ScriptEndedError
        return self.script.pop(0)

    def _unplug_if_next(self) -> None:
        if self.script and self.script[0] is None:
            self.script.pop(0)
            raise PanelDisconnectedError("unplugged")


class MenuMachine(RuleBasedStateMachine):
    """Drives the menu; `wanted_cancel` is the capture that the user has asked to cancel."""

    def __init__(self) -> None:
        super().__init__()
        self.job = FakeJob()
        self.worker = HandWorker()
        self.now_s = 0.0
        self.session = Session(cast(Worker, self.worker), lambda: self.now_s)
        self.camera_is_there = True
        self.keys_since_event = 0

    @property
    def state(self) -> State:
        return self.session.model.state

    def shown(self) -> Screen:
        return screen(self.session.model)

    @precondition(lambda self: self.state is not State.QUIT)
    @rule(key=st.sampled_from(list(Key)))
    def press(self, key: Key) -> None:
        self.session.press(key)

    @precondition(lambda self: self.state is not State.QUIT)
    @rule(keys=st.lists(st.sampled_from([Key.ENTER, Key.ENTER, Key.DOWN, Key.EXIT]), max_size=6))
    def press_several(self, keys: list[Key]) -> None:
        for key in keys:
            if self.state is not State.QUIT:
                self.session.press(key)

    @precondition(lambda self: self.state in (State.IDLE, State.RESULT, State.CANCELLED))
    @rule()
    def begin_a_capture(self) -> None:
        """Press the keys of a user who wants a picture, so that runs come to captures often."""
        if self.state is not State.IDLE:
            self.session.press(Key.EXIT)
        for _ in range(30):
            if self.state not in (State.SHOOTING, State.CAMERA_FAILED, State.PLAN_FAILED):
                while self.state is State.PLANNING and self.worker.running:
                    self._end(self.worker.running.pop(), succeeds=self.camera_is_there)
                self.session.press(Key.ENTER)

    @rule(by_s=st.sampled_from([0.5, 1.0, 3.0, 10.0, 400.0]))
    def wait(self, by_s: float) -> None:
        self.now_s += by_s
        self.session.pump()

    @precondition(lambda self: self.state is not State.QUIT)
    @rule(script=st.lists(st.sampled_from([None, *Key]), max_size=12))
    def use_a_panel_that_is_unplugged(self, script: list[Key | None]) -> None:
        """At each key the panel shows the screen of the menu's state, also after it was away."""
        panel = FlakyPanel([Key.DOWN, *script])  # what was open once is waited for

        def check() -> None:
            assert panel.shown is not None
            assert grid(panel.shown, *SIZE) == grid(self.shown(), *SIZE)

        def wait(seconds: float) -> None:
            self.now_s += seconds

        panel.on_key = check
        with suppress(_ScriptEndedError):
            self.session.use(panel, wait)

    @rule()
    def unplug_or_plug_in_the_camera(self) -> None:
        self.camera_is_there = not self.camera_is_there

    @precondition(lambda self: bool(self.worker.running))
    @rule(succeeds=st.booleans())
    def work_ends(self, succeeds: bool) -> None:
        self._end(self.worker.running.pop(), succeeds=succeeds and self.camera_is_there)

    def _end(self, task: Start, *, succeeds: bool) -> None:
        outcome = Outcome.DONE
        value: object = None
        if task.request_id in self.worker.cancelled:
            outcome = Outcome.CANCELLED
            value = str(InterruptedCaptureError("cancelled"))
        elif not succeeds and task.work is not Work.LOAD:
            outcome = Outcome.FAILED
            value = str(CameraDisconnectedError("the camera was disconnected"))
        else:
            value = self._value(task)
        self.worker.events.append(Event(outcome, task.request_id, value))
        self.session.pump()

    def _value(self, task: Start) -> object:
        calls: dict[Work, Callable[[], object]] = {
            Work.LOAD: self.job.load,
            Work.OPEN: lambda: self.job.open(""),
            Work.METER: self.job.meter,
            Work.FIND: self.job.find_cameras,
            Work.BROWSE: self.job.captures,
            Work.PREDICT: lambda: None,
            Work.TRACE: lambda: self.job.trace(task.argument, lambda: False),  # type: ignore[arg-type]  # a choice
            Work.PLAN: lambda: self.job.plan(task.argument, lambda: False),  # type: ignore[arg-type]  # a choice
            Work.CALIBRATE: lambda: Calibrated(("noise: 3 electrons",)),
            Work.LOOK: lambda: self.job.look(task.argument),  # type: ignore[arg-type]  # a capture
        }
        if task.work in CAPTURES:
            return self.job._capture(2, lambda _: None, lambda: False)
        return calls[task.work]()

    @rule(outcome=st.sampled_from(list(Outcome)), back=st.integers(1, 5))
    def late_event_arrives(self, outcome: Outcome, back: int) -> None:
        """An event of work that was left must change nothing."""
        if outcome in (Outcome.TICK, Outcome.UNUSED, Outcome.NOTE):
            return
        before = self.session.model
        late = before.request_id - back
        self.worker.events.append(Event(outcome, late, str(CaptureError("late"))))
        self.session.pump()
        assert self.session.model == before or self.state is State.SAVER

    @invariant()
    def the_screen_tells_the_truth(self) -> None:
        shown, model = self.shown(), self.session.model
        result = grid(shown, *SIZE)
        assert [len(line) for line in result.lines] == [SIZE[0]] * SIZE[1]
        if self.state is State.SAVER:
            return
        text = " ".join(" ".join(line.texts) for line in shown.lines)
        if self.state is State.REVIEW:
            assert model.plan is not None
            assert model.plan.frames[0][0] in text
        if self.state in (State.RESULT, State.PAST):
            assert model.summary is not None
        running = [each for each in self.worker.running if each.work in CAPTURES]
        if running:
            shows = {State.SHOOTING, State.RESUMING, State.SERIES_SHOOTING}
            busy = {*shows, State.CANCELLING, State.STOPPING, State.QUIT}
            assert self.state in busy, "a capture runs behind a screen that does not show it"
        if self.state in (State.SHOOTING, State.RESUMING, State.SERIES_SHOOTING):
            assert running, "the screen shows a capture that does not run"

    @invariant()
    def no_capture_starts_without_a_review(self) -> None:
        for effect in self.worker.started:
            if effect.work is Work.SHOOT:
                assert effect.argument is not None

    @invariant()
    def cancel_reaches_the_capture(self) -> None:
        if self.state in (State.CANCELLING, State.STOPPING):
            assert self.session.model.request_id in self.worker.cancelled

    @invariant()
    def the_user_is_never_stuck(self) -> None:
        """Waiting work that ends, and the exit and back keys, lead to a list or a page."""
        spec = STATES[self.state]
        waits = self.state not in (State.TIMER, State.SAVER, State.QUIT)
        if spec.kind.value == "wait" and waits:
            assert self.worker.running, f"{self.state} waits for nothing"

    def teardown(self) -> None:
        """From wherever the run has ended, keys and the end of work lead to the idle screen."""
        self.camera_is_there = True
        for _ in range(60):
            if self.state in (State.IDLE, State.QUIT):
                break
            while self.worker.running:
                self._end(self.worker.running.pop(), succeeds=True)
            if self.state is State.CONFIRM:
                self.session.press(Key.ENTER)  # the button that is selected is "Back"
            elif self.state not in (State.IDLE, State.QUIT):
                self.session.press(Key.EXIT)
            self.now_s += 1.0
            self.session.pump()
        assert self.state in (State.IDLE, State.QUIT)


TestMenu = MenuMachine.TestCase
TestMenu.settings = settings(stateful_step_count=60, max_examples=settings().max_examples // 3)


class AllExamples(MenuMachine):
    """The same with all examples of the profile."""


TestMenuLonger = pytest.mark.slow(AllExamples.TestCase)
TestMenuLonger.settings = settings(stateful_step_count=60)
