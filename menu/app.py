"""The menu's loop: keys, time and the outcome of work go into the state machine."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

from camctl.errors import CamctlError
from camctl.menu.data import Summary
from camctl.menu.entries import SAVERS, seconds
from camctl.menu.machine import step
from camctl.menu.model import Model, State
from camctl.menu.ports import Job, Key, Panel, PanelDisconnectedError
from camctl.menu.screens import ModelPanel, screen
from camctl.menu.service import ServiceNotifier
from camctl.menu.tables import LIVE_S, STATES, Event, Outcome, Start
from camctl.menu.worker import Worker
from camctl.messages.command_line import error_hint
from camctl.system.interrupts import uninterrupted

_log = logging.getLogger(__name__)


_KEY_WAIT_S = 0.05
"""Time to wait for a key before the next look at the worker's events, s."""

_REOPEN_WAIT_S = 1.0
"""Interval of the attempts to open a panel that was unplugged, s."""

_MOST_DISCARDED_KEYS = 100
"""Keys to discard when the screen changes; a key that is stuck would never end."""

_REST, _LONGEST_REST_S = 80.0, 15.0
"""The exposure meter rests for so many times the processor time that a reading takes with all that
shows it, and so many seconds at most."""

_LIVE_REST = 2.0
"""A live camera rests for so many times the processor time of a look: a third of one processor."""

_LONGEST_WAIT_S = 0.5
"""Time to wait for a key while no work runs, s."""


def run(
    panel: Panel,
    make_job: Callable[[], Job],
    *,
    now: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> Summary | None:
    """Run the menu on `panel` until the user quits; return the result of the last capture, if any.

    A `CamctlError` of the job is shown with buttons to retry, go back or take another camera.  Any
    other exception of the job is a programming error: it is shown in the same way, so that the user
    can keep or repeat the capture, and is raised from here once the panel is closed, or logged if
    a later try succeeded.  A panel that is unplugged is opened again; its other errors are raised.
    However this function ends, a running capture is cancelled, and camera and panel are closed.

    Args:
        panel: where the menu is shown; it is opened here
        make_job: returns the work behind the menu; called after the first screen is shown
        now: returns the time, s
        wait: waits for so many seconds, while there is no panel
    """
    worker = Worker(make_job)
    session = Session(worker, now)
    try:
        session.use(panel, wait)
    except BaseException as ended:
        session.stop()
        for note in session.last_words():
            ended.add_note(note)
        raise
    session.stop()
    for error in worker.recovered_errors:
        _log.warning("internal error, a later try succeeded: %r", error)
    if worker.internal_error is not None:
        raise worker.internal_error
    return session.last_summary


class Session:
    """One run of the menu, from its start to its end, on a panel that may come and go.

    Attributes:
        model: the state of the menu
        last_summary: result of the last capture
    """

    def __init__(self, worker: Worker, now: Callable[[], float]) -> None:
        self.worker = worker
        self.last_summary: Summary | None = None
        self._now = now
        self._notifier = ServiceNotifier(now)
        self.model = Model()
        self._saved = self.model.settings
        self._pending = 0  # request id of the work that has not ended
        self._next_tick_s = self._used_s = now()
        self._cpu_s = time.process_time()
        self._begin()

    def _begin(self) -> None:
        start = STATES[State.STARTING].work
        assert start is not None
        self.model = replace(self.model, request_id=1)
        self._pending = 1
        self.worker.start(Start(1, start))

    def use(self, panel: Panel, wait: Callable[[float], None]) -> None:
        """Show the menu until it ends; open the panel again whenever it was unplugged."""
        was_open = False
        while self.model.state is not State.QUIT:
            try:
                with panel:
                    was_open = True
                    self._loop(panel)
            except PanelDisconnectedError as error:
                if not was_open:
                    raise
                _log.warning("%s; waiting for it", error)
                self.pump()
                wait(_REOPEN_WAIT_S)

    @uninterrupted
    def stop(self) -> None:
        self._notifier.stopping()
        if self.model.settings != self._saved:
            self.worker.save(self.model.settings)
        self.worker.stop()

    def last_words(self) -> list[str]:
        """Return what became of the capture that was running, one line each."""
        words = []
        for event in self.worker.poll_events():
            if isinstance(event.error, CamctlError):  # read where commands are typed
                words.append("; ".join(filter(None, (event.error.what, error_hint(event.error)))))
            elif event.outcome in (Outcome.CANCELLED, Outcome.FAILED):
                words.append(str(event.value))
            elif isinstance(event.value, Summary):
                words.append(f"the last picture is in {event.value.folder}")
        return words

    def _loop(self, panel: Panel) -> None:
        shown: Model | None = None
        while self.model.state is not State.QUIT:
            before = self.model.state
            self.pump()
            if self.model.state is not before and shown is not None:
                _discard_keys(panel)
            if self.model is not shown:
                if isinstance(panel, ModelPanel):
                    panel.show_model(self.model)
                last_offset = panel.show(screen(self.model))
                self.model = replace(self.model, offset=min(self.model.offset, last_offset))
                shown = self.model
                self._notifier.ready(STATES[shown.state].title[0])
            key = panel.key(self._wait_s())
            if key is not None:
                self.press(key)

    def _wait_s(self) -> float:
        """Return how long nothing happens unless a key is pressed, s."""
        if self._pending:
            return _KEY_WAIT_S
        if not STATES[self.model.state].tick_s:
            return _LONGEST_WAIT_S
        return min(max(self._next_tick_s - self._now(), 0.0), _LONGEST_WAIT_S)

    def press(self, key: Key) -> None:
        self._used_s = self._now()
        self._advance(key)

    def pump(self) -> None:
        """Take what the worker reports and what the clock says, without waiting."""
        self._notifier.alive()
        for event in self.worker.poll_events():
            if event.request_id == self._pending and event.outcome in (
                Outcome.DONE,
                Outcome.FAILED,
                Outcome.CANCELLED,
            ):
                self._pending = 0
                self._set_tick()
            self._advance(event)
        saver_s = seconds(SAVERS[self.model.settings.saver])
        if saver_s and self._now() - self._used_s >= saver_s:
            self._advance(Event(Outcome.UNUSED))
        ticks = STATES[self.model.state].tick_s > 0 and not self._pending
        if ticks and self._now() >= self._next_tick_s:
            self._set_tick()
            self._cpu_s = time.process_time()
            self._advance(Event(Outcome.TICK))

    def _set_tick(self) -> None:
        """Set the next tick; metering rests so that it takes little of the processor."""
        reading = self.model.reading
        is_live = (
            self.model.state is State.IDLE and reading is not None and reading.rate is not None
        )
        rest_s = (_LIVE_REST if is_live else _REST) * (time.process_time() - self._cpu_s)
        if self.model.state is not State.IDLE:
            rest_s = 0.0
        tick_s = LIVE_S if is_live else STATES[self.model.state].tick_s
        interval_s = max(tick_s, min(rest_s, _LONGEST_REST_S))
        self._next_tick_s = self._now() + interval_s

    def _advance(self, given: Key | Event) -> None:
        before = self.model
        self.model, effect = step(before, given)
        if isinstance(effect, Start):
            self._pending = effect.request_id
        if effect is not None:
            self.worker.start(effect)
        model = self.model
        if model.summary is not before.summary and model.state is not State.PAST:
            self.last_summary = model.summary
        if model.state is State.STARTING or before.state is State.STARTING:
            self._saved = model.settings
        changed = model.state is not before.state or model.state in (State.SETTINGS, State.SERIES)
        if changed and model.settings != self._saved:
            self._saved = model.settings
            self.worker.save(model.settings)
        if model.state is not before.state:
            self._next_tick_s = self._now() + STATES[model.state].tick_s
            self._cpu_s = time.process_time()
            self._used_s = self._now()  # a result is shown, however long its capture took


def _discard_keys(panel: Panel) -> None:
    """Discard keys pressed before an event changed the screen: they were meant for the old one.

    Otherwise a second press of enter would shoot a plan that the user has not seen.
    """
    for _ in range(_MOST_DISCARDED_KEYS):
        if panel.key(0) is None:
            return
