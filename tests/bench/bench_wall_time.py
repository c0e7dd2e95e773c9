"""Planned time of a capture over the time that it takes, in real time, metered as users shoot.

    python tests/bench/bench_wall_time.py [--repeats 4] [--camera ID ...]

The simulated cameras are opened, metered and shot as by ``camctl shoot``; real ones as well, by
default every V4L2 camera of this computer.  A request comes at any time within a frame, and a
varying control delay is known on average, which no plan can know: so for each cell the mean over
repeated captures is compared, and the largest difference of a single one is printed.
`tests/captures/test_wall_time.py` compares still cameras and a V4L2 camera in virtual time; the
virtual hardware tests, a V4L2 camera in the kernel.
"""

from __future__ import annotations

import argparse
import sys
from statistics import fmean

import camctl

SENSORS = ("standard", "machine-vision", "webcam")
VARYING = "consumer"
"""A sensor whose control delay varies from setting to setting: its mean needs more captures."""
REQUESTS = (
    camctl.CaptureRequest("log", 256.0, 2),
    camctl.CaptureRequest("log", 1000.0, 3),
    camctl.CaptureRequest("linear", 1000.0, 6),
    camctl.CaptureRequest(ratios=(1.0, 1.0)),
    camctl.CaptureRequest(ratios=(1.0, 9.0, 40.0)),
)
LIMIT = 0.10
"""Largest relative difference of a cell's mean from the plan."""


def bench(name: str, repeats: int, **options: str) -> int:
    """Print one line for each request; return the number of those beyond the limit."""
    wrong = 0
    for request in REQUESTS:
        planned, actual = [], []
        for repeat in range(repeats):
            seeded = {**options, "seed": repeat} if name == "sim" else {}
            with camctl.open_camera(name, seeded) as camera:
                timing = camctl.capture(camera, request).timing
            planned.append(timing["planned_wall_s"])
            actual.append(timing["actual_wall_s"])
        ratio = fmean(planned) / fmean(actual)
        worst_s = max(abs(a - p) for a, p in zip(actual, planned, strict=True))
        wrong += abs(ratio - 1) > LIMIT
        count = request.count or len(request.ratios or ())
        print(
            f"{options.get('sensor', name):15} {'given' if request.ratios else request.response:6} "
            f"{count} exposures: planned {fmean(planned):6.3f} s, actual {fmean(actual):6.3f} s, "
            f"ratio {ratio:.3f}, a single one differs by up to {worst_s:.3f} s"
            f"{'  MISSED' if abs(ratio - 1) > LIMIT else ''}",
            flush=True,
        )
    return wrong


def main() -> int:
    """Print one line for each cell; return 1 if one differs by more than `LIMIT`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--camera", action="append", help="id of a real camera")
    arguments = parser.parse_args()
    wrong = sum(
        bench("sim", repeats, sensor=sensor, size="320x240", time="real")
        for sensor, repeats in [
            *((sensor, arguments.repeats) for sensor in SENSORS),
            (VARYING, 4 * arguments.repeats),
        ]
    )
    found = [info.id for info in camctl.list_cameras() if info.driver == "v4l2"]
    for name in arguments.camera or found:
        wrong += bench(name, arguments.repeats)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
