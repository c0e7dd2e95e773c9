"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

import click

from camctl.cli import kinds, options
from camctl.cli.commands import command
from camctl.cli.output import fields, number, say, say_json, warn
from camctl.cli.solve import desired_name, objective_line


@command(
    examples=(
        ("camctl evaluate --ratios 1,2,4", "the usual bracket of one stop"),
        ("camctl evaluate --ratios 1,9.91,88.38", "for equal contrast: far better"),
        ("camctl evaluate --ratios 1,2,4 --response gamma --phase 0.5", "an ADC that rounds"),
    )
)
@click.option(
    "--ratios",
    type=kinds.Ratios(),
    required=True,
    metavar="A,B,...",
    help="Exposures, relative to one another.",
)
@options.response
@options.dynamic_range
@options.real_camera
@options.levels_wanted
@options.objective
@options.as_json
def evaluate(
    ratios: tuple[float, ...],
    response: str,
    dynamic_range: float,
    bits: int,
    phase: float,
    curve: str | None,
    levels_wanted: float | None,
    p: float,
    noise: float | None,
    noise_weight: float,
    noise_kind: str,
    jitter: float,
    as_json: bool,
) -> None:
    """Tell how good given exposures are.

    Compare sets of exposures for one desired picture: fewer wanted levels missing (xi) and more
    effective levels are better; a longer open shutter is the price.
    """
    from camctl.exposure.effective import EffectiveCamera, effective_levels
    from camctl.exposure.goal import Goal
    from camctl.exposure.response import desired_response

    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    desired = desired_response(response, dynamic_range)
    camera = EffectiveCamera.of(real, ratios)
    wanted = float(camera.levels_total) if levels_wanted is None else levels_wanted
    goal = Goal(wanted, p, options.noise_term(noise, noise_weight, noise_kind), jitter)
    xi = goal.score(real, ratios, desired)
    accuracy = effective_levels(camera, desired)
    if as_json:
        say_json(
            {
                "xi": xi,
                "levels_wanted": wanted,
                "levels": camera.levels_total,
                "levels_distinct": camera.levels_distinct,
                "effective_levels": accuracy,
                "total_exposure": sum(ratios),
                "exposures": ratios,
                "response": response,
                "dynamic_range": dynamic_range,
                "camera": real.name,
            }
        )
        return
    lost = camera.levels_total - camera.levels_distinct
    plain = p == 1 and noise is None and jitter == 0
    say(
        fields(
            [
                ("wanted", desired_name(response, dynamic_range, len(ratios))),
                ("camera", real.name),
                ("exposures", "  ".join(number(ratio) for ratio in ratios)),
                objective_line(xi, wanted, plain=plain),
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
