"""Places at which one photograph contradicts all others of a series: movement, stains, damage.

Patches of each two photographs are compared by their normalised residual, with the noise that the
patches show and the errors of JPEG files.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.explanation import NEAR
from camctl.evidence.patch_errors import LEAST_PATCHES, PatchErrors, fitted_tables
from camctl.evidence.patches import Patches, patch_places
from camctl.evidence.ratio_check import MOST, SIGNIFICANCE
from camctl.findings import Finding, Place
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import JPEG_BLOCK_ERROR, RESPONSE_ERROR, SensorModel
from camctl.system.picture_operations import AREA, HEIGHT, LEFT, TOP, WIDTH, connected_parts

#: Connected patches that make a place: single ones contradict in 33 of 36 series of JPEG files at
#: rest, on contours, and places of four in 4.
_LEAST_PATCHES = 4

_Mask = NDArray[np.bool_]


def contradictions(
    exposures: Sequence[float],
    patches: Sequence[Patches],
    sensor: SensorModel,
    planes: Sequence[tuple[int, ...]],
) -> list[Finding]:
    """Return a finding for each photograph that contradicts the others in a place, largest first.

    Args:
        exposures: of the photographs, which fit their pixels
        patches: of each of them, see `sample_patches`
        sensor: light of each brightness
        planes: shape of each plane of a photograph; places are in their pixels
    """
    odd = _odd_ones(exposures, patches, sensor, len(planes))
    rows, columns, side = patch_places(planes)
    found = []
    for k, marks in enumerate(odd):
        grid = marks.reshape(len(planes), rows.size, columns.size).any(axis=0)
        _, boxes = connected_parts(grid)
        boxes = boxes[1:][boxes[1:, AREA] >= _LEAST_PATCHES]
        if not len(boxes) or grid.mean() > MOST:  # then it is not a place
            continue
        box = boxes[int(np.argmax(boxes[:, AREA]))].tolist()
        place = Place(
            top=int(rows[box[TOP]]),
            left=int(columns[box[LEFT]]),
            bottom=int(rows[box[TOP] + box[HEIGHT] - 1]) + side,
            right=int(columns[box[LEFT] + box[WIDTH] - 1]) + side,
        )
        finding = Finding(
            code="part_differs",
            frames=(k,),
            value=float(grid.mean()),
            place=place,
            details={"elsewhere": len(boxes) > 1},
        )
        found.append((box[AREA], finding))
    return [each for _, each in sorted(found, key=lambda pair: pair[0], reverse=True)]


def _odd_ones(
    exposures: Sequence[float], patches: Sequence[Patches], sensor: SensorModel, planes: int
) -> _Mask:
    """Return (photographs, patches): where one contradicts others that agree."""
    count, size = len(exposures), len(patches[0])
    order = sorted(range(count), key=exposures.__getitem__)
    near = [
        (short, long)
        for place, short in enumerate(order)
        for long in order[place + 1 : place + 1 + NEAR]
    ]
    limit = -NormalDist().inv_cdf(SIGNIFICANCE / 2 / max(len(near), 1) / size)
    # Of each photograph and patch: how many others it is brighter than, darker than, and like.
    counts = np.zeros((3, count, size), np.int64)
    for short, long in near:
        ratio = exposures[long] / exposures[short]
        residuals = _residuals(patches[short], patches[long], ratio, sensor, planes)
        for kind, marks in enumerate((residuals > limit, residuals < -limit)):
            counts[kind, short] += marks
            counts[1 - kind, long] += marks
        counts[2, [short, long]] += np.abs(residuals) <= limit
    against = counts[0] + counts[1]
    of_others = against.sum(axis=0) / 2 - against
    return np.asarray(
        (against > 1)  # one other does not show which of the two is wrong
        & (np.minimum(counts[0], counts[1]) == 0)
        & (against > MOST * counts.sum(axis=0))
        & (of_others < MOST * against)
    )


def _residuals(
    short: Patches, long: Patches, ratio: float, sensor: SensorModel, planes: int
) -> FloatArray:
    """Return the normalised residuals of the means of patches, (patches,).

    NaN of patches with samples that are saturated in either photograph, and of colours of which
    too few patches have none.
    """
    prediction = sensor.neighbour(ratio, None, None)
    saturated = (sensor.highest(None) + 1,) * 2
    found = []
    for before, after in zip(
        np.array_split(short, planes), np.array_split(long, planes), strict=True
    ):
        residuals = np.full(len(before), np.nan)
        part = PatchErrors.of(sensor, prediction, saturated, before, after, least=1.0)
        if part.size >= LEAST_PATCHES:
            at = np.rint(part.brightness).astype(np.intp)
            fit = fitted_tables(part, prediction)
            error = part.error - (fit.mean - prediction.mean)[at]
            block = JPEG_BLOCK_ERROR / 255 * sensor.white * sensor.step(part.light)
            variance = fit.own[at] / part.count + np.maximum(fit.shared[at], np.square(block))
            residuals[part.kept] = error / np.sqrt(
                variance + np.square(RESPONSE_ERROR * part.light)
            )
        found.append(residuals)
    return np.concatenate(found)
