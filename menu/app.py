"""The menu's loop: keys and events go into the state machine, its work runs on a thread."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable

from camctl.captures.sequencer import Progress
from camctl.errors import CamctlError, InterruptedCaptureError, UsageError
from menu.machine import step
from menu.messages import (
    Cancel,
    Cancelled,
    Done,
    Effect,
    Event,
    Failed,
    MakePlan,
    Planned,
    Predict,
    Predicted,
    Progressed,
    Quit,
    Shoot,
)
from menu.model import Model, State
from menu.ports import SMALLEST, Cost, Job, Key, Panel, Summary
from menu.screens import limit_scrolling, screen

_log = logging.getLogger(__name__)

_KEY_WAIT_S = 0.05
"""Time to wait for a key before the next look at the worker's events, s."""

_STOP_WAIT_S = 10.0
"""Time that the camera has to finish its frame after the menu has ended, s."""

_MOST_DISCARDED_KEYS = 100
"""Keys to discard when the screen changes; a key that is stuck would never end."""


def run(panel: Panel, job: Job) -> Summary | None:
    """Run the menu on `panel` until the user quits; return the result of the last capture, if any.

    A `CamctlError` of the job is shown with buttons to retry, go back or quit.  Any other exception
    of the job is a programming error: it is shown in the same way, so that the user can keep or
    repeat the capture, and is raised from here once the panel is closed, or logged if a later try
    succeeded.  Errors of the panel are raised.  However this function ends, a running capture is
    cancelled.
    """
    worker = _Worker(job)
    try:
        with panel:
            model = _loop(panel, worker)
    finally:
        worker.stop()
    for error in worker.recovered_errors:
        _log.warning("internal error, a later try succeeded: %r", error)
    if worker.internal_error is not None:
        raise worker.internal_error
    return model.summary


def _loop(panel: Panel, worker: _Worker) -> Model:
    model, shown = Model(), None
    while model.state is not State.QUIT:
        columns, rows = size = panel.size
        if columns < SMALLEST[0] or rows < SMALLEST[1]:
            raise UsageError(
                f"the panel has only {columns} x {rows} characters",
                hint=f"the menu needs {SMALLEST[0]} x {SMALLEST[1]}",
            )
        before = model.state
        for event in worker.poll_events():
            model = _advance(model, event, worker)
        if model.state is not before:
            _discard_keys(panel)
        model = limit_scrolling(model, columns, rows)
        grid = screen(model, columns, rows)
        if (grid, size) != shown:
            panel.show(grid.lines, grid.highlight)
            shown = (grid, size)
        key = panel.key(_KEY_WAIT_S)
        if key is not None:
            model = _advance(model, key, worker)
    return model


def _advance(model: Model, given: Key | Event, worker: _Worker) -> Model:
    model, effect = step(model, given)
    if effect is not None:
        worker.start(effect)
    return model


def _discard_keys(panel: Panel) -> None:
    """Discard keys pressed before an event changed the screen: they were meant for the old one.

    Otherwise a second press of enter would shoot a plan that the user has not seen.
    """
    for _ in range(_MOST_DISCARDED_KEYS):
        if panel.key(0) is None:
            return


class _Worker:
    """Does the job's work on a thread, one piece after the other."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._tasks: queue.SimpleQueue[Predict | MakePlan | Shoot | None] = queue.SimpleQueue()
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._cancelled: dict[int, threading.Event] = {}
        self._stopped = threading.Event()
        self._latest_id = 0  # of the work that was started last
        self._latest_camera_id = 0  # of the work with the camera that was started last
        self._finished_camera_id = 0  # of the work with the camera that ended last
        self.internal_error: Exception | None = None
        self.recovered_errors: list[Exception] = []
        # A daemon thread, so that a prediction that is not needed any more cannot delay the exit.
        self._thread = threading.Thread(target=self._run, name="menu job", daemon=True)
        self._thread.start()

    def start(self, effect: Effect) -> None:
        """Start or cancel work; returns at once."""
        match effect:
            case Cancel(request_id=request_id):
                self._cancelled[request_id].set()
            case Quit():
                self._stopped.set()
            case Predict() | MakePlan() | Shoot():
                self._latest_id = effect.request_id
                if not isinstance(effect, Predict):
                    self._latest_camera_id = effect.request_id
                if isinstance(effect, Shoot):
                    self._cancelled[effect.request_id] = threading.Event()
                self._tasks.put(effect)

    def poll_events(self) -> list[Event]:
        """Return the events since the last call."""
        events = []
        while True:
            try:
                events.append(self._events.get_nowait())
            except queue.Empty:
                return events

    def stop(self) -> None:
        """Cancel all work, and wait up to `_STOP_WAIT_S` until the camera is idle."""
        self._stopped.set()
        for cancelled in self._cancelled.values():
            cancelled.set()
        self._tasks.put(None)
        if self._finished_camera_id != self._latest_camera_id:
            self._thread.join(_STOP_WAIT_S)

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None and not self._stopped.is_set():
            if task.request_id == self._latest_id:  # else the user has left it
                self._events.put(self._outcome(task))
            if not isinstance(task, Predict):
                self._finished_camera_id = task.request_id

    def _outcome(self, task: Predict | MakePlan | Shoot) -> Event:
        """Return the event that a task ends with, whether it succeeds or fails."""
        request_id = task.request_id
        try:
            event = self._result(task)
        except CamctlError as error:
            cancelled = isinstance(task, Shoot) and self._cancelled[request_id].is_set()
            if cancelled and isinstance(error, InterruptedCaptureError):
                return Cancelled(request_id, str(error))
            return Failed(request_id, str(error))
        except Exception as error:
            self.internal_error = error
            return Failed(request_id, f"internal error: {type(error).__name__}: {error}")
        if self.internal_error is not None:
            self.recovered_errors.append(self.internal_error)
            self.internal_error = None
        return event

    def _result(self, task: Predict | MakePlan | Shoot) -> Event:
        match task:
            case Predict(request_id=request_id, response=response, dynamic_range=dynamic_range):
                costs: list[Cost] = []
                for cost in self._job.predict(response, dynamic_range):
                    costs.append(cost)
                    if request_id != self._latest_id or self._stopped.is_set():
                        break
                    self._progress_callback(request_id)(Progress(len(costs), 0, "computed"))
                return Predicted(request_id, tuple(costs))
            case MakePlan(request_id=request_id, choice=choice):
                return Planned(request_id, self._job.plan(choice))
            case Shoot(request_id=request_id, plan=plan):
                summary = self._job.shoot(
                    plan, self._progress_callback(request_id), self._cancelled[request_id].is_set
                )
                return Done(request_id, summary)

    def _progress_callback(self, request_id: int) -> Callable[[Progress], None]:
        return lambda progress: self._events.put(Progressed(request_id, progress))
