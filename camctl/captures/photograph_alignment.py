"""Whether photographs of one scene show it in the same place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.captures.photograph_checks import Sight

#: Tiles on each side of a picture, of which each has a shift of its own.
_TILES = 3
#: A shift counts from so many pixels of the grey copy, where its correlation is at least this much
#: and above that without a shift by this share.
_SHIFTED, _SURE, _BETTER = 1.0, 0.25, 1.15
#: Tiles with a sure result that are needed, and the share of them that must be shifted.
_LEAST_TILES, _SHIFTED_SHARE = 2, 0.4
#: Share of a tile, and of a whole photograph, that is neither dark nor saturated, and pixels of a
#: tile of the latter.
_LEAST_USABLE, _LEAST_SEEN, _LEAST_PIXELS = 0.3, 0.02, 500
#: Where noise hides the detail: standard deviations of the correlation of noise.
_CHANCE_SIGMAS = 4.0
#: No shift, as columns and rows.
_ALIGNED = (0.0, 0.0)
#: Brightness that is compared, as shares of full scale.
_DARKEST, _BRIGHTEST = 0.04, 0.96

_Shift = NDArray[np.float64]


def misaligned(sights: Sequence[Sight]) -> list[str]:
    """Return a line for each photograph that is shifted or turned against its neighbour."""
    order = sorted(range(len(sights)), key=lambda k: sights[k].photograph.exposure)
    shifts = [_shift(sights[one].grey, sights[other].grey) for one, other in pairwise(order)]
    # Photographs that can be compared one after the other, each with its place on the first one.
    chains = [[(order[0], np.zeros(2))]] if order else []
    for later, shift in zip(order[1:], shifts, strict=True):
        if shift is None:
            chains.append([(later, np.zeros(2))])
        else:
            chains[-1].append((later, chains[-1][-1][1] + shift))
    return [line for chain in chains for line in _misplaced(sights, chain)]


def _misplaced(sights: Sequence[Sight], chain: Sequence[tuple[int, _Shift]]) -> list[str]:
    """Return a line for each photograph that is not in the place of most."""

    def alike(place: _Shift) -> list[int]:
        return [k for k, other in chain if np.hypot(*(other - place)) < _SHIFTED]

    usual = max((place for _, place in chain), key=lambda place: len(alike(place)))
    others = alike(usual)
    found = []
    for k, place in chain:
        if k in others:
            continue
        exposure = sights[k].photograph.exposure
        near = min(others, key=lambda o: abs(math.log(sights[o].photograph.exposure / exposure)))
        columns, rows = (place - usual) * sights[k].scale
        found.append(
            f"{sights[k].photograph.name} is shifted against {sights[near].photograph.name} by "
            f"about {columns:+.0f} columns and {rows:+.0f} rows, and the picture will be blurred: "
            "align the photographs first"
        )
    return found


def _shift(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[float, float] | None:
    """Return by how much `after` is shifted, (columns, rows); None: nothing can be said."""
    shifts, sure = [], 0
    for rows, columns in _tiles(before.shape):
        result = _tile_shift(before[rows, columns], after[rows, columns])
        if result is None:
            continue
        sure += 1
        if np.hypot(*result) >= _SHIFTED:
            shifts.append(result)
    if sure < _LEAST_TILES:
        return _noisy_shift(before, after)
    if len(shifts) < max(_LEAST_TILES, _SHIFTED_SHARE * sure):
        return _ALIGNED
    # A tile may have contours of one direction only; a picture that is turned has no common shift.
    whole = _tile_shift(before, after)
    if whole is not None and np.hypot(*whole) >= _SHIFTED:
        return whole
    columns, rows = np.median(shifts, axis=0).tolist()
    return columns, rows


def _noisy_shift(
    before: NDArray[np.float32], after: NDArray[np.float32]
) -> tuple[float, float] | None:
    """Return the shift of photographs so dark that noise is most of what their tiles show.

    Noise is not correlated: the shift is that of the whole picture, and counts where tiles agree
    with it by more than chance.
    """
    found = _phase_shift(before, after, _LEAST_SEEN)
    if found is None:
        return None
    one, other, (columns, rows) = found
    moves, rests = 0, 0
    for tile in _tiles(before.shape):
        parts = one[tile], other[tile]
        if (size := np.count_nonzero(parts[0])) < _LEAST_PIXELS:
            continue
        still = _correlation(*parts, 0, 0)
        moved = _correlation(*parts, round(columns), round(rows))
        chance = _CHANCE_SIGMAS / math.sqrt(size)
        moves += moved > max(still, 0.0) + chance
        rests += still > max(moved, 0.0) + chance
    if np.hypot(columns, rows) >= _SHIFTED and moves >= _LEAST_TILES + rests:
        return columns, rows
    return _ALIGNED if rests >= _LEAST_TILES + moves else None


def _tiles(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    edges = [np.linspace(0, length, _TILES + 1).astype(int).tolist() for length in shape]
    return [
        (slice(top, bottom), slice(left, right))
        for top, bottom in pairwise(edges[0])
        for left, right in pairwise(edges[1])
    ]


def _tile_shift(
    before: NDArray[np.float32], after: NDArray[np.float32]
) -> tuple[float, float] | None:
    """Return the shift of one tile, (columns, rows); None where it shows too little.

    Both are turned into ranks of brightness, which do not depend on the exposure, of what neither
    saturates; the shift is the one of the best phase correlation, and it counts where the tiles
    then agree clearly better.
    """
    found = _phase_shift(before, after, _LEAST_USABLE)
    if found is None:
        return None
    one, other, (columns, rows) = found
    limit = min(before.shape) / 4
    still = _correlation(one, other, 0, 0)
    if max(abs(columns), abs(rows)) > limit:
        return (0.0, 0.0) if still > _SURE else None
    moved = _correlation(one, other, round(columns), round(rows))
    if max(moved, still) < _SURE:
        return None
    return (columns, rows) if moved > _BETTER * max(still, 0.0) else (0.0, 0.0)


def _phase_shift(
    before: NDArray[np.float32], after: NDArray[np.float32], least: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], tuple[float, float]] | None:
    """Return the fine structure of both, and the shift at which it fits best.

    None: less than the share `least` is neither dark nor saturated.
    """
    import cv2

    if min(before.shape) < 24:
        return None
    usable = (np.minimum(before, after) > _DARKEST) & (np.maximum(before, after) < _BRIGHTEST)
    if np.mean(usable) < least:
        return None
    one, other = (_detail(each, usable) for each in (before, after))
    window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    (columns, rows), _ = cv2.phaseCorrelate(one, other, window)
    return one, other, (columns, rows)


def _detail(grey: NDArray[np.float32], usable: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the fine structure of a tile in ranks of brightness; 0 where it is not usable."""
    import cv2

    values = np.sort(grey[usable])
    ranks = np.searchsorted(values, grey).astype(np.float32) / values.size
    fine = ranks - cv2.GaussianBlur(ranks, (0, 0), 4)
    eroded = cv2.erode(usable.astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(np.where(eroded > 0, fine, 0), np.float32)


def _correlation(
    one: NDArray[np.float32], other: NDArray[np.float32], columns: int, rows: int
) -> float:
    """Return the correlation of one tile with the other shifted back."""
    height, width = one.shape
    ours = one[max(0, -rows) : height - max(0, rows), max(0, -columns) : width - max(0, columns)]
    theirs = other[max(0, rows) : height + min(0, rows), max(0, columns) : width + min(0, columns)]
    norm = float(np.sqrt(np.sum(ours**2) * np.sum(theirs**2)))
    return float(np.sum(ours * theirs)) / norm if norm else 0.0
