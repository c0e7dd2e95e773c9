"""Exposures chosen by accuracy: against the xi sets, against scipy, and their cost.

    python tests/bench/bench_accuracy_objective.py [--no-scipy] [--sensors NAME,...]

Effective levels count the noise of the built-in sensors, by the exact prediction, over 1:1,000 at
gain 1; times are in units of the shortest exposure, CPU seconds those of one core.  "Same time" is
the most accurate set within the time of the xi set; "chosen" is the shortest one within 0.5 % of
the best.  scipy's differential evolution minimises the exact error itself, with 400 evaluations
for each exposure; its result is the rival of the most accurate set found.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np

from camctl.exposure.accuracy import solve_accuracy
from camctl.exposure.build import look_up
from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures
from camctl.exposure.noise import noisy_effective_levels
from camctl.model.effective import EffectiveCamera
from camctl.model.response.desired import desired_response
from camctl.sim.sensors.sensor import load_sensor

SENSORS = "standard,webcam,consumer,complete,phone,mobile,machine-vision,ideal-8"


class Target(NamedTuple):
    """Effective levels to reach, and the longest time."""

    sensor: str
    response: str
    n: int
    levels: float
    longest: float


TARGETS = (
    Target("standard", "linear", 3, 69.5, 3.1),
    Target("standard", "gamma", 6, 129.0, 16.5),
    Target("webcam", "linear", 3, 53.8, np.inf),
)


def problem_of(
    sensor: str, response: str, span: float = 1000.0, gains: tuple[float, ...] = (1.0,)
) -> AccuracyProblem:
    """Return the problem of a sensor preset."""
    controls = load_sensor(sensor).controls((8, 8), is_coloured=False, photons_per_unit=1.0)
    assert controls.noise is not None
    desired = desired_response(response, span)
    available = AvailableExposures(gains=gains)
    return AccuracyProblem(controls.levels, desired, controls.noise, available, controls.black)


def levels_of(problem: AccuracyProblem, exposures: tuple[float, ...]) -> float:
    """Return the effective levels of exposures at gain 1, by the exact prediction."""
    frame = problem.noise.frame(gain=1.0, time_s=0.0, black=problem.black)
    camera = EffectiveCamera.of(problem.response, exposures)
    return noisy_effective_levels(camera, problem.desired, [frame] * len(exposures))


def bench_targets() -> None:
    """Print the measured targets."""
    print("sensor     response n   effective levels (least)   time (longest)   CPU s")
    for target in TARGETS:
        found = solve_accuracy(problem_of(target.sensor, target.response), [target.n])
        reached = found.effective_levels >= target.levels and found.total_time <= target.longest
        print(
            f"{target.sensor:10} {target.response:8} {target.n}   {found.effective_levels:10.2f} "
            f"({target.levels:g})  {found.total_time:14.2f} ({target.longest:g})  "
            f"{found.seconds:10.2f}   {'reached' if reached else 'MISSED'}"
        )


def bench_against_xi(sensors: list[str], responses: tuple[str, ...]) -> None:
    """Print the xi set, the most accurate set in the same time, and the chosen set."""
    print("\n" + " " * 27 + "xi set         same time   chosen")
    print("sensor         response n   time  levels    levels      time  levels  CPU s")
    below: list[str] = []
    shares: dict[str, list[float]] = {}
    for sensor in sensors:
        for response in responses:
            problem = problem_of(sensor, response)
            for n in range(2, 7):
                row = look_up(problem.response, problem.desired, n)
                by_xi, total = levels_of(problem, row.exposures), row.total_exposure
                best = solve_accuracy(problem, [n], total_limit=total, near_tie=0.0)
                chosen = solve_accuracy(problem, [n])
                print(
                    f"{sensor:14} {response:8} {n} {total:7.2f} {by_xi:7.2f} "
                    f"{best.effective_levels:9.2f} {chosen.total_time:9.2f} "
                    f"{chosen.effective_levels:7.2f} {chosen.seconds:6.2f}",
                    flush=True,
                )
                if best.effective_levels < by_xi * (1 - 1e-9):
                    below.append(
                        f"{sensor} {response} n = {n}: {best.effective_levels / by_xi:.5f}"
                    )
                shares.setdefault(response, []).append(chosen.total_time / total)
    for response, values in shares.items():
        print(f"{response}: the chosen set takes {np.median(values):.2f} of the time (median)")
    print(f"below the xi set in the same time: {', '.join(below) or 'none'}")


def bench_against_scipy() -> None:
    """Print the regret of the most accurate set against differential evolution."""
    from scipy.optimize import differential_evolution

    print("\nsensor     response range  n   found   scipy   ratio   CPU s   scipy's CPU s")
    for sensor, response, span, n in (
        ("standard", "log", 1000.0, 3),
        ("standard", "gamma", 1000.0, 4),
        ("webcam", "log", 16000.0, 3),
        ("webcam", "linear", 1000.0, 4),
        ("consumer", "log", 1000.0, 4),
    ):
        problem = problem_of(sensor, response, span)
        found = solve_accuracy(problem, [n], near_tie=0.0)

        def error(logs: np.ndarray, problem: AccuracyProblem = problem) -> float:
            return -levels_of(problem, (1.0, *sorted(np.exp(logs).tolist())))

        started = time.process_time()
        bounds = [(0.0, np.log(problem.reach))] * (n - 1)
        rival = differential_evolution(
            error, bounds, popsize=20, maxiter=19, tol=0, polish=False, rng=0
        )
        spent = time.process_time() - started
        print(
            f"{sensor:10} {response:8} {span:5g} {n} {found.effective_levels:8.2f} "
            f"{-rival.fun:7.2f} {found.effective_levels / -rival.fun:7.4f} {found.seconds:7.2f} "
            f"{spent:10.2f}",
            flush=True,
        )


def main() -> None:
    """Run all benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-scipy", action="store_true")
    parser.add_argument("--sensors", default=SENSORS)
    parser.add_argument("--responses", default="log,gamma,linear")
    arguments = parser.parse_args()
    bench_targets()
    bench_against_xi(arguments.sensors.split(","), tuple(arguments.responses.split(",")))
    if not arguments.no_scipy:
        bench_against_scipy()


if __name__ == "__main__":
    main()
