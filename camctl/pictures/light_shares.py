"""How the light of a picture is spread over its range, from the sum of the frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.interface.controls import Layout
from camctl.model.response.desired import DesiredResponse
from camctl.pictures.render import DARK, GOOD, SATURATED, Tables
from camctl.system.picture_operations import level_counts

BINS = 40
"""Bins of the histogram: a line of a terminal holds them beside two numbers."""

#: Range of the histogram where the picture's is infinite.
_WIDEST = 2.0**20


@dataclass(frozen=True)
class LightShares:
    """Shares of the samples of a picture.

    Attributes:
        saturated: with light above the range: saturated in every frame
        dark: with light below the range
        histogram: with light in each of `BINS` equal steps of ln E, from the range's lower end on
    """

    saturated: float
    dark: float
    histogram: tuple[float, ...]


def light_shares(
    layout: Layout,
    total: NDArray[np.unsignedinteger],
    tables: Sequence[Tables],
    desired: DesiredResponse,
) -> LightShares:
    """Return the shares of a sum within and outside of the range.

    Args:
        layout: pixel layout of the sum
        total: (rows, columns) or (rows, columns, 3)
        tables: one for all of the sum, or one each for R, G and B of a mosaic
        desired: the desired response
    """
    planes = [total]
    if len(tables) > 1:
        planes = layout.planes(total)
        tables = [tables["RGB".index(colour)] for colour in layout.value.upper()]
    lowest = max(desired.e_min, 1 / _WIDEST)
    saturated, dark, histogram = 0.0, 0.0, np.zeros(BINS)
    for plane, table in zip(planes, tables, strict=True):
        shares = level_counts(plane, table.mask.size) / total.size
        saturated += float(shares[table.mask == SATURATED].sum())
        dark += float(shares[table.mask == DARK].sum())
        inside = table.mask == GOOD
        position = np.log(np.clip(table.shown[inside], lowest, 1.0)) / -math.log(lowest) + 1
        bins = np.minimum((position * BINS).astype(np.intp), BINS - 1)
        histogram += np.bincount(bins, weights=shares[inside], minlength=BINS)
    return LightShares(saturated, dark, tuple(histogram.tolist()))
