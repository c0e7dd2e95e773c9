"""Draw camctl/system/glyphs.npz, the characters of screens and sheets; needs Pillow, matplotlib.

The typeface is DejaVu Sans Mono, whose licence allows it (https://dejavu-fonts.github.io).

    python docs/draw_glyphs.py
"""

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

GLYPHS = Path(__file__).parents[1] / "camctl/system/glyphs.npz"
TYPEFACE = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSansMono.ttf"
CHARACTERS = "".join(map(chr, range(32, 127)))
HEIGHTS = (12, 14, 16, 20, 28, 40)
"""Heights of a line, pixels; a character is half as wide."""


def main() -> None:
    """Draw all characters in all sizes."""
    sizes = {}
    for height in HEIGHTS:
        width = height // 2
        points = next(p for p in range(height, 1, -1) if _width(p) <= width)
        font = ImageFont.truetype(TYPEFACE, points)
        ascent, descent = font.getmetrics()
        glyphs = np.zeros((len(CHARACTERS), height, width), np.uint8)
        for index, character in enumerate(CHARACTERS):
            cell = Image.new("L", (width, height))
            top = (height - ascent - descent) // 2
            ImageDraw.Draw(cell).text((0, top), character, fill=255, font=font)
            glyphs[index] = np.asarray(cell)
        sizes[f"lines_{height}"] = glyphs
    np.savez_compressed(GLYPHS, **sizes)


def _width(points: int) -> float:
    return ImageFont.truetype(TYPEFACE, points).getlength("M")


if __name__ == "__main__":
    main()
