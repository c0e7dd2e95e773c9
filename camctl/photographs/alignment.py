"""Whether photographs of one scene show it in the same place."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.alignment import displacement
from camctl.photographs.checks import Sight

#: A displacement counts from so many pixels of the photographs, and of their grey copies.
_DISPLACED, _DISPLACED_IN_COPY = 1.3, 0.15
#: Fine structure that is in the same place is displaced by less than this, pixels.
_FINE = 8.0
#: Share of the longer side by which photographs of one view are displaced at most.
_ALIGNABLE = 0.1

_Place = NDArray[np.float64]


def misaligned(
    sights: Sequence[Sight],
    alike: Collection[frozenset[int]] = (),
    other_views: Collection[int] = (),
) -> dict[int, str]:
    """Return by position how each photograph lies that does not lie where most of the others do.

    Args:
        sights: of the photographs
        alike: pairs of positions of photographs whose fine structure is in the same place, so that
            a large displacement is that of a thing that moved
        other_views: positions of photographs with other structure than most: a large displacement
            of them is a chance likeness, and not returned
    """
    order = sorted(range(len(sights)), key=lambda k: float(sights[k].grey.mean()))
    # Photographs that can be compared one after the other, each with its place on the first one.
    chains = [[(order[0], np.zeros(4))]] if order else []
    for one, other in pairwise(order):
        found = displacement(sights[one].grey, sights[other].grey)
        if found is not None and frozenset((one, other)) in alike:
            found = found * (_extent(found, sights[one]) < _FINE / sights[one].scale)
        if found is None:
            chains.append([(other, np.zeros(4))])
            continue
        place = chains[-1][-1][1]
        if found.any() and len(chains[-1]) > 1 and (chains[-1][-2][1] != place).any():
            # The one between is displaced: what errors of its place make is no displacement.
            direct = displacement(sights[chains[-1][-2][0]].grey, sights[other].grey)
            if direct is not None:
                found, place = direct, chains[-1][-2][1]
        chains[-1].append((other, place + found))
    return dict(line for chain in chains for line in _misplaced(sights, chain, other_views))


def _extent(place: _Place, sight: Sight) -> float:
    """Return by how much a displacement moves what it moves most, pixels of the grey copy."""
    columns, rows, turn, growth = place.tolist()
    half = max(sight.grey.shape) / 2
    return float(math.hypot(columns, rows) + math.hypot(turn, growth) * half)


def _misplaced(
    sights: Sequence[Sight], chain: Sequence[tuple[int, _Place]], other_views: Collection[int]
) -> list[tuple[int, str]]:
    """Return the position of each photograph that is not in the place of most, and how it lies."""
    first = sights[chain[0][0]]
    shape, scale = first.grey.shape, first.scale
    limit = max(_DISPLACED / scale, _DISPLACED_IN_COPY)

    def is_alike(one: _Place, other: _Place) -> bool:
        return _extent(other - one, first) < limit

    def alike(place: _Place) -> list[int]:
        return [k for k, other in chain if is_alike(place, other)]

    usual = max((place for _, place in chain), key=lambda place: len(alike(place)))
    others = alike(usual)
    found = []
    for k, place in chain:
        is_chance = k in other_views and _extent(place - usual, first) > _ALIGNABLE * max(shape)
        if k in others or is_chance:
            continue
        exposure = sights[k].photograph.exposure
        near = min(others, key=lambda o: abs(math.log(sights[o].photograph.exposure / exposure)))
        how = _described(place - usual, shape, scale, limit)
        how[0] = how[0].replace(" by ", f" against {sights[near].photograph.name} by ", 1)
        found.append((k, f"{sights[k].photograph.name} is {' and '.join(how)}"))
    return found


def _described(place: _Place, shape: tuple[int, ...], scale: float, limit: float) -> list[str]:
    """Return in words how a photograph is displaced."""
    columns, rows = (np.rint(place[:2] * scale) + 0.0).tolist()  # no -0
    turn, growth = place[2:]
    half = max(shape) / 2
    how = []
    if abs(turn) * half > limit / 2:
        sense = "clockwise" if turn > 0 else "anticlockwise"
        how.append(f"turned by about {abs(math.degrees(turn)):.1f} degrees {sense}")
    if abs(growth) * half > limit / 2:
        size = "enlarged" if growth > 0 else "reduced"
        how.append(f"{size} by about {100 * abs(growth):.1f} %")
    if not how or math.hypot(*place[:2]) >= limit:
        how.insert(0, f"shifted by about {columns:+.0f} columns and {rows:+.0f} rows")
    return how
