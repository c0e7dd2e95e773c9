"""Errors of estimated exposure ratios on simulated cameras, over seeds.

    python tests/bench/bench_exposure_ratios.py [--seeds 10]

For each scene and sensor a bracket 1, 2, 4 is shot and its ratios are estimated: the largest mean
error (bias) and the largest error of any seed, in percent, the half width of the 95 % interval, and
how often it contains the true ratio.  The last columns are the errors of the median of the ratios
of single pixels between a tenth and nine tenths of full scale in both frames, the usual estimate.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.errors import CamctlError
from camctl.evidence.patches import sample_patches
from camctl.evidence.ratios import estimate_ratios
from camctl.model.sensor import SensorModel

SCENES = ("tile-floor", "colour-chart", "ramp", "cloth", "ball", "room", "moving-target")
SENSORS = ("standard", "consumer", "webcam", "phone", "machine-vision", "ccd", "mobile", "ideal-8")
RATIOS = (1.0, 2.0, 4.0)


def errors(scene: str, sensor: str, seed: int) -> tuple[NDArray[np.float64], ...]:
    """Return the errors of the estimates, half their intervals, and the errors of the medians."""
    with camctl.open_camera("sim", scene=scene, sensor=sensor, seed=seed, size="320x240") as camera:
        controls = camera.controls
        plan = camctl.plan_capture(camera, camctl.CaptureRequest(ratios=RATIOS))
        frames = list(camera.shoot(plan.settings))
    scale = SensorModel(controls.levels, controls.black)
    exposures = np.array([frame.applied.exposure for frame in frames])
    patches = [
        sample_patches(controls.layout.planes(frame.pixels), scale.white) for frame in frames
    ]
    noise = (
        None
        if controls.noise is None
        else controls.frame_noise([frame.applied for frame in frames])
    )
    found = estimate_ratios(patches, exposures.tolist(), scale, noise)
    true = exposures / exposures[found.reference]
    estimate = np.array(found.exposures) / found.exposures[found.reference]
    half = np.array(found.high) / np.array(found.exposures) - 1
    light = [scale.light[np.minimum(frame.pixels, scale.white)] / scale.full for frame in frames]
    reference = light[found.reference]
    medians = []
    for each, ratio in zip(light, true, strict=True):
        both = (np.minimum(each, reference) > 0.1) & (np.maximum(each, reference) < 0.9)
        value = np.median(each[both] / reference[both]) if both.any() else np.nan
        medians.append(value / ratio - 1)
    others = np.arange(len(true)) != found.reference
    return (estimate / true - 1)[others], half[others], np.array(medians)[others]


def main() -> None:
    """Print one row for each scene and sensor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = range(parser.parse_args().seeds)
    print(
        f"{'scene':14}{'sensor':16}  bias %  worst %  half 95 %  inside   medians: bias %  worst %",
        flush=True,
    )
    for scene in SCENES:
        for sensor in SENSORS:
            try:
                found = [errors(scene, sensor, seed) for seed in seeds]
            except CamctlError as refusal:
                print(f"{scene:14}{sensor:16}  {refusal.what[:66]}", flush=True)
                continue
            error, half, medians = (np.array(part) for part in zip(*found, strict=True))
            inside = np.mean(np.abs(error) <= half)
            print(
                f"{scene:14}{sensor:16}{_worst_mean(error):8.3f}{_worst(error):9.3f}"
                f"{100 * half.mean():11.3f}{inside:8.0%}{_worst_mean(medians):19.3f}"
                f"{_worst(medians):9.3f}",
                flush=True,
            )


def _worst_mean(values: NDArray[np.float64]) -> float:
    return 100 * float(np.abs(values.mean(axis=0)).max())


def _worst(values: NDArray[np.float64]) -> float:
    return 100 * float(np.abs(values).max())


if __name__ == "__main__":
    main()
