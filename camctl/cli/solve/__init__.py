"""`camctl solve`: the best exposures for a desired response."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import (
    print_json,
    print_text,
    print_warning,
    progress_bar,
    without_stage,
)
from camctl.cli.real_camera import (
    KnownCamera,
    NoiseOptions,
    RealCameraOptions,
    noise_options,
    real_camera_options,
)
from camctl.cli.request_options import (
    TOLERANCE,
    RequestOption,
    RequestOptions,
    request_options,
)
from camctl.cli.search_options import (
    TOLERANCE_HELP,
    ObjectiveOptions,
    SearchLimits,
    by_accuracy,
    count_of,
    objective_options,
    search_limits,
)
from camctl.cli.solve.output import SettingsResult, SolveResult
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.exposure.grid_search import SettingsSolution
    from camctl.exposure.lower_bound import Certificate
    from camctl.model.response.camera import CameraResponse
    from camctl.model.response.desired import DesiredResponse

MOST_FOR_TOLERANCE = 16
"""Exposures that --tolerance may take where -n is not given."""

SAME_EXPOSURE = 1e-8
"""Products of time and gain whose ratio differs less from 1 are one exposure."""

DEFAULT_EVALUATIONS = 400_000
"""Sets of exposures to evaluate: a proof for two exposures, up to 10 bits."""

PROOF_SECONDS, FINE_PROOF_SECONDS = 20.0, 8.0
"""Processor time for them, about, at most; less where the search before takes long, for more than
10 bits."""


@command(
    examples=(
        ("camctl solve", "three exposures for equal contrast over 1:1,000, 8-bit linear camera"),
        ("camctl solve -n 2 --certificate", "with a proof that no other two are better"),
        ("camctl solve --settings 0.0001:1:0.0001 --gains 1,2,4", "what a real camera can set"),
        ("camctl solve --sensor standard --objective accuracy", "with the noise of a camera"),
        (
            "camctl solve --tolerance 30 --levels 256 --json",
            "the fewest that leave at most 30 of 256 levels missing",
        ),
    )
)
@request_options(
    *("response", "gamma", "dynamic_range", "count", "objective", "accuracy", "tolerance"),
    "levels_wanted",
    tolerance=RequestOption(TOLERANCE_HELP, "X", TOLERANCE),
)
@search_limits
@real_camera_options
@objective_options
@noise_options
@options.as_json
def solve(
    request: RequestOptions,
    limits: SearchLimits,
    real_camera: RealCameraOptions,
    objective: ObjectiveOptions,
    noise: NoiseOptions,
    as_json: bool,
) -> None:
    """Find the best exposures for a desired response.

    Exposures are relative to the shortest. Two numbers rate them: missing levels (xi), how many of
    the desired brightness levels they do not give (less is better); and effective levels, the
    number of equal steps of brightness that would be as accurate (more is better). Where the
    noise is known (--sensor, --camera, --electrons, --read-noise), effective levels count it in.
    """
    limits.check(request)
    camera = noise.camera(real_camera)
    for note in camera.response.notes:
        print_warning(note)
    if by_accuracy(request):
        result = _solve_by_accuracy(camera, request, limits)
    elif limits.certificate:
        result = _solve_with_certificate(camera, request, limits)
    else:
        result = _solve(camera, request, limits, objective)
    if as_json:
        print_json(result.to_json(limits.seed))
    else:
        print_text(result.to_text(limits.seed, counts_levels=objective.counts_levels))


def _solve(
    camera: KnownCamera,
    request: RequestOptions,
    limits: SearchLimits,
    objective: ObjectiveOptions,
) -> SolveResult:
    from camctl.exposure.exposure_choices import SettingsGrid
    from camctl.exposure.grid_search import base_indices, solve_settings
    from camctl.exposure.objective import Objective
    from camctl.exposure.solver import SearchOptions, part_of
    from camctl.exposure.solver import solve as search

    real, desired = camera.response, request.desired()
    levels_wanted, count = request.get("levels_wanted"), count_of(request)
    total_limit = math.inf if limits.total_limit is None else limits.total_limit
    grid = None
    if limits.settings is not None:
        grid = SettingsGrid(limits.settings, limits.gains or (1.0,), total_limit=total_limit)
        base_indices(grid, count)  # refuses what no search can find
    with progress_bar("searching") as bar:
        tolerance = request.get("tolerance")
        progress = without_stage(bar)
        found = search(
            real,
            desired,
            request.get("count", MOST_FOR_TOLERANCE) if tolerance is not None else count,
            objective=Objective(
                levels_wanted, objective.p, objective.noise_term(), objective.jitter
            ),
            tolerance=tolerance,
            total_limit=total_limit if grid is None else math.inf,
            search=SearchOptions(limits.seed),
            progress=part_of(progress, 0.0, 1.0 if grid is None else 0.5),
        )
        if grid is None:
            return SolveResult(camera, desired, found)
        restricted = solve_settings(
            real,
            desired,
            count,
            grid,
            objective=Objective(levels_wanted, objective.p),
            search=SearchOptions(limits.seed),
            ideal=found,
            progress=part_of(progress, 0.5, 1.0),
        )
    return SolveResult(camera, desired, found, restricted=_with_gains(restricted, limits))


def _solve_by_accuracy(
    camera: KnownCamera, request: RequestOptions, limits: SearchLimits
) -> SolveResult:
    from camctl.exposure.accuracy import solve_accuracy
    from camctl.exposure.exposure_choices import AccuracyProblem, AvailableExposures

    if camera.noise is None:
        raise UsageError(
            "exposures cannot be chosen by accuracy: the camera's noise is not known",
            hint="name a camera with --sensor or --camera, or give --electrons and --read-noise",
        )
    total_limit = math.inf if limits.total_limit is None else limits.total_limit
    desired = request.desired()
    counts = limits.counts(request)
    search = partial(solve_accuracy, total_limit=total_limit, accuracy=request.get("accuracy"))
    problem = AccuracyProblem(camera.response, desired, camera.noise, black=camera.black)
    with progress_bar("searching") as bar:
        if limits.settings is None:
            found = search(problem, counts, progress=without_stage(bar))
            return SolveResult(camera, desired, found, objective="accuracy")
        available = AvailableExposures(limits.settings, limits.gains or (1.0,), unit_s=1.0)
        available_problem = replace(problem, available=available)
        restricted = search(available_problem, counts, progress=without_stage(bar))
        found = solve_accuracy(problem, [len(restricted.exposures)])
    settings = SettingsResult(restricted, restricted.times, restricted.gains)
    return SolveResult(camera, desired, found, restricted=settings, objective="accuracy")


def _solve_with_certificate(
    camera: KnownCamera, request: RequestOptions, limits: SearchLimits
) -> SolveResult:
    from camctl.exposure.objective import ExposureProblem, Objective
    from camctl.exposure.solver import Solution

    real, desired = camera.response, request.desired()
    levels_wanted, count = request.get("levels_wanted"), count_of(request)
    certificate = _certify(real, desired, count, levels_wanted=levels_wanted, seed=limits.seed)
    found = Solution.of(
        ExposureProblem(real, desired, count, Objective(levels_wanted)),
        certificate.exposures,
        seconds=certificate.seconds,
        evaluations=certificate.evaluations,
    )
    return SolveResult(camera, desired, found, certificate=certificate)


def _with_gains(solution: SettingsSolution, limits: SearchLimits) -> SettingsResult:
    """Return the solution with the smallest gain that makes each exposure."""
    import numpy as np

    times = np.array(limits.settings)
    chosen = [
        next(
            (float(times[same][0]), gain)
            for gain in sorted(limits.gains or (1.0,))
            if (same := np.abs(times * gain / product - 1) <= SAME_EXPOSURE).any()
        )
        for product in solution.settings
    ]
    times_s, gains = zip(*chosen, strict=True)
    return SettingsResult(solution, times_s, gains)


def _certify(
    real: CameraResponse,
    desired: DesiredResponse,
    n: int,
    *,
    levels_wanted: float | None,
    seed: int,
) -> Certificate:
    """Return the best n exposures found, with a lower bound on xi for all others.

    Evaluates `DEFAULT_EVALUATIONS` sets, of cameras of many levels what takes `PROOF_SECONDS`.
    """
    from camctl.exposure.candidates import BatchScore
    from camctl.exposure.lower_bound import certify
    from camctl.exposure.objective import MAX_DIRECT_LEVELS, ExposureProblem

    score = BatchScore(ExposureProblem(real, desired, n), exact=True)
    longest_s = PROOF_SECONDS if real.M <= MAX_DIRECT_LEVELS else FINE_PROOF_SECONDS
    most = max(1, min(DEFAULT_EVALUATIONS, int(longest_s / score.seconds)))
    with progress_bar("proving" if n <= 2 else "bounding") as bar:
        return certify(
            real,
            desired,
            n,
            levels_wanted=levels_wanted,
            max_evaluations=most,
            seed=seed,
            progress=without_stage(bar),
        )
