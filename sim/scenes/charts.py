"""Drawings of test charts, and of what is brighter than any chart: the sun."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]

ALL = slice(None)
"""All rows of a drawing."""

_ROWS_OF_A_PIXEL = 16  # at which an edge is drawn exactly; their mean is the light of the pixel

_STEPS = (4, 5)  # rows and columns of the grey steps

_SUN = 160_000.0  # 1.6e9 cd/m^2, in units of a white in sunlight of 10,000 cd/m^2
_SUN_AT = (0.66, 0.26)  # share of width and height
_COLOURS = ((0.55, 0.30, 0.75), (0.72, 0.42, 0.68), (1.0, 0.55, 0.22))
"""Sky, hills and field in red, in green, and in blue."""

_SUN_RADIUS = 0.0066  # share of the width: half a degree in a picture of 40 degrees


def slanted_edge(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return an edge 5 degrees off the vertical with a contrast of 4, as in ISO 12233.

    Each pixel has the mean light on its area.
    """
    lines = np.arange(rows * _ROWS_OF_A_PIXEL).reshape(rows, _ROWS_OF_A_PIXEL)[part].reshape(-1)
    y = (lines + 0.5) / _ROWS_OF_A_PIXEL - rows / 2
    edge = columns / 2 - y * math.tan(math.radians(5))
    dark = np.clip(edge[:, np.newaxis] - np.arange(columns), 0, 1)
    share = dark.reshape(-1, _ROWS_OF_A_PIXEL, columns).mean(axis=1)
    return np.asarray(1 - share * (1 - 1 / 4), dtype=np.float32)


def grey_steps(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return 20 grey steps of equal ratio over 1:10,000, as for an OECF (ISO 14524).

    They lie on a grey of 18 %, row by row from the brightest, 1, to the darkest.
    """
    down, across = _STEPS
    y = (np.arange(rows)[part, np.newaxis] + 0.5) / rows * down
    x = (np.arange(columns) + 0.5) / columns * across
    number = np.floor(y) * across + np.floor(x)
    steps = 10_000.0 ** (-number / (down * across - 1))
    is_step = (np.abs(y % 1 - 0.5) < 0.4) & (np.abs(x % 1 - 0.5) < 0.4)
    return np.where(is_step, steps, 0.18).astype(np.float32)


def outdoor_sun(rows: int, columns: int, part: slice = ALL) -> Light:
    """Return a field below the sun, RGB: a white in sunlight would have 1, the sun has 160,000."""
    x = (np.arange(columns) + 0.5) / columns
    y = (np.arange(rows)[part, np.newaxis] + 0.5) / rows
    at_x, at_y = x - _SUN_AT[0], (y - _SUN_AT[1]) * rows / columns
    off = np.hypot(at_x, at_y) / _SUN_RADIUS
    # The air around the sun is bright by forward scattering.
    air = 0.25 + 3.0 / (1 + (off / 3) ** 2) + 0.6 * np.exp(-off / 30)
    ridge = 0.62 + 0.03 * np.sin(x * 9 + 1) + 0.012 * np.sin(x * 31)
    furrow = np.sin((x - 0.5) / np.maximum(y - 0.5, 0.02) * 22) * np.clip((y - 0.66) * 6, 0, 1)
    field = (0.16 + 0.05 * furrow) * np.clip(0.5 + y, 0, 1.4)
    trunk = np.abs(x - 0.2) < 0.012 + 0.01 * np.clip(y - 0.7, 0, 1)
    is_tree = (trunk & (y > 0.45) & (y < 0.8)) | (
        np.hypot((x - 0.2) * 1.2, (y - 0.4) * rows / columns)
        < 0.11 + 0.012 * np.sin(np.arctan2(y - 0.4, x - 0.2) * 11)
    )
    picture = np.empty((len(y), columns, 3), dtype=np.float32)
    sun = np.clip((1 - off) * _SUN_RADIUS * columns + 0.5, 0, 1) * _SUN
    for channel, (sky, hills, grass) in enumerate(_COLOURS):
        light = np.where(y < ridge, air * sky + sun, 0.09 * hills)
        light = np.where(y > 0.66, field * grass, light)
        picture[..., channel] = np.where(is_tree, 0.012 * grass, light)
    return picture
