"""Time saved by leaving effects out, for each scene and size.

Run by hand: ``python tests/bench/bench_sensor_budget.py``; `camctl tradeoff simulation` shows it
over the tolerance.  Frames with every effect and
frames with those that the tolerance requires take turns, with the same things kept between frames;
the times of the latter include planning.  "At most" is a frame without any of the effects that the
tolerance allows to leave out alone: no choice among them, which all change too much together in
some scenes, is faster.
"""

from __future__ import annotations

import argparse
import itertools
import random
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np

from camctl.sim.effects.budget import FramePlan, candidates, plan_frame
from camctl.sim.effects.record import Shot
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor
from camctl.system.memory import share_free_memory

SCENES = (
    "ball",
    "cloth",
    "colour-chart",
    "moving-target",
    "night-street",
    "ramp",
    "room",
    "stars",
    "tile-floor",
    "uniform",
)


def exposures(renderer: Renderer) -> dict[str, Shot]:
    """Return an exposure whose 98th percentile is 70 % of the full well, and one of 1/40 of it."""
    sensor, light = renderer.shot(1.0, 1.0, 0).sensor, renderer.shot(1.0, 1.0, 0).view.light
    bright = float(np.quantile(light[::3], 0.98)) * sensor.quantum_efficiency
    full = min(0.7 * sensor.full_well_e / bright, sensor.time_maximum_s)
    times = {"bright": full, "dim": full / 40}
    return {name: renderer.shot(t, 1.0, 0, previous_s=t) for name, t in times.items()}


def usual_seconds(works: dict[Any, Callable[[], object]], rounds: int) -> dict[Any, float]:
    """Return the median CPU seconds of each function.

    They take turns, each time in another order, since each one finds in the caches what the one
    before has left.  The least seconds of the same function differ by up to a tenth where a frame
    takes half a millisecond.
    """
    seconds: dict[Any, list[float]] = {key: [] for key in works}
    shuffled = random.Random(0)
    for turn in range(rounds + 1):
        for key in shuffled.sample(list(works), len(works)):
            start = time.process_time()
            works[key]()
            if turn:
                seconds[key].append(time.process_time() - start)
    return {key: statistics.median(values) for key, values in seconds.items()}


def plan_and_expose(renderer: Renderer, shots: Iterator[Shot]) -> None:
    """Render the next frame as a camera does: it leaves out what its tolerance allows."""
    shot = next(shots)
    renderer.expose(shot, renderer.plan(shot))


def expose_all(renderer: Renderer, shots: Iterator[Shot], plan: FramePlan) -> None:
    """Render the next frame with every effect, which needs no planning."""
    renderer.expose(next(shots), plan)


def numbered(renderer: Renderer, first: Shot) -> Iterator[Shot]:
    """Yield the exposures of one frame after another, which have new noise."""
    for number in itertools.count():
        yield renderer.shot(first.time_s, 1.0, number, previous_s=first.previous_s)


def per_scene(
    shape: tuple[int, int], rounds: int, tolerance_dn: float, *, compiled: bool
) -> list[dict[str, Any]]:
    """Return a row for each scene and exposure."""
    sensor = load_sensor("complete")
    rows = []
    for name in SCENES:
        view = View.of(load_scene(name, shape), sensor)
        _ = view.statistics
        make = partial(Renderer, view, sensor, threads=1, compiled=compiled)
        fresh, kept = make(cache_bytes=0), make()
        exact, loose = make(), make(tolerance_dn=tolerance_dn)
        exact._cache = loose._cache = kept._cache  # the same memory: else places in it differ
        for exposure, shot in exposures(fresh).items():
            every = plan_frame(shot, 0.0, left_out=())
            allowed = [effect.name for effect in candidates(every.bounds, tolerance_dn)]
            fewest = plan_frame(shot, 0.0, left_out=allowed, bounds=every.bounds)
            works: dict[Any, Callable[[], object]] = {
                "nothing kept": partial(expose_all, fresh, numbered(fresh, shot), every),
                "everything": partial(expose_all, kept, numbered(kept, shot), every),
                "again": partial(expose_all, kept, numbered(kept, shot), every),
                "exact": partial(plan_and_expose, exact, numbered(exact, shot)),
                "tolerance": partial(plan_and_expose, loose, numbered(loose, shot)),
                "at most": partial(expose_all, kept, numbered(kept, shot), fewest),
            }
            taken = usual_seconds(works, rounds)
            chosen = plan_frame(shot, tolerance_dn)
            everything = fresh.brightness(shot, every)
            off = loose.brightness(shot, chosen) - everything
            rows.append(
                {
                    "scene": name,
                    "exposure": exposure,
                    "ms": {key: seconds * 1e3 for key, seconds in taken.items()},
                    "exact_difference_dn": float(
                        np.abs(exact.brightness(shot, plan_frame(shot, 0.0)) - everything).max()
                    ),
                    "largest_difference_dn": float(np.abs(off).max()),
                    "mean_difference_dn": float(off.mean(dtype=np.float64)),
                    "cached_bytes": kept._cache.used_bytes,
                }
            )
    return rows


def print_scenes(rows: list[dict[str, Any]]) -> None:
    """Print the table of the scenes as Markdown, as in docs/explanation/simulation.md."""
    kinds = ("nothing kept", "exact", "tolerance", "at most", "again")
    print(
        "| scene | exposure | every effect, ms | nothing kept | exact | tolerance | at most"
        " | the same again | largest, DN | mean, DN |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        ms = row["ms"]
        times = " | ".join(f"{ms['everything'] / ms[kind]:.2f}" for kind in kinds)
        print(
            f"| {row['scene']} | {row['exposure']} | {ms['everything']:.2f} | {times}"
            f" | {row['largest_difference_dn']:.3f} | {row['mean_difference_dn']:+.3f} |"
        )
    assert all(row["exact_difference_dn"] == 0 for row in rows)
    for exposure in ("bright", "dim"):
        some = [row["ms"] for row in rows if row["exposure"] == exposure]
        whole = statistics.geometric_mean(ms["everything"] for ms in some)
        means = " | ".join(
            f"{statistics.geometric_mean(ms['everything'] / ms[kind] for ms in some):.2f}"
            for kind in kinds
        )
        print(f"| **geometric mean** | {exposure} | {whole:.2f} | {means} | | |")


def main() -> None:
    """Print the table of each size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--sizes", nargs="+", default=["160x120", "320x240", "1280x960"])
    parser.add_argument("--tolerance", type=float, default=0.5)
    parser.add_argument("--compiled", action="store_true", help="with the extra `fast`")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)  # its other threads wait in loops, which would count for the next frame
    share_free_memory()  # as a capture does: else memory is returned between frames, or not
    for size in arguments.sizes:
        width, height = (int(part) for part in size.split("x"))
        rounds = max(arguments.rounds, round(arguments.rounds * 1280 * 960 / width / height / 4))
        scenes = per_scene(
            (height, width), rounds, arguments.tolerance, compiled=arguments.compiled
        )
        print(f"{size}, sensor complete, 1 thread, tolerance {arguments.tolerance:g} DN")
        print_scenes(scenes)
        kept = max(row["cached_bytes"] for row in scenes) / 1e6
        print(f"kept between frames: {kept:.0f} MB at most\n")


if __name__ == "__main__":
    main()
