"""How far apart the first frames of several cameras are that take one picture together.

    python tests/bench/bench_several.py

Simulated cameras in real time shoot one plan with `menu.several.take_together`.  Their clocks
are one clock of this computer, so that times of different cameras can be compared: when each was
asked to shoot, and when the exposure of its first frame began.  The cameras are opened at any time
within a frame of each other, as they are where people plug them in: one that streams begins the
frame of the new exposure when a frame before it has ended.
"""

from __future__ import annotations

import random
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2])]

from camctl import CaptureRequest, plan_capture, read_report  # noqa: E402  found by the path above
from camctl.interface.camera import FrameStream  # noqa: E402
from camctl.interface.controls import ExposureSetting  # noqa: E402
from camctl.menu.several import Take, take_together  # noqa: E402
from camctl.sim.backend import SimulatedBackend  # noqa: E402
from camctl.sim.camera import SimulatedCamera  # noqa: E402

RUNS = 20
COUNTS = (2, 3, 4)
PHASES = random.Random(1)
REQUEST = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0), base_s=0.01)
OPTIONS = {"time": "real", "scene": "ramp", "sensor": "phone", "size": "96x64"}


class Asked:
    """When a camera was asked to shoot, s."""

    def __init__(self, camera: SimulatedCamera) -> None:
        self._clock, self._shoot = camera.clock, camera.shoot
        self.at_s = 0.0

    def __call__(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        self.at_s = self._clock.now()
        return self._shoot(settings)


def spread(values: Sequence[float]) -> float:
    return max(values) - min(values)


def skews(count: int) -> tuple[list[float], list[float]]:
    """Return the skew of the requests and of the begins of the first exposures, each in s."""
    requests, begins = [], []
    for _ in range(RUNS):
        asked, first = together(_opened(count))
        requests.append(spread(asked))
        begins.append(spread(first))
    return requests, begins


def _opened(count: int) -> list[SimulatedCamera]:
    cameras = []
    for _ in range(count):
        cameras.append(SimulatedBackend().open("", OPTIONS))
        time.sleep(PHASES.uniform(0, cameras[0].controls.frame_interval_s))
    return cameras


def together(cameras: Sequence[SimulatedCamera]) -> tuple[list[float], list[float]]:
    """Return when each was asked, and when its first exposure began, s."""
    asked = [Asked(camera) for camera in cameras]
    for camera, each in zip(cameras, asked, strict=True):
        camera.shoot = each  # type: ignore[method-assign]
    plan = plan_capture(cameras[0], REQUEST)
    takes = [Take(camera, {}, plan, REQUEST) for camera in cameras]
    with tempfile.TemporaryDirectory() as folder:
        take_together(takes, Path(folder), lambda _: None, lambda: False)
        reports = [read_report(each) for each in Path(folder).iterdir()]
    for camera in cameras:
        camera.close()
    frames = [report.frames[0] for report in reports]
    return [each.at_s for each in asked], [
        frame.timestamp_s - frame.applied_s for frame in frames if frame is not None
    ]


def main() -> None:
    """Print the skews."""
    interval_s = SimulatedBackend().open("", OPTIONS).controls.frame_interval_s
    print(f"a frame each {1e3 * interval_s:.1f} ms")
    for count in COUNTS:
        for name, found in zip(("asked", "first exposures"), skews(count), strict=True):
            print(
                f"{count} cameras, {name}: median {1e3 * statistics.median(found):.2f} ms, "
                f"at most {1e3 * max(found):.2f} ms of {RUNS} captures"
            )


if __name__ == "__main__":
    main()
