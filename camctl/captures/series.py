"""A series: many captures of one request, one after another, unattended.

Set k of a series with an interval begins k intervals after the first set by the camera's clock, so
that errors do not add up.  A set that takes longer than the interval makes the next start late.  As
an intervalometer does, the series then leaves out the starts that have passed and continues with
the next one: starts stay multiples of the interval, and all requested sets are taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from camctl.captures.gallery import make_thumbnail, write_gallery
from camctl.captures.series_sets import SeriesProgress, SeriesTools, SetTaker
from camctl.errors import (
    CamctlError,
    CameraError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.records import SERIES
from camctl.records.folder import CaptureFolder
from camctl.records.folder_store import resumption
from camctl.records.journal import SeriesJournal, SetRecord
from camctl.records.report import CaptureReport
from camctl.records.report_file import LOCK
from camctl.system.files import make_folder

#: A start that is late by no more than this share of the interval is not left out.
_LATE_SHARE = 0.1
#: How often keys are looked at during a wait, s.
_POLL_S = 0.1
#: Wait before a set is tried again, s: a camera that was unplugged takes seconds to be found.
_RETRY_WAIT_S = 2.0
#: The next set needs so many times the disk space of the last one: files compress differently.
_SPACE_MARGIN = 1.25
#: A series without an interval and without keys ends after so many failed sets in a row: else it
#: would go through all its numbers unattended.
_MOST_FAILURES = 3

_GO_ON = "continue the series"

TAKE_KEYS, PAUSE_KEYS, STOP_KEYS = (" ", "\n", "\r"), ("p", "P"), ("q", "Q", "\x1b")


_Result = TypeVar("_Result")


class Series:
    """A series in a folder, from its first set that is not complete to its last one.

    Args:
        directory: the folder; made where it is missing
        journal: of the series; kept in the folder
        taker: takes the sets
        tools: what else is used
    """

    def __init__(
        self, directory: Path, journal: SeriesJournal, taker: SetTaker, tools: SeriesTools
    ) -> None:
        self.directory, self.journal = directory, journal
        self._taker, self._tools = taker, tools
        self._run = max((each.run for each in journal.sets), default=0) + 1
        self._first_s: float | None = None
        self._slot = 0
        self._set_bytes = 0
        self._seconds = 0.0
        self._is_said = False

    def run(self) -> SeriesJournal:
        """Take the sets; return the journal.

        Raises:
            InterruptedCaptureError: a signal ended it; what was shot is kept
            StorageError: the disk is full, or another process writes the folder
            UsageError: no camera can do what was asked
            CamctlError: the first set could not be prepared
        """
        with self._owned():
            try:
                set_s = self._prepared()
                self._set_bytes = self._taker.least_bytes()
                self._save()
                self._warn_of_long_sets(set_s)
                while not self.journal.is_done() and self._wait_for_start():
                    self._check_space()
                    self._take(self._next_record())
                    self._check_failures()
            except (KeyboardInterrupt, InterruptedCaptureError) as error:
                what = error.what if isinstance(error, InterruptedCaptureError) else str(error)
                raise InterruptedCaptureError(
                    f"{what or 'interrupted'}; {self._done_text()}",
                    hint=_GO_ON,
                    remedies=self._remedies,
                ) from None
        return self.journal

    def _prepared(self) -> float | None:
        """Save the journal, so that a series which is interrupted from here on can be continued.

        Where the first set cannot be prepared there is no series: the folder stays as it was.
        """
        is_new = not (self.directory / SERIES).exists()
        self._save()
        try:
            return self._twice(lambda: self._taker.prepare(self.journal))
        except InterruptedCaptureError:
            raise
        except CamctlError:
            if is_new:
                (self.directory / SERIES).unlink(missing_ok=True)
            raise

    @contextmanager
    def _owned(self) -> Iterator[None]:
        """Own the folder while the block runs; where no journal was saved it is left as it was."""
        folder = CaptureFolder(self.directory)
        with folder.storage_errors():
            made = make_folder(self.directory)
        try:
            with folder.owned():
                yield
        finally:
            if not (self.directory / SERIES).exists():
                (self.directory / LOCK).unlink(missing_ok=True)
                with suppress(OSError):  # not empty
                    for each in made:
                        each.rmdir()

    # ---- one set

    def _next_record(self) -> SetRecord:
        """Return the record of the next set, which is kept before it begins."""
        sets, tools = self.journal.sets, self._tools
        now = tools.date()
        if not (sets and sets[-1].state == "begun"):
            folder = self.journal.new_folder(self.directory, now)
            sets.append(SetRecord(number=len(sets) + 1, folder=folder, started_at=""))
        record = sets[-1]
        assert self._first_s is not None  # `_wait_for_start` has set it
        record.run, record.slot = self._run, self._slot
        record.started_at = now.isoformat(timespec="seconds")
        record.started_s = tools.clock.now() - self._first_s
        self._save()
        return record

    def _take(self, record: SetRecord) -> None:
        directory = self.directory / record.folder
        if directory.is_symlink():
            raise StorageError(f"{directory} is a link", hint="move it away")
        self._show("shooting")
        began = self._tools.clock.now()

        def take() -> CaptureReport:
            return self._taker.take(directory)

        try:
            report = self._twice(take, record)
            record.complete(report)
        except (InterruptedCaptureError, UsageError):
            raise
        except CamctlError as error:
            record.state, record.error = "failed", str(error)
            self._tools.warn(f"{record.folder} failed twice and is left out: {error}")
        else:
            if not report.trustworthy:
                because = report.untrustworthy_because
                self._tools.warn(f"{record.folder} is not trustworthy: {because}")
            self._set_bytes = sum(
                path.stat().st_size for path in directory.rglob("*") if path.is_file()
            )
            record.has_thumbnail = make_thumbnail(self.directory, record)
            self._run_hook(directory, record)
        record.seconds = self._tools.clock.now() - began
        self._seconds += (record.seconds - self._seconds) / record.number
        write_gallery(self.directory, self.journal)  # before the series counts as complete
        self._save()

    def _twice(self, action: Callable[[], _Result], record: SetRecord | None = None) -> _Result:
        """Return what `action` returns; where it fails, try it once again.

        Raises:
            CamctlError: it failed twice, or trying again does not help
        """
        try:
            return action()
        except (InterruptedCaptureError, UsageError):
            raise
        except CamctlError as error:
            if record is not None:
                record.error, record.attempts = str(error), 2
            name = "the metering" if record is None else record.folder
            self._tools.warn(f"{name} is tried again: {error.what}")
            clock = self._tools.clock
            clock.sleep_until(clock.now() + _RETRY_WAIT_S)
            if isinstance(error, CameraError):
                self._taker.reconnect()
        return action()

    def _run_hook(self, directory: Path, record: SetRecord) -> None:
        if self._tools.hook is None:
            return
        try:
            self._tools.hook(directory, record)
            record.hook = "done"
        except CamctlError as error:
            record.hook, record.hook_error = "failed", str(error)
            self._tools.warn(f"{record.folder}: {error}")

    def _check_space(self) -> None:
        """Raise `StorageError` where the disk has no room for the next set."""
        needed = round(_SPACE_MARGIN * self._set_bytes)
        free = self._tools.free_bytes(self.directory)
        if free < needed:
            raise StorageError(
                f"the disk has {free / 1e6:,.0f} MB free and the next set needs about "
                f"{needed / 1e6:,.0f} MB; {self._done_text()}",
                hint=f"free some space, and {_GO_ON}",
                remedies=self._remedies,
            )

    def _check_failures(self) -> None:
        """Raise where sets fail one after another and nothing gives the camera time to recover."""
        options, last = self.journal.options, self.journal.sets[-_MOST_FAILURES:]
        have_failed = len(last) == _MOST_FAILURES and all(each.state == "failed" for each in last)
        if have_failed and options.interval_s is None and not options.on_key:
            raise CameraError(
                f"{_MOST_FAILURES} sets in a row have failed: {last[-1].error}; "
                f"{self._done_text()}",
                hint=f"correct that, and {_GO_ON}",
                remedies=self._remedies,
            )

    # ---- when the next set begins

    def _wait_for_start(self) -> bool:
        """Return when the next set is to begin; False: the user ends the series."""
        clock, options = self._tools.clock, self.journal.options
        if self._first_s is None and not options.on_key:
            self._first_s = clock.now()
            return True
        if options.on_key:
            if not self._wait_for_key():
                return False
            self._first_s = clock.now() if self._first_s is None else self._first_s
            return True
        due_s = clock.now() if options.interval_s is None else self._next_due_s(late=True)
        self._show("waiting")
        while True:
            key = None if self._tools.keys is None else self._tools.keys.read(0.0)
            if key in STOP_KEYS:
                return False
            if key in PAUSE_KEYS:
                if not self._pause():
                    return False
                due_s = clock.now() if options.interval_s is None else self._next_due_s(late=False)
            now = clock.now()
            if now >= due_s:
                return True
            clock.sleep_until(due_s if self._tools.keys is None else min(due_s, now + _POLL_S))

    def _next_due_s(self, *, late: bool) -> float:
        """Return the time of the next start; count those left out where the series is `late`."""
        interval_s, first_s = self.journal.options.interval_s, self._first_s
        assert interval_s is not None  # as the caller has checked
        assert first_s is not None  # the first set has begun
        elapsed = (self._tools.clock.now() - first_s) / interval_s
        slot = max(self._slot + 1, math.ceil(elapsed - _LATE_SHARE))
        missed = slot - self._slot - 1
        if late and missed:
            self.journal.skipped += missed
            if not self._is_said:
                self._is_said = True
                starts = "1 start is" if missed == 1 else f"{missed} starts are"
                self._tools.warn(
                    f"a set took longer than the interval of {interval_s:g} s: {starts} left out, "
                    "as are later ones where that happens again"
                )
        self._slot = slot
        return first_s + slot * interval_s

    def _warn_of_long_sets(self, set_s: float | None) -> None:
        """Say before the first set that each one is planned to take longer than the interval."""
        interval_s = self.journal.options.interval_s
        if interval_s is None or set_s is None or self.journal.is_done():
            return
        intervals = math.ceil(set_s / interval_s - _LATE_SHARE)
        if intervals > 1:
            self._is_said = True
            self._tools.warn(
                f"a set takes {set_s:.3g} s by its plan, longer than the interval of "
                f"{interval_s:g} s: sets begin every {intervals * interval_s:g} s at best, and the "
                "starts between are left out"
            )

    def _wait_for_key(self) -> bool:
        """Return when the user asks for a set; False: for the end."""
        assert self._tools.keys is not None  # `SeriesOptions.on_key` needs a terminal
        self._show("waiting for enter, q ends")
        while True:
            key = self._tools.keys.read(_POLL_S)
            if key in TAKE_KEYS:
                return True
            if key in STOP_KEYS:
                return False

    def _pause(self) -> bool:
        """Return when the user goes on; False: the user ends the series."""
        assert self._tools.keys is not None  # a key was pressed
        self._show("paused")
        while (key := self._tools.keys.read(_POLL_S)) not in PAUSE_KEYS:
            if key in STOP_KEYS:
                return False
        return True

    # ---- what is said

    def _save(self) -> None:
        self.journal.save(self.directory)

    def _show(self, state: str) -> None:
        done = self.journal.count(lambda each: each.state != "begun")
        total = self.journal.options.repeat
        self._tools.progress(SeriesProgress(done, total, state, self._ends_in_s(done, total)))

    def _ends_in_s(self, done: int, total: int | None) -> float | None:
        """Return when the last set will be complete, from the duration of those that are."""
        options = self.journal.options
        if total is None or options.on_key or not done or self._first_s is None:
            return None
        if options.interval_s is None:
            return (total - done) * self._seconds
        last_s = self._first_s + (self._slot + total - done - 1) * options.interval_s
        return last_s + self._seconds - self._tools.clock.now()

    def _done_text(self) -> str:
        total = self.journal.options.repeat
        of = "" if total is None else f" of {total}"
        return f"{self.journal.completed}{of} sets are complete"

    @property
    def _remedies(self) -> dict[str, Any]:
        return {"resume": resumption(self.directory, self.journal.source)}
