"""The objective: how many wanted levels are missing (the paper's equations 2 and 3, exactly).

The derivative of a staircase is one level per gap: h' = 1/(b - a) on a gap (a, b) between
neighbouring levels, the first gap starting at 0 and the last ending at 1.  Then

    xi = sum over gaps of  integral over (a, b) within [e_min, 1] of  max(0, g'(E) - 1/(b-a))^p dE

with g = G u the wanted response.  A gap that straddles e_min keeps its full width b - a.  For p = 1
each integral is a difference of g; a gap with g' (b - a) <= 1 throughout adds nothing and is never
divided by, so that gaps of 0 and 1e-15 are harmless.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.desired import DesiredResponse
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.norms import power_of_excess
from camctl.exposure.real import FloatArray


@dataclass(frozen=True, eq=False)
class Pieces:
    """Stretches of gaps within [e_min, 1], one row each.

    Attributes:
        low: (K,) float64, where the stretch begins
        high: (K,) float64, where it ends, > low
        width: (K,) float64, the full width of the gap it belongs to, >= high - low
    """

    low: FloatArray
    high: FloatArray
    width: FloatArray


def pieces_of(levels: FloatArray, desired: DesiredResponse) -> Pieces:
    """Return the gaps of ascending `levels` within [e_min, 1], parted at the knots of a table."""
    last = [1.0] if levels[-1] < 1 else []
    edges = np.concatenate([[0.0], levels, last])
    low, high = edges[:-1], edges[1:]
    width = high - low
    low, high = np.maximum(low, desired.e_min), np.minimum(high, 1.0)
    kept = high > low
    low, high, width = low[kept], high[kept], width[kept]
    knots = desired.knots
    if knots.size:
        cuts = np.union1d(low, knots)
        gap = np.searchsorted(low, cuts, side="right") - 1
        ends = np.minimum(np.append(cuts[1:], 1.0), high[gap])
        low, high, width = cuts, ends, width[gap]
    return Pieces(low, high, width)


@dataclass(frozen=True, eq=False)
class Excess:
    """Where more levels are wanted than there are: on [start, stop] of a gap of `width`.

    Attributes:
        start, stop, width: (K,) float64
    """

    start: FloatArray
    stop: FloatArray
    width: FloatArray


def excess_of(pieces: Pieces, desired: DesiredResponse, levels_wanted: float) -> Excess:
    """Return the part of each piece on which g' > 1 / width; pieces without one are left out."""
    low, high, width = pieces.low, pieces.high, pieces.width
    steepest = low if desired.bend <= 0 else high
    wanting = levels_wanted * desired.slope(steepest) * width > 1
    low, high, width = low[wanting], high[wanting], width[wanting]
    if desired.bend == 0 or not width.size:
        return Excess(low, high, width)
    crossing = np.clip(desired.where_slope(1 / (levels_wanted * width)), low, high)
    if desired.bend < 0:
        return Excess(low, crossing, width)
    return Excess(crossing, high, width)


def check_objective(levels_wanted: float, p: float) -> None:
    """Raise `UsageError` unless G > 0 and p >= 1."""
    if not (math.isfinite(levels_wanted) and levels_wanted > 0):
        raise UsageError(
            f"{levels_wanted:g} wanted levels", hint="G is a positive number, for example 765"
        )
    if not (math.isfinite(p) and 1 <= p <= 16):
        raise UsageError(f"norm p = {p:g}", hint="p lies between 1 and 16")


def xi(
    camera: EffectiveCamera | FloatArray,
    desired: DesiredResponse,
    levels_wanted: float,
    *,
    p: float = 1.0,
) -> float:
    """Return the objective of a camera, or of an ascending (N,) float64 array of its levels.

    `levels_wanted` is G, the levels that the desired camera has over its range.  For p = 1 the
    unit is levels: how many of the wanted ones are missing.  Raises `UsageError` for G <= 0 and
    p < 1, and for p > 1 with e_min = 0, where the integral need not exist.

    >>> from camctl.exposure.response import desired_response, linear_response
    >>> camera = EffectiveCamera.of(linear_response(8), (1, 1.003))
    >>> round(xi(camera, desired_response("linear", 512.0), 510), 2)
    106.21
    """
    check_objective(levels_wanted, p)
    levels = camera.levels if isinstance(camera, EffectiveCamera) else camera
    found = excess_of(pieces_of(levels, desired), desired, levels_wanted)
    if p != 1:
        return power_of_excess(found.start, found.stop, found.width, desired, levels_wanted, p)
    missing = levels_wanted * desired.rise(found.start, found.stop)
    missing -= (found.stop - found.start) / found.width
    return float(np.sum(np.maximum(missing, 0.0)))
