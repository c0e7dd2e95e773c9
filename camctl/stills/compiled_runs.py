"""Lines of an OpenEXR file of float16 in run lengths, compiled (extra `fast`).

The bytes are those of the OpenEXR library (`ImfRleCompressor`, `ImfRle`), which takes twice as
long: the low bytes of a line stand before its high bytes, of each the difference from the one
before is kept, and three bytes or more that are equal become a number and one byte.  This module
is imported only where it is used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

#: Most bytes that are kept as they are, and that one byte stands for, in a part of a line.
_MOST_KEPT, _MOST_ALIKE = 127, 128
_LEAST_ALIKE = 3
#: Bytes before each line, for its number and its size.
_HEAD = 8

#: What OpenEXR adds to differences.
_MIDDLE = np.uint8(128)
_NONE, _ONE, _BITS, _LAST_BYTE = (np.uint64(x) for x in (0, 1, 8, 56))
#: A word of eight bytes that are 1.
_ONES = np.uint64(0x0101010101010101)


class _Work(NamedTuple):
    """Bytes of a line, their differences, and 1 where one of them is equal to the next two.

    `words` is the memory of `alike`, which ends with a 1 after the line.
    """

    line: NDArray[np.uint8]
    differences: NDArray[np.uint8]
    alike: NDArray[np.uint8]
    words: NDArray[np.uint64]


@_compiled
def _next(words: NDArray[np.uint64], place: int, without: np.uint64) -> int:
    """Return the first place from one on whose byte, 0 or 1, is not as those in `without`."""
    word = (words[place >> 3] ^ without) >> (_BITS * np.uint64(place & 7))
    if word == _NONE:
        place = (place | 7) + 1
        while words[place >> 3] == without:
            place += 8
        word = words[place >> 3] ^ without
    # Of the bytes below the lowest 1 each adds one to the highest byte of the product.
    below = ((word - _ONE) & ~word & _ONES) * _ONES >> _LAST_BYTE
    return int(place + np.int64(below))


@_compiled
def _write_runs(work: _Work, count: int, found: NDArray[np.uint8], place: int) -> int:
    """Write the differences of a line in run lengths from a place on; return where they end."""
    start, differences = 0, work.differences
    while start < count:
        stop = _next(work.words, start, _NONE)
        while start < stop:
            end = min(stop, start + _MOST_KEPT)
            found[place] = (start - end) & 0xFF
            for k in range(end - start):
                found[place + 1 + k] = differences[start + k]
            place += 1 + end - start
            start = end
        if start < count:
            stop = _next(work.words, start, _ONES) + _LEAST_ALIKE - 1
            while stop - start >= _LEAST_ALIKE:
                end = min(stop, start + _MOST_ALIKE)
                found[place], found[place + 1] = end - start - 1, differences[start]
                place += 2
                start = end
    return place


@_compiled
def _encode(
    channels: tuple[NDArray[np.uint16], ...],
    work: _Work,
    found: NDArray[np.uint8],
    ends: NDArray[np.int64],
) -> None:
    """See `_run_lengths`."""
    rows, columns = channels[0].shape
    half, place = len(channels) * columns, 0
    count, line = 2 * half, work.line
    differences, alike = work.differences, work.alike
    for row in range(rows):
        place += _HEAD
        for each in range(len(channels)):
            first = each * columns
            for i in range(columns):
                line[first + i] = channels[each][row, i] & 0xFF
                line[half + first + i] = channels[each][row, i] >> 8
        differences[0] = line[0]
        for i in range(1, count):
            differences[i] = line[i] - line[i - 1] + _MIDDLE
        for i in range(count - 2):
            is_next = differences[i] == differences[i + 1]
            alike[i] = is_next & (differences[i + 1] == differences[i + 2])
        end = _write_runs(work, count, found, place)
        if end - place >= count:  # longer than what it stands for, sample by sample
            end = place + count
            for each in range(len(channels)):
                for i in range(columns):
                    at = place + 2 * (each * columns + i)
                    found[at] = channels[each][row, i] & 0xFF
                    found[at + 1] = channels[each][row, i] >> 8
        place = ends[row] = end


def _run_lengths(channels: list[NDArray[Any]]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return lines of float16 as OpenEXR keeps them, `_HEAD` bytes before each, and their ends.

    Args:
        channels: of 2 bytes a sample, (rows, columns) each, in the order of their names
    """
    rows, columns = channels[0].shape
    count = 2 * columns * len(channels)
    alike = np.zeros(count + 16 & ~7, np.uint8)
    alike[count] = 1
    line, differences = np.empty((2, count), np.uint8)
    work = _Work(line, differences, alike, alike.view(np.uint64))
    # The last line may be longer before it is kept as it is.
    most = rows * (_HEAD + count) + count // _MOST_KEPT + 2
    found, ends = np.empty(most, np.uint8), np.empty(rows, np.int64)
    words = tuple(np.ascontiguousarray(each).view(np.uint16) for each in channels)
    _encode(words, work, found, ends)
    return found, ends


class LinesFile:
    """Appends lines to an OpenEXR file that has its header, and room for the places of all lines.

    Args:
        path: of the file
        rows: of the picture
    """

    def __init__(self, path: Path, rows: int) -> None:
        self._file = path.open("r+b")
        self.close = self._file.close
        self._place = self._file.seek(0, os.SEEK_END)
        self._table = self._place - 8 * rows
        self._places = np.empty(0, np.int64)
        self._rows = rows

    def prepared(self, channels: list[NDArray[Any]]) -> Callable[[], None]:
        """Return what appends lines, see `_run_lengths`."""
        return partial(self._append, *_run_lengths(channels))

    def _append(self, lines: NDArray[np.uint8], ends: NDArray[np.int64]) -> None:
        """Append lines; after the last one the places of all are written."""
        starts = np.append(0, ends[:-1])
        numbers = len(self._places) + np.arange(len(ends))
        heads = np.stack((numbers, ends - starts - _HEAD), axis=1).astype("<i4")
        lines[starts[:, np.newaxis] + np.arange(_HEAD)] = heads.view(np.uint8)
        self._file.write(lines[: ends[-1]].data)
        self._places = np.append(self._places, self._place + starts)
        self._place += int(ends[-1])
        if len(self._places) == self._rows:
            self._file.seek(self._table)
            self._file.write(self._places.astype("<u8").data)
            self._file.flush()
