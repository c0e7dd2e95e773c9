"""Building exposure tables: many independent searches, on any executor, resumable.

Each row's random numbers follow from the row alone (camera, wish, seed), so that a table is the
same bit for bit whatever the executor, the number of workers and the order they finish in.  Between
kinds of processor numpy's float32 logarithms may differ in the last bit, and a search then ends
elsewhere with the same worth; workers of one build should be alike.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path

from camctl.errors import UsageError
from camctl.exposure.solver import check_count, solve
from camctl.exposure.table import ExposureTable, TableEntry, read_entry, write_text
from camctl.response.camera import CameraResponse
from camctl.response.desired import RANGES, RESPONSES, DesiredResponse, desired_response

COUNTS: tuple[int, ...] = (1, 2, 3, 4, 5, 6)


@dataclass(frozen=True, eq=False)
class Job:
    """One row to solve; it can be pickled, so that it may be solved anywhere."""

    real: CameraResponse
    desired: DesiredResponse
    n: int
    levels_wanted: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_count(self.n)

    @property
    def name(self) -> str:
        """What tells this row from any other, as a file name of 33 characters."""
        wish = (
            f"{self.desired.key}|{self.desired.dynamic_range!r}|{self.n}"
            f"|{self.levels_wanted!r}|{self.seed}"
        )
        return f"{self.real.fingerprint}-{hashlib.sha256(wish.encode()).hexdigest()[:16]}"

    def is_answered_by(self, entry: TableEntry) -> bool:
        """Return whether `entry` is this row."""
        return entry.is_for(self.real, self.desired, self.n, self.levels_wanted)


def solve_job(job: Job, progress: Callable[[float], None] | None = None) -> TableEntry:
    """Solve one row; the random numbers follow from `Job.name`."""
    seed = int.from_bytes(hashlib.sha256(job.name.encode()).digest()[:8], "little")
    found = solve(
        job.real,
        job.desired,
        job.n,
        levels_wanted=job.levels_wanted,
        seed=seed,
        progress=progress,
    )
    return TableEntry(
        response=job.desired.key,
        dynamic_range=job.desired.dynamic_range,
        n=job.n,
        camera=job.real.fingerprint,
        camera_name=job.real.name,
        levels_wanted=found.levels_wanted,
        exposures=found.exposures,
        xi=found.xi,
        effective_levels=found.effective_levels,
        total_exposure=found.total_exposure,
    )


def build_table(
    real: CameraResponse | Sequence[CameraResponse],
    responses: Iterable[str | DesiredResponse] = RESPONSES,
    ranges: Iterable[str | float] = tuple(RANGES),
    counts: Iterable[int] = COUNTS,
    *,
    seed: int = 0,
    executor: Executor | None = None,
    state: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ExposureTable:
    """Return the table of one camera or several, solved row by row.

    Args:
        real: the camera or cameras
        responses: names of `RESPONSES`, combined with every range, or `DesiredResponse` objects,
            which bring their own range
        ranges: names of `RANGES` or numbers above 1
        counts: numbers of exposures
        seed: same seed, same table, bit for bit, whatever the executor
        executor: any `concurrent.futures.Executor`, local, Dask's, MPI's; None solves here
        state: folder in which finished rows are kept, so that an interrupted build goes on where it
            stopped; it is emptied of them when the table is complete
        progress: called with (rows done, rows in all)

    Raises:
        UsageError: for names, ranges or counts that cannot be, or nothing to build
        DataError: for a damaged row in `state`; names the file to delete
        StorageError: if `state` cannot be written
    """
    cameras = [real] if isinstance(real, CameraResponse) else list(real)
    spans, numbers = list(ranges), list(counts)
    wishes: list[DesiredResponse] = []
    for response in responses:
        if isinstance(response, DesiredResponse):
            wishes.append(response)
        else:
            wishes.extend(desired_response(response, span) for span in spans)
    jobs = [
        Job(camera, wish, n, seed=seed) for camera in cameras for wish in wishes for n in numbers
    ]
    if not jobs:
        raise UsageError("nothing to build", hint="name a camera, a response, a range and a count")
    folder = None if state is None else Path(state)
    done: dict[str, TableEntry] = {}

    def keep(job: Job, entry: TableEntry, *, fresh: bool) -> None:
        done[job.name] = entry
        if fresh and folder is not None:
            write_text(folder / f"{job.name}.json", entry.model_dump_json() + "\n")
        if progress is not None:
            progress(len(done), len(jobs))

    waiting: list[Job] = []
    for job in jobs:
        kept = None if folder is None else folder / f"{job.name}.json"
        if kept is not None and kept.exists():
            keep(job, read_entry(kept, job.is_answered_by), fresh=False)
        else:
            waiting.append(job)
    waiting.sort(key=lambda job: -job.n * job.real.M)  # the longest first: none is left for last
    if executor is None:
        for job in waiting:
            keep(job, solve_job(job), fresh=True)
    else:
        _solve_all(executor, waiting, lambda job, entry: keep(job, entry, fresh=True))
    if folder is not None:
        _clear(folder, jobs)
    return ExposureTable(done[job.name] for job in jobs)


def _solve_all(
    executor: Executor, jobs: Sequence[Job], keep: Callable[[Job, TableEntry], None]
) -> None:
    futures: dict[Future[TableEntry], Job] = {executor.submit(solve_job, job): job for job in jobs}
    pending = set(futures)
    try:
        while pending:
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            # rows that are done are kept before a failed one ends the build
            for future in sorted(finished, key=lambda future: future.exception() is not None):
                keep(futures[future], future.result())
    finally:
        for future in pending:
            future.cancel()


def _clear(folder: Path, jobs: Iterable[Job]) -> None:
    for job in jobs:
        (folder / f"{job.name}.json").unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
