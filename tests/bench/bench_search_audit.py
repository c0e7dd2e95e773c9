"""Regret of the search by xi, against a multistart search of its own with the exact objective.

    python tests/bench/bench_search_audit.py [CASES] [EVALUATIONS]

Cameras of 3 to 12 bits, linear, sRGB and (with $CAMCTL_DATA) the measured curves of the Database of
Response Functions; desired responses log, linear, gamma and tables with flat parts; ranges 16 to
100,000; 2 to 6 exposures.  The other search starts from even, geometric and grouped sets and from
the set that `camctl.solve` found, and shares no code with it but the objective.  Prints the regret
of each case above 0.01 %, and the worst; ends with status 1 above 0.1 %.
"""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path

import numpy as np

from camctl.exposure.candidates import BatchScore
from camctl.exposure.objective import ExposureProblem
from camctl.exposure.solver import solve
from camctl.model.response.camera import (
    CameraResponse,
    FloatArray,
    linear_response,
    standard_response,
)
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.response.tabulated import tabulated_desired

CASES, EVALUATIONS = 60, 3000
"""Problems, and sets that the other search rates for each: 5 minutes of processor time."""

REGRET = 1e-3
"""Largest relative difference from the least xi that is known."""

BATCH_ERROR = 1e-9
"""Largest relative difference between the objective of a batch and the exact one."""

CURVES = Path(os.environ.get("CAMCTL_DATA", "")) / "dorf/curves.npz"


def measured(place: int, bits: int) -> CameraResponse:
    """Return a curve of the database, by its number there, as a camera of so many bits."""
    with np.load(CURVES) as data:
        row = data["index"].tolist().index(place)
        irradiance, brightness = (data[key][row] for key in ("irradiance", "brightness"))
    brightness = np.maximum.accumulate(brightness.astype(np.float64))
    rising = np.append(True, np.diff(brightness) > 0)
    steps = np.arange(1, 2**bits) / 2**bits
    levels = np.interp(steps, brightness[rising], irradiance[rising].astype(np.float64))
    return CameraResponse(np.maximum(levels, 1e-9), f"curve {place}, {bits} bit")


def problem_of(case: int) -> ExposureProblem:
    """Return the problem of a number: always the same one."""
    rng = np.random.default_rng(case)
    n, bits = int(rng.integers(2, 7)), int(rng.choice([3, 4, 5, 6, 7, 8, 10, 12]))
    span = float(np.round(np.exp(rng.uniform(math.log(16), math.log(1e5)))))
    cameras = ["linear", "sRGB", *(["measured"] if CURVES.exists() else [])]
    kind = str(rng.choice(cameras))
    response = linear_response(bits)
    if kind == "measured":
        with np.load(CURVES) as data:
            response = measured(int(rng.choice(data["index"])), bits)
    if kind == "sRGB":
        response = standard_response("srgb", bits)
    name = str(rng.choice(["log", "linear", "gamma", "table"]))
    desired: DesiredResponse
    if name == "table":
        points = int(rng.integers(2, 40))
        steps = rng.random(points) * (rng.random(points) > 0.3)
        steps[-1] += 0.1
        desired = tabulated_desired(np.geomspace(1 / span, 1, points), np.cumsum(steps))
    else:
        desired = desired_response(name, span)
    return ExposureProblem(response, desired, n)


def least_xi(problem: ExposureProblem, known: FloatArray, evaluations: int) -> float:
    """Return the least xi of a pattern search from many starts.

    Args:
        problem: the problem
        known: (n,) ln of exposures from which it starts, too
        evaluations: sets to rate
    """
    n, reach = problem.n, math.log(problem.desired.dynamic_range)
    rng = np.random.default_rng(11)

    def score(free: FloatArray) -> float:
        logs = np.sort(np.append(0.0, np.minimum(np.abs(free), reach)))
        return problem.score(np.exp(logs).tolist())

    gaps = np.diff(problem.response.levels) / problem.response.levels[:-1]
    starts = [reach * share * np.arange(1, n) / (n - 1) for share in np.linspace(0.02, 1, 40)]
    starts += [rng.uniform(0, reach * rng.random(), n - 1) for _ in range(80)]
    for _ in range(60):
        inner = float(rng.choice(gaps)) * rng.uniform(0.3, 1.5)
        groups = int(rng.integers(1, n + 1))
        centres = np.sort(np.append(0.0, rng.uniform(0, reach, groups - 1)))
        place = np.sort(rng.integers(0, groups, n))
        starts.append((centres[place] + inner * np.arange(n))[1:])
    ranked = sorted(((score(each), each) for each in starts), key=lambda pair: pair[0])
    best = math.inf
    left = max(evaluations - len(starts), 0)
    chosen = [(score(known[1:]), known[1:]), *ranked[:4]]
    for value, place in chosen:
        for _ in range(left // len(chosen)):
            step = 10 ** rng.uniform(-6, 0) * rng.standard_normal(n - 1)
            if rng.random() < 0.5:
                step *= rng.random(n - 1) < 0.5
            elif rng.random() < 0.5:
                step = np.where(np.arange(n - 1) >= rng.integers(n - 1), step[0], 0.0)
            trial = place + step
            found = score(trial)
            if found < value:
                value, place = found, trial
        best = min(best, value)
    return best


def main() -> None:
    """Print the regrets."""
    cases = int(sys.argv[1]) if len(sys.argv) > 1 else CASES
    evaluations = int(sys.argv[2]) if len(sys.argv) > 2 else EVALUATIONS
    if not CURVES.exists():
        print("no measured curves: $CAMCTL_DATA is not set")
    regrets, batch_error, started = [], 0.0, time.process_time()
    rng = np.random.default_rng(1)
    for case in range(cases):
        problem = problem_of(case)
        found = solve(problem.response, problem.desired, problem.n)
        known = least_xi(problem, np.log(found.exposures), evaluations)
        regret = found.xi / known - 1 if known > 0 else found.xi
        logs = np.sort(rng.uniform(0, math.log(problem.desired.dynamic_range), (4, problem.n)))
        rows = np.exp(np.concatenate([logs - logs[:, :1], [np.log(found.exposures)]]))
        exact = np.array([problem.score(row.tolist()) for row in rows])
        error = np.abs(BatchScore(problem, exact=True)(rows) - exact) / np.maximum(exact, 1.0)
        batch_error = max(batch_error, float(error.max()))
        regrets.append(regret)
        if regret > 1e-4:
            print(
                f"case {case}: {problem.response.name}, {problem.desired.description}, "
                f"1:{problem.desired.dynamic_range:,.0f}, n = {problem.n}: xi {found.xi:.6g}, "
                f"known {known:.6g}, regret {regret:.4%}",
                flush=True,
            )
    print(
        f"{cases} cases: worst regret {max(regrets):.4%}, {sum(r > REGRET for r in regrets)} above "
        f"{REGRET:.1%}; batch and exact objective differ by {batch_error:.1e} at most; "
        f"{time.process_time() - started:.0f} s of processor time"
    )
    if max(regrets) > REGRET or batch_error > BATCH_ERROR:
        sys.exit(1)


if __name__ == "__main__":
    main()
