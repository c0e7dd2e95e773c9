"""From R, G and B of a camera to linear BT.709, plane by plane."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from camctl.interface.colour import CameraColour

_Planes = tuple[NDArray[np.float32], ...]
#: Irradiance that is saturated is rounded by less than this share, see `render`.
_ROUNDED = np.float32(2.0**-8)
#: The least channel of a colour that a display shows, as a share of its luminance: a lower one is
#: outside of the display's range, or cannot be told from 0.
_LEAST_CHANNEL = np.float32(0.01)
#: Luminance of the primaries of BT.709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
#: Stands for an infinite standard deviation; its square is finite.
_LARGEST_DEVIATION = np.float32(1e18)


def to_bt709(colour: CameraColour, planes: _Planes, full: Sequence[float]) -> _Planes:
    """Return R, G and B in linear BT.709, float32, (rows, columns) each.

    A channel that every frame saturated is at least as bright as the brightest one after the white
    balance: white stays white, where the matrix would make it magenta.

    Args:
        colour: of the camera
        planes: its R, G and B
        full: irradiance from which each of them is saturated
    """
    balance = [np.float32(each) for each in colour.white_balance]
    balanced = [plane * factor for plane, factor in zip(planes, balance, strict=True)]
    saturated = [
        plane >= np.float32(most) * (1 - _ROUNDED) for plane, most in zip(planes, full, strict=True)
    ]
    if any(each.any() for each in saturated):
        largest = reduce(np.maximum, balanced)
        balanced = [
            np.where(each, largest, plane) for each, plane in zip(saturated, balanced, strict=True)
        ]
    return _product(np.array(colour.matrix), balanced)


def deviation_in_bt709(colour: CameraColour, planes: _Planes) -> _Planes:
    """Return the standard deviations of what `to_bt709` returns; those of R, G, B are independent.

    It is infinite where that of a channel is, and NaN where that of one is not known.
    """
    finite = [np.minimum(each, _LARGEST_DEVIATION) for each in planes]  # NaN stays
    found = _product(colour.of_samples**2, [each * each for each in finite])
    for each in found:
        np.sqrt(each, out=each)
        each[each > _LARGEST_DEVIATION / 100] = np.inf
    return found


def in_gamut(planes: _Planes, before: _Planes) -> _Planes:
    """Return colours as a display can show them: those beyond its range become less saturated.

    Args:
        planes: R, G and B in linear BT.709
        before: of the camera; where a channel shows no light there it shows none now
    """
    luminance = sum(plane * weight for plane, weight in zip(planes, LUMINANCE, strict=True))
    least = reduce(np.minimum, planes)
    limit = luminance * _LEAST_CHANNEL
    outside = least < limit
    unlit = [each <= 0 for each in before]
    if not outside.any() and not any(each.any() for each in unlit):
        return planes
    span = np.where(outside, luminance - least, np.float32(1))
    kept = np.where(outside, (luminance - limit) / np.where(span > 0, span, np.float32(1)), 1)
    kept = kept.astype(np.float32)
    return tuple(
        np.where(dark, np.float32(0), np.maximum(luminance + kept * (plane - luminance), 0))
        for plane, dark in zip(planes, unlit, strict=True)
    )


def _product(matrix: NDArray[np.float64], planes: Sequence[NDArray[np.float32]]) -> _Planes:
    rows = matrix.astype(np.float32)
    return tuple(
        np.asarray(sum(plane * weight for plane, weight in zip(planes, row, strict=True)))
        for row in rows
    )
