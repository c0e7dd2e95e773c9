"""Robustness of a set of exposures to exposure errors, noise, and the phase of the quantiser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.objective import xi
from camctl.model.effective import (
    MOST_SEARCHED,
    EffectiveCamera,
    check_count,
    check_exposures,
    effective_levels,
)
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse

EXPOSURE_ERRORS: tuple[float, ...] = (1e-4, 1e-3, 1e-2)
"""Relative standard deviations of the exposures."""

NOISES: tuple[float, ...] = (0.1, 0.5, 2.0)
"""Standard deviations of the noise of a frame, in brightness levels."""

PHASES = 16
"""Phases of the quantiser, evenly spaced over one level."""

DRAWS = 16
"""Random draws for each exposure error."""


@dataclass(frozen=True)
class Spread:
    """Quality of a set of exposures under one kind of disturbance.

    Attributes:
        xi: mean objective
        xi_worst: largest objective
        effective_levels: mean number of effective levels
        effective_levels_worst: smallest number of effective levels
    """

    xi: float
    xi_worst: float
    effective_levels: float
    effective_levels_worst: float


@dataclass(frozen=True)
class Robustness:
    """Quality of a set of exposures without and with each disturbance.

    Attributes:
        xi: objective without disturbance
        effective_levels: effective levels without disturbance
        exposure_errors: quality by relative standard deviation of the exposures
        noise: effective levels by noise of each frame, in brightness levels
        noise_of_equal: the same for as many equal exposures: shows whether the ratios gain anything
        phase: quality over `PHASES` shifts of the quantiser in [0, 1) of a level
    """

    xi: float
    effective_levels: float
    exposure_errors: dict[float, Spread]
    noise: dict[float, float]
    noise_of_equal: dict[float, float]
    phase: Spread


def shifted(response: CameraResponse, shift: float) -> CameraResponse:
    """Return the response with each level lowered by `shift` (0 to 1) of the gap below it."""
    below = np.concatenate([[0.0], response.levels[:-1]])
    if response.M > 1:  # level 0 is taken to lie as far below level 1 as level 2 lies above it
        below[0] = 2 * response.levels[0] - response.levels[1]
    levels = np.maximum(response.levels - shift * (response.levels - below), 0.0)
    return CameraResponse(levels, f"{response.name}, shifted by {shift:g}")


def _spread(values: list[tuple[float, float]]) -> Spread:
    scores, levels = np.array(values).T
    return Spread(
        float(scores.mean()), float(scores.max()), float(levels.mean()), float(levels.min())
    )


def sensitivity(
    response: CameraResponse,
    desired: DesiredResponse,
    exposures: Sequence[float],
    *,
    levels_wanted: float | None = None,
) -> Robustness:
    """Return how disturbances change xi and the effective levels of a set of exposures.

    Exposure errors are Gaussian in ln e: `DRAWS` fixed draws in opposite pairs; the first exposure
    is the unit and has no error.  Takes about 1 s for six exposures of 8 bits.

    Args:
        response: the response of the real camera
        desired: the desired response
        exposures: relative exposures, ascending from 1
        levels_wanted: G, the number of levels of the desired camera; None: n * M

    Raises:
        UsageError: an exposure or the number of levels is out of range
    """
    values = np.array(check_exposures(exposures))
    n = values.size
    check_count(n, MOST_SEARCHED)  # of more it would take minutes
    G = n * response.M if levels_wanted is None else levels_wanted

    def quality(camera: EffectiveCamera) -> tuple[float, float]:
        return xi(camera, desired, G), effective_levels(camera, desired)

    half = np.random.default_rng(8).standard_normal((DRAWS // 2, 16))[:, :n]
    draws = np.concatenate([half, -half])
    draws[:, 0] = 0.0
    camera = EffectiveCamera.of(response, values.tolist())
    equal = EffectiveCamera.of(response, [float(values[0])] * n)
    undisturbed = quality(camera)
    return Robustness(
        xi=undisturbed[0],
        effective_levels=undisturbed[1],
        exposure_errors={
            error: _spread(
                [
                    quality(EffectiveCamera.of(response, (values * np.exp(error * draw)).tolist()))
                    for draw in draws
                ]
            )
            for error in EXPOSURE_ERRORS
        },
        noise={
            sigma: noisy_effective_levels(camera, desired, [FrameNoise(math.inf, sigma)] * n)
            for sigma in NOISES
        },
        noise_of_equal={
            sigma: noisy_effective_levels(equal, desired, [FrameNoise(math.inf, sigma)] * n)
            for sigma in NOISES
        },
        phase=_spread(
            [
                quality(EffectiveCamera.of(shifted(response, step / PHASES), values.tolist()))
                for step in range(PHASES)
            ]
        ),
    )
