"""A screen as a grid of characters, for panels of text from 16 x 2 to a full terminal.

From the top: title; lines and paragraphs; histogram and progress, where there is room; what the
selected entry costs; the buttons of a page; on a panel of six rows and more the keys.  A panel of
two rows has neither title nor keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from camctl.menu.ports import Line, Screen
from camctl.menu.text import fit, wrap

SMALLEST = (16, 2)
"""(columns, rows) of the smallest panel that the menu can be shown on."""

_ROWS_WITH_KEYS = 6
"""Rows from which the last one shows the keys, and a histogram has a row."""

_ROWS_WITH_SPACE = 12
"""Rows from which a histogram has several rows."""

_SHADES = " .:-=+*#%@"


@dataclass(frozen=True)
class Highlight:
    """The characters of the selected entry: `width` of them in one row, counted from 0."""

    row: int
    column: int
    width: int


@dataclass(frozen=True)
class Grid:
    """The characters on a panel.

    Attributes:
        lines: one for each row, all as long as a row, each character one cell wide
        highlight: the place of the selected entry or button
        last_offset: the largest `Screen.offset` that still brings new lines
    """

    lines: tuple[str, ...]
    highlight: Highlight | None
    last_offset: int


def best(texts: Sequence[str], columns: int) -> str:
    """Return the longest text that fits; the last one if none does."""
    return next((text for text in texts if len(text) <= columns), texts[-1])


def arranged(line: Line, columns: int) -> str:
    """Return a line with its note at the right end, where both fit."""
    for text in line.texts:
        for note in line.note or ("",):
            if len(text) + (len(note) + 1 if note else 0) <= columns:
                return text + (f"{note:>{columns - len(text)}}" if note else "")
    return best(line.texts, columns)


def button_texts(screen: Screen, columns: int) -> list[tuple[int, str]]:
    """Return (index, text) of the buttons that fit, the selected one among them."""
    texts = [
        (index, f"[{text}]" if index == screen.action else f" {text} ")
        for index, text in enumerate(screen.actions)
    ]
    while sum(len(text) for _, text in texts) > columns and len(texts) > 1:
        # The one that is farthest from the selected one goes first.
        far_left = screen.action - texts[0][0] > texts[-1][0] - screen.action
        texts.pop(0 if far_left else -1)
    return texts


def hidden_buttons_mark(screen: Screen, shown: Sequence[tuple[int, str]]) -> str:
    """Return "<" and ">" for the sides on which `button_texts` has left out buttons."""
    has_left, has_right = shown[0][0] > 0, shown[-1][0] < len(screen.actions) - 1
    return "<" * has_left + ">" * has_right


def grid(screen: Screen, columns: int, rows: int) -> Grid:
    """Return a screen as exactly `rows` lines of exactly `columns` characters."""
    if screen.is_dark:
        lines = [""] * rows
        return Grid(tuple(fit(line, columns) for line in lines), None, 0)
    is_small = rows < 3
    is_page = screen.selected is None
    top = [arranged(screen.title, columns)]
    if is_small and (screen.actions or not is_page):
        top = []
        if not screen.lines:  # a message says nothing without its title
            screen = replace(screen, lines=(screen.title,))
    bottom = _bottom(screen, columns, rows)
    height = rows - len(top) - len(bottom)
    extras = _extras(screen, columns, height, rows)
    height -= len(extras)
    if is_page:
        body, last_offset = _page(screen, columns, height)
    else:
        body, last_offset = _entries(screen, columns, height), 0
    first = 0
    if screen.selected is not None:
        first = _first(screen.selected, len(screen.lines), height)
    lines = [*top, *body, *[""] * (height - len(body)), *extras, *bottom]
    highlight = None
    if screen.selected is not None:
        highlight = Highlight(len(top) + screen.selected - first, 0, columns)
    elif screen.actions:
        column = 0
        for index, text in button_texts(screen, columns):
            if index == screen.action:
                row = rows - 1 - (rows >= _ROWS_WITH_KEYS)
                highlight = Highlight(row, column, min(len(text), columns - column))
            column += len(text)
    return Grid(tuple(fit(line, columns) for line in lines[:rows]), highlight, last_offset)


def _bottom(screen: Screen, columns: int, rows: int) -> list[str]:
    lines = []
    if screen.detail is not None:
        lines.append(best(screen.detail.texts, columns))
    if screen.actions:
        shown = button_texts(screen, columns)
        line, mark = "".join(text for _, text in shown), hidden_buttons_mark(screen, shown)
        lines.append(line + f"{mark:>{max(0, columns - len(line))}}")
    if rows >= _ROWS_WITH_KEYS:
        lines.append(keys_text(screen.keys, columns))
    return lines


def keys_text(keys: Sequence[str], columns: int) -> str:
    """Return what the keys do, as many as fit."""
    line = ""
    for key in keys:
        longer = f"{line}  {key}" if line else key
        line = longer if len(longer) <= columns else line
    return line


def _extras(screen: Screen, columns: int, height: int, rows: int) -> list[str]:
    """Return the rows of the progress bar and of the histogram."""
    lines = []
    if screen.histogram and rows >= _ROWS_WITH_KEYS and height > 2:
        count = 4 if rows >= _ROWS_WITH_SPACE else 1
        lines += _histogram(screen.histogram, columns, count)
    if screen.share is not None and height > len(screen.lines):
        width = columns - 2
        filled = int(screen.share * width)
        lines.append(f"[{'#' * filled}{'.' * (width - filled)}]")
    return lines


def binned(histogram: Sequence[float], count: int) -> list[float]:
    """Return a histogram with `count` bins, the highest 1; shares go to where their bin begins."""
    found = [0.0] * count
    for index, share in enumerate(histogram):
        found[index * count // len(histogram)] += share
    if len(histogram) < count:
        found = [histogram[index * len(histogram) // count] for index in range(count)]
    highest = max(found)
    return [share / highest for share in found] if highest > 0 else found


def _histogram(histogram: Sequence[float], columns: int, rows: int) -> list[str]:
    bins = binned(histogram, columns)
    if rows == 1:
        top = len(_SHADES) - 1
        return ["".join(_SHADES[min(top, int(share * top + 0.999))] for share in bins)]
    return [
        "".join("#" if share * rows > rows - row - 1 else " " for share in bins)
        for row in range(rows)
    ]


def _page(screen: Screen, columns: int, height: int) -> tuple[list[str], int]:
    width = columns - 2  # the last column marks that there is more
    lines = [arranged(line, width) for line in screen.lines]
    lines += wrap(list(screen.paragraphs), width)
    last = max(0, len(lines) - height)
    first = min(screen.offset, last)
    shown = lines[first : first + height]
    if last and shown:
        marks = [" "] * len(shown)
        marks[0] = "^" if first else " "
        if first < last:
            marks[-1] = "v" if marks[-1] == " " else "|"
        shown = [fit(line, columns - 1) + mark for line, mark in zip(shown, marks, strict=True)]
    return shown, last


def _first(selected: int, length: int, height: int) -> int:
    """Return the first entry to show, so that the selected one is among them."""
    return max(0, min(selected - height // 2, length - height))


def _entries(screen: Screen, columns: int, height: int) -> list[str]:
    selected = screen.selected or 0
    first = _first(selected, len(screen.lines), height)
    lines = [
        (">" if index == selected else " ") + arranged(line, columns - 1)
        for index, line in list(enumerate(screen.lines))[first : first + height]
    ]
    remarks = wrap(list(screen.paragraphs), columns - 2)
    return [*lines, "", *remarks] if remarks and len(lines) + len(remarks) < height else lines
