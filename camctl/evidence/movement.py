"""Where the frames of a capture contradict each other: things that moved, or light that changed.

Frames neighbouring in exposure are compared, see `camctl.evidence.marks`.  Change of the whole
picture, as by lamps that flicker, is taken out first: it is the ratio of most patches.  A place is
reported where the mean of 5 x 5 samples contradicts so much that noise would report one in
`SIGNIFICANCE` of the captures in which nothing moves.

Light that spreads from saturated pixels (blooming) is not movement, see `camctl.evidence.spill`,
but the picture is wrong there: it is marked, and counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.marks import FALSE_ALARMS, STRIP_SAMPLES, Marks, Mask, Packed
from camctl.evidence.ratio_check import MOST
from camctl.evidence.residual import FrameRows, Pair
from camctl.evidence.spill import only_beside_white
from camctl.findings import Finding, Place
from camctl.system.picture_operations import connected_parts, dilated

#: Places that are named at most, the largest first.
_MOST_PLACES = 5
#: Where fewer samples than this share can be compared it is not known what moved.
_LEAST_COMPARED = 1e-3


@dataclass(frozen=True)
class FoundMovement:
    """How much of a picture contradicts: movement, changed light, light that blooming spilled.

    Attributes:
        share: of the samples that contradict, without those of `spread`
        false_alarms: share that does by noise, at most
        places: the largest places where it is no noise, those with most marks first
        area: share of the picture's blocks of `block` x `block` pixels in which it is no noise;
            larger than `share`, since not each sample of a block contradicts
        block: side of a block of the map, pixels
        spread: share of the samples that contradict because light spread to them from saturated
            ones of a longer exposure: the picture is too bright there.  All have marks, too.  A
            bright thing that moved beside such samples looks the same
        compared: share of the samples that are in range in two frames, of the pair with most
    """

    share: float
    false_alarms: float
    places: tuple[Place, ...]
    area: float = 0.0
    block: int = 0
    spread: float = 0.0
    compared: float = 1.0

    @property
    def is_seen(self) -> bool:
        """Whether enough samples could be compared to say that nothing moved."""
        return self.compared >= _LEAST_COMPARED

    @property
    def is_local(self) -> bool:
        """Whether things moved in a part of the picture, and most of it is at rest."""
        return bool(self.places) and self.area < MOST

    @property
    def findings(self) -> list[Finding]:
        """One finding where it is no noise, else none."""
        if not self.places:
            return []
        low = max(self.share - self.false_alarms, 0.0)
        return [
            Finding(
                code="moved",
                value=self.share,
                low=low,
                high=self.share,
                place=self.places[0],
                details={"area": self.area},
            )
        ]


@dataclass(frozen=True, eq=False)
class Movement:
    """Where frames contradict each other.

    Attributes:
        shape: of a frame, (rows, columns) or (rows, columns, 3)
        marks: which samples contradict, packed along each row: moved ones, and those to which
            light spread
        found: how many do, and where
        cell: side of a cell of `cells`, pixels
        cells: map of low resolution, bool: cells in which it is no noise
        spread_cells: likewise those where light spread from saturated samples
    """

    shape: tuple[int, ...]
    marks: Packed
    found: FoundMovement
    cell: int
    cells: Mask
    spread_cells: Mask

    def rows(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Return 1 where samples of these rows contradict, else 0, in the shape of a frame."""
        width = self.shape[1] * (self.shape[2] if len(self.shape) == 3 else 1)
        found = np.unpackbits(self.marks[start:stop], axis=1, count=width)
        return found.reshape(-1, *self.shape[1:])


def find_movement(
    rows: FrameRows, shape: tuple[int, ...], pairs: Sequence[Pair]
) -> Movement | None:
    """Return where the frames of a capture contradict each other; None with a single frame.

    Args:
        rows: returns some rows of a frame by its position, black included
        shape: of a frame
        pairs: frames neighbouring in exposure, from the shortest on
    """
    if not pairs:
        return None
    marks = Marks(shape, pairs)
    marks.compare(rows)
    return _movement(marks, pairs, rows)


def _movement(marks: Marks, pairs: Sequence[Pair], frame_rows: FrameRows) -> Movement:
    """Return what moved; frames are read again where parts of them may be light that spread."""
    rows, columns = marks.shape[:2]
    counts = _cell_counts(marks.marks, marks.shape, marks.cell)
    spread = only_beside_white(
        marks.cells, (rows, columns), marks.cell, pairs, frame_rows, marks.within, marks.sigmas
    )
    moves = marks.cells & ~spread
    # What moved reaches into the cells beside it that have more marks than by noise.
    expected = FALSE_ALARMS * marks.cell**2 * math.prod(marks.shape[2:])
    many = counts > expected + marks.significant * math.sqrt(expected)
    moves |= many & ~spread & (dilated(moves.astype(np.uint8), (3, 3)) > 0)
    size = math.prod(marks.shape)
    spread_count = counts[spread].sum()
    flooded = np.zeros_like(spread)
    if marks.spilled.any():
        more = _cell_counts(marks.spilled & ~marks.marks, marks.shape, marks.cell)
        spread_count += more.sum()
        flooded = more > marks.cell // 2  # streaks of half its side
    found = FoundMovement(
        share=float(counts[~spread].sum() / size),
        false_alarms=FALSE_ALARMS * marks.compared,
        places=_places(moves, counts, (rows, columns), marks.cell),
        area=float(moves.mean()),
        block=marks.cell,
        spread=float(spread_count / size),
        compared=marks.compared,
    )
    both = marks.marks | marks.spilled
    return Movement(marks.shape, both, found, marks.cell, moves, spread | flooded & ~moves)


def _cell_counts(marks: Packed, shape: tuple[int, ...], cell: int) -> NDArray[np.float64]:
    """Return the marks in each cell, of all colours."""
    rows, columns, channels = (*shape, 1)[:3]
    down, across = -(-rows // cell), -(-columns // cell)
    counts = np.zeros((down, across))
    step = max(1, STRIP_SAMPLES // (columns * channels * cell)) * cell
    for start in range(0, rows, step):
        packed = marks[start : start + step]
        row, byte = np.unravel_index(np.flatnonzero(packed), packed.shape)
        some, bit = np.nonzero(np.unpackbits(packed[row, byte, np.newaxis], axis=1))
        cells = row[some] // cell * across + (8 * byte[some] + bit) // (channels * cell)
        there = counts[start // cell : (start + step) // cell]
        there += np.bincount(cells, minlength=there.size).reshape(there.shape)
    return counts


def _places(
    moves: Mask, counts: NDArray[np.float64], shape: tuple[int, int], cell: int
) -> tuple[Place, ...]:
    """Return the rectangles around connected cells that move, those with most marks first."""
    labels, boxes = connected_parts(moves)
    weights = np.bincount(labels.ravel(), weights=counts.ravel(), minlength=len(boxes))[1:]
    largest = np.argsort(-weights, kind="stable")[:_MOST_PLACES]
    return tuple(
        Place(
            top=top * cell,
            left=left * cell,
            bottom=min((top + height) * cell, shape[0]),
            right=min((left + width) * cell, shape[1]),
        )
        for left, top, width, height in boxes[1:][largest, :4].tolist()
    )
