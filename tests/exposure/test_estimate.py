"""The fast estimate of the accuracy of a sum, against the exact prediction."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.accurate.judge import Judge
from camctl.exposure.accurate.sets import NEAR_BEST
from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures, Shot
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.tabulated import tabulated_desired

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


def standard_problem() -> AccuracyProblem:
    """Return one of sensor standard."""
    with camctl.open_camera("sim", sensor="standard") as camera:
        controls = camera.controls
    assert controls.noise is not None
    return AccuracyProblem(
        controls.levels,
        desired_response("gamma", 1000.0),
        controls.noise,
        AvailableExposures(unit_s=BASE_S),
        controls.black,
    )


def test_derivatives_are_those_of_the_error() -> None:
    """By ln(exposure): the gradient is the limit of differences of the error."""
    frames, times, step = FrameAccuracy(standard_problem()), np.array([1.0, 1.3, 2.1, 4.2]), 0.02

    def parts(shift: float) -> NDArray[np.float64]:
        return frames.parts(np.log(times) + shift, 1.0, times).astype(float)

    low, middle, high = (parts(shift) for shift in (-step, 0.0, step))
    total, one = middle.sum(axis=1), (high - low) / (2 * step)
    gradient, hessian = frames.derivatives(total, one, (high + low - 2 * middle) / step**2)
    small = 1e-3
    for place in range(times.size):
        change = small * one[:, place]
        up, down = frames.mse(total + change), frames.mse(total - change)
        assert gradient[place] == pytest.approx(float(up - down) / (2 * small), rel=0.01)
    assert hessian == pytest.approx(hessian.T)


@pytest.mark.parametrize("dark", [0.0, 200.0], ids=["no dark current", "dark current"])
def test_a_step_has_the_mean_of_what_frames_contribute_within_it(dark: float) -> None:
    """Several levels of a dark frame lie within one step: its middle alone shows one of them."""
    noise = NoiseModel(conversion_e_per_dn=40.0, read_noise_e=((1.0, 3.0),), dark_current_e_s=dark)
    problem = AccuracyProblem(
        linear_response(8),
        desired_response("log", 16_000.0),
        noise,
        AvailableExposures(unit_s=0.02),
    )
    exposures = np.array([1.0, 30.0, 300.0])
    coarse, fine = (
        FrameAccuracy(problem, np.linspace(0.0, 1.0, steps + 1)).parts(
            np.log(exposures), 1.0, exposures
        )
        for steps in (96, 96 * 16)
    )
    means = fine.reshape(*coarse.shape, 16).mean(axis=-1)
    for row, mean in zip(coarse[:2], means[:2], strict=True):
        assert row == pytest.approx(mean, abs=2e-3 * float(mean.max()))


def test_a_desired_response_that_jumps_has_finite_contributions() -> None:
    """Where it jumps, a step of brightness has no width in irradiance."""
    noise = NoiseModel(conversion_e_per_dn=40.0, read_noise_e=((1.0, 3.0),))
    desired = tabulated_desired([0.01, 0.1, 0.1000001, 1.0], [0.0, 0.3, 0.7, 1.0])
    frames = FrameAccuracy(AccuracyProblem(linear_response(8), desired, noise))
    parts = frames.parts(np.log([1.0, 8.0]), 1.0, np.array([1.0, 8.0]))
    assert np.isfinite(parts).all()
    assert parts[0].max() < 3 * 255  # levels of a frame for one unit of ln(irradiance)
