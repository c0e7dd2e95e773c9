"""Which samples of a shorter exposure contradict a longer one, by limits of their brightness.

Photographs have errors at edges that are neither noise of the sensor nor movement: JPEG files are
rounded in blocks, and programs mix the colours of neighbouring pixels.  They grow with the range
of brightness around a sample, and widen its limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.system.picture_operations import dilated, opencv

#: Standard deviation of the errors of photographs, as a share of the range of brightness around:
#: files of quality 75 with a quarter of the samples of colour exceed 3 times that in 1 of 5,000.
_SHARE = 0.05
#: Side of the blocks of which ranges are taken, pixels, those beside included: together they hold
#: the 16 x 16 pixels in which JPEG files round colours.
_BLOCK = 8
#: By how much less the range counts that the blocks beside have.
_BESIDE = 3

_Floats = NDArray[np.float64]
Ranges = NDArray[np.uint8]
"""Range of brightness in and beside each block of a frame, white = 255."""


@dataclass(frozen=True, eq=False)
class EdgeLimits:
    """Limits of the light of the shorter frame, which edges widen.

    Attributes:
        mean: light expected by the brightness of the longer frame, (colours, white + 1)
        reach: its largest error where there is no edge, likewise
        scale: largest error for each level of the standard deviation at edges, likewise
        steps: least light of each brightness, and infinity, (white + 2,)
    """

    mean: _Floats
    reach: _Floats
    scale: _Floats
    steps: _Floats

    def outside(
        self, colour: NDArray[np.intp], short: Pixels, long: Pixels, ranges: Ranges
    ) -> NDArray[np.bool_]:
        """Return which samples, (N,), contradict with these ranges of brightness around them."""
        white = self.mean.shape[1] - 1
        short, after = np.minimum(short, white), (colour, np.minimum(long, white))
        mean = self.mean[after]
        error = np.maximum(self.steps[short] - mean, mean - self.steps[short + 1])
        allowed = edge_levels(ranges, white) * self.scale[after]
        return np.asarray(error > np.maximum(self.reach[after], allowed))


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the brightness of the shorter frame.

    Attributes:
        low, high: least and largest one by the brightness of the longer frame, (colours, white + 1)
        edges: wider limits at edges; None where there are none
    """

    low: NDArray[np.uint16]
    high: NDArray[np.uint16]
    edges: EdgeLimits | None = None

    def outside(
        self,
        short: Pixels,
        long: Pixels,
        ranges: Ranges | None = None,
        first: tuple[int, int] = (0, 0),
        every: tuple[int, int] = (1, 1),
    ) -> NDArray[np.bool_]:
        """Return which samples of a shorter exposure contradict the longer one.

        Args:
            short: brightness, (rows, columns) or (rows, columns, colours)
            long: likewise, of the same shape
            ranges: `local_ranges` of the longer frame, for limits at edges
            first: row and column of the frame where they begin
            every: distance of their rows and of their columns in it
        """
        found = _outside(self.low, self.high, short, long)
        if self.edges is None or ranges is None:
            return found
        places = np.unravel_index(np.flatnonzero(found), found.shape)
        if not places[0].size:
            return found
        blocks = [
            (start + step * place) // _BLOCK
            for start, step, place in zip(first, every, places, strict=False)
        ]
        colour = places[2] if len(self.low) > 1 else np.zeros_like(places[0])
        around = ranges[blocks[0], blocks[1]]
        found[places] = self.edges.outside(colour, short[places], long[places], around)
        return found


def edge_levels(ranges: Ranges, white: int) -> _Floats:
    """Return the standard deviation of photographs with these ranges of brightness, in levels."""
    return np.asarray(ranges * (_SHARE * white / 255), np.float64)


def local_ranges(frame: Pixels, white: int) -> Ranges:
    """Return the range of brightness in and beside each block of a frame, of any colour.

    Brightness beside it counts by a third.
    """
    planes = frame.shape[2] if frame.ndim == 3 else 1
    found = []
    most, least = (
        (np.minimum(_blocks(frame, reduce), white) * (255 / white)).astype(np.uint8)
        for reduce in (np.maximum, np.minimum)
    )
    for plane in range(planes):
        above, below = (
            np.ascontiguousarray(each[:, plane::planes]) for each in (most, 255 - least)
        )
        around = dilated(above, (3, 3)) - (255 - dilated(below, (3, 3)))
        found.append(np.maximum(above - (255 - below), around // _BESIDE))
    return np.asarray(np.maximum.reduce(found))


def _blocks(frame: Pixels, reduce: np.ufunc) -> Pixels:
    """Return the largest or the least sample of each block, the colours of one side by side."""
    rows, columns = frame.shape[:2]
    whole = rows // _BLOCK * _BLOCK
    # Many times as fast as `reduceat` along rows.
    parts = [reduce.reduce(frame[:whole].reshape(-1, _BLOCK, *frame.shape[1:]), axis=1)]
    if whole < rows:
        parts.append(reduce.reduce(frame[whole:], axis=0, keepdims=True))
    found = reduce.reduceat(np.concatenate(parts), np.arange(0, columns, _BLOCK), axis=1)
    return np.asarray(found.reshape(len(found), -1))


def _outside(
    low: NDArray[np.uint16], high: NDArray[np.uint16], short: Pixels, long: Pixels
) -> NDArray[np.bool_]:
    """Return which samples are outside of limits, (colours, white + 1) each."""
    if short.dtype == long.dtype == np.uint8 and (cv2 := opencv()) is not None:
        # Five times as fast.  What is below the least brightness wraps to a large one; what is
        # above white counts as white.
        white = low.shape[1] - 1
        codes = np.minimum(np.arange(256), white)
        low, high = low[:, codes], np.where(high == white, 255, high)[:, codes]
        least, span = low.astype(np.uint8), (high - low).astype(np.uint8)
        # Tables that differ from channel to channel are slower than planes.
        planes = [[short], [long]] if len(low) == 1 else [cv2.split(short), cv2.split(long)]
        found = []
        for before, after, *tables in zip(*planes, least, span, strict=True):
            lowest, widest = (cv2.LUT(after, table) for table in tables)
            np.subtract(before, lowest, out=lowest)
            found.append(np.greater(lowest, widest, out=widest.view(np.bool_)))
        if len(found) == 1:
            return np.asarray(found[0])
        return np.asarray(cv2.merge([each.view(np.uint8) for each in found])).view(np.bool_)
    short, long = (np.minimum(each, low.shape[1] - 1) for each in (short, long))
    if len(low) == 1:
        return np.asarray((short < low[0][long]) | (short > high[0][long]))
    parts = (_outside(low[[k]], high[[k]], short[..., k], long[..., k]) for k in range(len(low)))
    return np.stack(list(parts), axis=-1)
