"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

from pathlib import Path

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import fields, number, range_name, say, say_json, warn
from camctl.cli.solve import missing


@command(
    examples=(
        ("camctl evaluate --ratios 1,2,4", "the usual bracket of one stop"),
        ("camctl evaluate --ratios 1,9.91,88.38", "for equal contrast: far better"),
        ("camctl evaluate --ratios 1,2,4 --response gamma --phase 0.5", "an ADC that rounds"),
    )
)
@click.option(
    "--ratios",
    type=options.Ratios(),
    required=True,
    metavar="A,B,...",
    help="Exposures, relative to one another.",
)
@options.response
@options.dynamic_range
@options.real_camera
@options.levels_wanted
@click.option(
    "--p",
    type=options.Number("a number of at least 1", least=1),
    default=1.0,
    metavar="1|2",
    help="Power of the objective; 1 counts missing levels.",
)
@options.as_json
def evaluate(
    ratios: tuple[float, ...],
    response: str,
    dynamic_range: float,
    bits: int,
    phase: float,
    curve: Path | None,
    levels_wanted: float | None,
    p: float,
    as_json: bool,
) -> None:
    """Tell how good given exposures are.

    Compare sets of exposures for one desired picture: fewer wanted levels missing (xi) and more
    effective levels are better; a longer open shutter is the price.
    """
    from camctl.exposure.effective import EffectiveCamera, effective_levels
    from camctl.exposure.objective import xi
    from camctl.exposure.response import desired_response

    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    desired = desired_response(response, dynamic_range)
    camera = EffectiveCamera.of(real, ratios)
    wanted = float(camera.levels_total) if levels_wanted is None else levels_wanted
    value = xi(camera, desired, wanted, p=p)
    accuracy = effective_levels(camera, desired)
    if as_json:
        say_json(
            {
                "xi": value,
                "levels_wanted": wanted,
                "levels": camera.levels_total,
                "levels_distinct": camera.levels_distinct,
                "effective_levels": accuracy,
                "total_exposure": sum(ratios),
                "exposures": ratios,
                "response": response,
                "dynamic_range": dynamic_range,
                "camera": real.name,
                "p": p,
            }
        )
        return
    lost = camera.levels_total - camera.levels_distinct
    objective = missing(value, wanted) if p == 1 else f"xi = {number(value)} for p = {number(p)}"
    say(
        fields(
            [
                ("wanted", f"{response}, {range_name(dynamic_range)}"),
                ("camera", real.name),
                ("exposures", "  ".join(number(ratio) for ratio in ratios)),
                ("wanted levels missing" if p == 1 else "objective", objective),
                ("effective levels", number(accuracy, 4)),
                (
                    "levels",
                    f"{camera.levels_distinct} different"
                    + (f", {lost} lost because levels coincide" if lost else ""),
                ),
                ("shutter open", f"{number(sum(ratios))} x the shortest exposure"),
            ]
        )
    )
