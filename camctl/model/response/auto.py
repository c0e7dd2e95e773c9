"""The desired response that suits a scene: bounded histogram equalisation of a metering frame.

Grossberg and Nayar suggest it in section 5.  Plain equalisation gives no levels to brightnesses
that the metering frame does not contain, and nearly all of them to a uniform wall.  Therefore the
density of u over ln E is bounded on both sides, in units of the density of constant contrast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError
from camctl.model.response.camera import FloatArray
from camctl.model.response.desired import DesiredResponse
from camctl.model.response.tabulated import tabulated_desired

BINS = 64
"""Bins of the histogram, equally wide in ln E."""

MIN_DENSITY, MAX_DENSITY = 0.1, 4.0
"""Bounds of the density of u over ln E; constant contrast has density 1 everywhere."""

MAX_SAMPLES = 200_000
"""A larger metering frame is sampled evenly: more pixels do not change 64 bins noticeably."""


def auto_response(
    irradiance: ArrayLike, dynamic_range: float, *, weights: ArrayLike | None = None
) -> DesiredResponse:
    """Return the bounded histogram-equalising response of a metering frame.

    A frame without light gives constant contrast.

    Args:
        irradiance: any shape, >= 0; E = 1 is the upper end of the dynamic range.  Values outside
            [1/DR, 1] count in the bin at that end
        dynamic_range: DR, > 1 and finite
        weights: counts for each irradiance, same shape, for example of a histogram of brightness
            levels

    Raises:
        UsageError: the dynamic range is not a finite number above 1
        DataError: the frame is empty, holds negative or non-finite values, or does not match its
            weights
    """
    if not (np.isfinite(dynamic_range) and dynamic_range > 1):
        raise UsageError(
            f"invalid dynamic range {dynamic_range:g}: expected a finite number above 1"
        )
    E = np.asarray(irradiance).ravel()
    counts = None if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if counts is None and E.size > MAX_SAMPLES:
        E = E[:: -(-E.size // MAX_SAMPLES)]
    E = E.astype(np.float64)
    if E.size == 0:
        raise DataError("the metering frame is empty")
    if counts is not None and counts.size != E.size:
        raise DataError(
            f"the metering frame has {E.size} irradiances and {counts.size} weights: "
            "expected one weight for each"
        )
    if not np.all(np.isfinite(E)) or E.min() < 0:
        raise DataError("the metering frame contains a negative or non-finite irradiance")
    log_range = np.log(dynamic_range)
    position = np.log(np.clip(E, 1 / dynamic_range, 1.0)) / log_range + 1
    histogram = np.bincount(
        np.minimum((position * BINS).astype(np.intp), BINS - 1), weights=counts, minlength=BINS
    ).astype(np.float64)
    shares = bounded_shares(histogram, MIN_DENSITY / BINS, MAX_DENSITY / BINS)
    edges = np.exp((np.arange(BINS + 1) / BINS - 1) * log_range)
    edges[-1] = 1.0
    u = np.concatenate([[0.0], np.cumsum(shares)])
    return tabulated_desired(edges, u / u[-1], name="auto")


def bounded_shares(histogram: FloatArray, low: float, high: float) -> FloatArray:
    """Return shares (K,) that sum to 1: clip(s * histogram, low, high) with the s that does so.

    If too few bins are occupied, no s does; then the remainder is spread evenly over the empty
    bins.
    """
    total = histogram.sum()
    if not total > 0:
        return np.full(histogram.size, 1 / histogram.size)
    histogram = histogram / total
    too_small, too_large = 0.0, high / histogram[histogram > 0].min()
    for _ in range(80):
        scale = (too_small + too_large) / 2
        if np.clip(scale * histogram, low, high).sum() > 1:
            too_large = scale
        else:
            too_small = scale
    shares = np.clip(too_small * histogram, low, high)
    empty = histogram == 0
    remainder = 1 - shares.sum()
    if remainder > 1e-9 and empty.any():
        shares[empty] += remainder / np.count_nonzero(empty)
    return np.asarray(shares / shares.sum())
