"""The menu at work: a panel in front, the machine in the middle, the job behind, on a thread."""

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
from menu.screens import screen, settled

_log = logging.getLogger(__name__)

_KEY_WAIT_S = 0.05  # between two looks at what the worker has to say
_GRACE_S = 10.0  # for a camera to finish its frame after somebody has left


def run(panel: Panel, job: Job) -> Summary | None:
    """Run the menu on `panel` until somebody quits; return what the last capture gave, if any.

    A `CamctlError` of the job is shown with a way on.  Any other exception of the job is a fault of
    the program: it is shown in the same way, so that what was shot can be kept and tried again, and
    raised from here once the panel is closed, unless later work has succeeded (then it is logged).
    Errors of the panel are raised.  A running capture is cancelled on every way out.
    """
    worker = _Worker(job)
    try:
        with panel:
            model = _loop(panel, worker)
    finally:
        worker.stop()
    for fault in worker.overcome:
        _log.warning("a fault of the program, overcome by a later try: %r", fault)
    if worker.fault is not None:
        raise worker.fault
    return model.summary


def _loop(panel: Panel, worker: _Worker) -> Model:
    model, shown = Model(), None
    while model.state is not State.QUIT:
        columns, rows = size = panel.size
        if columns < SMALLEST[0] or rows < SMALLEST[1]:
            raise UsageError(
                f"the panel shows {columns} x {rows} characters",
                hint=f"the menu needs {SMALLEST[0]} x {SMALLEST[1]}",
            )
        before = model.state
        for event in worker.news():
            model = _advance(model, event, worker)
        if model.state is not before:
            _forget_keys(panel)
        model = settled(model, columns, rows)
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
        worker.carry_out(effect)
    return model


def _forget_keys(panel: Panel) -> None:
    """Drop keys pressed before the screen changed by itself: they were meant for the last one.

    Else an impatient second press of enter would shoot a plan that nobody has seen.
    """
    for _ in range(100):  # a stuck key never ends
        if panel.key(0) is None:
            return


class _Worker:
    """Does the job's work on a thread of its own, one piece after the other."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._tasks: queue.SimpleQueue[Predict | MakePlan | Shoot | None] = queue.SimpleQueue()
        self._news: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._cancelled: dict[int, threading.Event] = {}
        self._stopped = threading.Event()
        self._asked = 0  # ticket of the work asked for last
        self._camera_asked = 0  # of that which uses the camera
        self._camera_left = 0  # of that which has let go of the camera
        self.fault: Exception | None = None
        self.overcome: list[Exception] = []
        # A daemon, so that a prediction that nobody waits for any more does not keep the program.
        self._thread = threading.Thread(target=self._work, name="menu job", daemon=True)
        self._thread.start()

    def carry_out(self, effect: Effect) -> None:
        """Start or call off some work; returns at once."""
        match effect:
            case Cancel(ticket=ticket):
                self._cancelled[ticket].set()
            case Quit():
                self._stopped.set()
            case Predict() | MakePlan() | Shoot():
                self._asked = effect.ticket
                if not isinstance(effect, Predict):
                    self._camera_asked = effect.ticket
                if isinstance(effect, Shoot):
                    self._cancelled[effect.ticket] = threading.Event()
                self._tasks.put(effect)

    def news(self) -> list[Event]:
        """Return what has happened since the last call."""
        events = []
        while True:
            try:
                events.append(self._news.get_nowait())
            except queue.Empty:
                return events

    def stop(self) -> None:
        """Cancel what runs; wait for the camera to be at rest, for a while."""
        self._stopped.set()
        for cancelled in self._cancelled.values():
            cancelled.set()
        self._tasks.put(None)
        if self._camera_left != self._camera_asked:
            self._thread.join(_GRACE_S)

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None and not self._stopped.is_set():
            if task.ticket == self._asked:  # else nobody waits for it any more
                self._news.put(self._outcome(task))
            if not isinstance(task, Predict):
                self._camera_left = task.ticket

    def _outcome(self, task: Predict | MakePlan | Shoot) -> Event:
        try:
            event = self._done(task)
        except CamctlError as error:
            wanted = isinstance(task, Shoot) and self._cancelled[task.ticket].is_set()
            if wanted and isinstance(error, InterruptedCaptureError):
                return Cancelled(task.ticket, str(error))
            return Failed(task.ticket, str(error))
        except Exception as error:
            self.fault = error
            return Failed(task.ticket, f"{type(error).__name__}: {error}; a fault of the program")
        if self.fault is not None:
            self.overcome.append(self.fault)
            self.fault = None
        return event

    def _done(self, task: Predict | MakePlan | Shoot) -> Event:
        match task:
            case Predict(ticket=ticket, response=response, dynamic_range=dynamic_range):
                costs: list[Cost] = []
                for cost in self._job.predict(response, dynamic_range):
                    costs.append(cost)
                    if ticket != self._asked or self._stopped.is_set():
                        break
                    self._reporter(ticket)(Progress(len(costs), 0, "counts done"))
                return Predicted(ticket, tuple(costs))
            case MakePlan(ticket=ticket, choice=choice):
                return Planned(ticket, self._job.plan(choice))
            case Shoot(ticket=ticket, plan=plan):
                summary = self._job.shoot(
                    plan, self._reporter(ticket), self._cancelled[ticket].is_set
                )
                return Done(ticket, summary)

    def _reporter(self, ticket: int) -> Callable[[Progress], None]:
        return lambda progress: self._news.put(Progressed(ticket, progress))
