"""Regret against CPU time of the search for exposures, beside general optimisers and a grid.

All methods minimise the same objective with the same code, `BatchScore`, which scores whole batches
of exposures in float32: only the strategies differ.  What a method has found is scored again with
the exact objective.  Regret is xi above the best xi that any run of the study has found, as a share
of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations_with_replacement, islice
from statistics import median
from typing import Any, TypeAlias

import numpy as np

from camctl.errors import CamctlError, UsageError, unknown_name
from camctl.exposure.candidates import BatchScore
from camctl.exposure.objective import ExposureProblem
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.response.camera import FloatArray, linear_response
from camctl.model.response.desired import desired_response

CAMCTL = "camctl"
GRID = "grid"
SCIPY_METHODS = ("differential-evolution", "dual-annealing")
METHODS = (CAMCTL, *SCIPY_METHODS, GRID)

ENOUGH = 0.005
"""Regret in xi from which a set counts as found: no method is ranked by less."""

POPULATION = 10
"""Population of differential evolution, in multiples of the number of free exposures."""

FIRST_EFFORT, EFFORT_STEP = 1 / 64, 2.0
"""The search is run with efforts from the first, each a step longer, up to the time limit."""

FIRST_GRID, GRID_STEP = 6, 1.3
"""Exposures of the coarsest grid, and how many times more each further grid has."""

Case: TypeAlias = tuple[str, float, int, int]
"""Response, dynamic range, number of exposures and bits of the camera."""

_ROWS = 4096  # sets of a grid that are scored together
_POINTS_PER_DECADE = 24  # of evaluations, kept of the record of a run


@dataclass(frozen=True)
class SolverRun:
    """One method on one problem: all that is needed to run it again.

    Attributes:
        method: one of `METHODS`
        response: desired response: linear, gamma or log
        dynamic_range: of the desired response
        n: number of exposures, 2 to 16
        bits: of the linear camera
        seed: of the random numbers; a grid has none
        limit_s: CPU time, s
        max_evaluations: sets of exposures that are scored at most; None: only the time ends a run.
            A repeated run has the same points up to the point at which the time ended it

    Raises:
        UsageError: an unknown method, fewer than two exposures, no time, or no evaluations
    """

    method: str
    response: str = "log"
    dynamic_range: float = 1000.0
    n: int = 3
    bits: int = 8
    seed: int = 0
    limit_s: float = 2.0
    max_evaluations: int | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise unknown_name("method", self.method, METHODS)
        if self.n < 2:
            raise UsageError(f"invalid number of exposures {self.n}: one has nothing to search")
        if not 0 < self.limit_s < math.inf:
            raise UsageError(f"invalid time limit {self.limit_s:g} s: expected a positive number")
        if self.max_evaluations is not None and self.max_evaluations < 1:
            raise UsageError(
                f"invalid number of evaluations {self.max_evaluations}: expected at least 1"
            )

    def is_over(self, cpu_s: float, evaluations: float) -> bool:
        """Return whether one of the limits is exceeded."""
        return cpu_s > self.limit_s or evaluations > (self.max_evaluations or math.inf)

    @property
    def problem(self) -> ExposureProblem:
        """What is minimised."""
        desired = desired_response(self.response, self.dynamic_range)
        return ExposureProblem(linear_response(self.bits), desired, self.n)

    @property
    def case(self) -> Case:
        """What is minimised, by name: runs with the same case are compared."""
        return self.response, self.dynamic_range, self.n, self.bits


@dataclass(frozen=True)
class SolverPoint:
    """What a run had found after some time.

    Attributes:
        cpu_s: CPU time spent, s
        evaluations: sets of exposures scored
        xi: exact objective of the best set
        exposures: that set, ascending from 1
    """

    cpu_s: float
    evaluations: int
    xi: float
    exposures: tuple[float, ...]


def measure(run: SolverRun) -> tuple[SolverPoint, ...]:
    """Return what a run found, in the order of time.

    The search and the grid do not improve an answer over time: each of their points is a
    complete run of its own, with more effort or a finer grid than the one before.

    Raises:
        ImportError: the method is scipy's, and scipy is absent
    """
    if run.method == CAMCTL:
        return tuple(_searches(run))
    if run.method == GRID:
        return tuple(_grids(run))
    return _optimiser(run)


def _searches(run: SolverRun) -> Iterator[SolverPoint]:
    problem = run.problem
    effort = FIRST_EFFORT
    while True:
        started = time.thread_time()
        found = solve(
            problem.response, problem.desired, run.n, search=SearchOptions(run.seed, effort)
        )
        spent = time.thread_time() - started
        yield SolverPoint(spent, found.evaluations, found.xi, found.exposures)
        if run.is_over(spent * EFFORT_STEP, found.evaluations * EFFORT_STEP):
            return
        effort *= EFFORT_STEP


def _grids(run: SolverRun) -> Iterator[SolverPoint]:
    """Search all sets of ascending exposures on grids of equal factors, as in the paper."""
    problem, points = run.problem, FIRST_GRID
    while True:
        score = BatchScore(problem)
        started = time.thread_time()
        logs = np.linspace(0.0, math.log(run.dynamic_range), points)
        sets = combinations_with_replacement(np.exp(logs).tolist(), run.n - 1)
        best, best_xi = (1.0,) * run.n, math.inf
        for rows in _batches(sets):
            found = score(rows)
            if found.min() < best_xi:
                best_xi, best = float(found.min()), tuple(rows[found.argmin()].tolist())
        spent = time.thread_time() - started
        yield SolverPoint(spent, score.evaluations, problem.score(best), best)
        finer = math.ceil(points * GRID_STEP)
        factor = (finer / points) ** (run.n - 1)
        if run.is_over(spent * factor, score.evaluations * factor):
            return
        points = finer


def _batches(sets: Iterable[tuple[float, ...]]) -> Iterator[FloatArray]:
    """Yield (rows, n) arrays of the sets, with exposure 1 in front."""
    rest = iter(sets)
    while rows := list(islice(rest, _ROWS)):
        yield np.insert(np.array(rows), 0, 1.0, axis=1)


class _Finished(Exception):  # noqa: N818 - ends a run, is no error
    pass


class _Recorder:
    """The objective as scipy calls it; records the best set over time and ends at the limit."""

    def __init__(self, run: SolverRun) -> None:
        self.run, self.score = run, BatchScore(run.problem)
        self.best = math.inf
        self.found: list[tuple[float, int, tuple[float, ...]]] = []
        self.started = time.thread_time()

    def __call__(self, logs: FloatArray) -> FloatArray | float:
        """Return the objective of (n - 1,) or, for a population, (n - 1, S) logarithms."""
        sets = np.exp(np.insert(np.atleast_2d(logs.T), 0, 0.0, axis=1))
        sets.sort(axis=1)
        scores = self.score(sets)
        spent = time.thread_time() - self.started
        if scores.min() < self.best:
            self.best = float(scores.min())
            best = tuple(sets[scores.argmin()].tolist())
            self.found.append((spent, self.score.evaluations, best))
        if self.run.is_over(spent, self.score.evaluations):
            raise _Finished
        return scores if logs.ndim == 2 else float(scores[0])


def _optimiser(run: SolverRun) -> tuple[SolverPoint, ...]:
    """Run one of scipy's optimisers, and again with the next seed if it ends before the limit."""
    minimise, options = scipy_optimiser(run.method)
    recorder = _Recorder(run)
    bounds = [(0.0, math.log(run.dynamic_range))] * (run.n - 1)
    seeds = np.random.SeedSequence(run.seed)
    try:
        while True:
            minimise(recorder, bounds, rng=np.random.default_rng(seeds.spawn(1)[0]), **options)
    except _Finished:
        pass
    kept = {}
    for spent, evaluations, exposures in recorder.found:
        place = math.floor(_POINTS_PER_DECADE * math.log10(evaluations))
        kept[place] = (spent, evaluations, exposures)
    problem = run.problem
    return tuple(
        SolverPoint(spent, evaluations, problem.score(exposures), exposures)
        for spent, evaluations, exposures in kept.values()
    )


def scipy_optimiser(method: str) -> tuple[Callable[..., object], dict[str, Any]]:
    """Return one of scipy's global optimisers and its options; `ImportError` without scipy."""
    from scipy.optimize import differential_evolution, dual_annealing

    if method == "dual-annealing":  # scores one set at a time
        return dual_annealing, {"maxiter": 10**6}
    return differential_evolution, {
        "vectorized": True,
        "updating": "deferred",
        "maxiter": 10**6,
        "tol": 0,
        "polish": False,
        "popsize": POPULATION,
    }


class MissingOptimisersError(CamctlError):
    """Runs with scipy's optimisers need scipy, which is not installed."""


def require_scipy(runs: Iterable[SolverRun]) -> None:
    """Raise `MissingOptimisersError` if one of the runs needs scipy and it is not installed."""
    if all(run.method not in SCIPY_METHODS for run in runs):
        return
    try:
        import scipy.optimize  # noqa: F401 - imported to find out whether it can be
    except ImportError as error:
        raise MissingOptimisersError(
            "differential evolution and dual annealing need scipy, which is not installed",
            hint="install it with: pip install 'camctl[studies]', or use other methods",
            remedies={"methods": "camctl,grid"},
        ) from error


@dataclass(frozen=True)
class SolverStudy:
    """Runs and what they found.

    Attributes:
        runs: in the order in which they were asked for
        points: of each run
    """

    runs: tuple[SolverRun, ...]
    points: tuple[tuple[SolverPoint, ...], ...]

    @property
    def cases(self) -> tuple[Case, ...]:
        """The problems, each once."""
        return tuple(dict.fromkeys(run.case for run in self.runs))

    def best_xi(self, case: Case) -> float:
        """Return the smallest xi that any run found."""
        return min(p.xi for points in self._of(case) for p in points)

    def _of(self, case: Case, method: str | None = None) -> list[tuple[SolverPoint, ...]]:
        return [
            points
            for run, points in zip(self.runs, self.points, strict=True)
            if run.case == case and method in (None, run.method)
        ]

    def curves(self, case: Case, method: str) -> list[list[tuple[float, float]]]:
        """Return (CPU seconds, regret) of each run of a method, in the order of time."""
        best = self.best_xi(case)
        return [[(p.cpu_s, p.xi / best - 1) for p in points] for points in self._of(case, method)]

    def regret_at(self, case: Case, method: str, cpu_s: float) -> float:
        """Return the median over the seeds of the regret after a CPU time; infinite for none."""
        curves = self.curves(case, method)
        return median(
            min((regret for spent, regret in curve if spent <= cpu_s), default=math.inf)
            for curve in curves
        )

    def time_to(self, case: Case, method: str) -> float:
        """Return the median CPU time to `ENOUGH`, s; infinite where half of the runs miss it."""
        return median(
            next((spent for spent, reached in curve if reached <= ENOUGH), math.inf)
            for curve in self.curves(case, method)
        )

    def in_words(self) -> list[str]:
        """Return a sentence for each method: in how many problems it was near the best, and when.

        The time is the median over the problems in which it was.
        """
        sentences = []
        for method in dict.fromkeys(run.method for run in self.runs):
            cases = [case for case in self.cases if self._of(case, method)]
            times = [self.time_to(case, method) for case in cases]
            reached = [time_s for time_s in times if math.isfinite(time_s)]
            after = f", after {median(reached):.2g} s" if reached else ""
            sentences.append(
                f"{method}: within {100 * ENOUGH:g} % of the best in {len(reached)} of "
                f"{len(cases)} problems{after}."
            )
        return sentences

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each point: its run, which can be run again, and what was found."""
        return [
            asdict(run) | asdict(point) | {"regret": point.xi / self.best_xi(run.case) - 1}
            for run, points in zip(self.runs, self.points, strict=True)
            for point in points
        ]


def solver_runs(
    cases: Iterable[tuple[str, float, int]],
    methods: Sequence[str] = METHODS,
    *,
    bits: int = 8,
    seeds: int = 3,
    limit_s: float = 2.0,
    max_evaluations: int | None = None,
) -> tuple[SolverRun, ...]:
    """Return the runs of a study: every case with every method, repeated where it is random."""
    return tuple(
        SolverRun(method, response, dynamic_range, n, bits, seed, limit_s, max_evaluations)
        for response, dynamic_range, n in cases
        for method in methods
        for seed in range(1 if method == GRID else seeds)
    )
