"""What is left of a set of exposures when exposures are off, frames are noisy, or levels shift."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from camctl.cli.output import number, range_name
from camctl.cli.output import table as columns

if TYPE_CHECKING:
    from camctl.exposure.rows import TableEntry
    from camctl.exposure.sensitivity import Sensitivity, Spread

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


def sensitivity_facts(found: Sensitivity) -> dict[str, Any]:
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


def sensitivity_text(found: Sensitivity, exposures: Sequence[float]) -> str:
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


def warnings_of(found: Sensitivity, exposures: Sequence[float]) -> list[str]:
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


def rows_text(entries: Sequence[TableEntry], found: Sequence[Sensitivity]) -> str:
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
