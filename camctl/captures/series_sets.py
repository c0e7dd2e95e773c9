"""The sets of a series: what takes them, with the keys, the hook and the reports of its caller."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Protocol

from camctl.captures.plan import plan_capture
from camctl.captures.sequence import Cancelled, OnProgress
from camctl.captures.sequencer import capture, resume
from camctl.exposure.table import ExposureTable
from camctl.interface.camera import Camera
from camctl.interface.clock import Clock, VirtualClock
from camctl.interface.controls import Layout
from camctl.pictures.accumulator import sum_dtype
from camctl.records.capture_plan import CapturePlan
from camctl.records.folder_store import read_report
from camctl.records.journal import SeriesJournal, SetRecord
from camctl.records.report import CaptureReport, UnfinishedCapture
from camctl.records.report_file import REPORT, read_report_file


class CameraSets:
    """Takes the sets of a series.

    Args:
        camera: an open camera
        journal: of the series: what is asked of each set
        progress: called before each frame and stage of a set
        date: returns date and time, as `SeriesTools.date`
        cancelled: called all the time while frames are awaited; if it returns True the set stops
    """

    def __init__(
        self,
        camera: Camera,
        journal: SeriesJournal,
        progress: OnProgress | None = None,
        date: Callable[[], datetime] = datetime.now,
        cancelled: Cancelled | None = None,
    ) -> None:
        self._camera, self._journal, self._progress = camera, journal, progress
        self._date, self._cancelled = date, cancelled
        self._table: ExposureTable | None = None
        if journal.table_file is not None:
            self._table = ExposureTable.load(Path(journal.table_file), camera.controls.levels)
        self._plan = journal.plan

    def prepare(self, journal: SeriesJournal) -> float | None:
        """Make the plan of the first set, which is kept if all sets have it."""
        self._plan = self._plan or self._new_plan()
        if journal.options.meter == "once":
            journal.plan = self._plan
        return self._plan.wall_s

    def least_bytes(self) -> int:
        """Return the bytes of the frames, the sum and the image: those files are as large."""
        assert self._plan is not None  # `prepare` has made it
        controls, count = self._camera.controls, len(self._plan.settings)
        pixels = math.prod(controls.shape)
        colours = 1 if controls.layout is Layout.MONO else 3
        samples = pixels * (3 if controls.layout is Layout.RGB else 1)
        each = 1 if controls.bits <= 8 else 2
        return (
            samples * (count * each + sum_dtype(count, controls.white).itemsize)
            + 2 * colours * pixels
        )

    def take(self, directory: Path) -> CaptureReport:
        """Take a set into `directory`, or complete the one that is there."""
        if (directory / REPORT).exists():
            if not isinstance(read_report_file(directory), UnfinishedCapture):
                return read_report(directory)  # only the journal was not written any more
            return resume(
                self._camera, directory, progress=self._progress, cancelled=self._cancelled
            )
        begun = self._date()  # before metering, as in the journal
        plan = self._plan or self._new_plan()
        if self._journal.plan is None:
            self._plan = None  # the next set has another light
        return capture(
            self._camera,
            self._journal.request,
            directory,
            plan=plan,
            source=self._journal.source,
            progress=self._progress,
            cancelled=self._cancelled,
            taken_at=begun,
        )

    def reconnect(self) -> None:
        """Close the camera and open it again."""
        self._camera.close()
        self._camera.__enter__()

    def _new_plan(self) -> CapturePlan:
        return plan_capture(self._camera, self._journal.request, table=self._table)


class Keys(Protocol):
    """Keys that the user presses."""

    def read(self, timeout_s: float) -> str | None:
        """Return the next key; None where none was pressed within `timeout_s`."""


class SetTaker(Protocol):
    """Takes one set of a series."""

    def prepare(self, journal: SeriesJournal) -> float | None:
        """Do what must not delay the first set: meter, and keep the plan where it is for all.

        Return the time that the first set is planned to take, s; None: it is not known.
        """

    def least_bytes(self) -> int:
        """Return how much space a set takes at least, as it is planned; 0 where it is not known."""

    def take(self, directory: Path) -> CaptureReport:
        """Take a set into a folder, or complete one that is there."""

    def reconnect(self) -> None:
        """Open the camera again after it has failed."""


@dataclass(frozen=True)
class SeriesProgress:
    """How far a series is.

    Attributes:
        done: sets that were taken or have failed
        total: of the series; None where the user ends it
        state: "waiting", "waiting for enter, q ends", "shooting" or "paused"
        ends_in_s: until the last set is complete, by the camera's clock, s; None: not known
    """

    done: int
    total: int | None
    state: str
    ends_in_s: float | None = None


def date_by(clock: Clock) -> Callable[[], datetime]:
    """Return what returns date and time; those of a virtual clock are now plus what it advances."""
    if not isinstance(clock, VirtualClock):
        return datetime.now
    zero = datetime.now() - timedelta(seconds=clock.now())
    return lambda: zero + timedelta(seconds=clock.now())


@dataclass(frozen=True)
class SeriesTools:
    """What a series uses beside the camera.

    Attributes:
        clock: of the camera
        keys: of the user; None: there is no terminal
        hook: called with a set's folder and record when it is complete; raises `CamctlError` where
            it fails
        warn: called with one line on what goes wrong
        progress: called before each set, and while the series waits
        date: returns date and time
        free_bytes: returns the free space of the disk that holds a folder
    """

    clock: Clock
    keys: Keys | None = None
    hook: Callable[[Path, SetRecord], None] | None = None
    warn: Callable[[str], None] = lambda _: None
    progress: Callable[[SeriesProgress], None] = lambda _: None
    date: Callable[[], datetime] = datetime.now
    free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free
