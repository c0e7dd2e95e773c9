"""What lies outside of the range with default options, and the time that finding movement takes.

    python tests/bench/bench_metering.py [SENSOR] [MEGAPIXELS]

The memorial map is read from $CAMCTL_DATA/memorial where that is set.  The rival of the second part
is OpenCV's MergeDebevec on the same six frames.
"""

from __future__ import annotations

import math
import os
import sys
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

import camctl
from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.movement import find_movement
from camctl.evidence.residual import Pair, Side
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from sim.scenes.scene import scene_names

EXPOSURES = (1.0, 3.0, 9.0, 27.0, 81.0, 243.0)


def print_outside(sensor: str) -> None:
    """Print what of each scene lies outside of the range that metering chose."""
    scenes = list(scene_names())
    if "CAMCTL_DATA" in os.environ:
        scenes.append(str(Path(os.environ["CAMCTL_DATA"], "memorial", "memorial.hdr")))
    print(f"{'scene':14} {'range':>11} {'saturated':>9} {'dark':>7} {'levels':>6} {'planning':>8}")
    for scene in scenes:
        with camctl.open_camera("sim", scene=scene, sensor=sensor) as camera:
            request = camctl.CaptureRequest(dynamic_range="auto")
            began = time.perf_counter()
            plan = camctl.plan_capture(camera, request)
            took_s = time.perf_counter() - began
            achieved = camctl.capture(camera, request, plan=plan).achieved
        print(
            f"{Path(scene).name:14} {f'1:{plan.dynamic_range:,.0f}':>11} "
            f"{achieved.saturated_fraction:>9.2%} {achieved.dark_fraction:>7.2%} "
            f"{achieved.effective_levels:>6.0f} {took_s:>6.1f} s"
        )


def print_movement(megapixels: float) -> None:
    """Print the time of `find_movement` as a share of that of MergeDebevec."""
    random = np.random.default_rng(0)
    rows = round(math.sqrt(megapixels * 1e6 / 1.5))
    light = np.exp(random.uniform(-6, 0, (rows, rows * 3 // 2, 1))).astype(np.float32)
    frames = [np.minimum(255, light * (exposure * 256)).astype(np.uint8) for exposure in EXPOSURES]
    check = NeighbourCheck(linear_response(8), 0)
    samples = [check.sample(frame[..., 0]).patches for frame in frames]
    sides = [Side(k, each, FrameNoise(39.0, 0.1)) for k, each in enumerate(EXPOSURES)]
    pairs = [
        Pair(
            check.scale,
            short,
            long,
            long.exposure / short.exposure,
            (samples[short.position], samples[long.position]),
        )
        for short, long in pairwise(sides)
    ]
    began = time.perf_counter()
    find_movement(lambda place: frames[place][..., 0], pairs)
    ours_s = time.perf_counter() - began
    three = [np.repeat(frame, 3, axis=2) for frame in frames]
    began = time.perf_counter()
    cv2.createMergeDebevec().process(three, np.array(EXPOSURES, np.float32))
    theirs_s = time.perf_counter() - began
    print(
        f"movement in {megapixels:g} MP, n = {len(EXPOSURES)}: {ours_s:.2f} s, "
        f"{ours_s / theirs_s:.2f} of MergeDebevec ({theirs_s:.2f} s)"
    )


if __name__ == "__main__":
    print_outside(sys.argv[1] if len(sys.argv) > 1 else "standard")
    print_movement(float(sys.argv[2]) if len(sys.argv) > 2 else 24.0)
