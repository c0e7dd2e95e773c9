"""The thread that does the menu's work, one piece after the other."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from camctl.errors import CamctlError, InterruptedCaptureError
from camctl.menu.data import Choice, Past, Plan, SeriesChoice, Settings
from camctl.menu.ports import Job
from camctl.menu.tables import Cancel, Effect, Event, Outcome, Start, Work
from camctl.messages.menu import error_text
from camctl.system.interrupts import uninterrupted

_STOP_WAIT_S = 10.0
"""Time that the camera has to finish its frame after the menu has ended, s."""

_CAPTURES = (Work.SHOOT, Work.RESUME, Work.SERIES, Work.CALIBRATE)


def failure_text(error: Exception) -> str:
    """Return what the menu shows of an error."""
    if isinstance(error, CamctlError):
        return error_text(error)
    return f"internal error: {type(error).__name__}: {error}"


class Worker:
    """Does the work of a job on a thread; `make_job` is called there, too.

    Attributes:
        internal_error: the last exception that was no `CamctlError`, unless a later try of the same
            work succeeded
        recovered_errors: those after which one did
    """

    def __init__(self, make_job: Callable[[], Job]) -> None:
        self._make_job = make_job
        self._job: Job | None = None
        self._tasks: queue.SimpleQueue[Start | Settings | None] = queue.SimpleQueue()
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._cancelled: set[int] = set()
        self._stopped = threading.Event()
        self._latest_id = 0
        self.internal_error: Exception | None = None
        self._failed_work: Work | None = None
        self.recovered_errors: list[Exception] = []
        # A daemon thread, so that a prediction that is not needed any more cannot delay the exit.
        self._thread = threading.Thread(target=self._run, name="menu job", daemon=True)
        self._thread.start()

    def start(self, effect: Effect) -> None:
        """Start or cancel work; returns at once."""
        if isinstance(effect, Cancel):
            self._cancelled.add(effect.request_id)
            return
        self._latest_id = effect.request_id
        self._tasks.put(effect)

    def save(self, settings: Settings) -> None:
        """Keep the settings once the work before has ended; a failure is reported as a note."""
        self._tasks.put(settings)

    def poll_events(self) -> list[Event]:
        """Return the events since the last call."""
        events = []
        while True:
            try:
                events.append(self._events.get_nowait())
            except queue.Empty:
                return events

    @uninterrupted
    def stop(self) -> None:
        """Cancel all work, and wait until the camera is closed, `_STOP_WAIT_S` at most."""
        self._stopped.set()
        self._tasks.put(None)
        self._thread.join(_STOP_WAIT_S)

    def _run(self) -> None:
        try:
            while (task := self._tasks.get()) is not None:
                if isinstance(task, Settings):
                    self._save(task)
                elif task.request_id == self._latest_id and not self._stopped.is_set():
                    # else the user has left it
                    self._events.put(self._outcome(task))
        finally:
            if self._job is not None:
                self._job.close()

    def _opened(self) -> Job:
        if self._job is None:
            self._job = self._make_job()
        return self._job

    def _save(self, settings: Settings) -> None:
        try:
            self._opened().save(settings)
        except Exception as error:
            self._events.put(Event(Outcome.NOTE, value=f"settings are not kept: {error}"))

    def _outcome(self, task: Start) -> Event:
        """Return the event that a task ends with, whether it succeeds or fails."""
        try:
            value = self._result(self._opened(), task)
        except CamctlError as error:
            cancelled = task.work in _CAPTURES and self._is_cancelled(task)
            is_cancelled = cancelled and isinstance(error, InterruptedCaptureError)
            outcome = Outcome.CANCELLED if is_cancelled else Outcome.FAILED
            return Event(outcome, task.request_id, failure_text(error), error)
        except Exception as error:
            self.internal_error, self._failed_work = error, task.work
            return Event(Outcome.FAILED, task.request_id, failure_text(error))
        if self.internal_error is not None and task.work is self._failed_work:
            self.recovered_errors.append(self.internal_error)
            self.internal_error = None
        return Event(Outcome.DONE, task.request_id, value)

    def _is_cancelled(self, task: Start) -> bool:
        if self._stopped.is_set() or task.request_id in self._cancelled:
            return True
        return task.work not in _CAPTURES and task.request_id != self._latest_id

    def _result(self, job: Job, task: Start) -> object:
        def cancelled() -> bool:
            return self._is_cancelled(task)

        def part(value: object) -> None:
            self._events.put(Event(Outcome.PART, task.request_id, value))

        argument = task.argument
        match task.work, argument:
            case Work.LOAD, _:
                return job.load()
            case Work.OPEN, str():
                return job.open(argument)
            case Work.METER, _:
                return job.meter()
            case Work.PLAN, Choice():
                return job.plan(argument, cancelled)
            case Work.TRACE, Choice():
                return job.trace(argument, cancelled)
            case Work.PREDICT, tuple():
                places = [place for place, each in enumerate(argument) if each is not None]
                costs = job.predict([argument[place] for place in places], cancelled)
                for place, cost in zip(places, costs, strict=False):
                    part((place, cost))
                return None
            case Work.SHOOT, Plan():
                return job.shoot(argument, part, cancelled)
            case Work.RESUME, Past():
                return job.resume(argument, part, cancelled)
            case Work.SERIES, SeriesChoice():
                return job.series(argument, part, cancelled)
            case Work.CALIBRATE, str():
                return job.calibrate(argument, part, cancelled)
            case Work.FIND, _:
                return job.find_cameras()
            case Work.BROWSE, _:
                return job.captures()
            case Work.LOOK, Past():
                return job.look(argument)
        raise ValueError(f"work {task.work} cannot be done with {argument!r}")
