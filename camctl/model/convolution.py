"""Distributions of sums of independent integers, of which some have the same distribution.

Transforms need be only as long as the sums that are probable, not as all that are possible: by
Chernoff's bound, P(S >= t) <= E exp(h S) / exp(h t) for each h > 0, and what lies beyond appears at
another sum, as little as it is.  The transform of a sum of k equal ones is the k-th power.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import FloatArray

LEFT_OUT = 1e-9
"""Probability at most that a sum is below, and that it is above, those that are returned."""

LEAST_FOURIER = 32
"""Sums from which a convolution is faster by Fourier transforms."""

_SHORTER = 0.6
"""Share of the possible sums from which it pays to find the probable ones."""

_MOST_WAVES, _LONGEST = 48, 1024
"""Values up to which the transform is a product of matrices, and length up to which it is."""

_LARGEST_POWER = 300.0
"""Largest h times a value in Chernoff's bound: its exponential stays finite."""


def convolved(parts: Sequence[FloatArray], counts: Sequence[int]) -> tuple[int, FloatArray]:
    """Return the least sum that is probable, and the probabilities from it, (W, Q).

    Args:
        parts: probabilities of 0, 1, ... for each kind of summand, (W1, Q), (W2, Q), ...
        counts: summands of each kind
    """
    steps = [count * (len(part) - 1) for part, count in zip(parts, counts, strict=True)]
    widest = max(range(len(parts)), key=steps.__getitem__)
    rest = sum(steps) - steps[widest]
    if rest + (steps[widest] if counts[widest] > 1 else 0) <= LEAST_FOURIER:
        total = parts[widest]
        again = [count - (kind == widest) for kind, count in enumerate(counts)]
        for part, count in zip(parts, again, strict=True):
            for _ in range(count):
                total = _added(total, part)
        return 0, total
    low, high = 0, sum(steps)
    if _spread(parts, counts) < _SHORTER * high:
        low, high = _probable(parts, counts, high)
    size = high - low + 1
    length = even_length(size)
    product = np.ones((length // 2 + 1, parts[0].shape[1]), dtype=np.complex128)
    for part, count in zip(parts, counts, strict=True):
        product *= _power(_transformed(part, length), count)
    found = np.roll(np.fft.irfft(product, length, axis=0), -low, axis=0)[:size]
    return low, np.maximum(found, 0.0, out=found)


def even_length(size: int) -> int:
    """Return a length of a fast transform from a size on: 4 to 7 times a power of 2."""
    unit = 1 << max(size.bit_length() - 3, 1)
    return -(-size // unit) * unit


def _spread(parts: Sequence[FloatArray], counts: Sequence[int]) -> float:
    """Return about the range of the probable sums, if each part holds as much of its own."""
    return math.sqrt(sum(c * len(part) ** 2 for part, c in zip(parts, counts, strict=True)))


def _probable(parts: Sequence[FloatArray], counts: Sequence[int], top: int) -> tuple[int, int]:
    """Return sums, 0 to `top`, beyond which the probability is `LEFT_OUT` at most on either side.

    Of a normal sum the best h of the bound is sqrt(2 ln(1 / LEFT_OUT)) over its deviation, which is
    taken from the widths of the parts; the bound holds for each h.
    """
    bound = -math.log(LEFT_OUT)
    h = min(4 * bound / _spread(parts, counts), _LARGEST_POWER / max(map(len, parts)))
    low, high = np.zeros((2, parts[0].shape[1]))
    for part, count in zip(parts, counts, strict=True):
        power = h * np.arange(len(part))
        below, above = np.log(np.exp(np.stack([-power, power])) @ part)
        low -= count * below
        high += count * above
    least, most = (float(low.min()) - bound) / h, (float(high.max()) + bound) / h
    return max(math.floor(least), 0), min(math.ceil(most), top)


def _transformed(part: FloatArray, length: int) -> NDArray[np.complex128]:
    """Return the Fourier transforms of the columns of a part, wrapped to a length."""
    if len(part) <= _MOST_WAVES and length <= _LONGEST:
        waves = _waves(length)[:, : len(part)] @ part
        found = np.empty((length // 2 + 1, part.shape[1]), dtype=np.complex128)
        found.real, found.imag = waves[: len(found)], waves[len(found) :]
        return found
    if len(part) > length:
        rows = np.zeros((-len(part) % length, part.shape[1]))
        part = np.concatenate([part, rows]).reshape(-1, length, part.shape[1]).sum(axis=0)
    return np.fft.rfft(part, length, axis=0)


@lru_cache(maxsize=16)
def _waves(length: int) -> FloatArray:
    """Return the real and, below, the imaginary parts of the first columns of a transform."""
    turns = np.outer(np.arange(length // 2 + 1), np.arange(_MOST_WAVES)) % length
    angles = 2 * np.pi / length * turns
    return np.concatenate([np.cos(angles), -np.sin(angles)])


def _power(base: NDArray[np.complex128], exponent: int) -> NDArray[np.complex128]:
    """Return an array to a power >= 1, by repeated squares; it may be overwritten."""
    found = None
    while exponent > 1:
        if exponent & 1:
            found = base.copy() if found is None else np.multiply(found, base, out=found)
        np.multiply(base, base, out=base)
        exponent >>= 1
    return base if found is None else np.multiply(found, base, out=found)


def _added(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the convolutions of the columns, (V + W - 1, Q) from (V, Q) and (W, Q)."""
    if len(b) > len(a):
        a, b = b, a
    if len(b) == 1:
        return a * b
    total = np.zeros((len(a) + len(b) - 1, a.shape[1]))
    for shift, each in enumerate(b):
        total[shift : shift + len(a)] += each * a
    return total
