"""Wrong exposures found, and true ones doubted, over all built-in scenes and sensors.

    python tests/bench/bench_exposure_check.py [--seeds 1] [--size 320x240] [--factors 0.5,1,2]

For each scene and sensor one capture with true exposures, and one for each factor by which all
tries of its second frame are wrong.  The counts are of captures marked as not trustworthy, and of
those with a warning.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator

import camctl
from camctl.errors import CaptureError
from sim.camera import Faults
from sim.scenes.scene import scene_names
from sim.sensors.sensor import sensor_names

FACTORS = (0.1, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.25, 2.0, 10.0)
#: A bracket as it is computed for constant contrast, without the time to compute it.
_REQUEST = camctl.CaptureRequest(ratios=(1.0, 8.9, 88.0))


def captures(factor: float, seed: int, size: str | None) -> Iterator[camctl.CaptureReport]:
    """Yield the captures of all scenes with all sensors that can take them."""
    faults = Faults(wrong_exposure=dict.fromkeys((1, 3, 4, 5), factor))
    for scene in scene_names():
        for sensor in sensor_names():
            with camctl.open_camera(
                "sim", scene=scene, sensor=sensor, seed=seed, size=size, faults=faults
            ) as camera:
                try:
                    yield camctl.capture(camera, _REQUEST)
                except CaptureError:  # too dark for this sensor
                    continue


def main() -> None:
    """Print one row for each factor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--size", default=None, help="of all scenes; default: the scene's own")
    parser.add_argument("--factors", default=",".join(map(str, FACTORS)))
    arguments = parser.parse_args()
    print("factor  captures  compared  not trustworthy  warned", flush=True)
    for factor in map(float, arguments.factors.split(",")):
        counts: Counter[str] = Counter()
        for seed in range(arguments.seeds):
            for report in captures(factor, seed, arguments.size):
                counts["all"] += 1
                ratio = report.frames[1].ratio
                counts["compared"] += ratio is not None and ratio.compared >= 0.1
                counts["not"] += not report.trustworthy
                counts["warned"] += any(each.code == "exposure_differs" for each in report.findings)
        print(
            f"{factor:6g}  {counts['all']:8}  {counts['compared']:8}  {counts['not']:15}  "
            f"{counts['warned']:6}",
            flush=True,
        )


if __name__ == "__main__":
    main()
