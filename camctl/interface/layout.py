"""The pixels of a frame, and their layout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

FEW_CHROMA_SAMPLES = "few_chroma_samples"
"""Detail of frames whose files state fewer samples of the differences of colours than of
brightness, as JPEG files of 4:2:0 and 4:2:2 do."""

BRIGHTNESS_STEPS = "brightness_steps"
"""Detail of frames from JPEG files: what the 64 frequencies of brightness of a block are multiples
of, row by row, levels."""


class Layout(StrEnum):
    """Pixel layout of a frame: monochrome, RGB, or the first four letters of a CFA pattern."""

    MONO = "mono"
    RGB = "rgb"
    RGGB = "rggb"
    GRBG = "grbg"
    GBRG = "gbrg"
    BGGR = "bggr"

    @property
    def is_mosaic(self) -> bool:
        """Whether each pixel has one colour of a 2 x 2 Bayer pattern, named row by row."""
        return self not in (Layout.MONO, Layout.RGB)

    def turned(self, shape: Sequence[int], turn: Callable[[NDArray[Any]], NDArray[Any]]) -> Layout:
        """Return the layout of a frame that is turned or mirrored.

        Args:
            shape: of the frame before
            turn: returns an array (rows, columns) turned
        """
        if not self.is_mosaic:
            return self
        rows, columns = (np.arange(2 + length % 2) % 2 for length in shape[:2])
        cells = np.array(list(self)).reshape(2, 2)[rows[:, np.newaxis], columns]
        return Layout("".join(turn(cells)[:2, :2].ravel()))

    def planes(self, pixels: NDArray[Any]) -> list[NDArray[Any]]:
        """Return views of a frame, one for each colour (the two greens of a mosaic apart)."""
        if self is Layout.MONO:
            return [pixels]
        if self is Layout.RGB:
            return [pixels[..., channel] for channel in range(3)]
        return [pixels[row::2, column::2] for row in (0, 1) for column in (0, 1)]
