"""How much of a set survives exposures that come out wrong, noise, and another quantiser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camctl.exposure.effective import EffectiveCamera, check_exposures, effective_levels
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.objective import xi
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse

EXPOSURE_ERRORS: tuple[float, ...] = (1e-4, 1e-3, 1e-2)
NOISES: tuple[float, ...] = (0.1, 0.5, 2.0)
PHASES = 16
DRAWS = 16


@dataclass(frozen=True)
class Spread:
    """What a disturbance does to one set.

    Attributes:
        xi: mean of the objective
        xi_worst: the greatest met
        effective_levels: mean
        effective_levels_worst: the least met
    """

    xi: float
    xi_worst: float
    effective_levels: float
    effective_levels_worst: float


@dataclass(frozen=True)
class Robustness:
    """The worth of a set undisturbed, and under each disturbance.

    Attributes:
        xi: undisturbed
        effective_levels: undisturbed
        exposure_errors: relative standard deviation of the exposures -> what is left
        noise: noise of each frame in brightness levels -> effective levels with it
        noise_of_equal: the same for as many equal exposures: what the ratios are worth in noise
        phase: over `PHASES` even shifts of the quantiser in [0, 1) of a level
    """

    xi: float
    effective_levels: float
    exposure_errors: dict[float, Spread]
    noise: dict[float, float]
    noise_of_equal: dict[float, float]
    phase: Spread


def shifted(response: CameraResponse, shift: float) -> CameraResponse:
    """Return the camera with each level lowered by `shift` (0 to 1) of the gap below it."""
    below = np.concatenate([[0.0], response.levels[:-1]])
    if response.M > 1:  # level 0 lies one gap below level 1, where a black level would be
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
    exposure_errors: Sequence[float] = EXPOSURE_ERRORS,
    noises: Sequence[float] = NOISES,
) -> Robustness:
    """Return how much xi and effective levels of a set lose when things are not as planned.

    Exposure errors are Gaussian in ln e, `DRAWS` fixed draws in opposite pairs; the first exposure
    is the unit and stays.  Takes about a second for six exposures of 8 bits.
    """
    values = np.array(check_exposures(exposures))
    n = values.size
    G = n * response.M if levels_wanted is None else levels_wanted

    def worth(camera: EffectiveCamera) -> tuple[float, float]:
        return xi(camera, desired, G), effective_levels(camera, desired)

    half = np.random.default_rng(8).standard_normal((DRAWS // 2, 16))[:, :n]
    draws = np.concatenate([half, -half])
    draws[:, 0] = 0.0
    camera = EffectiveCamera.of(response, values.tolist())
    equal = EffectiveCamera.of(response, [float(values[0])] * n)
    plain = worth(camera)
    return Robustness(
        xi=plain[0],
        effective_levels=plain[1],
        exposure_errors={
            error: _spread(
                [
                    worth(EffectiveCamera.of(response, (values * np.exp(error * draw)).tolist()))
                    for draw in draws
                ]
            )
            for error in exposure_errors
        },
        noise={
            sigma: noisy_effective_levels(camera, desired, read_noise_levels=sigma)
            for sigma in noises
        },
        noise_of_equal={
            sigma: noisy_effective_levels(equal, desired, read_noise_levels=sigma)
            for sigma in noises
        },
        phase=_spread(
            [
                worth(EffectiveCamera.of(shifted(response, step / PHASES), values.tolist()))
                for step in range(PHASES)
            ]
        ),
    )
