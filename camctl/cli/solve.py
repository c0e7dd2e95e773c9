"""`camctl solve`: the exposures that serve a desired picture best."""

from __future__ import annotations

from pathlib import Path

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import fields, number, range_name, say, say_json, warn
from camctl.cli.progress import progress_bar, share_only
from camctl.errors import UsageError


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
    type=options.Number("a number of levels from 0", least=0),
    metavar="X",
    help="Fewest exposures with at most X wanted levels missing; needs --levels, and -n is then "
    "the most.",
)
@click.option(
    "--total-limit",
    type=options.Number("a positive number", above=0),
    metavar="X",
    help="Keep the shutter open no longer than X times the shortest exposure in all.",
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
    bits: int,
    phase: float,
    curve: Path | None,
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
    if tolerance is not None:
        if levels_wanted is None:
            raise UsageError("--tolerance needs --levels", hint="say how many levels are wanted")
        extra = options.given(context) & {"p", "noise", "jitter", "total_limit"}
        if extra:
            names = ", ".join(options.spelling(context, name) for name in sorted(extra))
            raise UsageError(f"--tolerance goes without {names}")
    from camctl.exposure import solver
    from camctl.exposure.response import desired_response

    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    desired = desired_response(response, dynamic_range)
    with progress_bar("searching") as tick:
        if tolerance is not None and levels_wanted is not None:
            most = count if "count" in options.given(context) else 16
            found = solver.fewest(
                real,
                desired,
                tolerance,
                levels_wanted,
                seed=seed,
                most=most,
                progress=share_only(tick),
            )
        else:
            found = solver.solve(
                real,
                desired,
                count,
                levels_wanted=levels_wanted,
                seed=seed,
                progress=share_only(tick),
                p=p,
                noise=options.noise_term(noise, noise_weight, noise_kind),
                jitter=jitter,
                total_limit=total_limit,
            )
    if as_json:
        say_json(
            {
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
        )
        return
    say(
        fields(
            [
                ("wanted", f"{desired_name(response, dynamic_range, len(found.exposures))}"),
                ("camera", real.name),
                ("exposures", "  ".join(number(value) for value in found.exposures)),
                objective_line(found.xi, found.levels_wanted, plain=_is_plain(p, noise, jitter)),
                ("effective levels", number(found.effective_levels, 4)),
                ("shutter open", f"{number(found.total_exposure)} x the shortest exposure"),
                (
                    "search",
                    f"{number(found.seconds, 3)} s, {found.evaluations:,} sets, seed {seed}",
                ),
            ]
        )
    )


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


def _is_plain(p: float, noise: float | None, jitter: float) -> bool:
    return p == 1 and noise is None and jitter == 0
