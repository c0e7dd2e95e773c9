"""The fast estimate of the accuracy of a sum, against the exact prediction."""

from __future__ import annotations

import numpy as np

import camctl
from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.accurate.judge import Judge
from camctl.exposure.accurate.sets import NEAR_BEST
from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures, Shot
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import desired_response

TIMES = 2.1 ** np.arange(7)
"""Shutter times of each set, in that of the shortest exposure: 2.9 s together."""
BASE_S = 0.018

LONGEST: list[tuple[float, ...]] = [
    (1,),
    *[(gain,) * frames for frames in (1, 2, 3) for gain in (2, 4, 8)],
    (2, 4),
    (2, 4, 8),
]
"""Gains of the longest exposures of each set; the others have gain 1."""


def test_near_black_the_estimate_errs_alike_at_all_gains() -> None:
    """In the dark, at gain 1, sensor complete has noise of 0.06 levels: nothing is dithered."""
    with camctl.open_camera("sim", sensor="complete") as camera:
        controls = camera.controls
    assert controls.noise is not None
    gains = tuple(sorted({gain for each in LONGEST for gain in each}))
    problem = AccuracyProblem(
        controls.levels,
        desired_response("log", 16_000.0),
        controls.noise,
        AvailableExposures(gains=gains, unit_s=BASE_S),
        controls.black,
    )
    judge = Judge(FrameAccuracy(problem), dithered=False)
    ratios = []
    for longest in LONGEST:
        chosen = np.append(np.ones(TIMES.size - len(longest)), longest)
        pairs = zip(TIMES.tolist(), chosen.tolist(), strict=True)
        shots = tuple(Shot(time * gain, time, gain) for time, gain in pairs)
        ratios.append(judge(shots).levels / judge.estimated(shots))
    assert min(ratios) >= NEAR_BEST * max(ratios)


def test_a_curve_that_begins_flat_has_an_estimate() -> None:
    """Below its first level the signal of such a camera is exactly 0."""
    response = CameraResponse(np.sqrt(np.arange(1, 256) / 256), "square")
    noise = NoiseModel(40.0, ((1.0, 2.0),))
    frames = FrameAccuracy(AccuracyProblem(response, desired_response("log", 10_000.0), noise))
    slope, variance, _ = frames.parts(np.zeros(1), 1.0, np.ones(1))[:, 0]
    assert np.all(np.isfinite(slope) & np.isfinite(variance))
    assert slope[0] == variance[0] == 0  # the darkest light shows nothing, and no noise
    assert slope[-1] > 0
