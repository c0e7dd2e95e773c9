"""How `camctl evaluate` and `camctl table show` print the robustness of exposures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from camctl.cli.output import format_number, format_table
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.exposure.robustness import Robustness
    from camctl.exposure.table import TableEntry

NOTABLE_LOSS = 0.05
"""Fraction of the effective levels; a loss above it is reported in a sentence."""

STRONG_LOSS = 0.15
"""Fraction of the effective levels; a loss above it is called strong."""

EQUAL_FACTOR = 1.05
"""Up to this factor above equal exposures, effective levels count as no better than theirs."""

INTERLEAVED_RATIO = 1.02
"""Below this ratio, the levels of one exposure lie between neighbouring levels of the other."""


def sensitivity_json(found: Robustness) -> dict[str, Any]:
    """Return the robustness for JSON output; keys are the sizes of the disturbances."""
    return {
        "exposure_error": {f"{size:g}": spread for size, spread in found.exposure_errors.items()},
        "noise": {
            f"{sigma:g}": {
                "effective_levels": found.noise[sigma],
                "effective_levels_equal_exposures": found.noise_of_equal[sigma],
            }
            for sigma in found.noise
        },
        "phase": found.phase,
    }


def _percent(fraction: float) -> str:
    """Return 0.01 as 1 %."""
    return f"{100 * fraction:g} %"


def format_levels(levels: float) -> str:
    """Return a number of levels with three digits, or more where the whole part has more."""
    places = 0 if levels >= 99.95 else 1 if levels >= 9.995 else 2
    return f"{levels:.{places}f}"


def sensitivity_text(found: Robustness, exposures: Sequence[float]) -> str:
    """Return a table of effective levels under each disturbance, and sentences on the losses."""
    n = len(exposures)
    errors = found.exposure_errors if n > 1 else {}
    spreads = [
        *((f"exposure errors of {_percent(error)}", spread) for error, spread in errors.items()),
        ("all phases of the quantiser", found.phase),
    ]
    undisturbed = format_levels(found.effective_levels)
    rows = [("no disturbance", undisturbed, "", format_number(found.xi, 5), "")]
    rows += [
        (
            name,
            format_levels(spread.effective_levels),
            format_levels(spread.effective_levels_worst),
            format_number(spread.xi, 5),
            "",
        )
        for name, spread in spreads
    ]
    rows += [
        (f"noise of {format_number(sigma)} levels", format_levels(levels), "", "", equal)
        for (sigma, levels), equal in zip(
            found.noise.items(), map(format_levels, found.noise_of_equal.values()), strict=True
        )
    ]
    headings = [
        "disturbance",
        "effective levels",
        "worst case",
        "missing (xi)",
        f"{n} equal exposures",
    ]
    shown = len(headings) if n > 1 else len(headings) - 1
    table = format_table(
        headings[:shown], [row[:shown] for row in rows], right_aligned=range(1, shown)
    )
    sentences = describe_losses(found, exposures)
    return "\n\n".join([table, "\n".join(sentences)] if sentences else [table])


def describe_losses(found: Robustness, exposures: Sequence[float]) -> list[str]:
    """Return one sentence for each disturbance with a notable loss."""
    sentences = []
    losses = {
        error: 1 - spread.effective_levels / found.effective_levels
        for error, spread in sorted(found.exposure_errors.items())
        if spread.effective_levels < (1 - NOTABLE_LOSS) * found.effective_levels
    }
    if losses:
        ratios = [b / a for a, b in pairwise(sorted(exposures)) if 1 < b / a < INTERLEAVED_RATIO]
        near = (
            f"two exposures differ by only {format_number(100 * (min(ratios) - 1), 2)} %; "
            if ratios
            else ""
        )
        strongly = "strongly " if max(losses.values()) > STRONG_LOSS else ""
        sizes = ", ".join(
            f"by {format_number(100 * loss, 2)} % at errors of {_percent(error)}"
            for error, loss in losses.items()
        )
        sentences.append(f"{near}exposure errors {strongly}reduce the effective levels: {sizes}")
    if len(set(exposures)) > 1:
        for sigma, levels in sorted(found.noise.items()):
            if levels <= EQUAL_FACTOR * found.noise_of_equal[sigma]:
                sentences.append(
                    f"with noise of {format_number(sigma)} levels these exposures are no better "
                    f"than {len(exposures)} equal ones"
                )
                break
    worst = found.phase.effective_levels_worst / found.effective_levels
    if worst < 1 - NOTABLE_LOSS:
        sentences.append(
            "the result depends on the phase of the quantiser: the worst phase loses "
            f"{format_number(100 * (1 - worst), 2)} % of the effective levels"
        )
    return sentences


def sensitivity_table(entries: Sequence[TableEntry], found: Sequence[Robustness]) -> str:
    """Return the effective levels of each row of an exposure table under each disturbance."""
    errors, noises = found[0].exposure_errors, found[0].noise
    headings = (
        *("response", "range", "n", "effective levels"),
        *(f"error {_percent(error)}" for error in errors),
        *(f"noise {format_number(sigma)}" for sigma in noises),
        "all phases",
    )
    blocks = []
    for camera in dict.fromkeys(entry.camera_name for entry in entries):
        rows = [
            (
                entry.response,
                range_text(entry.dynamic_range),
                str(entry.n),
                *(
                    format_levels(levels)
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
        table = format_table(headings, rows, right_aligned=range(1, len(headings)))
        blocks.append(f"camera: {camera}\n\n{table}")
    legend = (
        "effective levels undisturbed, and on average with exposure errors of this relative size,\n"
        "with this noise in each frame (in brightness levels), and over all phases of the quantiser"
    )
    return "\n\n".join([*blocks, legend])
