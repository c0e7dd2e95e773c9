"""The response that suits a scene: histogram equalisation of a metering frame, bounded in slope.

The paper's section 5 suggests it.  Plain equalisation gives nothing to brightness that the metering
frame happened not to hold, and everything to a flat wall; so the density of u over ln E is held
between a floor and a ceiling, in units of the constant-contrast density.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError
from camctl.response.camera import FloatArray
from camctl.response.desired import DesiredResponse, tabulated_desired

BINS = 64
FLOOR, CEILING = 0.1, 4.0
MOST_SAMPLES = 200_000


def auto_response(
    irradiance: ArrayLike,
    dynamic_range: float,
    *,
    weights: ArrayLike | None = None,
    bins: int = BINS,
    floor: float = FLOOR,
    ceiling: float = CEILING,
) -> DesiredResponse:
    """Return the bounded histogram-equalising response of a metering frame.

    Args:
        irradiance: any shape, E = 1 the brightest to be told apart; what lies outside
            [1/DR, 1] counts in the bin at that end, NaN and negatives are refused
        dynamic_range: DR, > 1 and finite
        weights: counts for each irradiance, same shape, e.g. of a histogram of brightness levels
        bins: how many, equally wide in ln E
        floor: least share of a bin in units of 1 / bins, in (0, 1]
        ceiling: greatest share of a bin in the same unit, >= 1

    A frame of more than `MOST_SAMPLES` pixels is sampled evenly.  A frame without light gives
    constant contrast.  Raises `DataError` and `UsageError`.
    """
    if not (np.isfinite(dynamic_range) and dynamic_range > 1):
        raise UsageError(f"dynamic range {dynamic_range:g}", hint="give a finite number above 1")
    if not (0 < floor <= 1 <= ceiling and 2 <= bins <= 4096):
        raise UsageError(
            f"bounds {floor:g} .. {ceiling:g} of {bins} bins", hint="0 < floor <= 1 <= ceiling"
        )
    E = np.asarray(irradiance).ravel()
    counts = None if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if counts is None and E.size > MOST_SAMPLES:
        E = E[:: -(-E.size // MOST_SAMPLES)]
    E = E.astype(np.float64)
    if E.size == 0 or (counts is not None and counts.size != E.size):
        raise DataError("the metering frame is empty or its weights do not fit")
    if not np.all(np.isfinite(E)) or E.min() < 0:
        raise DataError("the metering frame holds NaN or negative light")
    span = np.log(dynamic_range)
    place = np.log(np.clip(E, 1 / dynamic_range, 1.0)) / span + 1
    held = np.bincount(
        np.minimum((place * bins).astype(np.intp), bins - 1), weights=counts, minlength=bins
    ).astype(np.float64)
    share = bounded_shares(held, floor / bins, ceiling / bins)
    edges = np.exp((np.arange(bins + 1) / bins - 1) * span)
    edges[-1] = 1.0
    u = np.concatenate([[0.0], np.cumsum(share)])
    return tabulated_desired(edges, u / u[-1], name="auto")


def bounded_shares(held: FloatArray, floor: float, ceiling: float) -> FloatArray:
    """Return shares (K,) that sum to 1: clip(s * held, floor, ceiling) for the s that does it.

    Where no s does, since too few bins hold anything, what is missing is spread evenly over the
    bins that hold nothing.
    """
    total = held.sum()
    if not total > 0:
        return np.full(held.size, 1 / held.size)
    held = held / total
    low, high = 0.0, ceiling / held[held > 0].min()
    for _ in range(80):
        scale = (low + high) / 2
        if np.clip(scale * held, floor, ceiling).sum() > 1:
            high = scale
        else:
            low = scale
    share = np.clip(low * held, floor, ceiling)
    empty = held == 0
    missing = 1 - share.sum()
    if missing > 1e-9 and empty.any():
        share[empty] += missing / np.count_nonzero(empty)
    return np.asarray(share / share.sum())
