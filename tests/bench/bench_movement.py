"""The share of samples that contradict, on all sensors and scenes, against the share stated.

    python tests/bench/bench_movement.py [WIDTHxHEIGHT]

Only `moving-target` moves.  A scene that is too dark for a sensor is left out.
"""

from __future__ import annotations

import sys

import camctl
from camctl.errors import CamctlError
from sim.scenes.scene import scene_names
from sim.sensors.sensor import sensor_names

RATIOS = (1.0, 4.0, 16.0)


def print_share(sensor: str, scene: str, size: str) -> None:
    """Print the shares of one capture, and how often its frames were shot."""
    try:
        with camctl.open_camera("sim", scene=scene, sensor=sensor, seed=1, size=size) as camera:
            report = camctl.capture(camera, camctl.CaptureRequest(ratios=RATIOS))
    except CamctlError as error:
        print(f"{sensor:15} {scene:14} {error.what}")
        return
    found = report.movement
    assert found is not None  # there are three frames
    ratio = f"{found.share / found.false_alarms:7.2f}" if found.false_alarms else f"{'-':>7}"
    print(
        f"{sensor:15} {scene:14} {found.share:8.3%} {found.false_alarms:8.3%} {ratio} "
        f"{found.area:7.2%} {[frame.attempts for frame in report.frames]}"
    )


def main() -> None:
    """Print a line for each sensor and scene."""
    size = sys.argv[1] if len(sys.argv) > 1 else "320x240"
    print(f"{'sensor':15} {'scene':14} {'differ':>8} {'stated':>8} {'ratio':>7} {'area':>7} shots")
    for sensor in sensor_names():
        for scene in scene_names():
            print_share(sensor, scene, size)


if __name__ == "__main__":
    main()
