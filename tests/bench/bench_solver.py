"""The search for exposures: against the best known sets, against scipy, and how its cost grows.

    python tests/bench/bench_solver.py [--no-scipy] [--largest N] [--times X]

Needs scipy (for the comparison only).  CPU seconds of one core, so that other work on the machine
disturbs little.  scipy gets the same objective, `camctl.exposure.objective.xi`; with --lend-kernel
it gets the solver's own float32 batches, whole populations at a time, which leaves the search alone
to be compared.  "Equal xi" is within 0.05 % of what the search finds; its own time to there is that
of the least effort that gets there.
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

from camctl.exposure.batch import BatchScore
from camctl.exposure.build import build_table
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.grid_search import solve_settings
from camctl.exposure.objective import Objective, xi
from camctl.exposure.solver import solve
from camctl.response.auto import auto_response
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from cells import CELLS, Cell

EIGHT_BIT = linear_response(8)
EQUAL = 1.0005
"""xi within 0.05 % counts as equal."""

Floats = NDArray[np.float64]


class _Enough(Exception):  # noqa: N818 - ends a run, no error
    pass


class Watched:
    """The objective of a cell, that notes its best and stops at a time or a value."""

    def __init__(self, cell: Cell, limit_s: float, goal: float, lend: bool) -> None:
        self.cell = cell
        self.batch = BatchScore(EIGHT_BIT, cell.desired, Objective(cell.levels_wanted), cell.n)
        self.score = self.batch if lend else self.exact
        self.limit_s, self.goal = limit_s, goal
        self.best, self.reached_s = np.inf, np.inf
        self.marks: list[tuple[float, float]] = []
        self.start = time.process_time()

    def exact(self, exposures: Floats) -> Floats:
        """Return the exact objective of each row."""
        cell = self.cell
        return np.array(
            [
                xi(EffectiveCamera.of(EIGHT_BIT, row), cell.desired, cell.levels_wanted)
                for row in exposures.tolist()
            ]
        )

    def __call__(self, logs: Floats) -> Floats | float:
        """Take (n - 1,) or, of a population, (n - 1, S) logarithms."""
        sets = np.atleast_2d(logs.T)
        ones = np.ones((len(sets), 1))
        found = self.score(np.sort(np.concatenate([ones, np.exp(sets)], axis=1), axis=1))
        spent = time.process_time() - self.start
        if found.min() < self.best:
            self.best = float(found.min())
            self.marks.append((spent, self.best))
        if self.best <= self.goal and np.isinf(self.reached_s):
            self.reached_s = spent
        if spent > self.limit_s or np.isfinite(self.reached_s):
            raise _Enough
        return found if logs.ndim == 2 else float(found[0])

    def best_at(self, seconds: float) -> float:
        """Return the best met within so many CPU seconds."""
        return min((value for spent, value in self.marks if spent <= seconds), default=np.inf)


def rivals(cell: Cell) -> dict[str, Callable[[Watched], object]]:
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


def time_to(cell: Cell, goal: float) -> float:
    """Return the CPU seconds of the least effort that scores `goal` or less."""
    for effort in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5):
        found = solve(EIGHT_BIT, cell.desired, cell.n, effort=effort)
        if found.xi <= goal:
            return found.seconds
    return solve(EIGHT_BIT, cell.desired, cell.n).seconds


def bench_cells(largest: int, times: float, with_scipy: bool, lend: bool) -> None:
    """Print each cell; with scipy, its xi at equal time and its time to equal xi."""
    seconds, ratios = [], []
    print("cell          best known        xi   regret   CPU s" + " " * 4 * with_scipy, end="")
    print("  rival: xi at equal time, times as long to equal xi" if with_scipy else "")
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
            own = time_to(cell, found.xi * EQUAL)
            for name, run in rivals(cell).items():
                watched = Watched(cell, times * found.seconds, found.xi * EQUAL, lend)
                stopped = ""
                try:
                    run(watched)
                    stopped = " (gave up)"
                except _Enough:
                    pass
                ratio = watched.reached_s / own
                told = (
                    f"{ratio:.1f}" if np.isfinite(ratio) else f"> {times * found.seconds / own:.0f}"
                )
                fastest = min(fastest, ratio)
                print(f"   {name}: {watched.best_at(found.seconds):.2f}, {told}{stopped}", end="")
            ratios.append(fastest)
        print(flush=True)
    print(f"CPU s: median {statistics.median(seconds):.2f}, most {max(seconds):.2f}")
    if ratios:
        print(f"times as fast as the better rival, median cell: {statistics.median(ratios):.1f}")


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
    """Print the time from a metering frame to the exposures, three of a third-stop dial."""
    frame = np.random.default_rng(0).lognormal(-3, 1.2, (1200, 1600)).astype(np.float32).clip(0, 1)
    spent = []
    for _ in range(7):
        start = time.perf_counter()
        desired = auto_response(frame, 1000.0)
        solve_settings(EIGHT_BIT, desired, 3, 2.0 ** (np.arange(-39, 16) / 3))
        spent.append(time.perf_counter() - start)
    print(f"\nauto response on 55 shutter times, n = 3: {1e3 * statistics.median(spent):.0f} ms")


def bench_table() -> None:
    """Print the wall time of the whole default table in two processes."""
    start = time.perf_counter()
    with ProcessPoolExecutor(2) as executor:
        build_table(EIGHT_BIT, executor=executor)
    print(f"default table, 54 rows, two processes: {time.perf_counter() - start:.0f} s")


def main() -> None:
    """Run all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-scipy", action="store_true")
    parser.add_argument("--largest", type=int, default=6, help="cells of up to so many exposures")
    parser.add_argument("--times", type=float, default=12.0, help="how long rivals may take")
    parser.add_argument("--lend-kernel", action="store_true", help="scipy gets the fast score")
    arguments = parser.parse_args()
    with_scipy = not arguments.no_scipy
    bench_cells(arguments.largest, arguments.times, with_scipy, arguments.lend_kernel)
    bench_growth()
    bench_auto()
    bench_table()


if __name__ == "__main__":
    main()
