"""A series of fake sets in virtual time, for tests of series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from camctl.captures.series import Series
from camctl.captures.series_sets import SeriesProgress, SeriesTools
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import VirtualClock
from camctl.records.journal import (
    SeriesJournal,
    SeriesOptions,
    SetRecord,
)
from camctl.records.report import CaptureReport

INFO = CameraInfo("sim", "camctl", "simulated", "1", "sim")


def journal(
    camera: CameraInfo = INFO, request: CaptureRequest | None = None, **options: Any
) -> Any:
    return SeriesJournal(
        camera=camera,
        source={},
        request=request or CaptureRequest(),
        options=SeriesOptions(**options),
    )


def report(levels: float = 100.0) -> CaptureReport:
    """Return what a series reads of the report of a set."""
    achieved = SimpleNamespace(
        effective_levels=levels, noise=None, saturated_fraction=0.01, dark_fraction=0.02
    )
    plan = SimpleNamespace(desired=SimpleNamespace(name="log"), dynamic_range=1000.0)
    found = SimpleNamespace(achieved=achieved, plan=plan, frames=[0, 0, 0], trustworthy=True)
    return cast(CaptureReport, found)


@dataclass
class FakeSets:
    """Sets that take the given times, s, and raise the given errors, one for each attempt."""

    clock: VirtualClock
    seconds: Sequence[float] = ()
    errors: Sequence[BaseException | None] = ()
    bytes: int = 0
    least: int = 0
    planned_s: float | None = None
    starts: list[float] = field(default_factory=list)
    folders: list[str] = field(default_factory=list)
    reconnected: int = 0

    def prepare(self, journal: SeriesJournal) -> float | None:
        self.clock.sleep_until(self.clock.now() + 7.3)  # metering
        return self.planned_s

    def least_bytes(self) -> int:
        return self.least

    def take(self, directory: Path) -> CaptureReport:
        attempt = len(self.starts)
        self.starts.append(self.clock.now())
        self.folders.append(directory.name)
        if attempt < len(self.seconds):
            self.clock.sleep_until(self.clock.now() + self.seconds[attempt])
        error = self.errors[attempt] if attempt < len(self.errors) else None
        if error is not None:
            raise error
        directory.mkdir(exist_ok=True)
        (directory / "sum.tiff").write_bytes(bytes(self.bytes))
        return report()

    def reconnect(self) -> None:
        self.reconnected += 1


class ScriptedKeys:
    """Keys that are pressed when they are asked for; None: no key for once."""

    def __init__(self, clock: VirtualClock, *keys: str | None) -> None:
        self._clock, self._keys = clock, list(keys)

    def read(self, timeout_s: float) -> str | None:
        self._clock.sleep_until(self._clock.now() + timeout_s)
        return self._keys.pop(0) if self._keys else None


@dataclass
class Bench:
    """A series of fake sets in a folder."""

    folder: Path
    clock: VirtualClock = field(default_factory=VirtualClock)
    warnings: list[str] = field(default_factory=list)
    shown: list[SeriesProgress] = field(default_factory=list)

    def run(
        self,
        sets: FakeSets,
        found: SeriesJournal,
        keys: ScriptedKeys | None = None,
        hook: Callable[[Path, SetRecord], None] | None = None,
        free: int = 10**12,
    ) -> SeriesJournal:
        tools = SeriesTools(
            self.clock,
            keys=keys,
            hook=hook,
            warn=self.warnings.append,
            progress=self.shown.append,
            free_bytes=lambda _: free,
        )
        return Series(self.folder, found, sets, tools).run()
