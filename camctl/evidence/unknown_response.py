"""What moved between two frames of a camera whose response is not known.

Brightness in the longer frame of a pair decides, but for noise, the brightness in the shorter one,
whatever the response is.  Samples in which nothing moved lie along one ascending curve of their
joint histogram, and samples of a moving thing lie beside it.  The curve is the ascending path on
which each brightness of either frame best implies the brightness of the other one: a thing of one
brightness makes a column or a row, and a sample of it implies no place in the column or the row.

Cells of neighbouring samples, or patches, are judged by their mean, in which noise averages out:
by Student's t, at the significance level divided over the cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import OF_Y, brightness
from camctl.evidence.lost_detail import LEVELS
from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import MOST, significant_sigmas
from camctl.model.quantiles import student
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import ESTIMATED_RESPONSE_ERROR, JPEG_BLOCK_ERROR, JPEG_ERROR
from camctl.system.picture_operations import dilated, level_counts, looked_up, reduced_by_area

#: Of more bits than eight, `LEVELS` are equal steps of the square root of the brightness, as photon
#: noise has them, and of this share of full scale more: as read noise.
_READ_NOISE = 0.003
#: Samples on each side of a cell.
_CELL_SIDE = 4
#: Levels on each side that count as one in the joint histogram (noise).
_NEAR = 2
#: Level from which on a sample may be a saturated one, as JPEG changes it.
_SATURATED = round((1 - JPEG_ERROR) * (LEVELS - 1))
#: Level that such a sample has at least without the changes of JPEG.
_LEAST_SATURATED = round((1 - 2 * JPEG_ERROR) * (LEVELS - 1))

Values: TypeAlias = NDArray[np.float32]


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
    cut = [(before[:rows, :columns], after[:rows, :columns]) for before, after in pairs]
    moved = _deviates(cut, partial(_cell_means, shape=shape), _CELL_SIDE**2)
    if not 0 < moved.mean() < MOST:
        return None
    moved = dilated(moved.view(np.uint8), (3, 3)).view(np.bool_)
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
    return np.tile(deviating & bool(deviating.mean() < MOST), colours)


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
    planes = [np.array_split(_as_levels(each, black, white), colours) for each in (short, long)]
    pairs = list(zip(*planes, strict=True))
    return _deviates(pairs, lambda values: np.asarray(values.mean(axis=1)), short.shape[1])


def _as_levels(samples: NDArray[Any], black: int, white: int) -> NDArray[np.uint8]:
    share = np.clip((np.arange(white + 1) - black) / (white - black), 0, 1)
    if white - black >= LEVELS:
        share = np.sqrt(share + _READ_NOISE) - math.sqrt(_READ_NOISE)
        share /= share[-1]
    table = np.rint((LEVELS - 1) * share).astype(np.uint8)
    return looked_up(table, np.minimum(samples, white))


def _deviates(
    pairs: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]],
    means: Callable[[Values], Values],
    size: int,
) -> NDArray[np.bool_]:
    """Return which cells deviate from the curves of most by more than noise does.

    The mean of a cell has the error of its samples, which they show themselves, and errors that
    they share: of the curve, of rounding, and of JPEG files.  These keep the brightness Y of a
    pixel better than its colours, so that of three colours Y decides.  A cell of one sample
    does not show its error, and never deviates.

    Args:
        pairs: levels of the samples of the shorter and of the longer frame, for each plane
        means: returns the mean of each cell of values of the samples
        size: samples of a cell
    """
    parts = [
        _errors(*pair, expected, means)
        for pair, expected in zip(pairs, _expected(pairs), strict=True)
    ]
    if len(parts) == OF_Y.size:
        of_colours, common = zip(*parts, strict=True)
        parts = [(brightness(of_colours), np.tensordot(np.square(OF_Y), np.stack(common), 1))]
    found = np.zeros(parts[0][1].shape, np.bool_)
    for errors, shared in parts if size > 1 else ():
        mean = means(errors)
        own = np.maximum(means(np.square(errors)) - np.square(mean), 0) / (size - 1)
        limit = student(significant_sigmas(mean.size), size - 1.0)
        found |= np.square(mean) > limit**2 * (own + shared)
    return found


def _errors(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    expected: Values,
    means: Callable[[Values], Values],
) -> tuple[Values, Values]:
    """Return the error of each sample of a plane, and the variance that those of a cell share."""
    predicted = looked_up(expected, after)
    errors = before - predicted
    # What is saturated in the longer frame may be brighter.
    np.minimum(errors, 0, out=errors, where=after >= _SATURATED)
    files = (1 / 12 + JPEG_BLOCK_ERROR**2 / 2) * (1 + np.square(np.gradient(expected)))
    shared = means(looked_up(files.astype(np.float32), after))
    return errors, shared + np.square(ESTIMATED_RESPONSE_ERROR * means(predicted))


def _expected(pairs: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> list[Values]:
    """Return the level of the shorter frame that most samples of each of the longer one have.

    For each plane, see `_deviates`.
    """
    planes = []
    for before, after in pairs:
        both = after.astype(np.uint16) * np.uint16(LEVELS) + before
        counts = level_counts(both, LEVELS**2).reshape(LEVELS, LEVELS)
        seen = counts[:_SATURATED, :_SATURATED].astype(np.float64)
        seen[0] = seen[:, 0] = 0  # clipped at black
        planes.append(seen)
    found = []
    for seen, curve in zip(planes, _ascending_paths(planes), strict=True):
        # What is saturated is at least as bright as what is not, and of which enough is seen.
        known = np.flatnonzero(seen[: _LEAST_SATURATED + 1].sum(axis=1) >= LEAST_PATCHES)
        expected = np.full(LEVELS, curve[known[-1] if known.size else 0], np.float32)
        expected[:_SATURATED] = curve
        found.append(expected)
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


def _ascending_paths(planes: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the brightness of the shorter frame at each one of the longer, (levels,) each.

    Args:
        planes: for each, (levels, levels) samples by brightness in the longer and in the shorter
            frame
    """
    size = len(planes[0])
    implied = np.empty((size, len(planes), size))  # of all planes for each step below
    for place, counts in enumerate(planes):
        near = _smoothed(_smoothed(counts).T).T
        total = [near.sum(axis=axis) + LEAST_PATCHES for axis in (1, 0)]
        implied[:, place] = near**2 / total[0][:, None] / total[1]
    highest, best = np.empty_like(implied), np.zeros(implied.shape[1:])
    for before, gain in zip(highest, implied, strict=True):
        best = np.maximum.accumulate(best, axis=1, out=before) + gain
    is_first = np.ones(highest.shape, np.bool_)
    is_first[..., 1:] = highest[..., 1:] > highest[..., :-1]
    came_from = np.maximum.accumulate(np.where(is_first, np.arange(size), 0), axis=2)
    paths = np.zeros((size, len(planes)), np.intp)
    places, every = best.argmax(axis=1), np.arange(len(planes))
    for path, origins in zip(paths[::-1], came_from[::-1], strict=True):
        path[:] = places
        places = origins[every, places]
    return list(_smoothed(paths.astype(np.float64)).T)


def _smoothed(values: FloatArray) -> FloatArray:
    """Return means over `_NEAR` places on each side along the first axis."""
    ends = [np.repeat(values[[place]], _NEAR, axis=0) for place in (0, -1)]
    padded = np.concatenate((ends[0], values, ends[1]))  # in half of the time of `np.pad`
    total = padded[: len(values)].copy()
    for k in range(1, 2 * _NEAR + 1):
        total += padded[k : k + len(values)]
    return total / (2 * _NEAR + 1)
