"""A screen as characters of 5 x 7 pixels, for displays too small for pictures, such as 128 x 64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camctl.menu.layout import SMALLEST as SMALLEST_GRID
from camctl.menu.layout import Grid

CELL = (6, 8)
"""(columns, rows) of a character with the gaps to its neighbours, pixels."""

SMALLEST = (CELL[0] * SMALLEST_GRID[0], CELL[1] * SMALLEST_GRID[1])
"""(columns, rows) of the smallest display that the menu can be shown on, pixels."""

_FIRST = " "
_FONT = bytes.fromhex(
    "0000000000 00005F0000 0007000700 147F147F14 242A7F2A12 2313086462 3649562050 0008070300"
    "001C224100 0041221C00 14083E0814 08083E0808 0050300000 0808080808 0060600000 2010080402"
    "3E5149453E 00427F4000 4261514946 2141454B31 1814127F10 2745454539 3C4A494930 0171090503"
    "3649494936 064949291E 0036360000 0056360000 0814224100 1414141414 0041221408 0201510906"
    "324979413E 7E1111117E 7F49494936 3E41414122 7F4141221C 7F49494941 7F09090901 3E4149497A"
    "7F0808087F 00417F4100 2040413F01 7F08142241 7F40404040 7F020C027F 7F0408107F 3E4141413E"
    "7F09090906 3E4151215E 7F09192946 4649494931 01017F0101 3F4040403F 1F2040201F 3F4038403F"
    "6314081463 0708700807 6151494543 007F414100 0204081020 0041417F00 0402010204 4040404040"
    "0001020400 2054545478 7F48444438 3844444420 384444487F 3854545418 087E090102 0C5252523E"
    "7F08040478 00447D4000 2040443D00 7F10284400 00417F4000 7C04180478 7C08040478 3844444438"
    "7C14141408 081414187C 7C08040408 4854545420 043F444020 3C4040207C 1C2040201C 3C4030403C"
    "4428102844 0C5050503C 4464544C44 0008364100 00007F0000 0041360800 1008081008"
)
"""The columns of each character from space to ~, the lowest bit at the top: the shapes that
character displays have (HD44780 data sheet, table 4), without its Japanese ones."""


def characters(shown: Grid, columns: int, rows: int) -> NDArray[np.uint8]:
    """Return a grid of characters as a picture of white on black, (rows, columns, 3).

    The selected entry or button is black on white.
    """
    width, height = CELL
    font = np.frombuffer(_FONT, np.uint8).reshape(-1, width - 1)
    is_ink = np.zeros((rows, columns), bool)
    for row, line in enumerate(shown.lines):
        places = [ord(each if " " <= each <= "~" else "?") - ord(_FIRST) for each in line]
        bits = font[places][..., None] >> np.arange(height) & 1  # (characters, columns, rows)
        cells = np.pad(bits, ((0, 0), (0, 1), (0, 0))).reshape(-1, height).T
        is_ink[row * height : (row + 1) * height, : cells.shape[1]] = cells
    if (found := shown.highlight) is not None:
        is_ink[
            found.row * height : (found.row + 1) * height,
            found.column * width : (found.column + found.width) * width,
        ] ^= True
    return np.repeat(is_ink[..., None] * np.uint8(255), 3, axis=2)
