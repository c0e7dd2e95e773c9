"""Mosaics: their colours, interpolated in linear light, with deviations and masks.

OpenCV's own demosaicing takes integers only, which would lose levels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.interface.controls import Layout
from camctl.system.picture_operations import correlated, dilated

LETTERS = "RGB"
#: Bilinear weights: every second pixel is green, every fourth one red or blue.
_GREEN_WEIGHTS = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_RED_BLUE_WEIGHTS = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
#: Bits kept of a float32's fraction: standard deviations are exact to 0.1 %, and light to 4e-6.
DEVIATION_BITS, MOST_BITS = 9, 17
#: Stands for an infinite standard deviation while they are interpolated; its square is finite.
_LARGEST_DEVIATION = np.float32(1e18)

#: The channels of a picture, (rows, columns) each: one, or R, G and B.
Planes = tuple[NDArray[np.float32], ...]


def colour_of(layout: Layout, row: int, column: int) -> int:
    """Return which of R, G, B (0, 1, 2) a mosaic has at (row, column)."""
    return LETTERS.index(layout.value.upper()[2 * (row % 2) + column % 2])


def new_planes(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return an array for results, of which each channel is contiguous."""
    if len(shape) == 2:
        return np.empty(shape, np.float32)
    return np.moveaxis(np.empty((shape[2], *shape[:2]), np.float32), 0, 2)


def demosaic(
    mosaic: NDArray[np.float32], layout: Layout, first_row: int, bits: int = MOST_BITS
) -> Planes:
    """Return R, G and B by bilinear interpolation of (rows, columns), borders mirrored.

    Linear light remains linear, but for the rounding to so many bits.  `first_row` is the row of
    the whole frame at which `mosaic` begins.
    """
    colours = _interpolated(mosaic, layout, first_row, _GREEN_WEIGHTS, _RED_BLUE_WEIGHTS)
    return tuple(rounded(each, bits) for each in colours)


def demosaic_deviation(deviation: NDArray[np.float32], layout: Layout, first_row: int) -> Planes:
    """Return the standard deviations of what `demosaic` interpolates.

    The errors of neighbouring pixels are independent, so that their variances add with the squares
    of the weights.  The error of interpolation itself is not known.
    """
    # A finite number stands for an infinite one: the product with a weight of 0 is 0.
    finite = np.minimum(deviation, _LARGEST_DEVIATION)
    unknown = np.isnan(deviation)
    if has_unknown := bool(unknown.any()):
        finite[unknown] = 0.0
        unknown = dilated(unknown.view(np.uint8), (3, 3)).view(np.bool_)
    found = _interpolated(finite**2, layout, first_row, _GREEN_WEIGHTS**2, _RED_BLUE_WEIGHTS**2)
    for each in found:
        np.sqrt(each, out=each)
        each[each > _LARGEST_DEVIATION / 100] = np.inf
        if has_unknown:
            each[unknown] = np.nan
    return tuple(rounded(each, DEVIATION_BITS) for each in found)


def rounded(values: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    """Return positive values rounded to so many bits of their fraction."""
    dropped = np.finfo(np.float32).nmant - bits
    found = values.view(np.uint32) + np.uint32(1 << (dropped - 1))
    found &= np.uint32(0xFFFFFFFF << dropped & 0xFFFFFFFF)
    return np.asarray(found.view(np.float32))


def _interpolated(
    mosaic: NDArray[np.float32],
    layout: Layout,
    first_row: int,
    green: NDArray[np.floating[Any]],
    red_blue: NDArray[np.floating[Any]],
) -> Planes:
    """Return each colour's samples, weighted by these kernels."""
    colours = []
    for channel in range(3):
        plane = np.zeros_like(mosaic)
        for row in (0, 1):
            for column in (0, 1):
                if colour_of(layout, first_row + row, column) == channel:
                    plane[row::2, column::2] = mosaic[row::2, column::2]
        kernel = green if channel == 1 else red_blue
        # Mirroring without repeating the border keeps the colour of every mirrored pixel.
        colours.append(correlated(plane, kernel, repeats_border=False))
    return tuple(colours)


def demosaic_mask(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mosaic's mask for each channel: a mark covers all pixels it contributed to.

    The value of such a pixel depends on the marked sample, in at least one channel.  More pixels
    than samples are marked: up to nine for one.
    """
    return dilated(mask, (3, 3))
