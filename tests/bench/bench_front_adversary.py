"""Sets of exposures that beat the front, looked for by a random search that is not part of camctl.

    OMP_NUM_THREADS=1 python tests/bench/bench_front_adversary.py [--seconds S] [--case NUMBER,...]
        [--scene SCENE] [--seed SEED]

Each case is a sensor before a scene, a desired response, a range and a time.  The search changes
times, gains and numbers of frames at random, by steps of all sizes, from the set of
`Front.at_time` and from even sets of three numbers; it fits each set into the time that the
front's takes and rates it with the exact prediction, as the settings that the camera has.  Its best
set is compared with the front's.  All 138 cases take 138 minutes of processor time by default.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time

import numpy as np

from camctl.captures.metering import meter_light
from camctl.errors import CamctlError
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.best import longest_base_s
from camctl.exposure.search.front import Front
from camctl.interface.controls import ExposureSetting
from camctl.model.effective import MOST_SEARCHED
from camctl.model.response.desired import desired_response
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

CASES = [
    *itertools.product(
        ("webcam", "complete", "standard"),
        (("log", 256.0), ("log", 1000.0), ("log", 16000.0), ("linear", 1000.0), ("gamma", 1000.0)),
        (0.6, 3.0, 8.0),
    ),
    *itertools.product(("machine-vision",), (("log", 1000.0),), (0.3, 1.0, 4.0)),
    *itertools.product(
        ("phone", "security", "consumer", "mobile", "ccd", "qcmos", "machine-vision"),
        (("log", 128.0), ("log", 4096.0), ("linear", 256.0), ("gamma", 64.0)),
        (0.4, 1.5, 5.0),
    ),
    *itertools.product(("ideal-8",), (("log", 1000.0), ("linear", 256.0)), (0.3, 1.0, 4.0)),
]
"""Sensor; response and range; time in seconds."""

SCENE = "tile-floor"

SAME_TIME = 1e-8
"""Relative difference up to which two times are the same."""


class Adversary:
    """A random search for sets within a time that have more levels than another set."""

    def __init__(self, front: Front, budget_s: float, first: ExposureSetting, seed: int) -> None:
        self.front, self.budget_s, self.first = front, budget_s, first
        self.controls = front.controls
        self.gains = [
            gain for gain in (2.0**k for k in range(12)) if self.controls.gain.nearest(gain) == gain
        ] or [first.gain]
        self.rng = np.random.default_rng(seed)
        self.rated = 0

    def start(self, n: int) -> list[ExposureSetting]:
        """Return n frames evenly over ln(exposure), from the first to the range's reach."""
        ratios = np.geomspace(1.0, self.front.desired.dynamic_range**0.9, n)
        return [self.setting(self.first.time_s * ratio, self.first.gain) for ratio in ratios]

    def setting(self, time_s: float, gain: float) -> ExposureSetting:
        """Return the nearest setting of the camera."""
        limits = self.controls.time_s
        time_s = min(max(time_s, limits.minimum), limits.maximum)
        return ExposureSetting(self.controls.nearest_time(time_s, gain), gain)

    def changed(self, settings: list[ExposureSetting], size: float) -> list[ExposureSetting]:
        """Return a set with some frames changed; the first stays the shortest exposure."""
        rest = settings[1:]
        kind = self.rng.random()
        if kind < 0.12 and len(rest) > 1:
            rest.pop(int(self.rng.integers(len(rest))))
        elif kind < 0.24 and len(rest) < MOST_SEARCHED - 1:
            reach = math.log(self.front.desired.dynamic_range)
            ratio = math.exp(self.rng.uniform(0.0, reach))
            gain = float(self.rng.choice(self.gains))
            rest.append(self.setting(self.first.exposure * ratio / gain, gain))
        elif kind < 0.4 and len(self.gains) > 1 and rest:
            place = int(self.rng.integers(len(rest)))
            gain = float(self.rng.choice(self.gains))
            rest[place] = self.setting(rest[place].exposure / gain, gain)
        elif rest:
            moved = self.rng.random(len(rest)) < self.rng.choice([1 / len(rest), 0.5])
            step = np.exp(size * self.rng.standard_normal(len(rest)) * moved)
            rest = [
                self.setting(each.time_s * factor, each.gain)
                for each, factor in zip(rest, step.tolist(), strict=True)
            ]
        return [self.first, *rest]

    def fits(self, settings: list[ExposureSetting]) -> bool:
        """Return whether the first is the shortest, and the set takes no more than allowed."""
        least = self.first.exposure * (1 - SAME_TIME)
        within = self.front.time_of(self.sorted(settings)) <= self.budget_s * (1 + SAME_TIME)
        return within and all(each.exposure >= least for each in settings)

    def fitted(self, settings: list[ExposureSetting]) -> list[ExposureSetting] | None:
        """Return a set whose longer times are scaled so that it takes the time allowed."""
        low, high, found = -6.0, 3.0, None
        for _ in range(18):
            middle = (low + high) / 2
            longer = [(s.time_s * math.exp(middle), s.gain) for s in settings[1:]]
            trial = [
                self.first,
                *(self.setting(max(t, self.first.exposure / gain), gain) for t, gain in longer),
            ]
            fits = self.fits(trial)
            low, high = (middle, high) if fits else (low, middle)
            found = trial if fits else found
        return found

    @staticmethod
    def sorted(settings: list[ExposureSetting]) -> list[ExposureSetting]:
        """Return settings by ascending exposure, as frames are taken."""
        return sorted(settings, key=lambda each: each.exposure)

    def levels(self, settings: list[ExposureSetting]) -> float:
        """Return the exact effective levels of a set."""
        self.rated += 1
        return self.front.levels_of(self.sorted(settings))

    def climbed(
        self, settings: list[ExposureSetting], seconds: float
    ) -> tuple[float, list[ExposureSetting]]:
        """Return the best set that random changes of one reach in some processor time."""
        end = time.process_time() + seconds
        fitting = settings if self.fits(settings) else self.fitted(settings)
        best, levels = settings, 0.0
        if fitting is not None:
            best, levels = fitting, self.levels(fitting)
        while time.process_time() < end:
            size = math.exp(self.rng.uniform(math.log(0.005), math.log(0.7)))
            changed = self.changed(best, size)
            trial = changed if self.rng.random() < 0.5 and self.fits(changed) else None
            trial = trial or self.fitted(changed)
            if trial is not None and (found := self.levels(trial)) > levels:
                best, levels = trial, found
        return levels, best

    def best(self, own: list[ExposureSetting], seconds: float) -> tuple[float, int]:
        """Return the most levels found and the number of frames that have them.

        The first half of the time is divided among the starts; the best goes on for the rest.
        """
        n = len(own)
        starts = [own, *(self.start(k) for k in (max(2, n - 2), n, min(MOST_SEARCHED, n + 3)))]
        found = [self.climbed(each, seconds / 2 / len(starts)) for each in starts]
        levels, best = max(found, key=lambda each: each[0])
        levels, best = max((levels, best), self.climbed(best, seconds / 2), key=lambda e: e[0])
        return levels, len(best)


def front_of(number: int, scene: str = SCENE) -> Front:
    """Return the front of a case before a scene, of which nothing is searched yet."""
    sensor, (response, dynamic_range), _ = CASES[number]
    request = CaptureRequest(response=response, dynamic_range=dynamic_range)
    with SimulatedCamera(load_scene(scene), load_sensor(sensor), seed=0) as camera:
        light = meter_light(camera, request)
        assert light is not None  # no base exposure is given
        desired = desired_response(response, dynamic_range)
        return Front(camera.controls, desired, longest_base_s(request, light), before=light.last)


def main() -> None:
    """Print a row for each case, and the largest gain."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time for a case")
    parser.add_argument("--case", default="", help="numbers of cases, by commas; all by default")
    parser.add_argument("--scene", default=SCENE)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chosen = [int(k) for k in arguments.case.split(",") if k] or range(len(CASES))
    print(
        f"{'case':>4} {'sensor':16}{'response':>16}{'time':>7}"
        f"{'front':>14}{'search':>14}{'gain':>9}"
    )
    gains = []
    for number in chosen:
        sensor, (response, dynamic_range), budget_s = CASES[number]
        front = front_of(number, arguments.scene)
        try:
            point = front.at_time(budget_s)
        except CamctlError as error:
            print(f"{number:4} {sensor:16}{response:>9}{dynamic_range:7g}{budget_s:6g}s {error}")
            continue
        own = front.levels_of(point.settings)
        taken_s = front.time_of(point.settings)
        adversary = Adversary(
            front, taken_s, point.settings[0], number + len(CASES) * arguments.seed
        )
        levels, n = adversary.best(list(point.settings), arguments.seconds)
        gains.append(levels / own - 1)
        print(
            f"{number:4} {sensor:16}{response:>9}{dynamic_range:7g}{taken_s:6.3g}s"
            f"{own:10.3f} ({point.n:2}){levels:9.3f} ({n:2}){gains[-1]:+9.3%}"
            f"  {adversary.rated} rated",
            flush=True,
        )
    print(f"{len(gains)} cases: largest gain {max(gains, default=0.0):+.3%}")


if __name__ == "__main__":
    main()
