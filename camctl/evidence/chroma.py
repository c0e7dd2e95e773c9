"""Errors of colours whose differences a file keeps with fewer samples, as JPEG does.

Of a cell of 2 x 2 pixels JPEG (4:2:0, and 4:2:2 in one direction) keeps the brightness Y of each
pixel, and one Cb and one Cr, the differences of blue and of red from it (ITU-T T.871).  What these
differ by within a cell is lost, and all frames of a scene lose about the same of it: it neither
shows in the differences of frames, nor does it average out.  How much that is, is seen in what is
kept: within a cell, Cb changes with Y as it does from cell to cell around it; and where it changes
there without Y, the more of it changes within cells the more of Y does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches
from camctl.model.colour_rounding import DECODED, ENCODED
from camctl.system.picture_operations import box_means

OF_Y = ENCODED[0].astype(np.float32)
"""Weights of red, green and blue in Y."""

#: What one level squared of Cb and of Cr is in red, green and blue, levels squared.
_VARIANCES = np.square(DECODED[:, 1:].T).astype(np.float32)

ROUNDING = np.sqrt((1 + _VARIANCES.sum(axis=0)) / 12)
"""Standard deviation of red, green and blue, levels, by whole numbers of Y, Cb and Cr: the least
error of a JPEG file."""

#: Real loss over the one that the cells show, of what follows Y and of what does not: fitted to the
#: errors of seven photographs, made smaller and kept as 4:2:0 (`tests/bench/bench_jpeg_loss.py`).
_FOLLOWING, _OTHER = 1.65, 1.33
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
        found = [_finest(each)[used] for each in (green, red - green, blue - green)]
        # Squares without any, most of them in the dark, show neither.
        count += int(np.count_nonzero(np.any(found, axis=0)))
        own, *of_others = (float(np.square(each).sum()) for each in found)
        detail += own
        others += of_others
    # Two roundings make a sixth of a level squared of R - G.
    return (
        count >= _LEAST_SQUARES
        and detail >= _LEAST_DETAIL * count
        and bool((others - count / 6 <= _MOST_DETAIL * detail).all())
    )


def chroma_variance(cells: Sequence[NDArray[Any]]) -> NDArray[np.float32]:
    """Return the variance of the errors of colours, levels squared, of each cell of 2 x 2 pixels.

    Args:
        cells: (4, rows, columns) of red, of green and of blue, see `_detail`

    Returns:
        (3, rows, columns)
    """
    red, green, blue = (each.sum(axis=0, dtype=np.uint32) * np.float32(0.25) for each in cells)
    detail = _detail(cells[1])
    lost = _lost_chroma(red, green, blue, detail, lambda each: box_means(each, 1))
    found = np.empty((3, *green.shape), np.float32)
    for k in range(3):
        np.multiply(lost[0], _VARIANCES[0, k], out=found[k])
        found[k] += _VARIANCES[1, k] * lost[1]
    return found


def patch_chroma_variance(patches: Patches) -> NDArray[np.float32]:
    """Return that of patches of red, green and blue, one number each, (3 * patches,)."""
    squares = _patch_squares(patches)
    squares = squares[..., : squares.shape[2] & ~1, : squares.shape[3] & ~1]
    cells = squares.reshape(*squares.shape[:2], squares.shape[2] // 2, 2, -1, 2)
    # (patches, rows, 2, columns, 2) to (4, rows, columns, patches)
    green = cells[1].transpose(2, 4, 1, 3, 0).reshape(4, *cells.shape[2:5:2], -1)
    means = cells.mean(axis=(3, 5), dtype=np.float32)
    detail = np.moveaxis(_detail(green), 2, 0)
    red, middle, blue = means
    lost = _lost_chroma(
        red, middle, blue, detail, lambda each: np.asarray(each.mean(axis=(1, 2), keepdims=True))
    )
    every = np.stack([each.mean(axis=(1, 2)) for each in lost], axis=-1)
    return np.asarray((every @ _VARIANCES).T.ravel(), np.float32)


def photon_noise_ratios(
    samples: Sequence[Patches], photons: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the variance of each colour's photon noise over that of each other one, (3, 3).

    It is the mean of the logarithm over patches of one file, in which no colour is clipped.

    Args:
        samples: patches of red, green and blue of each frame
        photons: variance of a sample of each colour at each brightness, times any number
    """
    found = []
    for patches in samples:
        colours = patches.reshape(3, -1, patches.shape[1])
        inside = (colours.min(axis=(0, 2)) > 0) & (colours.max(axis=(0, 2)) < len(photons[0]) - 1)
        means = [
            table.take(each[inside]).mean(axis=1)
            for table, each in zip(photons, colours, strict=True)
        ]
        found.append(np.log(means))
    of_colours = np.concatenate(found, axis=1)
    middle = of_colours.mean(axis=1) if of_colours.size else np.zeros(3)
    return np.asarray(np.exp(middle - middle[:, np.newaxis]))


def patch_brightness(patches: Patches) -> NDArray[np.float32]:
    """Return Y of patches of red, green and blue, (patches, side, side)."""
    return brightness(_patch_squares(patches))


def brightness(colours: Iterable[NDArray[Any]]) -> NDArray[np.float32]:
    """Return Y of red, green and blue, in the shape of each."""
    weighted = (each * weight for each, weight in zip(colours, OF_Y, strict=True))
    return np.asarray(sum(weighted), np.float32)


NOISE_OF_Y = float(np.sqrt(np.square(OF_Y).sum()))
"""Noise of Y as a multiple of that of each colour."""


def _lost_chroma(
    red: NDArray[np.float32],
    green: NDArray[np.float32],
    blue: NDArray[np.float32],
    detail: NDArray[np.float32],
    mean: Callable[[NDArray[np.float32]], NDArray[np.float32]],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the variance that Cb, and Cr, lose within cells, levels squared.

    Args:
        red: of each cell
        green: likewise
        blue: likewise
        detail: variance of Y within the cells, see `_detail`
        mean: returns the mean over the cells around each one, or over all
    """
    Y = brightness((red, green, blue))
    middle = mean(Y)
    spread = np.maximum(mean(Y * Y) - np.square(middle), 0) + np.float32(_NO_CONTRAST)
    # Without the root, sharp pictures lose more than that and soft ones less.
    share = np.sqrt(np.minimum(mean(detail) / spread, 1)) * np.float32(_OTHER)
    found = []
    for colour, scale in ((blue, DECODED[2, 1]), (red, DECODED[0, 2])):
        chroma = (colour - Y) * np.float32(1 / scale)
        average = mean(chroma)
        slope = (mean(chroma * Y) - average * middle) / spread
        square = np.square(slope)
        rest = np.maximum(mean(chroma * chroma) - np.square(average) - square * spread, 0)
        found.append(np.float32(_FOLLOWING) * square * detail + share * rest)
    return found[0], found[1]


def _patch_squares(patches: Patches) -> Patches:
    """Return patches of red, green and blue as (3, patches, side, side)."""
    side = round(patches.shape[1] ** 0.5)
    return patches.reshape(3, -1, side, side)


def _detail(cells: NDArray[Any]) -> NDArray[np.float32]:
    """Return the variance within cells that interpolation between their means does not show.

    Decoders put the mean at the centre of a cell, and interpolate linearly from there.

    Args:
        cells: (4, rows, columns, ...) of green, whose detail within a cell is that of Y: its upper
            left, upper right, lower left and lower right sample
    """
    mean = cells.sum(axis=0, dtype=np.uint32) * np.float32(0.25)
    found: NDArray[np.float32] = np.zeros_like(mean)
    for down in (0, 1):
        rows = (3 * mean + _beside(mean, 0, down)) / 16
        for across in (0, 1):
            smooth = 3 * rows + _beside(rows, 1, across)
            found += np.square(cells[2 * down + across] - smooth)
    found /= 4
    return found


def _beside(values: NDArray[np.float32], axis: int, step: int) -> NDArray[np.float32]:
    """Return the values before (0) or after (1) each one; at the ends of the axis its own."""
    found = values.copy()
    to, of = (slice(None, -1), slice(1, None)) if step else (slice(1, None), slice(None, -1))
    before: tuple[slice, ...] = (slice(None),) * axis
    found[(*before, to)] = values[(*before, of)]
    return found


def _finest(squares: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return how far neighbours are from a plane, of each 2 x 2 of (squares, side, side)."""
    return (
        squares[:, 1:, 1:] - squares[:, 1:, :-1] - squares[:, :-1, 1:] + squares[:, :-1, :-1]
    ) / 2
