"""Photographs whose colours are not those of the others: white balance, or the colour of the light.

The ratio of light between neighbours in brightness is that of their exposures, in each colour.
Where it is larger in one colour than in green, one of the two photographs has more of that colour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from camctl.evidence.patches import LightScale, Patches
from camctl.photographs.labels import STEADY, Run, steady_errors
from camctl.photographs.photograph import Photograph
from camctl.photographs.ratios import pair_ratio

#: Factor of one colour against green from which it is another white balance.
_NOTABLE = 1.05
#: Largest error of a ratio from rounding and black level, logarithm: darker colours do not count,
#: and with more than the first one only a difference that is larger than the error does.
_SURE, _MOST_UNSURE = 0.08, 0.2
#: Planes of the colours that are compared with green, and its plane.
_COLOURS, _GREEN = {"red": 0, "blue": 2}, 1
#: Photographs that must agree for each one that does not.
_AGREE = 2


def odd_colours(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scales: Sequence[LightScale]
) -> tuple[dict[int, str], list[str]]:
    """Return by position how the colours of photographs differ from those of most others.

    The second result has a note where they differ and the set does not show which are right.

    Args:
        photographs: in any order
        patches: of each of them, of red, green and blue
        scales: irradiance of each brightness of these
    """
    limit = math.log(_NOTABLE)
    found: dict[int, list[str]] = {}
    notes = []
    for colour, plane in _COLOURS.items():
        for run in _runs(patches, plane, scales):
            least = [max(STEADY * limit, each) for each in run.tolerances]
            errors = steady_errors(run.jumps, least)
            wrong = np.flatnonzero(np.abs(errors) > limit).tolist()
            remaining = np.abs(run.jumps - np.diff(errors))
            if not wrong or np.any(remaining > STEADY * limit):
                continue  # colours of a response that is not quite right differ everywhere
            if len(run.members) - len(wrong) >= _AGREE * len(wrong):
                for k in wrong:
                    found.setdefault(run.members[k], []).append(
                        f"{math.exp(float(errors[k])):.2f} times as much {colour}"
                    )
                continue
            first, last = (photographs[run.members[k]].name for k in (0, -1))
            notes.append(
                f"the white balance, or the colour of the light, changes between {first} and "
                f"{last}: {colour} against green by up to {math.exp(float(np.ptp(errors))):.2f} "
                "times, and the colours of the picture are not right"
            )
    how = "has another white balance than the others, or the light had another colour"
    return {k: f"{how} ({' and '.join(parts)})" for k, parts in found.items()}, notes


def _runs(patches: Sequence[Patches], plane: int, scales: Sequence[LightScale]) -> list[Run]:
    """Return by how much more the light of one colour grows than that of green."""
    order = sorted(range(len(patches)), key=lambda k: float(patches[k].mean()))
    runs = [Run(order[:1])]
    for dark, bright in pairwise(order):
        both = [np.array_split(patches[k], len(scales)) for k in (dark, bright)]
        of_colour, of_green = (
            pair_ratio(both[0][each], both[1][each], scales[each]) for each in (plane, _GREEN)
        )
        ratios = [each for each in (of_colour, of_green) if each is not None]
        error = sum(each.error for each in ratios)
        if len(ratios) < 2 or error > _MOST_UNSURE:
            runs.append(Run([bright]))
            continue
        jump = ratios[0].log - ratios[1].log
        runs[-1].members.append(bright)
        runs[-1].jumps.append(jump if error <= _SURE or abs(jump) > error else 0.0)
        runs[-1].tolerances.append(error)
    return runs
