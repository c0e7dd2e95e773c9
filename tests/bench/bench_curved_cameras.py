"""Regret of the search for cameras with measured response curves, against the best of ten seeds.

    python tests/bench/bench_curved_cameras.py EMOR_FILE [--curves 60] [--first 0]
        [--processes 2] [--linear-step]

EMOR_FILE is ``emor.txt``, the empirical model of response of Grossberg and Nayar (CVPR 2003), which
is not part of camctl.  A curve is its mean with random weights of the first five components, of a
standard deviation that falls as 1, 1/2, 1/3 ...  For each curve and each of log, linear and gamma
over 1:1,000, three exposures are searched with seeds 0 to 9; the regrets are those of seeds 0 to 2.
Each problem is printed as it is done; --first leaves out
the problems before that number, so that an interrupted run can be continued.
With --linear-step the search uses 1/(M + 1), the interleave step of a linear camera, for all.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from camctl.errors import DataError
from camctl.exposure import random_sets
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import desired_response
from camctl.model.response.measured import ResponseModel, read_response_model

SEEDS, JUDGED_SEEDS = 10, 3
LIMIT = 0.005
"""Largest regret that counts as good."""


def curves(model: ResponseModel, count: int) -> Iterator[CameraResponse]:
    """Yield measured-like responses of 8 bits that need no repair."""
    rng = np.random.default_rng(0)
    made = 0
    while made < count:
        weights = rng.standard_normal(5) / np.arange(1, 6)
        try:
            response = model.response(weights.tolist(), name=f"EMoR {made}")
        except DataError:
            continue
        if not any("decrease" in note for note in response.notes):
            made += 1
            yield response


def regrets(task: tuple[CameraResponse, str, bool]) -> tuple[str, list[float]]:
    """Return the name of a run, and the regrets of the judged seeds."""
    response, name, linear_step = task
    if linear_step:
        random_sets.SIMILAR_STEPS = math.inf
    desired = desired_response(name, 1000.0)
    found = [
        solve(response, desired, 3, search=SearchOptions(seed=seed)).xi for seed in range(SEEDS)
    ]
    return f"{response.name} {name}", [xi / min(found) - 1 for xi in found[:JUDGED_SEEDS]]


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--curves", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--linear-step", action="store_true")
    arguments = parser.parse_args()
    if not arguments.model.exists():
        print(f"{arguments.model} does not exist: nothing is measured")
        return
    model = read_response_model(arguments.model)
    tasks = [
        (response, name, arguments.linear_step)
        for response in curves(model, arguments.curves)
        for name in ("log", "linear", "gamma")
    ][arguments.first :]
    results = []
    with ProcessPoolExecutor(arguments.processes) as executor:
        for number, (name, values) in enumerate(executor.map(regrets, tasks), arguments.first):
            results.append((name, values))
            shown = "".join(f"{100 * value:8.3f} %" for value in values)
            print(f"{number:4} {name:20}{shown}", flush=True)
    every = [value for _, values in results for value in values]
    print(
        f"{len(every)} runs: median regret {100 * np.median(every):.4f} %, worst "
        f"{100 * max(every):.3f} %, {sum(value > LIMIT for value in every)} above "
        f"{100 * LIMIT:g} %"
    )


if __name__ == "__main__":
    main()
