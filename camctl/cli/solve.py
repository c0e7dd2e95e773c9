"""`camctl solve`: the best exposures for a desired response."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import (
    ProgressBar,
    print_json,
    print_text,
    print_warning,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import Number, Seconds, Settings
from camctl.cli.response_options import (
    DesiredOptions,
    ObjectiveOptions,
    RealCameraOptions,
    desired_options,
    levels_wanted,
    objective_options,
    real_camera_options,
)
from camctl.cli.solve_output import SettingsResult, SolveResult
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.exposure.grid_search import SettingsSolution
    from camctl.exposure.lower_bound import Certificate
    from camctl.response.camera import CameraResponse
    from camctl.response.desired import DesiredResponse

CONFLICTS = {
    "tolerance": {"p", "noise", "jitter", "total_limit", "settings", "time_limit"},
    "settings": {"noise", "jitter", "time_limit"},
    "gains": {"total_limit"},
    "certificate": {"p", "noise", "jitter", "total_limit", "settings", "tolerance"},
}
"""Parameters, and those that each cannot be combined with."""

MOST_FOR_TOLERANCE = 16
"""Exposures that --tolerance may take where -n is not given."""

SAME_EXPOSURE = 1e-8
"""Products of time and gain whose ratio differs less from 1 are one exposure."""

DEFAULT_EVALUATIONS = 400_000
"""Sets of exposures to evaluate without a time limit: a proof for two exposures, up to 10 bits."""

_TIMED_SETS = 256
"""Sets that are evaluated to measure this machine's speed."""

_REFRESH_S = 0.2
"""Time between two updates of the progress bar, s."""


@dataclass(frozen=True)
class SearchLimits:
    """What the exposures are chosen from, and how long the search may take."""

    count: int
    tolerance: float | None
    total_limit: float | None
    settings: tuple[float, ...] | None
    gains: tuple[float, ...] | None
    certificate: bool
    time_limit: float | None
    seed: int

    def check(self, levels_wanted: float | None) -> None:
        """Raise `UsageError` where options contradict each other or one that is needed lacks."""
        if self.tolerance is not None and levels_wanted is None:
            raise UsageError("--tolerance needs --levels", hint="give the desired number of levels")
        if self.gains is not None and self.settings is None:
            raise UsageError(
                "--gains needs --settings", hint="give the shutter times to choose from"
            )
        context = click.get_current_context()
        for option in CONFLICTS.keys() & options.given(context):
            options.refuse_together(context, f"--{option}", CONFLICTS[option])


search_limits = options.option_group(
    SearchLimits,
    "limits",
    options.count,
    click.option(
        "--tolerance",
        type=Number("a number of levels of at least 0", least=0),
        metavar="X",
        help="Find the fewest exposures with at most X desired levels missing; needs --levels, and "
        "-n is then the most.  [default: as many as -n]",
    ),
    click.option(
        "--total-limit",
        type=Number("a positive number", above=0),
        metavar="X",
        help="Limit the total exposure time to X times the shortest exposure, or with --settings "
        "to X seconds.  [default: no limit]",
    ),
    click.option(
        "--settings",
        type=Settings(
            "a file of times, a list of times or MIN:MAX:STEP in seconds", unit=Seconds(), file=True
        ),
        metavar="FILE|MIN:MAX:STEP",
        help="Choose among a camera's shutter times, for the shortest exposure too: a file with "
        "true seconds, one per line, such as 0.004 or 1/32; or even steps.  [default: any times]",
    ),
    click.option(
        "--gains",
        type=Settings(
            "gains such as 1,2,4, or MIN:MAX:STEP", unit=Number("a gain above 0", above=0)
        ),
        metavar="A,B,...|MIN:MAX:STEP",
        help="Gains, as factors, that can be combined with each of --settings.  [default: 1]",
    ),
    click.option(
        "--certificate",
        is_flag=True,
        help="Also compute how much better any other exposures could be: for two exposures of up "
        "to 10 bits a proof that none are (takes seconds); for more, a lower bound.",
    ),
    click.option(
        "--time-limit",
        type=Number("a time in seconds above 0", above=0),
        metavar="SECONDS",
        help="Stop the search after this time; with --certificate, stop bounding after about this "
        "time.  [default: no limit]",
    ),
    options.seed,
)


@command(
    examples=(
        ("camctl solve", "three exposures for equal contrast over 1:1,000, 8-bit linear camera"),
        ("camctl solve --response linear --range 2048 -n 4 --json", "for a script"),
        ("camctl solve -n 2 --certificate", "with a proof that no other two are better"),
        ("camctl solve --settings 0.0001:1:0.0001 --gains 1,2,4", "what a real camera can set"),
        ("camctl solve --tolerance 30 --levels 256", "as few as leave 30 of 256 levels missing"),
    )
)
@desired_options()
@search_limits
@real_camera_options
@levels_wanted
@objective_options
@options.as_json
def solve(
    desired: DesiredOptions,
    limits: SearchLimits,
    real_camera: RealCameraOptions,
    levels_wanted: float | None,
    objective: ObjectiveOptions,
    as_json: bool,
) -> None:
    """Find the best exposures for a desired response.

    Exposures are relative to the shortest. Two numbers rate them: missing levels (xi), how many of
    the desired brightness levels they do not give (less is better); and effective levels, the
    number of equal steps of brightness that would be as accurate (more is better).
    """
    limits.check(levels_wanted)
    real = real_camera.response()
    for note in real.notes:
        print_warning(note)
    response = desired.desired()
    if limits.certificate:
        result = _solve_with_certificate(real, response, limits, levels_wanted)
    else:
        result = _solve(real, response, limits, levels_wanted, objective)
    if as_json:
        print_json(result.to_json(limits.seed))
    else:
        print_text(result.to_text(limits.seed, counts_levels=objective.counts_levels))


def _solve(
    real: CameraResponse,
    desired: DesiredResponse,
    limits: SearchLimits,
    levels_wanted: float | None,
    objective: ObjectiveOptions,
) -> SolveResult:
    from camctl.exposure.grid_search import SettingsGrid, solve_settings
    from camctl.exposure.objective import Objective
    from camctl.exposure.solver import SearchOptions
    from camctl.exposure.solver import solve as search
    from camctl.exposure.tradeoff import fewest_exposures

    total_limit = math.inf if limits.total_limit is None else limits.total_limit
    with progress_bar("searching") as bar:
        if limits.tolerance is not None and levels_wanted is not None:
            count_given = "count" in options.given(click.get_current_context())
            found = fewest_exposures(
                real,
                desired,
                limits.tolerance,
                levels_wanted,
                seed=limits.seed,
                max_count=limits.count if count_given else MOST_FOR_TOLERANCE,
                progress=without_stage(bar),
            )
        else:
            found = search(
                real,
                desired,
                limits.count,
                objective=Objective(
                    levels_wanted, objective.p, objective.noise_term(), objective.jitter
                ),
                total_limit=total_limit if limits.settings is None else math.inf,
                search=SearchOptions(limits.seed, time_limit_s=limits.time_limit),
                progress=without_stage(bar),
            )
        if limits.settings is None:
            return SolveResult(real, desired, found)
        restricted = solve_settings(
            real,
            desired,
            limits.count,
            SettingsGrid(limits.settings, limits.gains or (1.0,), total_limit=total_limit),
            objective=Objective(levels_wanted, objective.p),
            search=SearchOptions(limits.seed),
        )
    return SolveResult(real, desired, found, restricted=_with_gains(restricted, limits))


def _solve_with_certificate(
    real: CameraResponse,
    desired: DesiredResponse,
    limits: SearchLimits,
    levels_wanted: float | None,
) -> SolveResult:
    from camctl.exposure.objective import ExposureProblem, Objective
    from camctl.exposure.solver import Solution

    certificate = _certify(
        real,
        desired,
        limits.count,
        levels_wanted=levels_wanted,
        seed=limits.seed,
        time_limit_s=limits.time_limit,
    )
    found = Solution.of(
        ExposureProblem(real, desired, limits.count, Objective(levels_wanted)),
        certificate.exposures,
        seconds=certificate.seconds,
        evaluations=certificate.evaluations,
    )
    return SolveResult(real, desired, found, certificate=certificate)


def _with_gains(solution: SettingsSolution, limits: SearchLimits) -> SettingsResult:
    """Return the solution with the smallest gain that makes each exposure."""
    pairs = [
        (time_s, gain)
        for gain in sorted(limits.gains or (1.0,))
        for time_s in limits.settings or ()
    ]
    chosen = [
        next(pair for pair in pairs if abs(pair[0] * pair[1] / product - 1) <= SAME_EXPOSURE)
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
    time_limit_s: float | None,
) -> Certificate:
    """Return the best n exposures found, with a lower bound on xi for all others.

    Evaluates `DEFAULT_EVALUATIONS` sets, or as many as this machine does in about `time_limit_s`.
    """
    from camctl.exposure.lower_bound import certify

    most = DEFAULT_EVALUATIONS
    rate = _sets_per_second(real, desired, n)
    if time_limit_s is not None:
        most = max(1, int(time_limit_s * rate))
    label = "proving" if n <= 2 else "bounding"
    with progress_bar(label) as bar, _advance_with_time(bar, most / rate):
        return certify(
            real, desired, n, levels_wanted=levels_wanted, max_evaluations=most, seed=seed
        )


def _sets_per_second(real: CameraResponse, desired: DesiredResponse, n: int) -> float:
    """Return how many sets of n exposures this machine evaluates per second."""
    import numpy as np

    from camctl.exposure.candidates import BatchScore
    from camctl.exposure.objective import ExposureProblem

    score = BatchScore(ExposureProblem(real, desired, n), exact=True)
    spread = np.linspace(0.0, math.log(desired.dynamic_range), _TIMED_SETS)
    sets = np.exp(spread[:, np.newaxis] * np.linspace(0.0, 1.0, n))
    score(sets[:1])
    started = time.perf_counter()
    score(sets)
    return _TIMED_SETS / (time.perf_counter() - started)


@contextmanager
def _advance_with_time(bar: ProgressBar | None, longest_s: float) -> Iterator[None]:
    """Advance the bar with elapsed time, up to the longest that the work may take."""
    if bar is None:
        yield
        return
    show = bar
    ended = threading.Event()
    started = time.monotonic()

    def advance() -> None:
        while not ended.wait(_REFRESH_S):
            show(min((time.monotonic() - started) / longest_s, 0.99), "")

    thread = threading.Thread(target=advance, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
