"""What the constants of the search for the front are worth: time and accuracy with other values.

    OMP_NUM_THREADS=1 python tests/bench/bench_front_constants.py [--every K] [--only NAME,...]

For each value of a constant it prints the processor time of `Front.at_time` for every K-th case of
`bench_front_adversary`, and how many effective levels, rated exactly, the sets have against those
of the search as it is: on average, and for the cases that change most.  It takes 3 minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from camctl.errors import CamctlError
from camctl.exposure import accuracy
from camctl.exposure.accurate import design, frame_sets, gap_filling, least_quantisation, sets
from camctl.exposure.search.front import Front
from camctl.model import inverse
from tests.bench.bench_front_adversary import CASES, front_of

CONSTANTS: list[tuple[ModuleType, str, tuple[float, ...]]] = [
    (design, "COARSER", (1, 4)),
    (design, "REFINED", (1, 4)),
    (design, "REGAINED", (1, 4)),
    (design, "NEAR_MSE", (1.01, 1.04)),
    (design, "ENOUGH", (2e-6, 1e-3)),
    (design, "CHEAPER", (1.0, 3.0, 30.0)),
    (design, "MOST_PATTERNS", (1000, 16000)),
    (design, "NEAR_PATTERN", (1.02, 1.5)),
    (frame_sets, "LATTICE", (0.1, 0.4)),
    (sets, "MOST_JUDGED", (3, 12)),
    (sets, "MOST_SMOOTH", (1, 4)),
    (sets, "JUDGED_FRAMES", (1, 16, 64)),
    (sets, "MOST_POLISHED", (0, 100_000)),
    (gap_filling, "EXCHANGED", (2, 5)),
    (gap_filling, "RATED", (6, 24)),
    (gap_filling, "STEPS", (2, 8)),
    (gap_filling, "COARSE", (1, 6)),
    (least_quantisation, "STARTS", (12, 72)),
    (least_quantisation, "MOST_STEPPED", (0, 16_000_000)),
    (least_quantisation, "MOST_EXCHANGED", (0, 640_000)),
]
"""Modules, names of their constants, and other values."""

Levels = dict[int, float]
"""Exact effective levels of the cases."""


def forget() -> None:
    """Forget what searches keep, in memory and on disk."""
    accuracy._kept.clear()
    inverse._posterior.cache_clear()
    os.environ["CAMCTL_CACHE"] = tempfile.mkdtemp()


def measured(fronts: dict[int, Front]) -> tuple[float, Levels]:
    """Return the processor time of a point of each front, and its effective levels."""
    spent_s, levels = 0.0, {}
    for number, front in fronts.items():
        forget()
        front._answers.clear()
        started = time.process_time()
        try:
            point = front.at_time(CASES[number][2])
        except CamctlError:
            continue
        spent_s += time.process_time() - started
        levels[number] = front.levels_of(point.settings)
    return spent_s, levels


def main() -> None:
    """Print a row for each value."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--every", type=int, default=7)
    parser.add_argument("--only", default="", help="names of constants; all by default")
    arguments = parser.parse_args()
    fronts = {number: front_of(number) for number in range(0, len(CASES), arguments.every)}
    as_is_s, as_is = measured(fronts)
    print(f"{'as it is':24}{as_is_s:8.2f} s  {len(as_is)} cases", flush=True)
    chosen = [name for name in arguments.only.split(",") if name]
    for module, name, values in CONSTANTS:
        if chosen and name not in chosen:
            continue
        own = getattr(module, name)
        for value in values:
            setattr(module, name, value)
            spent_s, levels = measured(fronts)
            setattr(module, name, own)
            change = np.array([levels[number] / as_is[number] - 1 for number in as_is])
            print(
                f"{name:16}{value:8g}{spent_s:8.2f} s  mean {change.mean():+.4%}, "
                f"{change.min():+.4%} to {change.max():+.4%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
