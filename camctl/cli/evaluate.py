"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import kinds, options
from camctl.cli.commands import command
from camctl.cli.output import fields, number, say, say_json, warn
from camctl.cli.realcamera import real_camera, real_response
from camctl.cli.sensitivity import QUICK_LEVELS, sensitivity_facts, sensitivity_text
from camctl.cli.solution import desired_name, objective_line

if TYPE_CHECKING:
    from camctl.exposure.effective import EffectiveCamera
    from camctl.exposure.response import DesiredResponse


@command(
    examples=(
        ("camctl evaluate --ratios 1,2,4", "the usual bracket of one stop"),
        ("camctl evaluate --ratios 1,9.91,88.38", "for equal contrast: far better"),
        ("camctl evaluate --ratios 1,2,4 --response gamma --phase 0.5", "an ADC that rounds"),
        (
            "camctl evaluate --ratios 1,9.91,88.38 --electrons 40 --read-noise 0.3",
            "with the noise of a sensor of 40 electrons a level",
        ),
    )
)
@click.option(
    "--ratios",
    type=kinds.Ratios(),
    required=True,
    metavar="A,B,...",
    help="Exposures, relative to one another.",
)
@options.wish
@options.exponent
@options.dynamic_range
@real_camera
@options.levels_wanted
@options.objective
@click.option(
    "--electrons",
    type=kinds.Number("a number of electrons above 0", above=0),
    metavar="K",
    help="Count photon noise in: electrons that make one brightness level of the linear scale.  "
    "[default: no photon noise]",
)
@click.option(
    "--read-noise",
    type=kinds.Number("a noise from 0", least=0),
    metavar="S",
    help="Count read noise in: the standard deviation of each frame, in brightness levels.  "
    "[default: 0]",
)
@click.option(
    "--sensitivity/--no-sensitivity",
    default=None,
    help="Say what is left when exposures are off, frames are noisy, or the quantiser's phase is "
    "another.  [default: said up to 65,536 levels in all frames: less than a second]",
)
@options.as_json
def evaluate(
    ratios: tuple[float, ...],
    response: str,
    exponent: float | None,
    dynamic_range: float,
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
    electrons: float | None,
    read_noise: float | None,
    sensitivity: bool | None,
    as_json: bool,
) -> None:
    """Tell how good given exposures are.

    Compare sets of exposures for one desired picture: fewer wanted levels missing (xi) and more
    effective levels are better; a longer open shutter is the price.  What is left when things are
    not as planned stands below.
    """
    from camctl.exposure.effective import EffectiveCamera, effective_levels
    from camctl.exposure.goal import Goal

    real = real_response(bits, phase, curve, coefficients)
    for note in real.notes:
        warn(note)
    desired = options.desired(response, dynamic_range, exponent)
    dynamic_range = desired.dynamic_range  # a file brings its own
    camera = EffectiveCamera.of(real, ratios)
    wanted = float(camera.levels_total) if levels_wanted is None else levels_wanted
    goal = Goal(wanted, p, options.noise_term(noise, noise_weight, noise_kind), jitter)
    xi = goal.score(real, ratios, desired)
    accuracy = effective_levels(camera, desired)
    noisy = None
    if electrons is not None or read_noise is not None:
        noisy = _with_noise(camera, desired, electrons, read_noise or 0.0)
    left = None
    if camera.levels_total <= QUICK_LEVELS if sensitivity is None else sensitivity:
        from camctl.exposure.sensitivity import sensitivity as judge

        left = judge(real, desired, ratios, levels_wanted=wanted)
    if as_json:
        facts: dict[str, Any] = {
            "xi": xi,
            "levels_wanted": wanted,
            "levels": camera.levels_total,
            "levels_distinct": camera.levels_distinct,
            "effective_levels": accuracy,
            "total_exposure": sum(ratios),
            "exposures": ratios,
            "response": desired.name,
            "dynamic_range": dynamic_range,
            "camera": real.name,
        }
        if noisy is not None:
            facts["with_noise"] = {
                "electrons_per_level": electrons,
                "read_noise_levels": read_noise or 0.0,
                "effective_levels": noisy[0],
                "effective_levels_of_equal_exposures": noisy[1],
            }
        if left is not None:
            facts["sensitivity"] = sensitivity_facts(left)
        say_json(facts)
        return
    lost = camera.levels_total - camera.levels_distinct
    plain = p == 1 and noise is None and jitter == 0
    rows = [
        ("wanted", desired_name(desired.name, dynamic_range, len(ratios))),
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
    if noisy is not None:
        equal = f", {len(ratios)} equal exposures {number(noisy[1], 4)}" if len(ratios) > 1 else ""
        rows.insert(5, ("with that noise", f"{number(noisy[0], 4)}{equal}"))
    text = fields(rows)
    say(text if left is None else f"{text}\n\n{sensitivity_text(left, ratios)}")


def _with_noise(
    camera: EffectiveCamera, desired: DesiredResponse, electrons: float | None, read_noise: float
) -> tuple[float, float]:
    """Return the effective levels with noise counted in, and those of as many equal exposures."""
    from camctl.exposure.effective import EffectiveCamera
    from camctl.exposure.noise import noisy_effective_levels

    shortest = [camera.exposures[0]] * len(camera.exposures)
    photons = math.inf if electrons is None else electrons
    with_noise, equal = (
        noisy_effective_levels(
            each, desired, read_noise_levels=read_noise, electrons_per_level=photons
        )
        for each in (camera, EffectiveCamera.of(camera.response, shortest))
    )
    return with_noise, equal
