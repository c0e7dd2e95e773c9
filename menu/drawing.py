"""A screen as a picture, in the manner of the paper's figure 4(b); characters where it is small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.menu.data import Picture
from camctl.menu.layout import SMALLEST as SMALLEST_GRID
from camctl.menu.layout import Grid, arranged, best, binned, button_texts, grid, hidden_buttons_mark
from camctl.menu.ports import Mood, Screen
from camctl.menu.text import fit, wrap
from camctl.system.characters import coverage

Pixels: TypeAlias = NDArray[np.uint8]
"""(rows, columns, 3), R, G, B."""

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

_SMALLEST_PICTURE = (240, 240)
"""(columns, rows) from which a screen is drawn as a picture, pixels."""

_LINE_HEIGHTS = (20, 28, 40)  # pixels, of `camctl.system.characters.HEIGHTS`
_LEAST_COLUMNS, _LEAST_ROWS = 24, 10
"""Characters that a picture has room for, at least."""

_PAPER, _INK, _FAINT = (250, 250, 248), (20, 22, 26), (110, 114, 122)  # R, G, B
_WHITE, _BAND, _LINE = (255, 255, 255), (228, 231, 236), (196, 200, 207)
_ACCENTS = {Mood.READY: (28, 78, 140), Mood.BUSY: (168, 98, 0), Mood.ERROR: (170, 30, 40)}
_Colour: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True)
class Drawing:
    """A drawn screen; `last_offset` is the largest `Screen.offset` that brings new lines."""

    pixels: Pixels
    last_offset: int


def _line_height(columns: int, rows: int) -> int:
    """Return the largest line height that leaves room for enough characters."""
    most = min(2 * columns // _LEAST_COLUMNS, rows // _LEAST_ROWS)
    sizes: list[int] = [*_LINE_HEIGHTS, *range(80, 401, 40)]
    fitting = [size for size in sizes if size <= most]
    return fitting[-1] if fitting else sizes[0]


class _Canvas:
    """Pixels, and where the next line of text goes."""

    def __init__(self, columns: int, rows: int) -> None:
        self.pixels = np.empty((rows, columns, 3), np.uint8)
        self.pixels[:] = _PAPER
        self.line = _line_height(columns, rows)
        self.cell = self.line // 2
        self.width, self.height = columns, rows
        self.margin = self.cell // 2
        self.columns = (columns - 2 * self.margin) // self.cell

    def fill(self, left: int, top: int, width: int, height: int, colour: _Colour) -> None:
        """Fill a rectangle; what is outside of the picture is cut."""
        self.pixels[max(0, top) : max(0, top + height), max(0, left) : max(0, left + width)] = (
            colour
        )

    def text(self, text: str, left: int, top: int, ink: _Colour, paper: _Colour) -> None:
        """Draw text in cells of one character each."""
        room = (self.width - left) // self.cell
        clean = fit(text, min(len(text), room))
        if not clean:
            return
        ink_share = coverage(clean, self.line)
        share = np.arange(256)[:, None] / 255
        shades = (np.array(paper) + share * (np.array(ink) - np.array(paper))).astype(np.uint8)
        area = self.pixels[top : top + self.line, left : left + ink_share.shape[1]]
        area[:] = shades[ink_share[: area.shape[0], : area.shape[1]]]

    def band(self, top: int, text: str, ink: _Colour, paper: _Colour) -> None:
        """Draw a line of text on a band over the whole width."""
        self.fill(0, top, self.width, self.line, paper)
        self.text(text, self.margin, top, ink, paper)

    def ring(self, left: int, top: int, colour: _Colour, *, is_filled: bool) -> None:
        """Draw the mark of an entry: a ring, filled where it is selected."""
        radius = self.cell * 0.45
        y, x = np.ogrid[: self.line, : self.cell]
        distance = np.hypot(y - self.line / 2 + 0.5, x - self.cell / 2 + 0.5)
        area = self.pixels[top : top + self.line, left : left + self.cell]
        is_ring = np.abs(distance - radius) < max(0.8, radius / 5)
        if is_filled:
            is_ring |= distance < radius * 0.55
        area[is_ring[: area.shape[0], : area.shape[1]]] = colour

    def picture(self, picture: Picture, left: int, top: int, width: int, height: int) -> int:
        """Draw a picture as large as fits; return the width that it takes."""
        source = np.frombuffer(picture.rgb, np.uint8).reshape(picture.rows, picture.columns, 3)
        scale = min(width / picture.columns, height / picture.rows)
        columns, rows = int(picture.columns * scale), int(picture.rows * scale)
        if columns < 1 or rows < 1:
            return 0
        down = np.arange(rows) * picture.rows // rows
        across = np.arange(columns) * picture.columns // columns
        self.pixels[top : top + rows, left : left + columns] = source[down][:, across]
        return columns

    def histogram(
        self, shares: tuple[float, ...], left: int, top: int, width: int, height: int
    ) -> None:
        """Draw a histogram as bars on a base line, one a pixel column at most."""
        if width < 8 or height < 8:
            return
        self.fill(left, top, width, height, _BAND)
        bins = binned(shares, min(width // 2, max(len(shares), 1)))
        edges = np.linspace(0, width, len(bins) + 1).astype(int)
        for first, last, share in zip(edges, edges[1:], bins, strict=False):
            bar = max(int(share > 0), round(share * (height - 4)))
            self.fill(left + first, top + height - bar, last - first, bar, _FAINT)
        self.fill(left, top + height - 1, width, 1, _INK)


def draw(screen: Screen, columns: int, rows: int) -> Drawing:
    """Return a screen as a picture of `columns` x `rows` pixels; it is black for a screen saver.

    Below 240 x 240 pixels it is text of 6 x 8 pixels a character.
    """
    if columns < _SMALLEST_PICTURE[0] or rows < _SMALLEST_PICTURE[1]:
        shown = grid(screen, columns // CELL[0], rows // CELL[1])
        return Drawing(characters(shown, columns, rows), shown.last_offset)
    canvas = _Canvas(columns, rows)
    if screen.is_dark:
        canvas.pixels[:] = 0
        return Drawing(canvas.pixels, 0)
    accent = _ACCENTS[screen.mood]
    canvas.band(0, arranged(screen.title, canvas.columns), _WHITE, accent)
    bottom = _draw_bottom(canvas, screen, accent)
    top = canvas.line + canvas.margin
    if screen.picture is not None or screen.histogram:
        bottom = _draw_pictures(canvas, screen, top, bottom)
    if screen.share is not None:
        _draw_progress(canvas, screen.share, top + 3 * canvas.line // 2, accent)
    height = max(1, (bottom - top) // canvas.line)
    if screen.selected is not None:
        _draw_entries(canvas, screen, top, height, accent)
        return Drawing(canvas.pixels, 0)
    return Drawing(canvas.pixels, _draw_page(canvas, screen, top, height))


def _draw_bottom(canvas: _Canvas, screen: Screen, accent: _Colour) -> int:
    """Draw buttons and what the selected entry costs; return where they begin."""
    top = canvas.height
    if screen.actions:
        top -= canvas.line + canvas.margin
        left = canvas.margin
        # A button takes the brackets of the text panels as its left and right end.
        shown = button_texts(screen, canvas.columns)
        for index, text in shown:
            is_selected = index == screen.action
            paper, ink = (accent, _WHITE) if is_selected else (_BAND, _INK)
            width = len(text) * canvas.cell
            canvas.fill(left, top, width - 2, canvas.line, paper)
            canvas.text(text[1:-1], left + canvas.cell, top, ink, paper)
            left += width
        mark = hidden_buttons_mark(screen, shown)
        right = canvas.width - canvas.margin - len(mark) * canvas.cell
        if mark and right >= left:
            canvas.text(mark, right, top, _FAINT, _PAPER)
    if screen.detail is not None:
        top -= canvas.line
        canvas.band(top, best(screen.detail.texts, canvas.columns), _INK, _BAND)
        canvas.fill(0, top, canvas.width, 1, _LINE)
    return top


def _draw_pictures(canvas: _Canvas, screen: Screen, top: int, bottom: int) -> int:
    """Draw picture and histogram side by side in the lower half; return where they begin."""
    height = (bottom - top) // 2
    first, left = bottom - height, canvas.margin
    room = canvas.width - 2 * canvas.margin
    if screen.picture is not None:
        left += (
            canvas.picture(screen.picture, left, first, 2 * room // 3, height - canvas.margin)
            + canvas.margin
        )
    if screen.histogram:
        width = canvas.width - canvas.margin - left
        canvas.histogram(screen.histogram, left, first, width, height - canvas.margin)
    return first - canvas.margin // 2


def _draw_progress(canvas: _Canvas, share: float, top: int, accent: _Colour) -> None:
    width = canvas.width - 2 * canvas.margin
    canvas.fill(canvas.margin, top, width, canvas.line, _BAND)
    canvas.fill(canvas.margin, top, round(width * share), canvas.line, accent)


def _draw_entries(canvas: _Canvas, screen: Screen, top: int, height: int, accent: _Colour) -> None:
    selected = screen.selected or 0
    first = max(0, min(selected - height // 2, len(screen.lines) - height))
    for row, line in enumerate(screen.lines[first : first + height]):
        is_selected = first + row == selected
        paper, ink = (accent, _WHITE) if is_selected else (_PAPER, _INK)
        y = top + row * canvas.line
        text = arranged(line, canvas.columns - 2)
        canvas.band(y, "  " + text, ink, paper)
        canvas.ring(canvas.margin, y, ink, is_filled=is_selected)


def _draw_page(canvas: _Canvas, screen: Screen, top: int, height: int) -> int:
    columns = canvas.columns - 1
    lines = [arranged(line, columns) for line in screen.lines]
    lines += wrap(list(screen.paragraphs), columns)
    last = max(0, len(lines) - height)
    first = min(screen.offset, last)
    for row, text in enumerate(lines[first : first + height]):
        canvas.text(text, canvas.margin, top + row * canvas.line, _INK, _PAPER)
    right = canvas.width - canvas.margin - canvas.cell
    if first:
        canvas.text("^", right, top, _FAINT, _PAPER)
    if first < last:
        canvas.text("v", right, top + (height - 1) * canvas.line, _FAINT, _PAPER)
    return last


def text_picture(lines: Sequence[str]) -> Pixels:
    """Return lines of text of equal length as a picture, as a panel of characters shows them."""
    line, margin = _LINE_HEIGHTS[0], _LINE_HEIGHTS[0] // 4
    canvas = _Canvas(len(lines[0]) * line // 2 + 2 * margin, len(lines) * line + 2 * margin)
    canvas.line, canvas.cell = line, line // 2
    canvas.pixels[:] = _BAND
    for row, text in enumerate(lines):
        canvas.text(text, margin, margin + row * line, _INK, _BAND)
    return canvas.pixels


def characters(shown: Grid, columns: int, rows: int) -> NDArray[np.uint8]:
    """Return a grid of characters of 5 x 7 pixels, white on black, (rows, columns, 3).

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
