"""Errors of colours whose differences a file keeps with fewer samples, as JPEG does.

Of a cell of 2 x 2 pixels JPEG (4:2:0, and 4:2:2 in one direction) keeps the brightness Y of each
pixel, and one Cb and one Cr, the differences of blue and of red from it (ITU-T T.871).  What these
differ by within a cell is lost, and all frames of a scene lose about the same of it: it neither
shows in the differences of frames, nor does it average out.  How much that is, is seen in what is
kept: within a cell, Cb changes with Y as it does from cell to cell around it; and where it changes
there without Y, the more of it changes within cells the more of Y does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches
from camctl.interface.layout import FEW_CHROMA_SAMPLES
from camctl.model.colour_rounding import DECODED, ENCODED
from camctl.system.picture_operations import box_means, looked_up

OF_Y = ENCODED[0].astype(np.float32)
"""Weights of red, green and blue in Y."""

ROUNDING = np.sqrt((1 + np.square(DECODED[:, 1:]).sum(axis=1)) / 12)
"""Standard deviation of red, green and blue, levels, by whole numbers of Y, Cb and Cr: the least
error of a JPEG file."""

#: Real loss over the one that the cells show, of what follows Y and of what does not: fitted to the
#: errors of seven photographs, made smaller and kept as 4:2:0 (`tests/bench/bench_jpeg_loss.py`).
FOLLOWING, OTHER = 1.65, 1.33
#: G - Y as shares of R - Y and of B - Y.
GREEN: tuple[float, float] = tuple((-OF_Y[[0, 2]] / OF_Y[1]).tolist())
#: Degrees of freedom of variances of 3 x 3 cells: of their means, and of what is within them.
OF_CELLS, OF_DETAIL = 9 - 1, 9 * 3
#: Variance of Y, levels squared, below which a cell shows no contrast: that of two roundings.
NO_CONTRAST = 1 / 6
#: Share of the finest detail of green that R - G and B - G have at most where their samples are
#: fewer: 0 to 0.2 in JPEG files of 4:2:0 and 4:2:2, 0.6 to 7 in other files of the same scenes.
_MOST_DETAIL = 0.3
#: Squares of 2 x 2 pixels that show it, and their least detail, levels squared: six roundings.
_LEAST_SQUARES, _LEAST_DETAIL = 1000, 0.5


def states_few_chroma_samples(details: Iterable[Mapping[str, Any]]) -> bool:
    """Return whether a file states it, from the details of frames; see `has_few_chroma_samples`."""
    return any(each.get(FEW_CHROMA_SAMPLES) for each in details)


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


def chroma_variance(
    cells: Sequence[NDArray[Any]], noise: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Return the variance of the errors of colours, levels squared, of each cell of 2 x 2 pixels.

    Args:
        cells: (4, rows, columns) of red, of green and of blue, see `_detail`
        noise: what noise shows of R - Y, of B - Y, of Y and of detail at each brightness of green,
            (4, levels), see `ColourRounding.cells`; None: nothing

    Returns:
        (3, rows, columns)
    """
    means = [_cell_means(each) for each in cells]
    shown = None
    if noise is not None:
        green = means[1].astype(cells[1].dtype)
        shown = [looked_up(each, green) for each in noise]
    return _lost_chroma(means, _detail(cells[1]), lambda each: box_means(each, 1), shown)


def patch_chroma_variance(patches: Patches) -> NDArray[np.float32]:
    """Return that of patches of red, green and blue, one number each, (3 * patches,)."""
    squares = _patch_squares(patches)
    squares = squares[..., : squares.shape[2] & ~1, : squares.shape[3] & ~1]
    cells = squares.reshape(*squares.shape[:2], squares.shape[2] // 2, 2, -1, 2)
    # (patches, rows, 2, columns, 2) to (4, rows, columns, patches)
    green = cells[1].transpose(2, 4, 1, 3, 0).reshape(4, *cells.shape[2:5:2], -1)
    means = cells.mean(axis=(3, 5), dtype=np.float32)
    detail = np.moveaxis(_detail(green), 2, 0)
    lost = _lost_chroma(
        means, detail, lambda each: np.asarray(each.mean(axis=(1, 2), keepdims=True))
    )
    return np.asarray(lost.mean(axis=(2, 3)).ravel())


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


def patch_differences(patches: Patches, at: int) -> NDArray[np.float32]:
    """Return Cb (1) or Cr (2) of patches of red, green and blue, (patches, side, side)."""
    return differences(_patch_squares(patches), at)


def brightness(colours: Iterable[NDArray[Any]]) -> NDArray[np.float32]:
    """Return Y of red, green and blue, in the shape of each."""
    return _weighted(colours, OF_Y)


def differences(colours: Iterable[NDArray[Any]], at: int) -> NDArray[np.float32]:
    """Return Cb (1) or Cr (2) of red, green and blue, in the shape of each."""
    return _weighted(colours, ENCODED[at].astype(np.float32))


def _weighted(colours: Iterable[NDArray[Any]], weights: NDArray[np.float32]) -> NDArray[np.float32]:
    parts = (each * weight for each, weight in zip(colours, weights, strict=True))
    return np.asarray(sum(parts), np.float32)


NOISE_OF_Y = float(np.sqrt(np.square(OF_Y).sum()))
"""Noise of Y as a multiple of that of each colour."""


def _lost_chroma(
    means: Sequence[NDArray[np.float32]],
    detail: NDArray[np.float32],
    mean: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    noise: Sequence[NDArray[np.float32]] | None = None,
) -> NDArray[np.float32]:
    """Return the variance that red, green and blue lose within cells, levels squared, (3, ...).

    What they differ by from Y is R - Y, B - Y and G - Y.  The last one is the mix of the others
    that has no Y: what both lose may cancel there.

    Args:
        means: red, green and blue of each cell
        detail: variance of Y within the cells, see `_detail`
        mean: returns the mean over the cells around each one, or over all
        noise: what it shows, see `chroma_variance`
    """
    Y = brightness(means)
    middle = mean(Y)
    contrast, within = mean(Y * Y) - np.square(middle), mean(detail)
    spread = np.maximum(contrast, 0) + np.float32(NO_CONTRAST)
    real = spread
    if noise is not None:
        real = np.maximum(contrast - noise[2], 0) + np.float32(NO_CONTRAST)
        within = _without(within, noise[3], OF_DETAIL)
        detail = np.maximum(detail - noise[3], 0)
    # Without the root, sharp pictures lose more than that and soft ones less.
    share = np.sqrt(np.minimum(within / real, 1)) * np.float32(OTHER)
    following = np.float32(FOLLOWING) * detail
    red, blue = means[0] - Y, means[2] - Y
    averages = mean(red), mean(blue)
    slopes = [
        np.asarray((mean(each * Y) - average * middle) / spread, np.float32)
        for each, average in zip((red, blue), averages, strict=True)
    ]

    def rest(one: int, other: int) -> NDArray[np.float32]:
        product = mean((red, blue)[one] * (red, blue)[other])
        product -= averages[one] * averages[other]
        product -= slopes[one] * slopes[other] * spread
        return np.asarray(product, np.float32)

    def lost(slope: NDArray[np.float32], rest: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(np.square(slope) * following + share * np.maximum(rest, 0))

    of_red, of_blue = rest(0, 0), rest(1, 1)
    if noise is not None:
        of_red = _without(of_red, noise[0], OF_CELLS)
        of_blue = _without(of_blue, noise[1], OF_CELLS)
    to_red, to_blue = GREEN
    of_both = to_red**2 * of_red + to_blue**2 * of_blue + 2 * to_red * to_blue * rest(0, 1)
    slope, of_green = (
        np.asarray(each, np.float32) for each in (to_red * slopes[0] + to_blue * slopes[1], of_both)
    )
    return np.stack([lost(slopes[0], of_red), lost(slope, of_green), lost(slopes[1], of_blue)])


def _without(
    variance: NDArray[np.float32], noise: NDArray[np.float32], freedom: int
) -> NDArray[np.float32]:
    """Return a measured variance without the variance of noise, above 0.

    It has the error of a variance of noise with so many degrees of freedom.  Where what is left is
    0, half of a normal error is above 0, with the mean sqrt(2 / pi), and no error is left where it
    is much.
    """
    rest = variance - noise
    square = np.square(rest)
    square += np.float32(16 / np.pi / freedom) * np.square(noise)
    rest += np.sqrt(square, out=square)
    rest *= np.float32(0.5)
    return rest


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
    mean = _cell_means(cells)
    found: NDArray[np.float32] = np.zeros_like(mean)
    for down in (0, 1):
        rows = np.asarray((3 * mean + _beside(mean, 0, down)) / 16, np.float32)
        for across in (0, 1):
            smooth = 3 * rows + _beside(rows, 1, across)
            found += np.square(cells[2 * down + across] - smooth)
    found /= 4
    return found


def _cell_means(cells: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(cells.sum(axis=0, dtype=np.float32) * np.float32(0.25))


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
