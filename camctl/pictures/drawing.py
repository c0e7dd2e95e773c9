"""Drawing of small pictures with text: the parts of contact sheets and of previews."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camctl.system.picture_operations import (
    channels_together,
    draw_text,
    reduced_by_area,
    text_width,
)

Colour = tuple[int, int, int]

#: Colours of text, of notes, and of the background.
INK: Colour = (40, 40, 40)
PALE: Colour = (110, 110, 110)
PAPER: Colour = (244, 244, 244)
MOST_ENLARGED = 8
"""Factor by which a picture is enlarged at most."""

MARGIN = 16
"""Distance between the parts of a drawing and from its edges, pixels."""

TEXT, SMALL_TEXT, TITLE = 0.48, 0.42, 0.66
"""Sizes of text, as OpenCV scales its letters."""

LINE_HEIGHT = 18
"""Height of a line of text, pixels."""

#: Smallest size to which a text is reduced; a longer one is cut.
_LEAST_SIZE = 0.36


class Drawing:
    """A picture in sRGB with a light background; places are (x, y) in pixels from the top left.

    Attributes:
        pixels: uint8, (rows, columns, 3)
    """

    def __init__(self, width: int, height: int) -> None:
        # Several times as fast as with all three components of the colour, which are equal.
        self.pixels = np.full((height, width, 3), PAPER[0], np.uint8)

    def text(
        self,
        text: str,
        place: tuple[int, int],
        width: int,
        *,
        size: float = TEXT,
        colour: Colour = INK,
        align: float = 0.0,
    ) -> None:
        """Write one line whose top left is `place`, smaller or cut where it is wider than `width`.

        `align` is where the text stands in the width: 0 left, 1 right.  Letters that the font does
        not have are replaced.
        """
        text = text.encode("ascii", "replace").decode()
        while (needed := text_width(text, size)) > width and text:
            if size > _LEAST_SIZE:
                size = max(_LEAST_SIZE, size - 0.02)
            else:
                text = text[:-1]
        left = place[0] + round(align * (width - needed))
        baseline = place[1] + round(26 * size)
        draw_text(self.pixels, text, (left, baseline), size, colour)

    def picture(
        self, picture: NDArray[np.uint8], place: tuple[int, int], size: tuple[int, int]
    ) -> None:
        """Put a picture of its own shape into the middle of a box of (width, height) pixels."""
        shown = fitted(picture, size)
        x = place[0] + (size[0] - shown.shape[1]) // 2
        y = place[1] + (size[1] - shown.shape[0]) // 2
        self.pixels[y : y + shown.shape[0], x : x + shown.shape[1]] = shown

    def fill(self, place: tuple[int, int], size: tuple[int, int], colour: Colour) -> None:
        """Fill a box of (width, height) pixels."""
        x, y = place
        area = self.pixels[y : y + size[1], x : x + size[0]]
        # A fifth of the time of a whole area at once: rows are copied.
        area[:1] = colour
        area[1:] = area[:1]


def fitted(picture: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture as (rows, columns, 3), enlarged or reduced to fit (width, height)."""
    shown, shape = reduced(picture, size), _shape_in(picture, size)
    if shown.shape[:2] == shape:
        return shown
    # Enlarged pixels stay visible as pixels.  The rows of the result are copied whole.
    down, across = (np.arange(n) * m // n for n, m in zip(shape, shown.shape, strict=False))
    return np.asarray(shown.take(across, axis=1).take(down, axis=0))


def reduced(picture: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture as (rows, columns, 3), reduced to fit (width, height) where it is larger."""
    rows, columns = _shape_in(picture, size)
    if rows < picture.shape[0] or columns < picture.shape[1]:
        picture = reduced_by_area(picture, (columns, rows))
    return picture if picture.ndim == 3 else channels_together([picture] * 3)


def _shape_in(picture: NDArray[np.uint8], size: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of a picture that fits (width, height)."""
    rows, columns = picture.shape[:2]
    factor = min(size[0] / columns, size[1] / rows, MOST_ENLARGED)
    return max(1, round(rows * factor)), max(1, round(columns * factor))


def decades(low: float, high: float) -> tuple[int, int]:
    """Return the exponents of the powers of ten that enclose two numbers > 0, at least one apart.

    >>> decades(0.02, 30.0), decades(1.0, 1.0)
    ((-2, 2), (0, 1))
    """
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    return first, max(last, first + 1)
