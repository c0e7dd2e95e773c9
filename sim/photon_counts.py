"""Whole Poisson numbers by inversion, for sensors whose read noise does not hide single electrons.

Each number is a function of its mean and of one uniform number, and never decreases with the mean:
another mean changes it no more than `camctl.sim.effects.bounds` says.
"""

from __future__ import annotations

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

_LEAST_EXPANDED = 8.0  # mean from which the expansion in the normal quantile is used
_BLOCK = 1 << 13  # samples at a time, so that the working arrays stay in the cache
_LARGEST_CHECKED = 24.0  # mean up to which what the expansion leaves in doubt is added up
_DOUBT = 0.03  # distance from a whole number within which the expansion may be off by one
_DOUBTED_NOISE = 3.0  # abs(w) from which it may be off by more than that
_MOST_COUNTED = 128  # a mean of 24 exceeds it with a probability of 1e-48
_CELLS = 1 << 16  # of the quantile: one for each 16 random bits


@lru_cache(maxsize=1)
def _cell_edges() -> NDArray[np.float64]:
    """Return (65537,) normal quantiles at multiples of 2^-16; the ends are not used."""
    inverse = NormalDist().inv_cdf
    upper = [inverse(0.5 + i / _CELLS) for i in range(_CELLS // 2)]
    upper.append(LARGEST_COUNT_NOISE)
    edges = np.array(upper)
    return np.concatenate((-edges[:0:-1], edges))


def normal_of(uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return standard normal quantiles: linear between multiples of 2^-16, exact in the tails.

    In the first 16 cells at either end, where a straight line is not near enough, each quantile is
    computed.
    """
    edges = _cell_edges()
    place = uniform * _CELLS
    cell = place.astype(np.intp)
    low = edges.take(cell)
    z = low + (place - cell) * (edges.take(cell + 1) - low)
    inverse = NormalDist().inv_cdf
    for index in np.flatnonzero((cell < 16) | (cell >= _CELLS - 16)):
        z[index] = inverse(uniform[index])
    return np.asarray(z)


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
        few = mean < _LEAST_EXPANDED
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
    term = np.exp(-mean)
    total = term.copy()
    count = np.zeros_like(mean)
    for k in range(1, _MOST_COUNTED):
        is_beyond = uniform > total
        if not is_beyond.any():
            break
        count += is_beyond
        term *= mean
        term /= k
        total += term
    return count


def _expanded(mean: NDArray[np.float64], uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    w = normal_of(uniform)
    root = np.sqrt(mean)
    square = w * w
    value = mean + w * root + (1 / 3 + square / 6)
    value -= w * (1 / 36 + square / 72) / root
    value += (-8 / 405 + square * (7 / 810 + square / 270)) / mean
    count = np.maximum(np.floor(value), 0.0)
    is_checked = mean < _LARGEST_CHECKED
    if is_checked.any():
        off = value - count
        is_checked &= (off < _DOUBT) | (off > 1 - _DOUBT) | (square > _DOUBTED_NOISE**2)
        count[is_checked] = _summed(mean[is_checked], uniform[is_checked])
    return np.asarray(count)
