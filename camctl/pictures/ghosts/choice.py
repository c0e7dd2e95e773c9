"""Which frame shows each place where things moved.

The map of movement is in cells (`camctl.evidence.movement`).  Connected cells, what they enclose
and the cells around them are a region, whose cells get labels (`camctl.pictures.ghosts.labels`).

All frames together have an error by what moved: m, the mean square of the largest difference of a
frame from them beyond its noise.  A frame of the variance v has the weight m / (m + v), which has
the least error (Wiener), v m / (m + v): where nothing moves, all frames are believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.movement import Movement
from camctl.evidence.patches import Patches
from camctl.evidence.residual import FrameRows
from camctl.interface.camera import Pixels
from camctl.model.light import Floats32
from camctl.pictures.frame_light import FrameLight
from camctl.pictures.ghosts.labels import LabelField, Mask, least_error_labels
from camctl.pictures.ghosts.replacement import COMPARED, Ghosts
from camctl.pictures.single_light import SingleLight, least_light, single_lights
from camctl.system.picture_operations import connected_parts, dilated, looked_up, plane_by_plane

#: Cells have 2 x 2 parts, whose mean light is compared at seams.
_PARTS = 2
#: Stands for no movement; its quotients exist.
_NO_ERROR = 1e-12


def find_ghosts(
    movement: Movement,
    frames: FrameRows,
    total: NDArray[np.unsignedinteger],
    light: FrameLight,
    exposures: Sequence[float],
    samples: Callable[[Mask, int], Sequence[Patches]],
    black: int,
) -> Ghosts | None:
    """Return from which frame each place is where things moved; None where nothing did.

    Args:
        movement: where frames contradict each other
        frames: returns rows of each frame
        total: sum of the frames
        light: what estimates the light from all frames
        exposures: of the frames, relative to the shortest
        samples: returns the patches of each frame, see `sample_patches`, outside of some cells of a
            size: what all frames show where things moved says nothing of the light of one
        black: brightness without light, DN
    """
    if not movement.cells.any():
        return None
    cells = _regions(movement.cells)
    at_rest = samples(cells, movement.cell)
    lights = tuple(single_lights(light, exposures, at_rest, black))
    error, features, certainty = _measured(
        dilated(cells.astype(np.uint8), (3, 3)) > 0,
        movement.cell,
        frames,
        total,
        light,
        lights,
        len(exposures),
    )
    labels = np.full(cells.shape, -1, np.int16)
    numbers, boxes = connected_parts(cells)
    for number, (left, top, width, height, _) in enumerate(boxes.tolist()[1:], 1):
        near = (
            slice(max(0, top - 1), top + height + 1),
            slice(max(0, left - 1), left + width + 1),
        )
        inside = numbers[near] == number
        found = least_error_labels(LabelField(inside, error[near], features[near]))
        labels[near][inside] = found[inside]
    # A pixel at the edge of a thing is between parts that it moved in and others: the former count.
    for each in certainty:
        each[...] = dilated(each, (3, 3))
    return Ghosts(labels, movement.cell, certainty, lights)


def _regions(cells: Mask) -> Mask:
    """Return cells with what they enclose, and those around them."""
    outer = np.pad(~(dilated(cells.astype(np.uint8), (3, 3)) > 0), 1, constant_values=True)
    numbers, _ = connected_parts(outer)
    return np.asarray((numbers != numbers[0, 0])[1:-1, 1:-1])


def _measured(
    cells: Mask,
    cell: int,
    frames: FrameRows,
    total: NDArray[np.unsignedinteger],
    light: FrameLight,
    lights: Sequence[SingleLight],
    count: int,
) -> tuple[Floats32, Floats32, Floats32]:
    """Return `error` and `features` of a `LabelField`, and `Ghosts.certainty`, of some cells."""
    channels = int(np.prod(total.shape[2:]))
    error = np.zeros((*cells.shape, count), np.float32)
    features = np.zeros((*cells.shape, count + 1, _PARTS**2 * channels), np.float32)
    parts = cells.shape[0] * COMPARED, cells.shape[1] * COMPARED
    certainty = np.zeros((count, *parts), np.float32)
    for row in range(0, cells.shape[0], 2):  # an even row of a mosaic
        for first, last in _runs(np.asarray(cells[row : row + 2].any(axis=0))):
            rows = slice(row * cell, min((row + 2) * cell, len(total)))
            across = slice(first * cell, min(last * cell, total.shape[1]))
            values = [plane_by_plane(frames(place, rows)[:, across]) for place in range(count)]
            all_frames = light.by_sample(values, total[rows, across])
            together = np.log(np.maximum(all_frames, np.float32(least_light(lights))))
            here = slice(row, row + 2), slice(first, last)
            finer = [slice(each.start * COMPARED, each.stop * COMPARED) for each in here]
            features[(*here, count)] = _cell_means(together, cell, _PARTS)
            known, square = (
                np.empty((count, *features[here].shape[:2], COMPARED**2), np.float32)
                for _ in range(2)
            )
            for place, pixels in enumerate(values):
                found = _compared(lights, pixels, place, together)
                features[(*here, place)] = _cell_means(found.light, cell, _PARTS)
                for into, each in ((known, found.variance), (square, found.difference)):
                    means = _cell_means(each, cell, COMPARED)
                    into[place] = means.reshape(*known.shape[1:], channels).mean(axis=3)
                error[(*here, place)] = _cell_means(found.lost, cell, 1).mean(axis=2)
            moved = _moved(square, known, max(1, cell // COMPARED) ** 2 * channels)
            share = moved / (moved + known)
            error[here] += (known * share).mean(axis=3).transpose(1, 2, 0)
            split = share.reshape(*share.shape[:3], COMPARED, COMPARED).transpose(0, 1, 3, 2, 4)
            into = certainty[:, finer[0], finer[1]]
            into[...] = split.reshape(into.shape)
    return error, features, certainty


def _runs(columns: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last + 1 of consecutive columns, from even ones (of a mosaic) on."""
    pairs = np.pad(columns, (0, columns.size & 1)).reshape(-1, 2).any(axis=1)
    ends = np.flatnonzero(np.diff(np.pad(pairs, 1).astype(np.int8))).reshape(-1, 2) * 2
    return [(first, min(last, columns.size)) for first, last in ends.tolist()]


def _moved(square: Floats32, variance: Floats32, samples: int) -> Floats32:
    """Return the mean square error of ln light that movement makes of all frames, about.

    It is the largest difference of a frame from all frames beyond its noise.  Noise makes the mean
    of n squares, of K frames, larger by a share of sqrt(2 ln K) sqrt(2 / n) (Donoho and Johnstone,
    1994).

    Args:
        square: (K, ...) mean square differences
        variance: of the frames, likewise
        samples: n
    """
    beyond = math.sqrt(2 * math.log(len(square))) * math.sqrt(2 / samples)
    found = (square - variance * np.float32(1 + beyond)).max(axis=0)
    return np.asarray(np.maximum(found, np.float32(_NO_ERROR)))


@dataclass(frozen=True, eq=False)
class _Comparison:
    """What a frame shows beside all frames together, in its shape, float32.

    Attributes:
        light: its ln light, or the light of all frames where it is saturated and they show more
        variance: of it; 0 where it is saturated
        difference: square of its difference from all frames
        lost: mean square error where it is saturated, else 0
    """

    light: Floats32
    variance: Floats32
    difference: Floats32
    lost: Floats32


def _compared(
    lights: Sequence[SingleLight], pixels: Pixels, frame: int, together: Floats32
) -> _Comparison:
    """Return what some rows of a frame show beside the ln light of all frames."""
    variance, light, lost = (np.empty_like(together) for _ in range(3))
    for single in lights:
        view = single.part.view
        clipped = np.minimum(view(pixels), pixels.dtype.type(single.irradiance.shape[1] - 1))
        known = np.log(np.maximum(single.irradiance[frame], np.float32(least_light(lights))))
        saturated = np.isinf(single.deviation[frame])
        view(light)[...] = looked_up(known, clipped)
        view(variance)[...] = looked_up(np.where(saturated, 0, single.variance[frame]), clipped)
        view(lost)[...] = looked_up(np.where(saturated, single.variance[frame], 0), clipped)
        brighter = looked_up(saturated.astype(np.uint8), clipped) > 0
        brighter &= view(together) > view(light)
        np.copyto(view(light), view(together), where=brighter)
    return _Comparison(light, variance, np.square(light - together), lost)


def _cell_means(values: Floats32, cell: int, parts: int) -> Floats32:
    """Return the means over parts x parts of each cell, (cells down, cells across, parts^2 ...)."""
    planes: NDArray[Any] = values[np.newaxis] if values.ndim == 2 else np.moveaxis(values, 2, 0)
    down, across = (_shares_of_parts(length, cell, parts) for length in planes.shape[1:])
    found = (down @ planes @ across.T).reshape(
        len(planes), len(down) // parts, parts, len(across) // parts, parts
    )
    split = found.transpose(1, 3, 2, 4, 0)
    return np.asarray(split.reshape(*split.shape[:2], -1))


@lru_cache(maxsize=8)
def _shares_of_parts(length: int, cell: int, parts: int) -> Floats32:
    """Return the share of each pixel in the mean of each part of a cell, (parts, length)."""
    starts = np.arange(0, length, cell)
    # A last cell that is too narrow for parts has the same edge twice: its first sample.
    edges = np.minimum(
        (starts[:, np.newaxis] + np.arange(parts) * cell // parts).ravel(), length - 1
    )
    ends = np.maximum(np.append(edges[1:], length), edges + 1)
    pixels = np.arange(length)
    inside = (pixels >= edges[:, np.newaxis]) & (pixels < ends[:, np.newaxis])
    return np.asarray(inside / inside.sum(axis=1, keepdims=True), np.float32)
