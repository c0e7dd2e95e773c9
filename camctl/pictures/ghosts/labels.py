"""From which frame each cell of a region is where things moved: the labels of least error.

The labels minimise the mean square error of ln light: the error in a frame, and along a seam the
square of what the frames of both sides show differently: a thing that only one of them shows is cut
there, so that one cell is wrong.  First the best frame of a whole region is found, then connected
cells change to another frame as long as the error becomes less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camctl.system.picture_operations import HEIGHT, LEFT, TOP, WIDTH, connected_parts

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LabelField:
    """What labels of the cells in a box cost.

    Attributes:
        inside: (rows, columns), cells that have a label; others are from all frames
        error: (rows, columns, frames) mean square error of ln light in a frame
        features: (rows, columns, frames + 1, F) mean ln light of parts of a cell, of all frames
            together last
    """

    inside: Mask
    error: NDArray[np.float32]
    features: NDArray[np.float32]

    def part(self, rows: slice, columns: slice) -> LabelField:
        """Return a part of the box."""
        box = rows, columns
        return replace(
            self, inside=self.inside[box], error=self.error[box], features=self.features[box]
        )

    def cost(self, labels: NDArray[np.int16]) -> float:
        """Return the sum of the errors of all cells and seams."""
        rows, columns = np.nonzero(self.inside)
        total = float(self.error[rows, columns, labels[rows, columns]].sum())
        for before, after in (
            ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
            ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ):
            seams = np.nonzero(labels[before] != labels[after])
            if not seams[0].size:
                continue
            one, other = labels[before][seams], labels[after][seams]
            for side in (self.features[before], self.features[after]):
                step = side[(*seams, one)] - side[(*seams, other)]
                total += float(np.square(step).mean(axis=1).sum()) / 2
        return total


def least_error_labels(field: LabelField) -> NDArray[np.int16]:
    """Return the labels of least cost that are found; those outside of the region are -1."""
    count = field.error.shape[2]

    def whole(frame: int) -> NDArray[np.int16]:
        return np.where(field.inside, frame, -1).astype(np.int16)

    labels = min(map(whole, range(count)), key=field.cost)
    changes = True
    while changes:
        changes = False
        for frame in range(count):
            present = np.take_along_axis(
                field.error, np.maximum(labels, 0)[..., np.newaxis].astype(np.intp), 2
            )[..., 0]
            better = field.inside & (labels != frame) & (field.error[..., frame] < present)
            changes |= _switched(field, labels, better, frame)
    return labels


def _switched(field: LabelField, labels: NDArray[np.int16], cells: Mask, frame: int) -> bool:
    """Let connected cells be from a frame where that costs less; return whether any are."""
    if not cells.any():
        return False
    numbers, boxes = connected_parts(cells)
    changes = False
    for number, box in enumerate(boxes.tolist()[1:], 1):
        near = (
            slice(max(0, box[TOP] - 1), box[TOP] + box[HEIGHT] + 1),
            slice(max(0, box[LEFT] - 1), box[LEFT] + box[WIDTH] + 1),
        )
        part, old = field.part(*near), labels[near]
        new = np.where(numbers[near] == number, np.int16(frame), old)
        if part.cost(new) < part.cost(old):
            labels[near] = new
            changes = True
    return changes
