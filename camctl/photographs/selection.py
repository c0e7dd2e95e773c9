"""Which photographs are left out: copies, empty ones, other views, and other colours."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.evidence.views import Likeness, likenesses, unlike_each_other, unlike_others
from camctl.findings import Finding
from camctl.interface.controls import ExposureControls, Layout, ResponseOrigin
from camctl.model.sensor import SensorModel
from camctl.photographs.alignment import NEARLY, Chain, Sight, chains_of, misaligned
from camctl.photographs.camera import Photograph, at, detailed
from camctl.photographs.labels import SAME_EXPOSURE
from camctl.photographs.ratios import odd_colours


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


def distinct(sights: Sequence[Sight], notes: list[Finding]) -> list[int]:
    """Return the positions of photographs that are no copies, and show something.

    Args:
        sights: of all photographs
        notes: findings, to which this adds one for each of the others

    Raises:
        DataError: two copies state different exposures, or fewer than two photographs remain
    """
    first: dict[bytes, int] = {}
    kept = []
    empty = []
    why = []
    for k, sight in enumerate(sights):
        earlier = first.setdefault(sight.digest, k)
        if sight.is_even:
            empty.append(Finding(code="empty", frames=(k,)))
            why.append(f"{sight.photograph.name} is one colour everywhere")
        elif earlier == k:
            kept.append(k)
        else:
            _check_copy(sights[earlier].photograph, sight.photograph)
            notes.append(Finding(code="copy", frames=(k, earlier)))
            original = sights[earlier].photograph
            why.append(f"{sight.photograph.name} is the same photograph as {original.name}")
    notes += empty
    if len(kept) < 2:
        more = "" if len(why) <= 3 else f", and {len(why) - 3} others are such"
        raise DataError(
            f"{len(kept)} of {len(sights)} photographs can be merged: {', '.join(why[:3])}{more}",
            hint="give two or more exposures of one scene",
        )
    return kept


def _check_copy(one: Photograph, other: Photograph) -> None:
    if not 1 / SAME_EXPOSURE < one.exposure / other.exposure < SAME_EXPOSURE:
        raise DataError(
            f"{one.name} and {other.name} are the same photograph, but their exposures differ",
            hint="leave one of them out, or correct its exposure time",
            remedies={"times": None},
        )


@dataclass(frozen=True, eq=False)
class Views:
    """What photographs show of each other.

    Attributes:
        likenesses: of pairs of them
        unlike: findings, by place, of those that show something else
        chains: the places of those that can be compared
        displaced: findings, by place, of those that do not lie where most do
    """

    likenesses: dict[tuple[int, int], Likeness]
    unlike: dict[int, Finding]
    chains: list[Chain]
    displaced: dict[int, Finding]

    @classmethod
    def of(cls, selection: Selection, sights: Sequence[Sight]) -> Views:
        """Compare photographs, of which these are the sights."""
        series = selection.series
        found = likenesses(series.patches, len(series.colours()), series.black, series.white)
        unlike = unlike_others(found, len(sights))
        chains = chains_of(
            sights, {frozenset(pair) for pair, each in found.items() if each.is_same}
        )
        return cls(found, unlike, chains, misaligned(sights, chains, unlike))


def of_one_view(
    selection: Selection, views: Views, notes: list[Finding], moved: Collection[int] = ()
) -> tuple[Selection, dict[int, Finding]]:
    """Return the photographs that show what most do in the same place, equally sharp.

    Args:
        selection: the photographs
        views: of them
        notes: findings, to which this adds one for each of the others
        moved: positions of those that were moved: they are kept where they nearly lie as the others

    Returns:
        those photographs, and by place among them how they lie if most do not lie alike
    """
    count, found, unlike = len(selection.photographs), views.likenesses, views.unlike
    displaced = views.displaced
    if not displaced and (pair := unlike_each_other(found, count)) is not None:
        finding = Finding(code="other_view", frames=pair, value=found[pair].resting)
        notes.append(at(finding, selection.positions))
    nearly = {
        k: at(each, selection.positions)
        for k, each in displaced.items()
        if selection.positions[k] in moved and (each.value or 0.0) < NEARLY and k not in unlike
    }
    displaced = {k: each for k, each in displaced.items() if k not in nearly}
    odd = unlike | displaced
    if len(odd) >= count / 2:
        others = {k: at(each, selection.positions) for k, each in displaced.items()}
        return selection, nearly | others
    notes += [detailed(at(each, selection.positions), left_out=True) for each in odd.values()]
    kept = [k for k in range(count) if k not in odd]
    return selection.without(odd), {kept.index(k): each for k, each in nearly.items()}


def of_one_colour(
    selection: Selection, controls: ExposureControls, notes: list[Finding]
) -> Selection:
    """Return the photographs that agree with most in their colours.

    Args:
        selection: the photographs
        controls: with the response
        notes: findings, to which this adds one for each of the others
    """
    if controls.layout is not Layout.RGB:
        return selection
    planes = controls.plane_levels
    models = {each: SensorModel(each, controls.black) for each in set(planes)}
    scales = [models[each] for each in planes]
    patches = [each.clip(max=controls.white) for each in selection.series.patches]
    is_stated = controls.response_origin is ResponseOrigin.STATED
    odd, found = odd_colours(patches, scales, are_exact=is_stated and controls.bits > 8)
    notes += [at(each, selection.positions) for each in found]
    return selection.without(odd) if odd else selection
