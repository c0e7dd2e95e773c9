"""Whether photographs of one scene show it in the same place."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.alignment import displacement
from camctl.findings import Detail, Finding
from camctl.interface.camera import Pixels
from camctl.photographs.camera import Photograph
from camctl.system.picture_operations import reduced_in_steps, required_opencv

#: Longest side of the grey copies in which alignment is measured, pixels.
_SIDE = 768
#: Every so manyth row tells two photographs apart: noise differs in each, and a block of JPEG has
#: eight.
_EVERY = 8
#: A displacement counts from so many pixels of the photographs, and of their grey copies.
_DISPLACED, _DISPLACED_IN_COPY = 1.3, 0.15
#: Fine structure that is in the same place is displaced by less than this, pixels.
NEARLY = 8.0
#: Share of the longer side by which photographs of one view are displaced at most.
ALIGNABLE = 0.1

_Place = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sight:
    """What is kept of one photograph for the checks.

    Attributes:
        photograph: its name and exposure
        digest: SHA-256 of every `_EVERY`-th row of its pixels, and of the grey copy of all of them
        grey: grey copy, float32, up to `_SIDE` pixels a side, 0 to 1
        scale: pixels of the photograph in one of the copy
        is_even: all samples are equal, as where everything is saturated
    """

    photograph: Photograph
    digest: bytes
    grey: NDArray[np.float32]
    scale: float
    is_even: bool = False

    @classmethod
    def of(cls, photograph: Photograph, pixels: Pixels, white: int) -> Sight:
        """Return the sight of a photograph's pixels; raises `UsageError` without OpenCV."""
        required_opencv("merging photographs")
        copy, scale = grey_copy(pixels, white, _SIDE)
        digest = hashlib.sha256(np.ascontiguousarray(pixels[::_EVERY]).data)
        digest.update(np.ascontiguousarray(copy).data)
        is_even = bool(copy.min() == copy.max() and (pixels == pixels.flat[0]).all())
        return cls(photograph, digest.digest(), copy, scale, is_even)


def grey_copy(pixels: Pixels, white: int, side: int) -> tuple[NDArray[np.float32], float]:
    """Return a grey copy of at most so many pixels a side, 0 to 1, and how many become one."""
    grey = pixels[..., 1] if pixels.ndim == 3 else pixels
    scale = max(1.0, max(grey.shape) / side)
    size = (max(1, round(grey.shape[1] / scale)), max(1, round(grey.shape[0] / scale)))
    small = reduced_in_steps(grey, size)
    return np.float32(1 / white) * np.asarray(small, np.float32), scale


Chain = list[tuple[int, _Place]]
"""Positions of photographs that can be compared one after the other, in ascending brightness, each
with its place on the first one: as `displacement` returns it."""


def misaligned(
    sights: Sequence[Sight], chains: Sequence[Chain], other_views: Collection[int] = ()
) -> dict[int, Finding]:
    """Return by position how each photograph lies that does not lie where most of the others do.

    Args:
        sights: of the photographs
        chains: of them, see `chains_of`
        other_views: positions of photographs with other structure than most: a large displacement
            of them is a chance likeness, and not returned
    """
    return dict(line for chain in chains for line in _misplaced(sights, chain, other_views))


def chains_of(sights: Sequence[Sight], alike: Collection[frozenset[int]] = ()) -> list[Chain]:
    """Return the places of photographs.

    Args:
        sights: of them
        alike: pairs of positions of photographs whose fine structure is in the same place, so that
            a large displacement comes from a thing that moved
    """
    order = sorted(range(len(sights)), key=lambda k: float(sights[k].grey.mean()))
    chains: list[Chain] = [[(order[0], np.zeros(4))]] if order else []
    for one, other in pairwise(order):
        found = displacement(sights[one].grey, sights[other].grey)
        if found is not None and frozenset((one, other)) in alike:
            found = found * (_extent(found, sights[one]) < NEARLY / sights[one].scale)
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
    return chains


def usual_place(sights: Sequence[Sight], chain: Chain) -> tuple[_Place, list[int]]:
    """Return the place of most photographs of a chain, and the positions of those."""
    first = sights[chain[0][0]]
    limit = _limit(first)

    def alike(place: _Place) -> list[int]:
        return [k for k, other in chain if _extent(other - place, first) < limit]

    usual = max((place for _, place in chain), key=lambda place: len(alike(place)))
    return usual, alike(usual)


def _limit(sight: Sight) -> float:
    """Return from where on a displacement counts, pixels of the grey copy."""
    return max(_DISPLACED / sight.scale, _DISPLACED_IN_COPY)


def _extent(place: _Place, sight: Sight) -> float:
    """Return by how much a displacement moves what it moves most, pixels of the grey copy."""
    columns, rows, turn, growth = place.tolist()
    half = max(sight.grey.shape) / 2
    return float(math.hypot(columns, rows) + math.hypot(turn, growth) * half)


def _misplaced(
    sights: Sequence[Sight], chain: Chain, other_views: Collection[int]
) -> list[tuple[int, Finding]]:
    """Return the position of each photograph that is not in the place of most, and how it lies."""
    first = sights[chain[0][0]]
    limit = _limit(first)
    usual, others = usual_place(sights, chain)
    found = []
    for k, place in chain:
        extent = _extent(place - usual, first)
        is_chance = k in other_views and extent > ALIGNABLE * max(first.grey.shape)
        if k in others or is_chance:
            continue
        exposure = sights[k].photograph.exposure
        near = min(others, key=lambda o: abs(math.log(sights[o].photograph.exposure / exposure)))
        other: dict[str, Detail] = {"other": sights[near].photograph.name}
        details, value = other | _described(place - usual, first, limit), extent * first.scale
        finding = Finding(
            code="shifted", frames=(k,), value=value, details=details, remedies={"align": "full"}
        )
        found.append((k, finding))
    return found


def _described(place: _Place, first: Sight, limit: float) -> dict[str, Detail]:
    """Return turn, clockwise, enlargement and shift of a photograph, those that are notable."""
    columns, rows = (np.rint(place[:2] * first.scale) + 0.0).tolist()  # no -0
    turn, growth = place[2:].tolist()
    half = max(first.grey.shape) / 2
    how: dict[str, Detail] = {}
    if abs(turn) * half > limit / 2:
        how["degrees"] = math.degrees(turn)
    if abs(growth) * half > limit / 2:
        how["percent"] = 100 * growth
    if not how or math.hypot(*place[:2]) >= limit:
        how |= {"columns": columns, "rows": rows}
    return how
