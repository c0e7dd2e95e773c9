"""`camctl solve`: the exposures that serve a desired picture best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from camctl.cli import kinds, options
from camctl.cli.commands import command
from camctl.cli.output import duration, fields, number, range_name, say, say_json, warn
from camctl.cli.progress import progress_bar, share_only
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.exposure.solver import Solution

WITHOUT_TOLERANCE = frozenset({"p", "noise", "jitter", "total_limit", "settings"})
WITHOUT_SETTINGS = frozenset({"noise", "jitter"})


@command(
    examples=(
        ("camctl solve", "three exposures for equal contrast over 1:1,000, 8-bit linear camera"),
        ("camctl solve --response linear --range 2048 -n 4 --json", "for a script"),
        ("camctl solve --bits 10 --phase 0.5 --range high -n 2", "a 10-bit camera that rounds"),
        ("camctl solve --tolerance 30 --levels 256", "as few as leave 30 of 256 levels missing"),
    )
)
@options.response
@options.dynamic_range
@options.count
@click.option(
    "--tolerance",
    type=kinds.Number("a number of levels from 0", least=0),
    metavar="X",
    help="Fewest exposures with at most X wanted levels missing; needs --levels, and -n is then "
    "the most.",
)
@click.option(
    "--total-limit",
    type=kinds.Number("a positive number", above=0),
    metavar="X",
    help="Keep the shutter open no longer in all than X times the shortest exposure, or with "
    "--settings X seconds.",
)
@click.option(
    "--settings",
    type=kinds.Settings(),
    metavar="FILE",
    help="Choose among the shutter times that a camera has: true seconds, one a line, such as "
    "0.004 or 1/32.",
)
@options.real_camera
@options.levels_wanted
@options.objective
@options.seed
@options.as_json
@click.pass_context
def solve(
    context: click.Context,
    response: str,
    dynamic_range: float,
    count: int,
    tolerance: float | None,
    total_limit: float | None,
    settings: tuple[float, ...] | None,
    bits: int,
    phase: float,
    curve: str | None,
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
    for option, without in (("tolerance", WITHOUT_TOLERANCE), ("settings", WITHOUT_SETTINGS)):
        if option in named and named & without:
            extra = ", ".join(options.spelling(context, name) for name in sorted(named & without))
            raise UsageError(f"--{option} goes without {extra}")
    from camctl.exposure.response import desired_response
    from camctl.exposure.settings import SettingsSolution, solve_settings
    from camctl.exposure.solver import fewest
    from camctl.exposure.solver import solve as search

    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    desired = desired_response(response, dynamic_range)
    ideal: Solution | None = None
    with progress_bar("searching") as tick:
        progress = share_only(tick)
        if tolerance is not None and levels_wanted is not None:
            most = count if "count" in named else 16
            found = fewest(
                real, desired, tolerance, levels_wanted, seed=seed, most=most, progress=progress
            )
        else:
            found = search(
                real,
                desired,
                count,
                levels_wanted=levels_wanted,
                seed=seed,
                progress=progress,
                p=p,
                noise=options.noise_term(noise, noise_weight, noise_kind),
                jitter=jitter,
                total_limit=None if settings is not None else total_limit,
            )
        if settings is not None:
            ideal = found
            found = solve_settings(
                real,
                desired,
                count,
                settings,
                total_limit=total_limit,
                levels_wanted=levels_wanted,
                p=p,
                seed=seed,
            )
    facts = {
        "exposures": found.exposures,
        "xi": found.xi,
        "levels_wanted": found.levels_wanted,
        "effective_levels": found.effective_levels,
        "total_exposure": found.total_exposure,
        "seconds": found.seconds,
        "evaluations": found.evaluations,
        "response": response,
        "dynamic_range": dynamic_range,
        "camera": real.name,
        "seed": seed,
    }
    chosen = found if isinstance(found, SettingsSolution) else None
    if chosen is not None and ideal is not None:
        facts["settings_s"] = chosen.settings
        facts["every_set_tried"] = chosen.enumerated
        facts["without_settings"] = {
            "exposures": ideal.exposures,
            "xi": ideal.xi,
            "effective_levels": ideal.effective_levels,
        }
    if as_json:
        say_json(facts)
        return
    plain = p == 1 and noise is None and jitter == 0
    rows = [
        ("wanted", desired_name(response, dynamic_range, len(found.exposures))),
        ("camera", real.name),
        ("exposures", "  ".join(number(value) for value in found.exposures)),
        objective_line(found.xi, found.levels_wanted, plain=plain),
        ("effective levels", number(found.effective_levels, 4)),
        ("shutter open", f"{number(found.total_exposure)} x the shortest exposure"),
        ("search", f"{number(found.seconds, 3)} s, {found.evaluations:,} sets, seed {seed}"),
    ]
    if chosen is not None and ideal is not None:
        rows[2:2] = [("settings", "  ".join(duration(value) for value in chosen.settings))]
        rows += [
            (
                "any times at all",
                f"{number(ideal.effective_levels, 4)} effective levels with "
                + "  ".join(number(value) for value in ideal.exposures),
            )
        ]
    say(fields(rows))


def desired_name(response: str, dynamic_range: float, count: int) -> str:
    """Return what is wanted, in words."""
    return (
        f"{response}, {range_name(dynamic_range)}, in {count} exposure{'s' if count != 1 else ''}"
    )


def objective_line(xi: float, levels_wanted: float, *, plain: bool) -> tuple[str, str]:
    """Return the objective in words; only the plain one counts levels."""
    if plain:
        return "wanted levels missing", f"{number(xi, 5)} of {number(levels_wanted)} (xi)"
    return "objective", f"{number(xi)}, {number(levels_wanted)} levels wanted"
