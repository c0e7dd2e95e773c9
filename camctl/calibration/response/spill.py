"""Samples of a frame that are saturated or near a saturated one, and what spills over from there.

Charge beyond a full well flows along its column and fills the wells that it meets (blooming).  The
samples that it reaches count as bright in that frame, and as dark in one of a shorter exposure,
which bends a response that is estimated from both.  Where saturated samples and those near them are
left out of both frames, what remains shows the scene alone.  Light that spreads far (glare) is not
left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import certain
from camctl.calibration.response.matches import LEAST_NODES, Matches
from camctl.interface.controls import Layout
from camctl.system.picture_operations import level_counts

#: Rows and columns of the grid of samples of a colour.
_GRID = 512
#: Rows and columns on each side that are near a pixel: the last well of a column that charge
#: reaches is filled in part, and neighbouring columns share a little.
_ROWS_NEAR, _COLUMNS_NEAR = 2, 1
#: What spills over: a pair of frames whose levels match otherwise without samples near saturation,
#: certainly, and by this much, relative.
_LEAST_SPILLED = 0.003
#: Neighbouring matches have pixels in common: so many count as one.
_ALIKE = 5.0


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """A grid of samples of one frame, and the brightest sample near each of them.

    Attributes:
        planes: of each colour as `Layout.planes`, (rows, columns) each; those of a small frame have
            all samples
        peaks: of each of them, the same shape: the brightest sample near each one, of any colour
    """

    planes: tuple[NDArray[Any], ...]
    peaks: tuple[NDArray[Any], ...]

    @classmethod
    def of(cls, pixels: NDArray[Any], layout: Layout) -> SampleGrid:
        """Return the samples of a frame."""
        planes: list[NDArray[Any]] = []
        peaks: list[NDArray[Any]] = []
        scale = 2 if layout.is_mosaic else 1
        colours = layout.planes(pixels)
        for place, plane in enumerate(colours):
            rows, columns = (
                np.linspace(0, length - 1, min(length, _GRID)).astype(np.intp)
                for length in plane.shape
            )
            planes.append(plane[rows].take(columns, axis=1))
            row, column = divmod(place, 2) if layout.is_mosaic else (0, 0)
            if layout is Layout.RGB and peaks:  # one for all colours
                peaks.append(peaks[0])
                continue
            near = [pixels] if layout.is_mosaic else colours
            peaks.append(_brightest(near, scale * rows + row, scale * columns + column))
        return cls(tuple(planes), tuple(peaks))

    @cached_property
    def largest(self) -> int:
        """The largest of the samples."""
        return max(int(plane.max()) for plane in self.planes)


def _brightest(
    planes: Sequence[NDArray[Any]], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[Any]:
    """Return the brightest sample of any plane near each pixel of a grid, (rows, columns)."""
    height, width = planes[0].shape
    # Whole rows first: they lie in a piece in memory.
    tall = np.zeros((rows.size, width), planes[0].dtype)
    for plane in planes:
        for down in range(-_ROWS_NEAR, _ROWS_NEAR + 1):
            np.maximum(tall, plane[np.clip(rows + down, 0, height - 1)], out=tall)
    brightest = tall.take(columns, axis=1)
    for across in range(-_COLUMNS_NEAR, _COLUMNS_NEAR + 1):
        near = tall.take(np.clip(columns + across, 0, width - 1), axis=1)
        np.maximum(brightest, near, out=brightest)
    return brightest


def grid_counts(
    frames: Sequence[SampleGrid],
    colours: Sequence[int],
    places: NDArray[np.intp],
    *,
    below: int | None = None,
    moved: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """Return histograms of the samples of grids.

    Args:
        frames: of one scene
        colours: which planes are counted
        places: (K,) levels, ascending from 0
        below: level that the samples near a counted one are below in all of the frames, DN
        moved: (rows, columns) samples that are not counted

    Returns:
        (frames, K): samples from each level up to the next one
    """
    largest = max(frame.largest for frame in frames)
    counts = np.zeros((len(frames), max(largest, int(places[-1])) + 1), np.int64)
    for colour in colours:
        used = np.ones(frames[0].planes[colour].shape, np.bool_)
        if below is not None:
            for frame in frames:
                used &= frame.peaks[colour] < below
        if moved is not None:
            used[: moved.shape[0], : moved.shape[1]] &= ~moved
        for count, frame in zip(counts, frames, strict=True):
            count += level_counts(frame.planes[colour], count.size, used)
    return np.asarray(np.add.reduceat(counts, places, axis=1))


def spills_over(everywhere: Matches, clean: Matches) -> bool:
    """Return whether levels match otherwise without samples near saturation.

    Args:
        everywhere: matches of all samples
        clean: matches without samples near saturation
    """
    pairs = np.unique(clean.pairs)
    for place in pairs:
        all_, some = (each.part(each.pairs == place) for each in (everywhere, clean))
        _, left, right = np.intersect1d(all_.high, some.high, return_indices=True)
        if left.size < LEAST_NODES:
            continue
        weight = some.low[right] ** 2 / (some.low_variance[right] + all_.low_variance[left])
        shift = float(np.average(np.log(all_.low[left] / some.low[right]), weights=weight))
        error = float(np.sqrt(_ALIKE / weight.sum()))
        if abs(shift) > max(_LEAST_SPILLED, certain(pairs.size) * error):
            return True
    return False
