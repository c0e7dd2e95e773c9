"""`camctl solve`: the exposures that serve a desired picture best."""

from __future__ import annotations

from pathlib import Path

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import fields, number, range_name, say, say_json, warn
from camctl.cli.progress import progress_bar, share_only


@command(
    examples=(
        ("camctl solve", "three exposures for equal contrast over 1:1,000, 8-bit linear camera"),
        ("camctl solve --response linear --range 2048 -n 4 --json", "for a script"),
        ("camctl solve --bits 10 --phase 0.5 --range high -n 2", "a 10-bit camera that rounds"),
        ("camctl solve --curve webcam.txt --response gamma", "a camera whose curve was measured"),
    )
)
@options.response
@options.dynamic_range
@options.count
@options.real_camera
@options.levels_wanted
@options.seed
@options.as_json
def solve(
    response: str,
    dynamic_range: float,
    count: int,
    bits: int,
    phase: float,
    curve: Path | None,
    levels_wanted: float | None,
    seed: int,
    as_json: bool,
) -> None:
    """Find the exposures that serve a desired picture best.

    Exposures are relative to the shortest.  How good they are is said twice: in wanted brightness
    levels that are missing (xi; less is better), and in effective levels: as many equal steps of
    brightness would be as accurate (more is better).
    """
    from camctl.exposure.response import desired_response
    from camctl.exposure.solver import solve as search

    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    desired = desired_response(response, dynamic_range)
    with progress_bar("searching") as tick:
        found = search(
            real,
            desired,
            count,
            levels_wanted=levels_wanted,
            seed=seed,
            progress=share_only(tick),
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
                ("wanted", f"{response}, {range_name(dynamic_range)}, in {count} exposures"),
                ("camera", real.name),
                ("exposures", "  ".join(number(value) for value in found.exposures)),
                ("wanted levels missing", missing(found.xi, found.levels_wanted)),
                ("effective levels", number(found.effective_levels, 4)),
                ("shutter open", f"{number(found.total_exposure)} x the shortest exposure"),
                (
                    "search",
                    f"{number(found.seconds, 3)} s, {found.evaluations:,} sets, seed {seed}",
                ),
            ]
        )
    )


def missing(xi: float, levels_wanted: float) -> str:
    """Return the objective in words."""
    return f"{number(xi, 5)} of {number(levels_wanted)} (xi)"
