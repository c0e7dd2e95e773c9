"""What a series needs of its caller: keys, what takes the sets, and where it reports."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Protocol

from camctl.interface.clock import Clock, VirtualClock
from camctl.records.journal import SeriesJournal, SetRecord
from camctl.records.report import CaptureReport


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
