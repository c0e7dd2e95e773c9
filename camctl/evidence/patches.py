"""Samples of a frame in small patches.

A patch is a square of neighbouring samples of one colour.  Its mean has little noise, and what is
true of most patches of a frame is true of its exposure: a moving object changes only its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import FloatArray

SIDE = 8
"""Side of a patch in samples of one colour, as of the blocks of JPEG files (ITU-T T.81)."""

#: Patches of a frame, about.
_PATCHES = 4800
#: Distances at which the samples of a patch are compared to see whether they are equal.
_STEPS_APART = (1, 9, 27)

Patches: TypeAlias = NDArray[np.uint16]
"""Brightness up to white, black included, (patches, samples)."""


def sample_patches(planes: Sequence[NDArray[Any]], white: int) -> Patches:
    """Return patches all over a frame, which is given as one array (rows, columns) a colour.

    Frames of one size have the same patches, colour by colour and row by row.
    """
    rows, columns, side = patch_places([plane.shape for plane in planes])
    found = np.empty((len(planes), rows.size, columns.size, side, side), planes[0].dtype)
    for place, plane in enumerate(planes):
        squares = np.lib.stride_tricks.sliding_window_view(plane, (side, side))
        found[place] = squares[rows[:, None], columns]
    return np.asarray(np.minimum(found.reshape(-1, side * side), white), np.uint16)


def patch_places(
    shapes: Sequence[Sequence[int]],
) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
    """Return first rows, first columns and side of the patches of planes of these shapes.

    They are the same in all planes; those of a mosaic of odd size differ by a row or a column.
    """
    shape = [min(lengths) for lengths in zip(*shapes, strict=True)]
    side = min(SIDE, max(1, min(shape) // 4))
    most = math.isqrt(_PATCHES // len(shapes))
    # Blocks of JPEG files begin at multiples of their side.
    rows, columns = (
        np.linspace(0, length - side, min(length // side, most)).astype(np.intp) // side * side
        for length in shape
    )
    return rows, columns, side


def marked_samples(marks: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return how many samples of each patch, (patches, samples), are marked.

    In a third of the time of `np.count_nonzero`.
    """
    return np.asarray(marks.astype(np.float32) @ np.ones(marks.shape[1], np.float32), np.intp)


def shared_rounding(
    frame: Patches, middle: NDArray[np.intp], sample: FloatArray, gap: FloatArray
) -> FloatArray:
    """Return the variance of the rounding error that does not average out within a patch.

    Samples of one value share their error, also with the patches of the same brightness `middle`.
    Noise of s levels averages it out, up to exp(-4 (pi s)^2) of the variance.
    """
    equal = np.mean([frame == np.roll(frame, step, axis=1) for step in _STEPS_APART], axis=(0, 2))
    alike = np.bincount(middle)[middle]
    noisy = np.exp(-4 * np.square(np.pi) * sample / gap**2)
    return np.asarray(gap**2 / 12 * noisy * equal * (1 + (alike - 1) * equal))
