"""Errors of colours whose differences a file keeps with fewer samples, as JPEG does.

Of a cell of 2 x 2 pixels JPEG (4:2:0, and 4:2:2 in one direction) keeps the brightness Y of each
pixel, and one Cb and one Cr, the differences of blue and of red from it (ITU-T T.871).  What these
differ by within a cell is lost, and all frames of a scene lose about the same of it: it neither
shows in the differences of frames, nor does it average out.  How much that is, is seen in what is
kept: a cell loses as much of Cb as it would have lost of Y, times the contrast of Cb over that of Y
in the cells around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches
from camctl.system.picture_operations import box_means

#: Weights of red, green and blue in Y, and the range of Cb and of Cr as shares of that of B - Y and
#: of R - Y (ITU-T T.871).
_OF_Y, _OF_BLUE, _OF_RED = np.array((0.299, 0.587, 0.114), np.float32), 1.772, 1.402
#: What one level squared of Cb and of Cr is in red, green and blue, levels squared.
_GREEN = (_OF_BLUE * 0.114 / 0.587) ** 2, (_OF_RED * 0.299 / 0.587) ** 2
_VARIANCES = np.array(((0, _GREEN[0], _OF_BLUE**2), (_OF_RED**2, _GREEN[1], 0)), np.float32)

ROUNDING = np.sqrt((1 + _VARIANCES.sum(axis=0)) / 12)
"""Standard deviation of red, green and blue, levels, by whole numbers of Y, Cb and Cr: the least
error of a JPEG file."""

#: Real loss over the one that the cells show: so large that as many errors of four colour sets are
#: within one and two `sd` as should be (`tests/bench/bench_light_rivals.py`).
_LOSS = 4.0
#: Share of the variance of cells around that an error has at most: 2 of an edge within a cell.
_MOST_LOST = 2.0
#: Variance of Y, levels squared, below which a cell shows no contrast: that of two roundings.
_NO_CONTRAST = 1 / 6
#: Share of the finest detail of green that R - G and B - G have at most where their samples are
#: fewer: 0 to 0.2 in JPEG files of 4:2:0 and 4:2:2, 0.6 to 7 in other files of the same scenes.
_MOST_DETAIL = 0.3
#: Squares of 2 x 2 pixels that show it, and their least detail, levels squared: six roundings.
_LEAST_SQUARES, _LEAST_DETAIL = 1000, 0.5


def has_few_chroma_samples(samples: Sequence[Patches], highest: int) -> bool:
    """Return whether frames have fewer samples of the differences of colours than of brightness.

    Args:
        samples: patches of red, green and blue of each frame, see `sample_patches`
        highest: brightness up to which samples are not saturated
    """
    detail, others, count = 0.0, np.zeros(2), 0
    for patches in samples:
        squares = _patch_squares(patches).astype(np.int16)
        used = np.asarray(((squares > 0) & (squares <= highest)).all(axis=0))
        used = used[:, 1:, 1:] & used[:, 1:, :-1] & used[:, :-1, 1:] & used[:, :-1, :-1]
        red, green, blue = squares
        detail += float(np.square(_finest(green)[used]).sum())
        others += [np.square(_finest(each - green)[used]).sum() for each in (red, blue)]
        count += int(np.count_nonzero(used))
    # Two roundings make a sixth of a level squared of R - G.
    return (
        count >= _LEAST_SQUARES
        and detail >= _LEAST_DETAIL * count
        and bool((others - count / 6 <= _MOST_DETAIL * detail).all())
    )


def chroma_variance(cells: Sequence[NDArray[Any]]) -> NDArray[np.float32]:
    """Return the variance of the errors of colours, levels squared, of each cell of 2 x 2 pixels.

    Args:
        cells: (4, rows, columns) of red, of green and of blue, see `_lost`

    Returns:
        (3, rows, columns)
    """
    red, green, blue = (each.sum(axis=0, dtype=np.uint32) * np.float32(0.25) for each in cells)
    Y = _OF_Y[0] * red + _OF_Y[1] * green + _OF_Y[2] * blue
    of_y, of_blue, of_red = (
        np.maximum(box_means(each * each, 1) - np.square(box_means(each, 1)), 0.0)
        for each in (Y, (blue - Y) * np.float32(1 / _OF_BLUE), (red - Y) * np.float32(1 / _OF_RED))
    )
    share = _LOSS * box_means(_lost(cells[1]), 1)
    share /= of_y + np.float32(_NO_CONTRAST)
    np.minimum(share, _MOST_LOST, out=share)
    of_blue *= share
    of_red *= share
    found = np.empty((3, *Y.shape), np.float32)
    for k in range(3):
        np.multiply(of_blue, _VARIANCES[0, k], out=found[k])
        found[k] += _VARIANCES[1, k] * of_red
    return found


def patch_chroma_variance(patches: Patches) -> NDArray[np.float32]:
    """Return that of patches of red, green and blue, one number each, (3 * patches,)."""
    squares = _patch_squares(patches)
    squares = squares[..., : squares.shape[2] & ~1, : squares.shape[3] & ~1]
    cells = squares.reshape(*squares.shape[:2], squares.shape[2] // 2, 2, -1, 2)
    # (patches, rows, 2, columns, 2) to (4, rows, columns, patches)
    green = cells[1].transpose(2, 4, 1, 3, 0).reshape(4, *cells.shape[2:5:2], -1)
    lost = _lost(green).mean(axis=(0, 1))
    mean = cells.mean(axis=(3, 5), dtype=np.float32)
    Y = np.tensordot(_OF_Y, mean, 1)
    of_y, blue, red = (
        each.var(axis=(1, 2)) for each in (Y, (mean[2] - Y) / _OF_BLUE, (mean[0] - Y) / _OF_RED)
    )
    share = np.minimum(_LOSS * lost / (of_y + _NO_CONTRAST), _MOST_LOST)
    found = (np.stack([blue, red], axis=-1) * share[:, np.newaxis]) @ _VARIANCES
    return np.asarray(found.T.ravel(), np.float32)


def _patch_squares(patches: Patches) -> Patches:
    """Return patches of red, green and blue as (3, patches, side, side)."""
    side = round(patches.shape[1] ** 0.5)
    return patches.reshape(3, -1, side, side)


def _lost(cells: NDArray[Any]) -> NDArray[np.float32]:
    """Return the variance that interpolation between the means of cells does not show.

    It shows a quarter of the difference of the means on both sides.

    Args:
        cells: (4, rows, columns, ...) of green, whose detail within a cell is that of Y: its upper
            left, upper right, lower left and lower right sample
    """
    first, second, third, last = (each.astype(np.float32) for each in cells)
    left, right, differences = first + third, second + last, third - first
    across, others = right - left, last - second
    down, diagonal = differences + others, others - differences
    mean = (left + right) / 4
    down[1:-1] -= (mean[2:] - mean[:-2]) / 2
    across[:, 1:-1] -= (mean[:, 2:] - mean[:, :-2]) / 2
    return np.asarray((np.square(across) + np.square(down) + np.square(diagonal)) / 16)


def _finest(squares: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return how far neighbours are from a plane, of each 2 x 2 of (squares, side, side)."""
    return (
        squares[:, 1:, 1:] - squares[:, 1:, :-1] - squares[:, :-1, 1:] + squares[:, :-1, :-1]
    ) / 2
