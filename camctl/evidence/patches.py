"""Samples of a frame in small patches, and which of them something moved through.

A patch is a square of neighbouring samples of one colour.  Its mean has little noise, and what is
true of most patches of a frame is true of its exposure: a moving object changes only its own.

Brightness in the longer frame of a pair decides, but for noise, the brightness in the shorter one,
whatever the response is.  Samples in which nothing moved lie along one ascending curve of their
joint histogram, and samples of a moving thing lie beside it.  The curve is the ascending path on
which each brightness of either frame best implies the brightness of the other one: a thing of one
brightness makes a column or a row, and a sample of it implies no place in the column or the row.

Cells of neighbouring samples, or patches, are judged by their mean, in which noise averages out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import FloatArray
from camctl.model.sensor import JPEG_ERROR
from camctl.system.picture_operations import level_counts, looked_up, reduced_by_area

#: Side of a patch in samples of one colour, and the number of patches of a frame, about.
_SIDE, _PATCHES = 8, 4800

#: Brightness levels that are distinguished; of more bits than eight, equal steps of the square root
#: of the brightness, as photon noise has them, and of a share of full scale more: as read noise.
_LEVELS, _READ_NOISE = 256, 0.003
#: Share of the samples that are saturated in the longer frame that may have moved.
_MOSTLY = 0.25
#: Samples on each side of a cell.
_CELL_SIDE = 4
#: Levels on each side that count as one in the joint histogram (noise), and samples that a level
#: needs to say where the other frame is.
_NEAR, _FEW = 2, 30.0
#: Level from which on a sample may be a saturated one, as JPEG changes it.
_SATURATED = round((1 - JPEG_ERROR) * (_LEVELS - 1))
#: Error of a sample at most, by its level in the longer frame: what is saturated may be brighter.
_MOST_ERROR = np.where(np.arange(_LEVELS) < _SATURATED, np.inf, 0).astype(np.float32)
#: Deviation of a cell from the curve that is no noise: levels, a share of its brightness, and
#: median deviations of all cells of about its brightness, which is a band of so many levels (a
#: thing may be most of them: up to so many levels are noise).
_LEAST_DEVIATION, _LEAST_SHARE, _DEVIATIONS, _BAND, _MOST_NOISE = 4.0, 0.05, 8.0, 32, 16.0
#: Colours in which a cell must deviate: JPEG changes single ones where another one is saturated.
_COLOURS = 2
#: Cells around one that moved, of eight, that must have moved, too: contours are narrow.
_NEIGHBOURS = 3
#: Shares of the cells up to which nothing moved, and from which on it is not a thing that moved.
_LEAST_MOVED, _MOST_MOVED = 0.002, 0.5

#: Distances at which the samples of a patch are compared to see whether they are equal.
_STEPS_APART = (1, 9, 27)

Patches: TypeAlias = NDArray[np.uint16]
"""Brightness up to white, black included, (patches, samples)."""

Values: TypeAlias = NDArray[np.float32]


def sample_patches(planes: Sequence[NDArray[Any]], white: int) -> Patches:
    """Return patches all over a frame, which is given as one array (rows, columns) a colour.

    Frames of one size have the same patches, colour by colour and row by row.
    """
    patches = []
    for plane in planes:
        rows, columns, side = patch_places(plane.shape, len(planes))
        within = np.arange(side)
        found = plane[
            (rows[:, None] + within)[:, None, :, None], (columns[:, None] + within)[None, :, None]
        ]
        patches.append(found.reshape(-1, side * side))
    return np.asarray(np.minimum(np.concatenate(patches), white), np.uint16)


def patch_places(
    shape: Sequence[int], planes: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
    """Return first rows, first columns and side of the patches of one of so many planes."""
    side = min(_SIDE, max(1, min(shape) // 4))
    most = math.isqrt(_PATCHES // planes)
    # Blocks of JPEG files begin at multiples of their side.
    rows, columns = (
        np.linspace(0, length - side, min(length // side, most)).astype(np.intp) // side * side
        for length in shape
    )
    return rows, columns, side


def shared_rounding(
    frame: Patches, middle: NDArray[np.intp], sample: FloatArray, gap: FloatArray
) -> FloatArray:
    """Return the variance of the rounding error that does not average out within a patch.

    Samples of one value share their error, also with the patches of the same brightness `middle`.
    Noise of s levels averages it out, up to exp(-4 (pi s)^2) of the variance.
    """
    equal = np.mean([frame == np.roll(frame, step, axis=1) for step in _STEPS_APART], axis=(0, 2))
    alike = np.bincount(middle)[middle]
    noisy = np.exp(-4 * np.square(np.pi) * sample / gap**2)
    return np.asarray(gap**2 / 12 * noisy * equal * (1 + (alike - 1) * equal))


def moved_samples(
    short: Sequence[NDArray[Any]], long: Sequence[NDArray[Any]], black: int, white: int
) -> NDArray[np.bool_] | None:
    """Return which samples of the grids of two frames show something that moved between them.

    Args:
        short: of the frame of shorter exposure, (rows, columns) for each colour
        long: of the other one, likewise
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN

    Returns:
        (rows, columns), the same for all colours; None where nothing moved, and where so much
        differs that it is no moving thing
    """
    pairs = [
        (_as_levels(one, black, white), _as_levels(other, black, white))
        for one, other in zip(short, long, strict=True)
    ]
    rows = min(each.shape[0] for pair in pairs for each in pair)
    columns = min(each.shape[1] for pair in pairs for each in pair)
    shape = (max(1, rows // _CELL_SIDE), max(1, columns // _CELL_SIDE))
    count = np.zeros(shape, np.intp)
    for before, after in pairs:
        count += _deviates(
            before[:rows, :columns],
            after[:rows, :columns],
            partial(_cell_means, shape=shape),
        )
    moved: NDArray[np.bool_] = count >= min(_COLOURS, len(pairs))
    moved &= _neighbours(moved) >= _NEIGHBOURS
    if not _LEAST_MOVED < moved.mean() < _MOST_MOVED:
        return None
    moved |= _neighbours(moved) > 0
    place = [
        np.minimum(np.arange(length) * cells // length, cells - 1)
        for length, cells in zip((rows, columns), moved.shape, strict=True)
    ]
    return np.asarray(moved[np.ix_(*place)])


def moved_patches(
    short: Patches, long: Patches, colours: int, black: int, white: int
) -> NDArray[np.bool_]:
    """Return which patches of two frames show something that moved between them, (patches,).

    None do where so many differ that it is no moving thing.  Arguments as `deviating_patches`.
    """
    deviating = deviating_patches(short, long, colours, black, white)
    return np.tile(deviating & bool(deviating.mean() < _MOST_MOVED), colours)


def deviating_patches(
    short: Patches, long: Patches, colours: int, black: int, white: int
) -> NDArray[np.bool_]:
    """Return which patches of a frame do not have the brightness that most have in another one.

    Args:
        short: of the frame of shorter exposure, see `sample_patches`
        long: of the other one
        colours: that have responses of their own; each has as many patches
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN

    Returns:
        (patches of one colour,), the same for all
    """
    count = np.zeros(len(short) // colours, np.intp)
    parts = (np.array_split(_as_levels(each, black, white), colours) for each in (short, long))
    for before, after in zip(*parts, strict=True):
        count += _deviates(before, after, lambda values: np.asarray(values.mean(axis=1)))
    return count >= min(_COLOURS, colours)


def _as_levels(samples: NDArray[Any], black: int, white: int) -> NDArray[np.uint8]:
    share = np.clip((np.arange(white + 1) - black) / (white - black), 0, 1)
    if white - black >= _LEVELS:
        share = np.sqrt(share + _READ_NOISE) - math.sqrt(_READ_NOISE)
        share /= share[-1]
    table = np.rint((_LEVELS - 1) * share).astype(np.uint8)
    return looked_up(table, np.minimum(samples, white))


def _deviates(
    before: NDArray[np.uint8], after: NDArray[np.uint8], means: Callable[[Values], Values]
) -> NDArray[np.intp]:
    """Return 1 in the cells that deviate from the curve of most, and 0 in the others.

    Args:
        before: levels of the samples of the shorter frame
        after: of the longer one
        means: returns the mean of each cell of values of the samples
    """
    both = after.astype(np.uint16) * np.uint16(_LEVELS) + before
    counts = level_counts(both, _LEVELS**2).reshape(_LEVELS, _LEVELS)
    seen = counts[:_SATURATED, :_SATURATED].astype(np.float64)
    seen[0] = seen[:, 0] = 0  # clipped at black
    expected = np.empty(_LEVELS, np.float32)
    expected[:_SATURATED] = curve = _ascending_path(seen)
    # Where the longer frame is saturated, the shorter one may be anything brighter; most is.
    expected[_SATURATED:] = float(curve[-1])
    saturated = np.repeat(np.arange(_LEVELS), counts[_SATURATED:].sum(axis=0))
    if saturated.size:
        expected[_SATURATED:] = min(float(curve[-1]), float(np.quantile(saturated, _MOSTLY)))
    predicted = looked_up(expected, after)
    most = looked_up(_MOST_ERROR, after)
    mean = means(np.minimum(before - predicted, most, out=most))
    level = means(after.astype(np.float32))
    band = (level // _BAND).astype(np.intp)
    noise = _medians(np.abs(mean), band)
    limit = _LEAST_DEVIATION + _LEAST_SHARE * means(predicted)
    limit = np.maximum(limit, np.minimum(_DEVIATIONS * noise, _MOST_NOISE))
    deviates: NDArray[np.bool_] = np.abs(mean) > limit
    return deviates.astype(np.intp)


def _medians(values: Values, group: NDArray[np.intp]) -> Values:
    """Return for each value the median of the values of its group; both have the same shape."""
    found = np.empty_like(values)
    for each in np.unique(group):
        members = group == each
        found[members] = np.median(values[members])
    return found


def _cell_means(values: Values, shape: tuple[int, int]) -> Values:
    """Return the means of cells of about equal size, each of whole samples."""
    if all(length % cells == 0 for length, cells in zip(values.shape, shape, strict=True)):
        return np.asarray(reduced_by_area(values, shape[::-1]))
    for axis, cells in enumerate(shape):
        first = -(-np.arange(cells) * values.shape[axis] // cells)
        sums = np.add.reduceat(values, first, axis=axis)
        sizes = np.diff(np.append(first, values.shape[axis])).astype(np.float32)
        values = np.asarray(sums / (sizes[:, None] if axis == 0 else sizes), np.float32)
    return values


def _ascending_path(counts: FloatArray) -> FloatArray:
    """Return the brightness of the shorter frame at each one of the longer, (levels,).

    Args:
        counts: (levels, levels) samples by brightness in the longer and in the shorter frame
    """
    size = len(counts)
    near = _smoothed(_smoothed(counts).T).T
    total = [near.sum(axis=axis) + _FEW for axis in (1, 0)]
    implied = near**2 / total[0][:, None] / total[1]
    highest, best = np.empty((size, size)), np.zeros(size)
    for level, gain in enumerate(implied):
        best = np.maximum.accumulate(best, out=highest[level]) + gain
    is_first = np.ones((size, size), np.bool_)
    is_first[:, 1:] = highest[:, 1:] > highest[:, :-1]
    came_from = np.maximum.accumulate(np.where(is_first, np.arange(size), 0), axis=1)
    path = np.zeros(size, np.intp)
    place = int(best.argmax())
    for level in range(size - 1, -1, -1):
        path[level] = place
        place = int(came_from[level][place])
    return _smoothed(path.astype(np.float64)[:, None])[:, 0]


def _smoothed(values: FloatArray) -> FloatArray:
    """Return means over `_NEAR` places on each side along the first axis."""
    padded = np.pad(values, ((_NEAR, _NEAR), (0, 0)), mode="edge")
    total = padded[: len(values)].copy()
    for k in range(1, 2 * _NEAR + 1):
        total += padded[k : k + len(values)]
    return total / (2 * _NEAR + 1)


def _neighbours(cells: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return how many of the eight cells around each one are set."""
    padded = np.pad(cells.astype(np.intp), 1)
    rows, columns = cells.shape
    around = -padded[1:-1, 1:-1]
    for down in range(3):
        for across in range(3):
            around += padded[down : down + rows, across : across + columns]
    return around
