"""`camctl solve`: the exposures that serve a desired picture best."""

from __future__ import annotations

import math

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.commands import command
from camctl.cli.output import progress_bar, share_only, warn
from camctl.cli.response_options import real_camera, real_response
from camctl.cli.solve_output import made_of, prove, tell
from camctl.errors import UsageError

WITHOUT = {
    "tolerance": frozenset({"p", "noise", "jitter", "total_limit", "settings", "time_limit"}),
    "settings": frozenset({"noise", "jitter", "time_limit"}),
    "gains": frozenset({"total_limit"}),
    "certificate": frozenset({"p", "noise", "jitter", "total_limit", "settings", "tolerance"}),
}
"""Options, and those that they go without."""

GAIN = kinds.Number("a gain above 0", above=0)


@command(
    examples=(
        ("camctl solve", "three exposures for equal contrast over 1:1,000, 8-bit linear camera"),
        ("camctl solve --response linear --range 2048 -n 4 --json", "for a script"),
        ("camctl solve -n 2 --certificate", "with a proof that no other two are better"),
        ("camctl solve --settings 0.0001:1:0.0001 --gains 1,2,4", "what a real camera can set"),
        ("camctl solve --tolerance 30 --levels 256", "as few as leave 30 of 256 levels missing"),
    )
)
@options.wish
@options.exponent
@options.dynamic_range
@options.count
@click.option(
    "--tolerance",
    type=kinds.Number("a number of levels from 0", least=0),
    metavar="X",
    help="Fewest exposures with at most X wanted levels missing; needs --levels, and -n is then "
    "the most.  [default: as many as -n says]",
)
@click.option(
    "--total-limit",
    type=kinds.Number("a positive number", above=0),
    metavar="X",
    help="Keep the shutter open no longer in all than X times the shortest exposure, or with "
    "--settings X seconds.  [default: no limit]",
)
@click.option(
    "--settings",
    type=kinds.Settings(
        "a file of times, a list or MIN:MAX:STEP in seconds", unit=kinds.Seconds(), file=True
    ),
    metavar="FILE|MIN:MAX:STEP",
    help="Choose among the shutter times that a camera has, the shortest exposure too: a file "
    "with true seconds, one a line, such as 0.004 or 1/32; or even steps.  "
    "[default: any times at all]",
)
@click.option(
    "--gains",
    type=kinds.Settings("gains such as 1,2,4, or MIN:MAX:STEP", unit=GAIN),
    metavar="A,B,...|MIN:MAX:STEP",
    help="Gains, as factors, that combine with each of --settings.  [default: 1]",
)
@click.option(
    "--certificate",
    is_flag=True,
    help="Print how much better any other exposures could be: for two, up to 10 bits, a proof "
    "that none are (seconds); for more, a lower bound.",
)
@click.option(
    "--time-limit",
    type=kinds.Number("a time in seconds above 0", above=0),
    metavar="SECONDS",
    help="Stop the search after that long, or with --certificate the bounding after about that "
    "long.  [default: until done]",
)
@real_camera
@options.levels_wanted
@options.objective
@options.seed
@options.as_json
@click.pass_context
def solve(
    context: click.Context,
    response: str,
    exponent: float | None,
    dynamic_range: float,
    count: int,
    tolerance: float | None,
    total_limit: float | None,
    settings: tuple[float, ...] | None,
    gains: tuple[float, ...] | None,
    certificate: bool,
    time_limit: float | None,
    bits: int,
    phase: float,
    curve: str | None,
    coefficients: tuple[float, ...] | None,
    levels_wanted: float | None,
    p: float,
    noise: float | None,
    noise_weight: float,
    noise_kind: str,
    jitter: float,
    seed: int,
    as_json: bool,
) -> None:
    """Find the exposures that serve a desired picture best.

    Exposures are relative to the shortest.  How good they are is said twice: in wanted brightness
    levels that are missing (xi; less is better), and in effective levels: as many equal steps of
    brightness would be as accurate (more is better).
    """
    named = options.given(context)
    if tolerance is not None and levels_wanted is None:
        raise UsageError("--tolerance needs --levels", hint="say how many levels are wanted")
    if gains is not None and settings is None:
        raise UsageError("--gains needs --settings", hint="say which shutter times there are")
    for option, without in WITHOUT.items():
        if option in named and named & without:
            extra = ", ".join(options.spelling(context, name) for name in sorted(named & without))
            raise UsageError(f"--{option} goes without {extra}")
    from camctl.exposure.grid_search import SettingsGrid, solve_settings
    from camctl.exposure.objective import ExposureProblem, Objective
    from camctl.exposure.solver import SearchOptions, Solution
    from camctl.exposure.solver import solve as search
    from camctl.exposure.tradeoff import fewest_exposures

    real = real_response(bits, phase, curve, coefficients)
    for note in real.notes:
        warn(note)
    desired = options.desired(response, dynamic_range, exponent)
    dynamic_range = desired.dynamic_range  # a file brings its own
    if certificate:
        proof = prove(
            real, desired, count, levels_wanted=levels_wanted, seed=seed, limit_s=time_limit
        )
        found = Solution.of(
            ExposureProblem(real, desired, count, Objective(levels_wanted)),
            proof.exposures,
            seconds=proof.seconds,
            evaluations=proof.evaluations,
        )
        tell(found, real.name, desired.name, dynamic_range, seed, as_json=as_json, proof=proof)
        return
    limit = math.inf if total_limit is None else total_limit
    with progress_bar("searching") as tick:
        progress = share_only(tick)
        if tolerance is not None and levels_wanted is not None:
            most = count if "count" in named else 16
            found = fewest_exposures(
                real,
                desired,
                tolerance,
                levels_wanted,
                max_count=most,
                seed=seed,
                progress=progress,
            )
        else:
            noise_term = options.noise_term(noise, noise_weight, noise_kind)
            found = search(
                real,
                desired,
                count,
                objective=Objective(levels_wanted, p, noise_term, jitter),
                total_limit=limit if settings is None else math.inf,
                search=SearchOptions(seed, time_limit_s=time_limit),
                progress=progress,
            )
        possible = None
        if settings is not None:
            possible = solve_settings(
                real,
                desired,
                count,
                SettingsGrid(settings, gains or (1.0,), total_limit=limit),
                objective=Objective(levels_wanted, p),
                search=SearchOptions(seed),
            )
    tell(
        found,
        real.name,
        desired.name,
        dynamic_range,
        seed,
        as_json=as_json,
        plain=p == 1 and noise is None and jitter == 0,
        possible=None if possible is None else (possible, made_of(possible, settings, gains)),
    )
