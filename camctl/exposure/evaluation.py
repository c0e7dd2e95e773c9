"""The quality of given exposures: missing levels, effective levels, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.objective import ExposureProblem, Objective
from camctl.model.effective import EffectiveCamera, check_exposures, effective_levels
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse


@dataclass(frozen=True)
class Evaluation:
    """The quality of a set of exposures.

    Attributes:
        xi: the objective; by default the number of desired levels that are missing
        levels_wanted: G, the number of levels of the desired camera
        levels: number of levels of the effective camera, n * M
        levels_distinct: number of different levels among them
        effective_levels: L, the number of equal steps in the desired response of the same accuracy,
            with the noise of the frames where it was given
        effective_levels_noise_free: L by quantisation alone
        total_exposure: sum of the exposures, in units of the shortest
    """

    xi: float
    levels_wanted: float
    levels: int
    levels_distinct: int
    effective_levels: float
    effective_levels_noise_free: float
    total_exposure: float


def evaluate(
    response: CameraResponse,
    desired: DesiredResponse,
    exposures: Sequence[float],
    *,
    objective: Objective | None = None,
    noise: Sequence[FrameNoise] | None = None,
) -> Evaluation:
    """Return how well the sum of exposures of a camera approximates a desired response.

    Args:
        response: the response of the real camera
        desired: the desired response; its E = 1 is full scale of the shortest exposure
        exposures: 1 to 64 exposures relative to each other, for example 1, 2, 4 or times in s
        objective: the definition of xi; None: missing levels of n * M
        noise: noise of each exposure, in their order; None: unknown

    Raises:
        UsageError: an exposure is not a positive, finite number, there are none or more than 64, or
            there is not one noise for each

    >>> from camctl.model.response.camera import linear_response
    >>> from camctl.model.response.desired import desired_response
    >>> found = evaluate(linear_response(8), desired_response("linear", 1000.0), (1, 2, 4))
    >>> found.levels, found.levels_distinct, round(found.effective_levels), found.total_exposure
    (765, 511, 336, 7.0)
    """
    values = check_exposures(exposures)
    relative = tuple(sorted(value / min(values) for value in values))
    problem = ExposureProblem(response, desired, len(relative), objective or Objective())
    camera = EffectiveCamera.of(response, relative)
    noise_free = effective_levels(camera, desired)
    with_noise = noise_free
    if noise is not None:
        given = EffectiveCamera.of(response, [value / min(values) for value in values])
        with_noise = noisy_effective_levels(given, desired, noise)
    return Evaluation(
        xi=problem.score(relative),
        levels_wanted=problem.levels_wanted,
        levels=camera.levels_total,
        levels_distinct=camera.levels_distinct,
        effective_levels=with_noise,
        effective_levels_noise_free=noise_free,
        total_exposure=math.fsum(relative),
    )
