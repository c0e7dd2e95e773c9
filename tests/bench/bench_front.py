"""Processor time of planning, before every built-in scene with every built-in sensor.

    OMP_NUM_THREADS=1 python tests/bench/bench_front.py [SENSOR,... [SCENE,...]]

Each row is a sensor before a scene, metered as by ``camctl shoot``: seconds for a whole front (log
1:1,000), for the plan by default, for plans within 0.5 and 2 s, and for one of 64 exposures.
Nothing is cached before each of these five; the last column is the longest of them once more, with
what was kept on disk.  A plan that ends in an error is marked by "!".  All cells take about 10
minutes.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from camctl.captures.metering import meter_light
from camctl.captures.plan import plan_for
from camctl.errors import CamctlError
from camctl.exposure import accuracy
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.best import Search, longest_base_s
from camctl.exposure.search.front import Front
from camctl.model import inverse
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene, scene_names
from camctl.sim.sensors.sensor import load_sensor, sensor_names

REQUESTS = (
    CaptureRequest(),
    CaptureRequest(time_budget_s=0.5),
    CaptureRequest(time_budget_s=2.0),
    CaptureRequest(count=64),
)

GIVEN = CaptureRequest(dynamic_range=1000.0)
"""The request of the front."""

LIMIT_S, CACHED_S = 1.0, 0.3
"""Aims for the processor time of planning, not cached and cached."""


def forget() -> None:
    """Forget what searches and predictions keep in memory, as a new process does."""
    accuracy._kept.clear()
    inverse._posterior.cache_clear()


def seconds(work: Callable[[], object]) -> tuple[float, str]:
    """Return the processor time of some work, and "!" where it ended in an error."""
    forget()
    started, mark = time.process_time(), ""
    try:
        work()
    except CamctlError:
        mark = "!"
    return time.process_time() - started, mark


def tasks(camera: SimulatedCamera) -> list[Callable[[], object]]:
    """Return what is timed: the front, and the plans."""
    light, given = meter_light(camera, REQUESTS[0]), meter_light(camera, GIVEN)
    controls, desired = camera.controls, GIVEN.desired
    assert given is not None  # no base exposure is given
    assert desired is not None  # a response and its range are
    limit_s, before = longest_base_s(GIVEN, given), given.last

    def front() -> object:
        return Front(controls, desired, limit_s, before=before).points

    def plan(request: CaptureRequest) -> Callable[[], object]:
        return lambda: plan_for(controls, Search(controls, request), light)

    return [front, *map(plan, REQUESTS)]


def main() -> None:
    """Print the table."""
    arguments = [each.split(",") for each in sys.argv[1:]]
    sensors = arguments[0] if arguments else sensor_names()
    scenes = arguments[1] if len(arguments) > 1 else scene_names()
    heads = ("front", "default", "0.5 s", "2 s", "n = 64", "kept")
    print(f"{'sensor':16}{'scene':14}" + "".join(f"{head:>8}" for head in heads))
    worst, worst_kept, over = 0.0, 0.0, 0
    for sensor in sensors:
        for scene in scenes:
            try:
                with SimulatedCamera(load_scene(scene), load_sensor(sensor), seed=0) as camera:
                    work = tasks(camera)
            except CamctlError as error:
                print(f"{sensor:16}{scene:14}  {error.what[:60]}")
                continue
            with tempfile.TemporaryDirectory() as folder:
                spent = []
                for place, each in enumerate(work):
                    os.environ["CAMCTL_CACHE"] = str(Path(folder) / str(place))
                    spent.append(seconds(each))
                kept_s = 0.0
                for place, each in enumerate(work):
                    os.environ["CAMCTL_CACHE"] = str(Path(folder) / str(place))
                    kept_s = max(kept_s, seconds(each)[0])
            cells = " ".join(f"{s:6.2f}{mark or ' '}" for s, mark in spent)
            print(f"{sensor:16}{scene:14} {cells} {kept_s:6.2f}", flush=True)
            worst, worst_kept = max(worst, *(s for s, _ in spent)), max(worst_kept, kept_s)
            over += sum(s > LIMIT_S for s, _ in spent)
    print(
        f"longest {worst:.2f} s, kept {worst_kept:.2f} s; {over} above {LIMIT_S:g} s "
        f"({CACHED_S:g} s where kept)"
    )


if __name__ == "__main__":
    main()
