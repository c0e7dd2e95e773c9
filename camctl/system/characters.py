"""The characters of drawn screens and sheets: DejaVu Sans Mono in a few sizes."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HEIGHTS = (12, 14, 16, 20, 28, 40)
"""Heights of a line, pixels; a character is half as wide."""

_FILE = Path(__file__).with_name("glyphs.npz")
_FIRST, _LAST, _OTHER = " ", "~", "?"


@lru_cache(maxsize=4)
def glyphs(height: int) -> NDArray[np.uint8]:
    """Return the coverage of the characters from space to ~, (95, height, height / 2), 255 = ink.

    `height` is one of `HEIGHTS`, or a multiple of one, which is enlarged.
    """
    available = max(each for each in HEIGHTS if height % each == 0)
    with np.load(_FILE) as sizes:
        found: NDArray[np.uint8] = sizes[f"lines_{available}"]
    factor = height // available
    return found.repeat(factor, axis=1).repeat(factor, axis=2)


def coverage(text: str, height: int) -> NDArray[np.uint8]:
    """Return a line of text as coverage, (height, characters * height / 2); "?" for others."""
    places = [ord(c if _FIRST <= c <= _LAST else _OTHER) - ord(_FIRST) for c in text]
    return glyphs(height)[places].transpose(1, 0, 2).reshape(height, -1)
