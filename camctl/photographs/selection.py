"""Which photographs are left out: copies, empty ones, other views, and other colours."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from camctl.calibration.response_series import Series
from camctl.errors import UsageError
from camctl.evidence.patches import LightScale
from camctl.interface.controls import ExposureControls, Layout
from camctl.photographs.alignment import misaligned
from camctl.photographs.checks import Sight, duplicates
from camctl.photographs.colours import odd_colours
from camctl.photographs.photograph import Photograph
from camctl.photographs.views import likenesses, unlike_each_other, unlike_others


@dataclass(frozen=True, eq=False)
class Selection:
    """Photographs that are used, of those given.

    Attributes:
        positions: among those given
        photographs: with the exposures that they state
        series: histograms and patches of them
    """

    positions: list[int]
    photographs: list[Photograph]
    series: Series

    def without(self, left_out: Collection[int]) -> Selection:
        """Return the others than those at these places of the selection."""
        kept = [k for k in range(len(self.photographs)) if k not in left_out]
        return Selection(
            [self.positions[k] for k in kept],
            [self.photographs[k] for k in kept],
            self.series.part(kept),
        )


def distinct(sights: Sequence[Sight], notes: list[str]) -> list[int]:
    """Return the positions of photographs that are no copies, and show something.

    Args:
        sights: of all photographs
        notes: what the user should know, to which this adds a line for each of the others

    Raises:
        DataError: two copies state different exposures
        UsageError: fewer than two photographs remain
    """
    same = duplicates(sights)
    names = [each.photograph.name for each in sights]
    notes += [
        f"{names[k]} is the same photograph as {names[earlier]}, and left out"
        for k, earlier in same.items()
    ]
    empty = [k for k, each in enumerate(sights) if each.is_even]
    notes += [f"{names[k]} is one colour everywhere, and left out" for k in empty]
    kept = [k for k in range(len(sights)) if k not in same and k not in empty]
    if len(kept) < 2:
        raise UsageError("one photograph makes no merge", hint="give two or more exposures")
    return kept


def of_one_view(
    selection: Selection, sights: Sequence[Sight], notes: list[str]
) -> tuple[Selection, dict[int, str]]:
    """Return the photographs that show what most do in the same place, equally sharp.

    Args:
        selection: the photographs
        sights: of them
        notes: what the user should know, to which this adds a line for each of the others

    Returns:
        those photographs, and by place among them how they lie where no place is that of most
    """
    series, count = selection.series, len(sights)
    found = likenesses(series.patches, len(series.colours()), series.black, series.white)
    unlike = unlike_others(found, count)
    alike = {frozenset(pair) for pair, each in found.items() if each.is_same}
    displaced = misaligned(sights, alike, unlike)
    names = [each.name for each in selection.photographs]
    if not displaced and (pair := unlike_each_other(found, count)) is not None:
        notes.append(
            f"{names[pair[0]]} and {names[pair[1]]} do not show the same view or scene, and the "
            "photographs do not show which is right"
        )
    odd = unlike | displaced
    if len(odd) >= count / 2:
        return selection, displaced
    for k, how in odd.items():
        advice = ": align it with the others to use it" if k in displaced else ""
        line = how if k in displaced else f"{names[k]} {how}"
        notes.append(f"{line}, and is left out{advice}")
    return selection.without(odd), {}


def of_one_colour(selection: Selection, controls: ExposureControls, notes: list[str]) -> Selection:
    """Return the photographs whose colours are those of most.

    Args:
        selection: the photographs
        controls: with the response
        notes: what the user should know, to which this adds a line for each of the others
    """
    if controls.layout is not Layout.RGB:
        return selection
    scales = [LightScale(each, controls.black) for each in controls.plane_levels]
    patches = [each.clip(max=controls.white) for each in selection.series.patches]
    odd, unsure = odd_colours(selection.photographs, patches, scales)
    names = [each.name for each in selection.photographs]
    notes += [f"{names[k]} {how}, and is left out" for k, how in odd.items()] + unsure
    return selection.without(odd) if odd else selection
