"""The search for exposures: against the best known sets, against scipy, and how its cost grows.

    python tests/bench/bench_solver.py [--no-scipy] [--largest N] [--times X]

Needs scipy (for the comparison only).  Times are CPU seconds of one core, so that other work on the
machine disturbs little.  scipy's optimisers use the solver's own fast objective, whole populations
at a time, as in `camctl tradeoff solver`: only the search strategies are compared.  "Equal xi" is
within 0.05 % of what the search finds; its own time to that value is that of the smallest effort
that reaches it.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from camctl.exposure.build import build_table, table_jobs
from camctl.exposure.exposure_choices import SettingsGrid
from camctl.exposure.grid_search import solve_settings
from camctl.exposure.objective import xi
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.effective import EffectiveCamera
from camctl.model.response.auto import auto_response
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.studies.solver_study import SCIPY_METHODS, SolverRun, measure

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from cells import CELLS, Cell

EIGHT_BIT = linear_response(8)
EQUAL = 1.0005
"""xi within 0.05 % counts as equal."""


def time_to_reach(cell: Cell, target: float) -> float:
    """Return the CPU seconds of the smallest effort that reaches `target`."""
    for effort in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5):
        found = solve(EIGHT_BIT, cell.desired, cell.n, search=SearchOptions(effort=effort))
        if found.xi <= target:
            return found.seconds
    return solve(EIGHT_BIT, cell.desired, cell.n).seconds


def bench_cells(largest: int, times: float, with_scipy: bool) -> None:
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
            fastest = math.inf
            target = found.xi * EQUAL
            solver_s = time_to_reach(cell, target)
            limit_s = times * found.seconds
            for method in SCIPY_METHODS:
                dynamic_range = cell.desired.dynamic_range
                run = SolverRun(method, cell.response, dynamic_range, cell.n, limit_s=limit_s)
                points = measure(run)
                equal_time = min((p.xi for p in points if p.cpu_s <= found.seconds), default=-1)
                reached_s = next((p.cpu_s for p in points if p.xi <= target), math.inf)
                ratio = reached_s / solver_s
                shown = f"{ratio:.1f}" if math.isfinite(ratio) else f"> {limit_s / solver_s:.0f}"
                fastest = min(fastest, ratio)
                print(f"   {method}: {equal_time:.2f}, {shown}", end="")
            ratios.append(fastest)
        print(flush=True)
    print(f"CPU s: median {statistics.median(seconds):.2f}, maximum {max(seconds):.2f}")
    if ratios:
        print(
            "relative time of the faster scipy optimiser: "
            f"median cell {statistics.median(ratios):.1f}, least {min(ratios):.1f}; "
            f"not reached in {sum(math.isinf(ratio) for ratio in ratios)} of {len(ratios)} cells"
        )


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
        default=4.0,
        help="time limit of scipy, in units of the time of the solver",
    )
    arguments = parser.parse_args()
    with_scipy = not arguments.no_scipy
    bench_cells(arguments.largest, arguments.times, with_scipy)
    bench_growth()
    bench_auto()
    bench_table()


if __name__ == "__main__":
    main()
