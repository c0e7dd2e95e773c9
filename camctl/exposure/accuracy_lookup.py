"""Exposures chosen by accuracy: from the rows that are part of camctl, the cache, or solved now."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from camctl.exposure.accuracy import NEAR_TIE, AccuracySolution, solve_accuracy
from camctl.exposure.build import COUNTS, cached_row
from camctl.exposure.exposure_choices import AccuracyProblem, TimeCosts
from camctl.exposure.solver import Progress
from camctl.exposure.table import TableEntry, accuracy_rows

VERSION = 2
"""Part of the key of a row; it changes where the search finds other exposures."""


LIMITED_VERSION = 1
"""The same for rows with a time limit, an accuracy or the costs of a capture."""


@dataclass(frozen=True, eq=False)
class AccuracyJob:
    """What is asked of `solve_accuracy`.  It can be pickled and sent to another process.

    Attributes:
        problem: the camera, its noise and the desired response
        counts: numbers of exposures to choose from
        total_limit: longest time of a set, in the unit of the available times
        accuracy: effective levels to reach in the least time; None: as many as possible
        recommended: the set beyond which more time brings no more than averaging does
    """

    problem: AccuracyProblem
    counts: tuple[int, ...]
    total_limit: float = math.inf
    accuracy: float | None = None
    recommended: bool = False

    @property
    def name(self) -> str:
        """Name that identifies this row, used as a file name."""
        return f"accuracy-{self.key}"

    @property
    def work(self) -> float:
        """Estimate of the time that solving it takes, in any unit."""
        return float(sum(self.counts))

    @property
    def key(self) -> str:
        """First 16 hex digits of a hash of everything that decides the result."""
        available = self.problem.available
        is_plain = available.costs == TimeCosts() and self.accuracy is None
        is_plain = is_plain and math.isinf(self.total_limit) and not self.recommended
        parts = (
            VERSION,
            NEAR_TIE,
            *self.problem.identity,
            self.counts,
            self.total_limit,
            self.accuracy,
            *([] if is_plain else [LIMITED_VERSION, available.costs, self.recommended]),
        )
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]

    def solve(self, progress: Progress | None = None) -> TableEntry:
        """Solve it; raises what `solve_accuracy` raises."""
        problem = self.problem
        found = solve_accuracy(
            problem,
            self.counts,
            total_limit=self.total_limit,
            accuracy=self.accuracy,
            recommended=self.recommended,
            progress=progress,
        )
        return TableEntry(
            response=problem.desired.key,
            dynamic_range=problem.desired.dynamic_range,
            n=len(found.exposures),
            camera=problem.response.fingerprint,
            camera_name=problem.response.name,
            levels_wanted=found.levels_wanted,
            exposures=found.exposures,
            xi=found.xi,
            effective_levels=found.effective_levels,
            total_exposure=found.total_exposure,
            accuracy=self.key,
            times=None if found.times == found.exposures else found.times,
            gains=None if set(found.gains) == {1.0} else found.gains,
            effective_levels_noise_free=found.effective_levels_noise_free,
        )

    def matches(self, entry: TableEntry) -> bool:
        """Return whether `entry` is the row of this job."""
        return entry.accuracy == self.key


def without_idle_limits(problem: AccuracyProblem) -> AccuracyProblem:
    """Return the problem with limits left out that do not bind; see `AvailableExposures`."""
    available = problem.available.without_idle_limits(problem.reach, problem.noise)
    return replace(problem, available=available)


def accuracy_jobs(
    problems: Iterable[AccuracyProblem], counts: Iterable[int] = COUNTS
) -> tuple[AccuracyJob, ...]:
    """Return the rows of a table: every number of exposures for each problem, without limits."""
    numbers = list(counts)
    return tuple(
        AccuracyJob(without_idle_limits(problem), (n,)) for problem in problems for n in numbers
    )


def look_up_accurate(
    problem: AccuracyProblem,
    counts: Sequence[int],
    *,
    total_limit: float = math.inf,
    accuracy: float | None = None,
    recommended: bool = False,
    progress: Progress | None = None,
) -> AccuracySolution:
    """Return the exposures that `solve_accuracy` finds, solved once and then kept.

    Where shutter time alone counts, limits that do not bind, and a dark current that hardly adds to
    the read noise, are left out first, so that captures share a row.  Arguments and errors as in
    `solve_accuracy`.
    """
    if problem.available.costs == TimeCosts():
        problem = without_idle_limits(problem)
    job = AccuracyJob(problem, tuple(sorted(set(counts))), total_limit, accuracy, recommended)
    entry = accuracy_rows().get(job.key) or cached_row(job, progress)
    assert entry.effective_levels_noise_free is not None  # rows of this key have it
    return AccuracySolution(
        exposures=entry.exposures,
        xi=entry.xi,
        levels_wanted=entry.levels_wanted,
        effective_levels=entry.effective_levels,
        total_exposure=entry.total_exposure,
        seconds=0.0,
        evaluations=0,
        effective_levels_noise_free=entry.effective_levels_noise_free,
        times=entry.times or entry.exposures,
        gains=entry.gains or (1.0,) * entry.n,
    )
