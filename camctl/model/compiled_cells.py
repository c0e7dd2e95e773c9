"""Cells of 2 x 2 samples of colours, before their frames are joined and after, compiled.

What `camctl.pictures.chroma_light` does with numpy (extra `fast`), with float32 in the same order.
This module is imported only where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.compiled_alike import ALIKE, BY_SAMPLE, WHITE, Joined
from camctl.model.joined_frames import Cells
from camctl.model.light import KEPT_TABLES, Floats32, LightTables
from camctl.model.light_bins import DROPPED
from camctl.system.compiled_functions import compiler

_compiled = compiler(are_joined=True) or (lambda function: function)

_ZERO, _ONE, _QUARTER = (np.float32(x) for x in (0, 1, 0.25))
_INFINITE, _ALL_ALIKE = np.float32(np.inf), np.uint8(ALIKE)
_DROPPED = np.uint32(DROPPED)
#: Cells at a time, where loops are split so that they can be done side by side.
_AT_ONCE = np.uint64(512)


@_compiled
def _in_cells(planes: NDArray[Any], at: int, cells: NDArray[Any]) -> None:
    columns = planes.shape[2] // 2
    for colour in range(3):
        for row in range(planes.shape[1]):
            k, first = 2 * (row % 2), np.uint64(row // 2 * columns)
            for c in range(columns):
                cells[colour, at, k, first + np.uint64(c)] = planes[colour, row, 2 * c]
                cells[colour, at, k + 1, first + np.uint64(c)] = planes[colour, row, 2 * c + 1]


def in_cells(frames: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return the samples of frames by cells of 2 x 2 pixels, (3, n, 4, cells).

    Args:
        frames: (rows, columns, 3) of each, both even
    """
    rows, columns, _ = frames[0].shape
    cells = np.empty((3, len(frames), 4, rows // 2 * (columns // 2)), frames[0].dtype)
    for at, frame in enumerate(frames):
        _in_cells(np.ascontiguousarray(np.moveaxis(frame, 2, 0)), at, cells)
    return cells


@_compiled
def _beside_saturated(
    seen: NDArray[Any],
    spreads: Floats32,
    ends: Floats32,
    work: Floats32,
    beside: NDArray[np.bool_],
    hidden: NDArray[np.bool_],
) -> None:
    top, visible, reach, whole = ends[0], ends[1], ends[2], np.uint64(len(beside))
    largest, brightest = work[0], work[1]
    for c in range(whole):
        beside[c] = False
    for first in range(np.uint64(0), whole, _AT_ONCE):
        count = min(_AT_ONCE, whole - first)
        for at in range(len(hidden)):
            for j in range(count):
                c = first + j
                error = max(spreads[0, at, c], spreads[1, at, c])
                largest[j], brightest[j] = max(error, spreads[2, at, c]), _ZERO
            for k in range(4):
                one = work[2]
                for j in range(count):
                    c = first + j
                    value = max(seen[0, at, k, c], seen[1, at, k, c])
                    one[j] = np.float32(max(value, seen[2, at, k, c]))
                for j in range(count):
                    hidden[at, k, first + j] = (largest[j] > visible) & (one[j] > top)
                for j in range(count):
                    brightest[j] = max(brightest[j], one[j])
            for j in range(count):
                is_near = brightest[j] + reach * largest[j] > top
                beside[first + j] |= (largest[j] > visible) & is_near


def beside_saturated(
    seen: NDArray[Any], spreads: Floats32, top: int, visible: float, reach: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return in which cells a frame with errors of colours may be saturated, and what that hides.

    Args:
        seen: (3, n, 4, C)
        spreads: standard deviations of the errors that frames have in common, levels, (3, n, C)
        top: most levels of a sample that is not saturated
        visible: error from which on it changes other colours
        reach: standard deviations that nothing is off by

    Returns:
        (C,); of which samples another colour may be saturated, (n, 4, C)
    """
    beside, hidden = np.empty(seen.shape[3], np.bool_), np.empty(seen.shape[1:], np.bool_)
    ends, work = (
        np.array([top, visible, reach], np.float32),
        np.empty((3, int(_AT_ONCE)), np.float32),
    )
    _beside_saturated(seen, spreads, ends, work, beside, hidden)
    return beside, hidden


@_compiled
def _small_errors(
    of_bins: Floats32,
    ends: Floats32,
    first: int,
    errors: Floats32,
    light: Floats32,
    small: Floats32,
    is_large: NDArray[np.bool_],
) -> None:
    notable, share = ends[2], ends[3]
    for c in range(np.uint64(len(small))):
        mean = (((light[0, c] + light[1, c]) + light[2, c]) + light[3, c]) * _QUARTER
        inside = np.float32(min(max(mean, ends[0]), ends[1]))
        place = np.uint32((inside.view(np.uint32) >> _DROPPED) - np.uint32(first))
        found = _ZERO
        for at in range(len(errors)):
            error = errors[at, c]
            found += of_bins[place, at] * (error if error * error > notable else _ZERO)
        deviation = of_bins[place, len(errors)]
        small[c], is_large[c] = found, found * found > share * (deviation * deviation)


@lru_cache(maxsize=KEPT_TABLES)
def _errors_of_bins(tables: LightTables) -> Floats32:
    """Return what a level adds in each frame, and the deviation, by bin of light, (B, n + 1)."""
    return np.column_stack([*(tables.weights * tables.steps), tables.deviation])


def small_errors(
    tables: LightTables, errors: Floats32, light: Floats32, notable: float, share: float
) -> tuple[Floats32, NDArray[np.bool_]]:
    """Return what errors of colours add to the deviation of cells, and where that is much, (C,).

    Args:
        tables: of the colour
        errors: standard deviations of the errors that frames have in common, levels, (n, C)
        light: of the samples, (4, C)
        notable: square of an error from which on it counts
        share: of the variance of cells, from which on it is much
    """
    bins = tables.light_bins
    ends = np.array([bins.least, bins.brightest, notable, share], np.float32)
    small, is_large = np.empty(light.shape[1], np.float32), np.empty(light.shape[1], np.bool_)
    _small_errors(_errors_of_bins(tables), ends, bins.first, errors, light, small, is_large)
    return small, is_large


@_compiled
def _put(
    scatter: Floats32,
    known: np.float32,
    cells: Cells,
    found: Joined,
    light: Floats32,
    deviation: Floats32,
) -> None:
    columns, slot = light.shape[1] // 2, 0
    for row in range(light.shape[0] // 2):
        first, some = np.uint64(row * columns), _ALL_ALIKE
        for down in range(2):
            k = 2 * down
            for c in range(columns):
                i = first + np.uint64(c)
                ratio = np.sqrt((scatter[0, i] + known) / (scatter[1, i] + known))
                own, common = found.own[i] * ratio, found.common[i]
                both = np.sqrt(own * own + common * common)
                deviation[down + 2 * row, 2 * c] = deviation[down + 2 * row, 2 * c + 1] = both
            for c in range(columns):
                i = first + np.uint64(c)
                light[down + 2 * row, 2 * c] = found.light[k, i]
                light[down + 2 * row, 2 * c + 1] = found.light[k + 1, i]
        for c in range(columns):
            some |= found.kinds[first + np.uint64(c)]
        if some == _ALL_ALIKE:
            continue
        for c in range(columns):
            i = first + np.uint64(c)
            kind, ratio = found.kinds[i], _ONE
            if kind == ALIKE:
                continue
            if kind == BY_SAMPLE:
                ratio = np.sqrt((scatter[0, i] + known) / (scatter[1, i] + known))
            for k in range(4):
                own, common = cells.deviation[k, i], cells.common[i]
                if kind == BY_SAMPLE:
                    own, common = found.of_samples[0, k, slot] * ratio, found.of_samples[1, k, slot]
                elif kind == WHITE:
                    own = own if own != own else _INFINITE
                both = np.sqrt(own * own + common * common)
                deviation[2 * row + k // 2, 2 * c + k % 2] = both
            slot += 1 if kind == BY_SAMPLE else 0


def put(
    scatter: Floats32,
    known: float,
    cells: Cells,
    found: Joined,
    light: Floats32,
    deviation: Floats32,
) -> None:
    """Set the light of samples and its standard deviation, by both kinds of errors.

    Args:
        scatter: of the frames around each cell, and what noise makes of it, (2, C), which the own
            deviation of chosen cells follows
        known: scatter that the noise is known from besides
        cells: with the deviation of those that are not chosen
        found: of the cells
        light: (rows, columns)
        deviation: likewise
    """
    _put(scatter, np.float32(known), cells, found, light, deviation)
