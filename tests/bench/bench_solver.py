"""The search for exposures: against the best known sets, against scipy, and how its cost grows.

    python tests/bench/bench_solver.py [--no-scipy] [--largest N] [--times X]

Needs scipy (for the comparison only).  Times are CPU seconds of one core, so that other work on the
machine disturbs little.  scipy minimises the same objective, `camctl.exposure.objective.xi`; with
--share-kernel it uses the solver's own float32 batches, whole populations at a time, so that only
the search strategies are compared.  "Equal xi" is within 0.05 % of what the search finds; its own
time to that value is that of the smallest effort that reaches it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.build import build_table, table_jobs
from camctl.exposure.candidates import BatchScore
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.grid_search import SettingsGrid, solve_settings
from camctl.exposure.objective import ExposureProblem, xi
from camctl.exposure.solver import SearchOptions, solve
from camctl.response.auto import auto_response
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from cells import CELLS, Cell

EIGHT_BIT = linear_response(8)
EQUAL = 1.0005
"""xi within 0.05 % counts as equal."""

Floats = NDArray[np.float64]


class _Finished(Exception):  # noqa: N818 - ends a run, is no error
    pass


class RecordedObjective:
    """The objective of a cell, which records its best values and ends at a time or a value."""

    def __init__(self, cell: Cell, limit_s: float, target: float, share_kernel: bool) -> None:
        self.problem = ExposureProblem(EIGHT_BIT, cell.desired, cell.n)
        self.score = BatchScore(self.problem) if share_kernel else self.exact
        self.limit_s, self.target = limit_s, target
        self.best, self.reached_s = np.inf, np.inf
        self.history: list[tuple[float, float]] = []
        self.start = time.process_time()

    def exact(self, exposures: Floats) -> Floats:
        """Return the exact objective of each row."""
        return np.array([self.problem.score(row) for row in exposures.tolist()])

    def __call__(self, logs: Floats) -> Floats | float:
        """Return the objective of (n - 1,) or, for a population, (n - 1, S) logarithms."""
        sets = np.atleast_2d(logs.T)
        ones = np.ones((len(sets), 1))
        found = self.score(np.sort(np.concatenate([ones, np.exp(sets)], axis=1), axis=1))
        spent = time.process_time() - self.start
        if found.min() < self.best:
            self.best = float(found.min())
            self.history.append((spent, self.best))
        if self.best <= self.target and np.isinf(self.reached_s):
            self.reached_s = spent
        if spent > self.limit_s or np.isfinite(self.reached_s):
            raise _Finished
        return found if logs.ndim == 2 else float(found[0])

    def best_at(self, seconds: float) -> float:
        """Return the best value found within so many CPU seconds."""
        return min((value for spent, value in self.history if spent <= seconds), default=np.inf)


def scipy_optimisers(cell: Cell) -> dict[str, Callable[[RecordedObjective], object]]:
    """Return scipy's global optimisers, set up for a cell."""
    from scipy.optimize import differential_evolution, dual_annealing

    bounds = [(0.0, float(np.log(cell.desired.dynamic_range)))] * (cell.n - 1)
    return {
        "differential_evolution": lambda f: differential_evolution(
            f, bounds, vectorized=True, updating="deferred", maxiter=10**6, tol=0, polish=False,
            popsize=30, rng=0,
        ),
        "dual_annealing": lambda f: dual_annealing(f, bounds, maxiter=10**6, rng=0),
    }  # fmt: skip


def time_to_reach(cell: Cell, target: float) -> float:
    """Return the CPU seconds of the smallest effort that reaches `target`."""
    for effort in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5):
        found = solve(EIGHT_BIT, cell.desired, cell.n, search=SearchOptions(effort=effort))
        if found.xi <= target:
            return found.seconds
    return solve(EIGHT_BIT, cell.desired, cell.n).seconds


def bench_cells(largest: int, times: float, with_scipy: bool, share_kernel: bool) -> None:
    """Print each cell; for scipy, its xi at equal time and its time to equal xi."""
    seconds, ratios = [], []
    print("cell          best known        xi   regret   CPU s" + " " * 4 * with_scipy, end="")
    print("  scipy: xi at equal time, relative time to equal xi" if with_scipy else "")
    for cell in (cell for cell in CELLS if cell.n <= largest):
        found = solve(EIGHT_BIT, cell.desired, cell.n)
        seconds.append(found.seconds)
        print(
            f"{cell.response:8}n={cell.n}  {cell.best_xi:10.2f} {found.xi:9.3f} "
            f"{100 * (found.xi / cell.best_xi - 1):+7.3f} % {found.seconds:6.2f}",
            end="",
        )
        if with_scipy:
            fastest = np.inf
            target = found.xi * EQUAL
            solver_s = time_to_reach(cell, target)
            for name, run in scipy_optimisers(cell).items():
                recorded = RecordedObjective(cell, times * found.seconds, target, share_kernel)
                ending = ""
                try:
                    run(recorded)
                    ending = " (ended by itself)"
                except _Finished:
                    pass
                ratio = recorded.reached_s / solver_s
                limit = f"> {times * found.seconds / solver_s:.0f}"
                relative = f"{ratio:.1f}" if np.isfinite(ratio) else limit
                fastest = min(fastest, ratio)
                at_equal_time = recorded.best_at(found.seconds)
                print(f"   {name}: {at_equal_time:.2f}, {relative}{ending}", end="")
            ratios.append(fastest)
        print(flush=True)
    print(f"CPU s: median {statistics.median(seconds):.2f}, maximum {max(seconds):.2f}")
    if ratios:
        median = statistics.median(ratios)
        print(f"relative time of the faster scipy optimiser, median cell: {median:.1f}")


def bench_growth() -> None:
    """Print the cost of one exact evaluation against n 2^b log n."""
    desired = desired_response("log", 1e5)
    print("\nbits  n   one evaluation, ms   ns per n 2^b (1 + log2 n)   peak MB")
    for bits, n in ((8, 1), (8, 8), (12, 2), (12, 8), (16, 1), (16, 2), (16, 4), (16, 8)):
        response = linear_response(bits)
        exposures = [3.1**k for k in range(n)]

        def evaluate() -> float:
            camera = EffectiveCamera.of(response, exposures)  # noqa: B023 - called at once
            return xi(camera, desired, n * response.M)  # noqa: B023

        evaluate()
        spent = []
        for _ in range(7):
            start = time.process_time()
            evaluate()
            spent.append(time.process_time() - start)
        cost = statistics.median(spent)
        tracemalloc.start()
        evaluate()
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        unit = n * 2**bits * (1 + np.log2(n))
        print(f"{bits:4} {n:2} {1e3 * cost:15.2f} {1e9 * cost / unit:25.1f} {peak:18.0f}")


def bench_auto() -> None:
    """Print the time from a metering frame to three exposures on a grid of third stops."""
    frame = np.random.default_rng(0).lognormal(-3, 1.2, (1200, 1600)).astype(np.float32).clip(0, 1)
    spent = []
    for _ in range(7):
        start = time.perf_counter()
        desired = auto_response(frame, 1000.0)
        solve_settings(EIGHT_BIT, desired, 3, SettingsGrid(2.0 ** (np.arange(-39, 16) / 3)))
        spent.append(time.perf_counter() - start)
    print(f"\nauto response on 55 shutter times, n = 3: {1e3 * statistics.median(spent):.0f} ms")


def bench_table() -> None:
    """Print the wall time of the default table in two processes."""
    start = time.perf_counter()
    with ProcessPoolExecutor(2) as executor:
        build_table(table_jobs(EIGHT_BIT), executor=executor)
    print(f"default table, 54 rows, two processes: {time.perf_counter() - start:.0f} s")


def main() -> None:
    """Run all benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-scipy", action="store_true")
    parser.add_argument("--largest", type=int, default=6, help="largest number of exposures")
    parser.add_argument(
        "--times",
        type=float,
        default=12.0,
        help="time limit of scipy, in units of the time of the solver",
    )
    parser.add_argument("--share-kernel", action="store_true", help="scipy uses the batch score")
    arguments = parser.parse_args()
    with_scipy = not arguments.no_scipy
    bench_cells(arguments.largest, arguments.times, with_scipy, arguments.share_kernel)
    bench_growth()
    bench_auto()
    bench_table()


if __name__ == "__main__":
    main()
