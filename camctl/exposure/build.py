"""Rows of exposure tables: solved on demand and cached, or for a whole table on any executor.

The random numbers of a row follow from the row alone (camera, desired response, n, G, seed), so
that a table is the same bit for bit whatever the executor, the number of workers and the order in
which they finish.  Between kinds of processors the float32 logarithms of numpy may differ in the
last bit; a search then ends elsewhere with the same quality.  The workers of one build should
therefore be of one kind.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from camctl.errors import UsageError
from camctl.exposure.cache import kept, read_kept
from camctl.exposure.objective import Objective
from camctl.exposure.solver import MOST_SECONDS, Progress, SearchOptions, solve
from camctl.exposure.table import (
    ExposureTable,
    TableEntry,
    default_table,
    read_entry,
    write_text,
)
from camctl.model.effective import MOST_SEARCHED, check_count
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.response.names import RANGES, RESPONSES
from camctl.system.files import storage_error, sync_folder
from camctl.system.interrupts import uninterrupted

COUNTS: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
"""Numbers of exposures of a table, by default."""


@dataclass(frozen=True, eq=False)
class Job:
    """One row to solve.  It can be pickled and sent to another process.

    Attributes:
        response: the response of the real camera
        desired: the desired response
        n: number of exposures, 1 to 16
        levels_wanted: G, the number of levels of the desired camera; None: n * M
        seed: seed of the random numbers
        processor_s: see `SearchOptions`

    Raises:
        UsageError: n is out of range
    """

    response: CameraResponse
    desired: DesiredResponse
    n: int
    levels_wanted: float | None = None
    seed: int = 0
    processor_s: float = MOST_SECONDS

    def __post_init__(self) -> None:
        check_count(self.n, MOST_SEARCHED)

    @property
    def name(self) -> str:
        """Name of 33 characters that identifies this row, used as a file name."""
        rest = (
            f"{self.desired.key}|{self.desired.dynamic_range!r}|{self.n}"
            f"|{self.levels_wanted!r}|{self.seed}"
        )
        if self.processor_s != MOST_SECONDS:
            rest += f"|{self.processor_s!r}"
        return f"{self.response.fingerprint}-{hashlib.sha256(rest.encode()).hexdigest()[:16]}"

    @property
    def work(self) -> float:
        """Estimate of the time that solving it takes, in any unit."""
        return float(self.n * self.response.M)

    def solve(self, progress: Progress | None = None) -> TableEntry:
        """Solve it; the random numbers follow from `name`."""
        seed = int.from_bytes(hashlib.sha256(self.name.encode()).digest()[:8], "little")
        found = solve(
            self.response,
            self.desired,
            self.n,
            objective=Objective(self.levels_wanted),
            search=SearchOptions(seed, processor_s=self.processor_s),
            progress=progress,
        )
        return TableEntry.of(self.response, self.desired, found)

    def matches(self, entry: TableEntry) -> bool:
        """Return whether `entry` is this row, whatever its seed."""
        return entry.matches(self.response, self.desired, self.n, self.levels_wanted)


def solve_job(job: Job, progress: Progress | None = None) -> TableEntry:
    """Solve one row."""
    return job.solve(progress)


def look_up(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    *,
    levels_wanted: float | None = None,
    processor_s: float = MOST_SECONDS,
    progress: Progress | None = None,
) -> TableEntry:
    """Return the exposures for a camera: from the default table, from the cache, or solved now.

    Args:
        response: the response of the real camera
        desired: the desired response
        n: number of exposures, 1 to 16
        levels_wanted: G, the number of levels of the desired camera; None: n * M
        processor_s: of the search, where it is solved now; see `SearchOptions`
        progress: called with the completed share, 0 to 1, while solving

    Raises:
        UsageError: n or G is out of range
    """
    found = default_table().find(response, desired, n, levels_wanted)
    if found is not None:
        return found
    job = Job(response, desired, n, levels_wanted=levels_wanted, processor_s=processor_s)
    return kept(
        job.name, partial(read_row, job=job), lambda: solve_job(job, progress), TableEntry.to_json
    )


def read_row(path: Path, job: Job) -> TableEntry:
    """Return the row of `job` from a file; raises what `read_entry` raises."""
    return read_entry(path, job.matches)


def table_jobs(
    cameras: CameraResponse | Sequence[CameraResponse],
    responses: Iterable[str | DesiredResponse] = RESPONSES,
    ranges: Iterable[str | float] = tuple(RANGES),
    counts: Iterable[int] = COUNTS,
    *,
    seed: int = 0,
) -> tuple[Job, ...]:
    """Return the rows of a table: every combination of the arguments.

    Args:
        cameras: one or several camera responses
        responses: names of desired responses, which are combined with every range, or
            `DesiredResponse` objects, which have a range already
        ranges: names in `RANGES`, or numbers above 1
        counts: numbers of exposures
        seed: seed of the random numbers

    Raises:
        UsageError: an unknown name, or a range or count out of range
    """
    if isinstance(cameras, CameraResponse):
        cameras = [cameras]
    spans, numbers = list(ranges), list(counts)
    desired: list[DesiredResponse] = []
    for response in responses:
        if isinstance(response, DesiredResponse):
            desired.append(response)
        else:
            desired.extend(desired_response(response, span) for span in spans)
    return tuple(
        Job(camera, each, n, seed=seed) for camera in cameras for each in desired for n in numbers
    )


def build_table(
    jobs: Sequence[Job],
    *,
    executor: Executor | None = None,
    state: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ExposureTable:
    """Return the table of rows, solved one by one.

    Args:
        jobs: the rows, see `table_jobs`
        executor: any `concurrent.futures.Executor` (local processes, Dask, MPI); None: this process
        state: folder in which solved rows are kept, so that an interrupted build can be continued,
            until `discard_rows` once the table is saved
        progress: called with the number of solved rows and of all rows

    Raises:
        UsageError: there are no rows
        StorageError: `state` cannot be written
    """
    if not jobs:
        raise UsageError(
            "the exposure table has no rows",
            hint="name at least one camera, response, range and number of exposures",
        )
    folder = None if state is None else Path(state)
    done: dict[str, TableEntry] = {}

    def keep(job: Job, entry: TableEntry) -> None:
        done[job.name] = entry
        if progress is not None:
            progress(len(done), len(jobs))

    @uninterrupted  # a row that is saved is counted
    def save(job: Job, entry: TableEntry) -> None:
        if folder is not None:
            write_text(folder / f"{job.name}.json", entry.to_json() + "\n")
        keep(job, entry)

    waiting: list[Job] = []
    for job in jobs:
        saved = None
        if folder is not None:
            saved = read_kept(folder / f"{job.name}.json", partial(read_row, job=job))
        if saved is None:
            waiting.append(job)
        else:
            keep(job, saved)
    waiting.sort(key=lambda job: -job.work)  # the longest first
    if executor is None:
        for job in waiting:
            save(job, solve_job(job))
    else:
        _solve_all(executor, waiting, save)
    return ExposureTable(done[job.name] for job in jobs)


def discard_rows(jobs: Iterable[Job], state: str | Path) -> None:
    """Remove the rows that `build_table` has kept in `state`; call it when the table is saved.

    Raises:
        StorageError: they cannot be removed
    """
    folder = Path(state)
    try:
        for job in jobs:
            (folder / f"{job.name}.json").unlink(missing_ok=True)
        if folder.is_dir():
            if any(folder.iterdir()):
                sync_folder(folder)
            else:
                folder.rmdir()
                sync_folder(folder.parent)
    except OSError as error:
        raise storage_error(folder, error) from error


def _solve_all(
    executor: Executor, jobs: Sequence[Job], save: Callable[[Job, TableEntry], None]
) -> None:
    futures: dict[Future[TableEntry], Job] = {executor.submit(solve_job, job): job for job in jobs}
    pending = set(futures)
    try:
        while pending:
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            # Solved rows are saved before a failed one ends the build.
            for future in sorted(finished, key=lambda future: future.exception() is not None):
                save(futures[future], future.result())
    finally:
        for future in pending:
            future.cancel()
