"""Fast and reproducible noise: one seed gives one frame, whatever the number of threads.

A frame is divided into tiles of a fixed number of samples.  Each tile of each effect has its own
generator of random bits (SFC64), seeded with (seed, frame, effect, tile) by numpy's `SeedSequence`,
so that no stream depends on another.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.sim.compiled import Kernels
from camctl.sim.photon_counts import (
    LARGEST_CHECKED,
    LEAST_EXPANDED,
    guide,
    poisson_quantiles,
    tables,
)

TILE = 1 << 18
"""Samples in a tile; the frame of a seed depends on it.

Small enough for the caches, and large enough for two threads, which wait for each other at every
step (measured: 1.7 times the speed of one thread, 1.25 times with tiles of 1 << 16)."""

_COUNTED = 1 << 14  # photon counts made at a time: of 2^11 to 2^14 the fastest; a multiple of 4
_GUIDED_FIRST = 0.7  # share of low means from which looking all up first is faster (measured)
_TABLE_BITS = 16  # random bits that choose a normal quantile


class Stream(IntEnum):
    """Streams of random bits, one for each random effect; a seed's frames depend on the numbers."""

    PHOTON = 1
    READ = 2
    PRNU = 3
    DSNU = 4
    HOT = 5
    ROW = 6
    COLUMN = 7
    COSMIC = 8
    PHOTON_FINE = 9
    DCNU = 10
    RTS = 11
    RTS_STATE = 12
    ADC = 13


PATTERN = 0
"""Frame number for fixed patterns, which are the same in every frame of a seed."""


@lru_cache(maxsize=1)
def normal_quantiles() -> NDArray[np.float32]:
    """Return (65536,) float32: standard normal quantiles at the middles of equal probabilities.

    Mean 0 and variance 1 to float32 accuracy, symmetric; none is above `largest_noise`.
    """
    half = 1 << (_TABLE_BITS - 1)
    inverse = NormalDist().inv_cdf
    upper = np.array([inverse(0.5 + (i + 0.5) / (2 * half)) for i in range(half)])
    upper /= np.sqrt(np.mean(upper**2))
    table = np.concatenate((-upper[::-1], upper)).astype(np.float32)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=16)
def scaled_quantiles(sigma: float) -> NDArray[np.float32]:
    """Return `normal_quantiles` times `sigma`, which saves a product for each sample."""
    table = normal_quantiles() * np.float32(sigma)
    table.setflags(write=False)
    return table


def largest_noise() -> float:
    """Return an upper bound of |z| in `normal_quantiles`, about 4.325."""
    return NormalDist().inv_cdf(1 - 0.5 / 2**_TABLE_BITS) * 1.0001


def _bits_of(seed: int, frame: int, stream: Stream, tile: int) -> np.random.SFC64:
    return np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(frame, int(stream), tile)))


def _state(seed: int, frame: int, stream: Stream, tile: int) -> NDArray[np.uint64]:
    """Return the four words with which the generator of `tile_bits` starts."""
    state: Any = _bits_of(seed, frame, stream, tile).state
    return np.asarray(state["state"]["state"], dtype=np.uint64)


def tile_bits(seed: int, frame: int, stream: Stream, tile: int, count: int) -> NDArray[np.uint16]:
    """Return `count` uniform 16-bit numbers of one tile of one effect in one frame."""
    generator = np.random.Generator(_bits_of(seed, frame, stream, tile))
    # The full range gives the generator's raw words; `integers` releases the lock of Python.
    words = generator.integers(0, 2**64 - 1, (count + 3) // 4, dtype=np.uint64, endpoint=True)
    return words.astype("<u8", copy=False).view("<u2")[:count]


def line_noise(
    seed: int, frame: int, stream: Stream, count: int, pink_share: float = 0.0
) -> NDArray[np.float32]:
    """Return `count` standard normal numbers, one for each row or column.

    The share `pink_share` of their variance is 1/f noise along the lines; such numbers are clipped
    at `largest_noise`.
    """
    table = normal_quantiles()
    if pink_share == 0:
        return table[tile_bits(seed, frame, stream, 0, count)]
    length = 1 << (2 * count - 1).bit_length()  # the noise of a period must not repeat in a frame
    z = table[tile_bits(seed, frame, stream, 0, count + length)].astype(np.float64)
    power = 1 / np.arange(1, length // 2 + 1)
    spectrum = np.fft.rfft(z[count:])
    spectrum[0] = 0
    spectrum[1:] *= np.sqrt(power)
    pink = np.fft.irfft(spectrum, length)[:count]
    pink *= math.sqrt(length / (2 * float(power.sum()) - power[-1]))
    both = math.sqrt(1 - pink_share) * z[:count] + math.sqrt(pink_share) * pink
    most = float(table[-1])
    return np.clip(both, -most, most).astype(np.float32)


def _count(kernels: Kernels, means: NDArray[np.float32], bits: NDArray[np.uint32]) -> None:
    """Replace means by their Poisson quantiles, in place, with compiled functions."""
    normal, exponentials, inverses = tables()
    left, low = np.arange(means.size), np.count_nonzero(means < LARGEST_CHECKED)
    if low > _GUIDED_FIRST * means.size:
        left = left[: kernels.look_up(bits, guide(), means, left)]
        rest = means.take(left)
        if left.size and rest.max() >= LEAST_EXPANDED:
            places = np.empty(left.size, np.int64)
            places = places[: kernels.expand(bits.take(left), normal, rest, places)]
            means[left] = rest
            left = left[places]
    else:
        left = left[: kernels.expand(bits, normal, means, left)]
        left = left[: kernels.look_up(bits, guide(), means, left)]
    if left.size:
        kernels.add_up(bits, exponentials, inverses, means, left)


class TileNoise:
    """Draws the noise of tiles of up to `most` samples, with the working memory of one thread.

    Attributes:
        kernels: compiled functions that give the same numbers sooner, or None
    """

    def __init__(self, kernels: Kernels | None = None, most: int = TILE) -> None:
        self.kernels = kernels
        self._index = np.empty(most, dtype=np.intp)
        self._z = np.empty(most, dtype=np.float32)
        self._a = np.empty(most, dtype=np.float32)
        self._b = np.empty(most, dtype=np.float32)
        self._table = normal_quantiles()

    def normal(
        self,
        count: int,
        seed: int,
        frame: int,
        stream: Stream,
        tile: int,
        table: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return `count` normal numbers from `table`, standard normal ones by default.

        The next call overwrites them.
        """
        index, z = self._index[:count], self._z[:count]
        quantiles = self._table if table is None else table
        if self.kernels is not None:
            z.fill(0)
            self.kernels.add_noise(_state(seed, frame, stream, tile), quantiles, z, False)
            return z
        np.copyto(index, tile_bits(seed, frame, stream, tile, count))
        # 16 bits never lie outside of the table, and wrap is the fastest mode.
        quantiles.take(index, out=z, mode="wrap")
        return z

    def add_photon_noise(
        self, electrons: NDArray[np.float32], seed: int, frame: int, tile: int
    ) -> None:
        """Replace means (electrons, >= 0) by random numbers, in place.

        A Poisson number of mean m is approximated by ``m + s z + a (z^2 - 1)``, z standard normal:
        a Gaussian with the skew term of the Cornish-Fisher expansion.  ``a = m / (6 m + 0.2)`` and
        ``s^2 = m - 2 a^2`` make mean and variance exact for every m and the third moment m
        asymptotically; the 0.2 reduces the skew where m is far below one electron (any value from
        1/6 up keeps s real; 0.2 is nearest to Poisson).  With read noise of 1 e- or more added, the
        result is within 0.009 e- (Wasserstein-1) of Poisson plus Gaussian.
        """
        if self.kernels is not None:
            state = _state(seed, frame, Stream.PHOTON, tile)
            self.kernels.add_noise(state, self._table, electrons, True)
            return
        count = electrons.size
        z = self.normal(count, seed, frame, Stream.PHOTON, tile)
        a, s = self._a[:count], self._b[:count]
        np.multiply(electrons, np.float32(6), out=a)
        np.add(a, np.float32(0.2), out=a)
        np.divide(electrons, a, out=a)
        np.multiply(a, a, out=s)
        np.multiply(s, np.float32(2), out=s)
        np.subtract(electrons, s, out=s)
        np.sqrt(s, out=s)
        # s z + a z^2 - a = z (s + a z) - a
        np.subtract(electrons, a, out=electrons)
        np.multiply(a, z, out=a)
        np.add(a, s, out=a)
        np.multiply(a, z, out=a)
        np.add(electrons, a, out=electrons)

    def count_photons(
        self, electrons: NDArray[np.float32], seed: int, frame: int, tile: int
    ) -> None:
        """Replace means (electrons, >= 0) by whole Poisson numbers, in place.

        The first 16 of the 32 bits of each are the bits of `add_photon_noise`.
        """
        count = electrons.size
        if self.kernels is not None:
            coarse = _state(seed, frame, Stream.PHOTON, tile)
            fine = _state(seed, frame, Stream.PHOTON_FINE, tile)
            for start in range(0, count, _COUNTED):
                means = electrons[start : start + _COUNTED]
                bits = np.empty(-4 * (-means.size // 4), np.uint32)  # four to a word of random bits
                self.kernels.draw(coarse, fine, bits)
                _count(self.kernels, means, bits)
            return
        uniform = tile_bits(seed, frame, Stream.PHOTON, tile, count).astype(np.float64)
        uniform *= 65536.0
        uniform += tile_bits(seed, frame, Stream.PHOTON_FINE, tile, count)
        uniform += 0.5
        uniform *= 2.0**-32
        np.copyto(electrons, poisson_quantiles(electrons, uniform))

    def add_read_noise(
        self,
        electrons: NDArray[np.float32],
        sigma_e: float,
        seed: int,
        frame: int,
        tile: int,
        stream: Stream = Stream.READ,
    ) -> None:
        """Add Gaussian noise of `sigma_e` electrons in place."""
        table = scaled_quantiles(sigma_e)
        if self.kernels is not None:
            self.kernels.add_noise(_state(seed, frame, stream, tile), table, electrons, False)
            return
        noise = self.normal(electrons.size, seed, frame, stream, tile, table)
        np.add(electrons, noise, out=electrons)
