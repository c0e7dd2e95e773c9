"""How colour lies in frames: the planes of a mosaic, and three colours from it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.controls import Layout

_LETTERS = "RGB"
#: Bilinear weights: green lies on every second pixel, red and blue on every fourth.
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_OTHER = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4


def planes(pixels: NDArray[Any], layout: Layout) -> list[NDArray[Any]]:
    """Return views of a frame, one for each colour (both greens of a mosaic apart)."""
    if layout is Layout.MONO:
        return [pixels]
    if layout is Layout.RGB:
        return [pixels[..., channel] for channel in range(3)]
    return [pixels[row::2, column::2] for row in (0, 1) for column in (0, 1)]


def colour_of(layout: Layout, row: int, column: int) -> int:
    """Return which of R, G, B (0, 1, 2) a mosaic has at (row, column)."""
    return _LETTERS.index(layout.value.upper()[2 * (row % 2) + column % 2])


def demosaic(mosaic: NDArray[np.float32], layout: Layout, first_row: int) -> NDArray[np.float32]:
    """Return (rows, columns, 3) by bilinear interpolation of (rows, columns), borders mirrored.

    OpenCV's own demosaicing takes integers only, and levels would be lost in them; linear light
    stays linear here.  `first_row` is where the first row of `mosaic` lies in the whole frame.
    """
    import cv2

    colours = np.empty((*mosaic.shape, 3), np.float32)
    for channel in range(3):
        plane = np.zeros_like(mosaic)
        for row in (0, 1):
            for column in (0, 1):
                if colour_of(layout, first_row + row, column) == channel:
                    plane[row::2, column::2] = mosaic[row::2, column::2]
        kernel = _GREEN if channel == 1 else _OTHER
        # Mirroring without repeating the border keeps the colour of every mirrored pixel.
        colours[..., channel] = cv2.filter2D(plane, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
    return colours


def spread(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mosaic's mask as (rows, columns, 3), with all that interpolation touched."""
    import cv2

    wide = cv2.dilate(mask, np.ones((3, 3), np.uint8))
    return np.repeat(wide[..., None], 3, axis=2)
