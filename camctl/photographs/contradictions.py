"""Places at which one photograph contradicts all others of a series: movement, stains, damage."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches, patch_places
from camctl.findings import Finding, Place
from camctl.model.sensor import SensorModel
from camctl.photographs.camera import Photograph, detailed
from camctl.system.picture_operations import AREA, HEIGHT, LEFT, TOP, WIDTH, connected_parts

#: Errors of a patch's mean brightness, as shares of full scale and of the brightness.
_ERROR, _RELATIVE_ERROR = 0.008, 0.04
#: A prediction is known where its error is at most this share of full scale.
_KNOWN = 0.03
#: Bins of brightness, in each of which the median difference comes from the response.
_BINS = 16
#: Share of the comparisons in which the others must contradict it and agree with each other.
_MAJORITY = 0.7
#: Other photographs that must be contradicted, and connected patches that make a place.
_LEAST_OTHERS, _LEAST_PATCHES = 2, 4
#: Largest share of the patches: where more differ, it is not a place.
_MOST = 0.25

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]


def contradictions(
    photographs: Sequence[Photograph],
    patches: Sequence[Patches],
    scale: SensorModel,
    planes: Sequence[tuple[int, ...]],
) -> list[Finding]:
    """Return a finding for each photograph that contradicts the others in a place, largest first.

    Args:
        photographs: with the exposures that fit their pixels
        patches: of each of them, see `sample_patches`
        scale: irradiance of each brightness
        planes: shape of each plane of a photograph; places are in their pixels
    """
    odd = _odd_ones(photographs, patches, scale, len(planes))
    rows, columns, side = patch_places(planes[0], len(planes))
    found = []
    for k, marks in enumerate(odd):
        grid = marks.reshape(len(planes), rows.size, columns.size).any(axis=0)
        _, boxes = connected_parts(grid)
        boxes = boxes[1:][boxes[1:, AREA] >= _LEAST_PATCHES]
        if not len(boxes) or grid.mean() > _MOST:
            continue
        box = boxes[int(np.argmax(boxes[:, AREA]))].tolist()
        place = Place(
            top=int(rows[box[TOP]]),
            left=int(columns[box[LEFT]]),
            bottom=int(rows[box[TOP] + box[HEIGHT] - 1]) + side,
            right=int(columns[box[LEFT] + box[WIDTH] - 1]) + side,
        )
        finding = Finding(code="part_differs", frames=(k,), value=float(grid.mean()), place=place)
        found.append((box[AREA], detailed(finding, elsewhere=len(boxes) > 1)))
    return [each for _, each in sorted(found, key=lambda pair: pair[0], reverse=True)]


def _odd_ones(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: SensorModel, planes: int
) -> _Mask:
    """Return (photographs, patches): where one contradicts others that agree."""
    count, size = len(photographs), len(patches[0])
    means = [each.mean(axis=1) for each in patches]
    usable = [each.max(axis=1) <= scale.highest(None) for each in patches]
    # Of each photograph and patch: how many others it is brighter than, darker than, and like.
    counts = np.zeros((3, count, size), np.int64)
    for one, other in permutations(range(count), 2):
        factor = photographs[one].exposure / photographs[other].exposure
        both = usable[one] & usable[other]
        results = _compared(means[one], means[other], both, factor, scale, planes)
        for kind, result in enumerate(results):
            counts[kind, one] += result
            if kind < 2:  # the other is darker than the one, or brighter
                counts[1 - kind, other] += result
            else:
                counts[2, other] += result
    brighter, darker, _ = counts
    against = brighter + darker
    of_others = against.sum(axis=0) / 2 - against
    return np.asarray(
        (np.maximum(brighter, darker) >= 2 * _LEAST_OTHERS)
        & (np.minimum(brighter, darker) == 0)
        & (against >= _MAJORITY * counts.sum(axis=0))
        & (of_others <= (1 - _MAJORITY) * against)
    )


def _compared(
    seen: _Floats, other: _Floats, usable: _Mask, factor: float, scale: SensorModel, planes: int
) -> tuple[_Mask, _Mask, _Mask]:
    """Return where `seen` is brighter than `other` predicts, darker, and as it predicts.

    Patches that are not usable, as those with saturated samples, are none of these, and do not
    count for the median difference.
    """
    codes = np.arange(scale.light.size, dtype=np.float64)
    error = _ERROR * scale.white + _RELATIVE_ERROR * np.maximum(other - scale.black, 0)

    def predicted(brightness: _Floats) -> _Floats:
        light = np.interp(brightness, codes, scale.light) * factor
        return np.interp(light, scale.light, codes)

    middle, low, high = predicted(other), predicted(other - error), predicted(other + error)
    # Each plane has a response of its own.
    plane = np.arange(seen.size) // (seen.size // planes)
    bins = np.minimum(middle / scale.white * _BINS, _BINS - 1).astype(int) + _BINS * plane
    known = (high - low < _KNOWN * 2 * scale.white) & (middle <= scale.highest(None)) & usable
    difference = seen - middle
    for k in np.unique(bins[known]):
        members = bins == k
        difference[members] -= np.median(difference[members & known])
    margin = _ERROR * scale.white + _RELATIVE_ERROR * np.maximum(middle - scale.black, 0)
    brighter = known & (difference > high - middle + margin)
    darker = known & (difference < low - middle - margin)
    return brighter, darker, known & ~brighter & ~darker
