"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.commands import command
from camctl.cli.output import fields, number, range_name, say, say_json, warn
from camctl.cli.output import table as columns
from camctl.cli.response_options import real_camera, real_response
from camctl.cli.solve_output import desired_name, objective_line

if TYPE_CHECKING:
    from camctl.exposure.robustness import Robustness, Spread
    from camctl.exposure.table import TableEntry

QUICK_LEVELS = 2**16
"""Up to so many levels in all frames together the whole takes less than a second."""

KEPT = 0.95
"""Less than this share of the effective levels left is told in words."""

SURVIVES = 0.85
"""A set that keeps less than this share has not survived."""

GAINS_NOTHING = 1.05
"""Up to this many times what equal exposures give counts as no more than they give."""

INTERLEAVED = 1.02
"""Exposures nearer than this put the levels of one frame between those of another."""


def sensitivity_facts(found: Robustness) -> dict[str, Any]:
    """Return what a script wants to know; disturbances are named by their size."""
    return {
        "exposures_off_by": {f"{size:g}": _spread(s) for size, s in found.exposure_errors.items()},
        "noise_levels": {
            f"{sigma:g}": {
                "effective_levels": found.noise[sigma],
                "effective_levels_of_equal_exposures": found.noise_of_equal[sigma],
            }
            for sigma in found.noise
        },
        "any_phase": _spread(found.phase),
    }


def _spread(spread: Spread) -> dict[str, float]:
    return {
        "xi": spread.xi,
        "xi_worst": spread.xi_worst,
        "effective_levels": spread.effective_levels,
        "effective_levels_worst": spread.effective_levels_worst,
    }


def percent(share: float) -> str:
    """Return 0.01 as 1 %."""
    return f"{100 * share:g} %"


def count(levels: float) -> str:
    """Return a number of levels to three digits or to the last whole one."""
    places = 0 if levels >= 99.95 else 1 if levels >= 9.995 else 2
    return f"{levels:.{places}f}"


def sensitivity_text(found: Robustness, exposures: Sequence[float]) -> str:
    """Return the table of what is left, and what of it matters, in words."""
    n = len(exposures)
    off = found.exposure_errors if n > 1 else {}
    spreads = [
        *((f"exposures off by {percent(error)}", spread) for error, spread in off.items()),
        ("any phase of the quantiser", found.phase),
    ]
    rows = [("as given", count(found.effective_levels), "", number(found.xi, 5), "")]
    rows += [
        (
            name,
            count(spread.effective_levels),
            count(spread.effective_levels_worst),
            number(spread.xi, 5),
            "",
        )
        for name, spread in spreads
    ]
    rows += [
        (f"noise of {number(sigma)} levels", count(levels), "", "", count(equal))
        for (sigma, levels), equal in zip(
            found.noise.items(), found.noise_of_equal.values(), strict=True
        )
    ]
    heads = ["what is left", "effective", "worst", "missing (xi)", f"{n} equal exposures"]
    shown = len(heads) if n > 1 else len(heads) - 1
    parts = [columns(heads[:shown], [row[:shown] for row in rows], right=range(1, shown))]
    if said := warnings_of(found, exposures):
        parts.append("\n".join(said))
    return "\n\n".join(parts)


def warnings_of(found: Robustness, exposures: Sequence[float]) -> list[str]:
    """Return plain sentences on what does not survive; none where all does."""
    said = []
    lost = {
        error: 1 - spread.effective_levels / found.effective_levels
        for error, spread in sorted(found.exposure_errors.items())
        if spread.effective_levels < KEPT * found.effective_levels
    }
    if lost:
        near = [b / a - 1 for a, b in pairwise(sorted(exposures)) if 1 < b / a < INTERLEAVED]
        what = f"the {number(100 * min(near), 2)} % interleave" if near else "this set"
        does = "does not survive" if max(lost.values()) > 1 - SURVIVES else "suffers from"
        how = ", ".join(
            f"{number(100 * part, 2)} % at {percent(error)} off" for error, part in lost.items()
        )
        said.append(f"{what} {does} wrong exposures: effective levels lost are {how}")
    if len(set(exposures)) > 1:
        for sigma, levels in sorted(found.noise.items()):
            if levels <= GAINS_NOTHING * found.noise_of_equal[sigma]:
                said.append(
                    f"with noise of {number(sigma)} levels this gives no more than "
                    f"{len(exposures)} equal exposures"
                )
                break
    worst = found.phase.effective_levels_worst / found.effective_levels
    if worst < KEPT:
        said.append(
            "much depends on where the quantiser's steps lie: the worst phase loses "
            f"{number(100 * (1 - worst), 2)} % of the effective levels"
        )
    return said


def rows_text(entries: Sequence[TableEntry], found: Sequence[Robustness]) -> str:
    """Return the effective levels left of each row of a table under each disturbance."""
    errors, noises = found[0].exposure_errors, found[0].noise
    heads = (
        *("response", "range", "n", "effective"),
        *(f"off {percent(error)}" for error in errors),
        *(f"noise {number(sigma)}" for sigma in noises),
        "any phase",
    )
    blocks = []
    for camera in dict.fromkeys(entry.camera_name for entry in entries):
        rows = [
            (
                entry.response,
                range_name(entry.dynamic_range),
                str(entry.n),
                *(
                    count(levels)
                    for levels in (
                        each.effective_levels,
                        *(spread.effective_levels for spread in each.exposure_errors.values()),
                        *each.noise.values(),
                        each.phase.effective_levels,
                    )
                ),
            )
            for entry, each in zip(entries, found, strict=True)
            if entry.camera_name == camera
        ]
        table = columns(heads, rows, right=range(1, len(heads)))
        blocks.append(f"camera: {camera}\n\n{table}")
    legend = (
        "effective levels that are left, in the mean: exposures off by so much; noise of each "
        "frame,\nin brightness levels; and over all phases of the quantiser"
    )
    return "\n\n".join([*blocks, legend])


if TYPE_CHECKING:
    from camctl.exposure.effective import EffectiveCamera
    from camctl.response.desired import DesiredResponse


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
    from camctl.exposure.effective import EffectiveCamera
    from camctl.exposure.objective import Objective
    from camctl.exposure.objective import evaluate as evaluate_exposures

    real = real_response(bits, phase, curve, coefficients)
    for note in real.notes:
        warn(note)
    desired = options.desired(response, dynamic_range, exponent)
    dynamic_range = desired.dynamic_range  # a file brings its own
    noise_term = options.noise_term(noise, noise_weight, noise_kind)
    found = evaluate_exposures(
        real, ratios, desired, objective=Objective(levels_wanted, p, noise_term, jitter)
    )
    noisy = None
    if electrons is not None or read_noise is not None:
        camera = EffectiveCamera.of(real, ratios)
        noisy = _with_noise(camera, desired, electrons, read_noise or 0.0)
    left = None
    if found.levels <= QUICK_LEVELS if sensitivity is None else sensitivity:
        from camctl.exposure.robustness import sensitivity as judge

        left = judge(real, desired, ratios, levels_wanted=found.levels_wanted)
    if as_json:
        facts: dict[str, Any] = {
            **asdict(found),
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
    lost = found.levels - found.levels_distinct
    plain = p == 1 and noise is None and jitter == 0
    rows = [
        ("wanted", desired_name(desired.name, dynamic_range, len(ratios))),
        ("camera", real.name),
        ("exposures", "  ".join(number(ratio) for ratio in ratios)),
        objective_line(found.xi, found.levels_wanted, plain=plain),
        ("effective levels", number(found.effective_levels, 4)),
        (
            "levels",
            f"{found.levels_distinct} different"
            + (f", {lost} lost because levels coincide" if lost else ""),
        ),
        ("shutter open", f"{number(found.total_exposure)} x the shortest exposure"),
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
