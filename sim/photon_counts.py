"""Whole Poisson numbers by inversion, for sensors whose read noise does not hide single electrons.

Each number is a function of its mean and of one uniform number, and never decreases with the mean:
another mean changes it no more than `camctl.sim.effects.bounds` says.

`camctl.sim.compiled` does the same arithmetic in the same order, with the same tables, and gives
the same bits; for that reason `exp` of a library, which differs from one to another, is not used.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

READ_NOISE_THAT_HIDES_COUNTS_E = 2.5
"""Read noise, electrons, from which whole and continuous charge cannot be distinguished: the peaks
of single electrons then have a contrast below 1e-50 (``2 exp(-2 pi^2 R^2)``), and the difference of
the distributions is below 0.006 e- (Wasserstein-1) at every mean."""

LARGEST_COUNT_NOISE = NormalDist().inv_cdf(1 - 0.5 / 2**32) * 1.0001
"""Upper bound of |z| for uniform numbers of 32 bits, about 6.34."""

COUNT_ERROR_E = 7.0
"""By how much a count differs at most from the formula ``m + s z + a (z^2 - 1)`` of the continuous
noise, highest minus lowest difference over all means for one z (`tests/sim/test_photon_counts.py`
measures 6.9)."""

LEAST_EXPANDED = 8.0  # mean, e-, from which the expansion in the normal quantile is used
LARGEST_CHECKED = 24.0  # mean, e-, up to which what the expansion leaves in doubt is added up
DOUBT = 0.03  # distance from a whole number within which the expansion may be off by one
DOUBTED_NOISE = 3.0  # abs(w) from which it may be off by more than that
MOST_COUNTED = 128  # a mean of 24 exceeds it with a probability of 1e-48
CELL_SHIFT = 44  # bits of a float64 below the 8 highest of its 52 bits of mantissa
PART_SHIFT, PART_BITS = 20, 24  # of those 44, the highest 24: the rest of 32 random bits is zero
FIRST_PLACE = (1023 - 33) << (52 - CELL_SHIFT)  # cell of 2^-33, the middle of the first of 2^32
STEPS = 16  # a table of the exponential function has this number of entries for each 1
EXPONENTIAL = tuple((-1) ** k / math.factorial(k) for k in range(8))  # within 1e-16 up to 1 / 32
EXPANSION = (1 / 3, 1 / 6, 1 / 36, 1 / 72, -8 / 405, 7 / 810, 1 / 270)  # Giles, see below
GUIDE_STEPS = 32  # cells of the guide for each electron: 0.8 MB, which fits a cache of 1 MB
GUIDE_CELLS = 1024  # and those of the uniform number
UNSURE = 255  # in the guide: the cell holds several counts
_GUIDE_MARGIN = 1e-12  # more than the rounding of probabilities that are added up
_BLOCK = 1 << 13  # samples at a time, so that the working arrays stay in the cache


@lru_cache(maxsize=1)
def tables() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return normal quantiles, ``exp(-k / 16)`` up to 24, and ``1 / k``.

    The quantiles, (8194,) and not negative, are exceeded with the probabilities p from 2^-33 to
    1/2, 256 of equal distance in each [2^-j, 2^-j+1): the place of p is the high bits of its
    float64.  The last is there twice, for the interpolation at 1/2.
    """
    inverse = NormalDist().inv_cdf
    exceeded = [math.ldexp(1 + k / 256, -j) for j in range(33, 1, -1) for k in range(256)]
    found = (
        np.array([-inverse(p) for p in exceeded] + [0.0, 0.0]),
        np.exp(-np.arange(LARGEST_CHECKED * STEPS + 1) / STEPS),
        1 / np.arange(1, MOST_COUNTED + 1),
    )
    for table in found:
        table.setflags(write=False)
    return found


@lru_cache(maxsize=1)
def guide() -> NDArray[np.uint8]:
    """Return the counts of means below `LARGEST_CHECKED` by cells of mean and uniform number.

    (768, 1024) uint8.  A count does not decrease with either of them, so that a cell has one count
    if its corners have the same; 5 % have not, and are `UNSURE`.
    """
    means = np.arange(LARGEST_CHECKED * GUIDE_STEPS + 1) / GUIDE_STEPS
    counts = np.arange(MOST_COUNTED)
    factorials = np.array([math.lgamma(k + 1) for k in counts])
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.exp(np.log(means)[:, None] * counts - means[:, None] - factorials)
    terms[0] = counts == 0
    totals = np.cumsum(terms, axis=1)
    edges = np.arange(GUIDE_CELLS + 1) / GUIDE_CELLS
    least = [np.searchsorted(row, edges[:-1] - _GUIDE_MARGIN) for row in totals[:-1]]
    most = [np.searchsorted(row, edges[1:] + _GUIDE_MARGIN) for row in totals[1:]]
    found = np.where(np.equal(least, most), least, UNSURE).astype(np.uint8)
    found.setflags(write=False)
    return found


def normal_of(uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return standard normal quantiles (`tables`), linear in between, for multiples of 2^-33."""
    quantiles = tables()[0]
    bits = np.minimum(uniform, 1 - uniform).view(np.int64)
    place = (bits >> CELL_SHIFT) - FIRST_PLACE
    part = ((bits >> PART_SHIFT) & ((1 << PART_BITS) - 1)) * 2.0**-PART_BITS
    low = quantiles.take(place)
    z = low + part * (quantiles.take(place + 1) - low)
    return np.where(uniform > 0.5, z, -z)


def poisson_quantiles(
    means: NDArray[np.float32], uniform: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the Poisson number of each mean whose cumulative probability first reaches `uniform`.

    Args:
        means: electrons, >= 0
        uniform: of the same shape, above 0 and below 1

    Below a mean of 8 the probabilities are added up, which is exact, and up to a mean of 24 where
    the expansion is in doubt.  Otherwise the quantile is the expansion in the normal quantile w
    by Giles (Algorithm 955, ACM TOMS 42, 2016, Q_N2), rounded down:
    ``m + w sqrt m + (1/3 + w^2/6) - (w/36 + w^3/72) / sqrt m
    + (-8/405 + 7 w^2/810 + w^4/270) / m``.
    """
    counts = np.empty_like(means)
    for start in range(0, means.size, _BLOCK):
        here = slice(start, start + _BLOCK)
        mean, u, count = means[here].astype(np.float64), uniform[here], counts[here]
        few = mean < LEAST_EXPANDED
        if few.all():
            count[...] = _summed(mean, u)
        elif not few.any():
            count[...] = _expanded(mean, u)
        else:
            count[few] = _summed(mean[few], u[few])
            count[~few] = _expanded(mean[~few], u[~few])
    return counts


def _summed(mean: NDArray[np.float64], uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how many of the probabilities of 0, 1, 2, ... electrons add up to less."""
    _, exponentials, inverses = tables()
    step = np.floor(mean * STEPS + 0.5)
    rest = mean - step * (1 / STEPS)
    term = np.full_like(mean, EXPONENTIAL[-1])
    for factor in EXPONENTIAL[-2::-1]:
        term = term * rest + factor
    term *= exponentials.take(step.astype(np.intp))
    total = term.copy()
    count = np.zeros_like(mean)
    for k in range(1, MOST_COUNTED):
        is_beyond = uniform > total
        if not is_beyond.any():
            break
        count += is_beyond
        term *= mean * inverses[k - 1]
        total += term
    return count


def _expanded(mean: NDArray[np.float64], uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    third, sixth, p, q, r, s, t = EXPANSION
    w = normal_of(uniform)
    root = np.sqrt(mean)
    over = 1 / root
    square = w * w
    value = mean + w * root + (third + square * sixth)
    value -= w * (p + square * q) * over
    value += (r + square * (s + square * t)) * over * over
    count = np.maximum(np.floor(value), 0.0)
    is_checked = mean < LARGEST_CHECKED
    if is_checked.any():
        off = value - count
        is_checked &= (off < DOUBT) | (off > 1 - DOUBT) | (square > DOUBTED_NOISE**2)
        count[is_checked] = _summed(mean[is_checked], uniform[is_checked])
    return np.asarray(count)
