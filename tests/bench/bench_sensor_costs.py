"""The cost of each effect of a simulated sensor against the one that its record states.

Run by hand: ``python tests/bench/bench_sensor_costs.py [--compiled]``.  A cost is the CPU time that
the effect's own functions take in frames with every effect after the first, with what is kept
between frames, on one thread, over the samples that it works on: of the median frame, in
nanoseconds.  Where several sensors have an effect, the geometric mean counts; the light of a scene
at rest is kept, so that effects on it cost something before the moving target alone.  The work of
motion blur and of a rolling shutter is done where the target is drawn, and is not counted: theirs
is the difference to a frame without them.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from camctl.sim import render
from camctl.sim.effects import EFFECTS
from camctl.sim.effects.budget import plan_frame
from camctl.sim.effects.record import Effect, Lines, RowTiming, Shot
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor

#: Sensor, scene and exposure, s; together they have every effect.  Some wells overflow.
CASES = (
    ("complete", "tile-floor", 0.03),
    ("complete", "night-street", 2.0),
    ("complete", "moving-target", 0.03),
    ("security", "pwm-lamp", 0.01),
    ("security", "room", 0.1),
    ("mobile", "room", 0.1),
    ("ccd", "tile-floor", 0.01),
)
SHAPE = (960, 1280)


class Spent:
    """CPU seconds of each effect in one frame."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def timed(self, name: str, work: Callable[..., Any] | None) -> Any:
        """Return a function that does `work` and adds its time to that of the effect `name`."""
        if work is None:
            return None

        def do(*arguments: Any) -> Any:
            start = time.process_time()
            try:
                return work(*arguments)
            finally:
                self.seconds[name] += time.process_time() - start

        return do

    def effect(self, effect: Effect) -> Effect:
        """Return an effect that counts its time."""
        name, lines = effect.name, effect.lines

        def timed_lines(shot: Shot, timing: RowTiming) -> Any:
            assert lines is not None
            made: Lines = self.timed(name, lines)(shot, timing)
            return _TimedLines(self.timed(name, made.apply))

        return replace(
            effect,
            timing=self.timed(name, effect.timing),
            picture=self.timed(name, effect.picture),
            apply=self.timed(name, effect.apply),
            flow=self.timed(name, effect.flow),
            lines=None if lines is None else timed_lines,
        )


class _TimedLines:
    def __init__(self, apply: Callable[..., None]) -> None:
        self.apply = apply


def costs(case: tuple[str, str, float], rounds: int, *, compiled: bool) -> dict[str, float]:
    """Return nanoseconds a sample of each effect that takes part in a frame."""
    sensor_name, scene, time_s = case
    sensor = load_sensor(sensor_name)
    view = View.of(load_scene(scene, SHAPE), sensor)
    renderer = Renderer(view, sensor, threads=1, compiled=compiled)
    shot = renderer.shot(time_s, 1.0, 0, previous_s=time_s)
    plan = plan_frame(shot, 0.0, left_out=())
    renderer.expose(shot, plan)
    taken: dict[str, list[float]] = defaultdict(list)
    for _ in range(rounds):
        spent = Spent()
        vars(render)["EFFECTS"] = tuple(map(spent.effect, EFFECTS))
        try:
            renderer.expose(shot, plan)
        finally:
            vars(render)["EFFECTS"] = EFFECTS
        for effect in EFFECTS:
            if effect.name in spent.seconds:
                samples = effect.samples(shot)
                taken[effect.name].append(spent.seconds[effect.name] / samples * 1e9)
    return {name: statistics.median(values) for name, values in taken.items()}


def main() -> None:
    """Print what each effect costs, stated and measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--compiled", action="store_true", help="with the extra `fast`")
    arguments = parser.parse_args()
    found: dict[str, list[float]] = defaultdict(list)
    for case in CASES:
        for name, cost in costs(case, arguments.rounds, compiled=arguments.compiled).items():
            found[name].append(cost)
    print(f"{'effect':18} stated  measured  in each case, ns a sample")
    for effect in EFFECTS:
        if effect.name in found:
            each = found[effect.name]
            mean = statistics.geometric_mean(max(cost, 1e-3) for cost in each)
            values = " ".join(f"{cost:.2f}" for cost in each)
            print(f"{effect.name:18} {effect.cost:6.2f} {mean:9.2f}  {values}")


if __name__ == "__main__":
    main()
