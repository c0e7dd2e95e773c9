"""Drawing noise and quantising in compiled code (extra `fast`): bit for bit what numpy gives.

Each function below is one pass over a tile.  `load` compiles them with numba, which keeps the
machine code beside this file or in the user's cache.  Arithmetic is float32 throughout, in the
order in which `camctl.sim.noise` and `camctl.sim.render` do it with numpy, and neither contracted
nor reordered.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.sim.photon_counts import (
    CELL_SHIFT,
    DOUBT,
    DOUBTED_NOISE,
    EXPANSION,
    EXPONENTIAL,
    FIRST_PLACE,
    GUIDE_CELLS,
    GUIDE_STEPS,
    LARGEST_CHECKED,
    LEAST_EXPANDED,
    MOST_COUNTED,
    PART_BITS,
    PART_SHIFT,
    STEPS,
    UNSURE,
    guide,
    tables,
)
from camctl.system.compiled_functions import LoadedLater, compiler

Light = NDArray[np.float32]
Counts = NDArray[np.float64]
Bits = NDArray[np.uint32]  # uniform numbers: (bits + 1/2) / 2^32

SAMPLES_WORTH_LOADING = 1 << 27
"""Samples that a camera renders before the compiled functions are loaded on their own: without
them that takes about as long as loading does."""

# numba takes a plain number for a float64 or an int64, and these as what they are.
_ZERO, _FIFTH, _WHOLE, _TWO, _SIX = (np.float32(x) for x in (0, 0.2, 1, 2, 6))
_ONE, _3, _11, _16, _24, _32, _40, _48 = (np.uint64(n) for n in (1, 3, 11, 16, 24, 32, 40, 48))
_LOW = np.uint64(0xFFFF)

_BLOCK = 1 << 11  # samples whose noise is kept at a time, in the fastest cache; a multiple of 4


def _add_noise(
    state: NDArray[np.uint64], table: Light, values: Light, is_photon_noise: bool
) -> None:
    """Add entries of `table` (65,536), chosen by the 16-bit parts of the words of SFC64.

    With `is_photon_noise` they are the normal numbers of
    `camctl.sim.noise.TileNoise.add_photon_noise`.
    """
    a, b, c, counter = state[0], state[1], state[2], state[3]
    z = np.empty(_BLOCK, np.float32)
    for start in range(0, values.size, _BLOCK):
        part = values[start : start + _BLOCK]
        for i in range(0, part.size, 4):
            word = a + b + counter
            counter += _ONE
            a = b ^ (b >> _11)
            b = c + (c << _3)
            c = ((c << _24) | (c >> _40)) + word
            z[i] = table[word & _LOW]
            z[i + 1] = table[(word >> _16) & _LOW]
            z[i + 2] = table[(word >> _32) & _LOW]
            z[i + 3] = table[word >> _48]
        if is_photon_noise:
            for i in range(part.size):
                mean = part[i]
                skew = mean / (mean * _SIX + _FIFTH)
                deviation = np.sqrt(mean - skew * skew * _TWO)
                part[i] = (mean - skew) + (skew * z[i] + deviation) * z[i]
        else:
            for i in range(part.size):
                part[i] += z[i]


_CELL, _FIRST, _PART = np.uint64(CELL_SHIFT), np.uint64(FIRST_PLACE), np.uint64(PART_SHIFT)
_GUIDED, _ROWS, _UNSURE = np.float32(LARGEST_CHECKED), np.float32(GUIDE_STEPS), np.uint8(UNSURE)
_UNIT, _HALF = 2.0**-32, np.uint32(2**31 - 1)
_GUIDE_SHIFT = np.uint32(32 - (GUIDE_CELLS.bit_length() - 1))
_PART_MASK, _PART_UNIT = np.uint64((1 << PART_BITS) - 1), 2.0**-PART_BITS


def _draw(coarse: NDArray[np.uint64], fine: NDArray[np.uint64], bits: Bits) -> None:
    """Set `bits` (a multiple of 4) to 16 high bits of one generator (SFC64) and 16 of another.

    Their states are left as they then are.
    """
    a, b, c, counter = coarse[0], coarse[1], coarse[2], coarse[3]
    p, q, r, number = fine[0], fine[1], fine[2], fine[3]
    for i in range(0, bits.size, 4):
        high = a + b + counter
        counter += _ONE
        a = b ^ (b >> _11)
        b = c + (c << _3)
        c = ((c << _24) | (c >> _40)) + high
        low = p + q + number
        number += _ONE
        p = q ^ (q >> _11)
        q = r + (r << _3)
        r = ((r << _24) | (r >> _40)) + low
        bits[i] = ((high & _LOW) << _16) | (low & _LOW)
        bits[i + 1] = (high & (_LOW << _16)) | ((low >> _16) & _LOW)
        bits[i + 2] = ((high >> _16) & (_LOW << _16)) | ((low >> _32) & _LOW)
        bits[i + 3] = ((high >> _32) & (_LOW << _16)) | (low >> _48)
    coarse[0], coarse[1], coarse[2], coarse[3] = a, b, c, counter
    fine[0], fine[1], fine[2], fine[3] = p, q, r, number


def _look_up(bits: Bits, counts: NDArray[np.uint8], means: Light, left: NDArray[np.int64]) -> int:
    """Replace means at the places `left` by their Poisson quantiles where the guide gives them.

    Returns:
        how many are not replaced; their places are the first of `left`
    """
    found = 0
    for j in range(left.size):
        i = left[j]
        count = _UNSURE
        if means[i] < _GUIDED:
            row = np.uint64(np.int32(means[i] * _ROWS))
            count = counts[row, np.uint64(bits[i] >> _GUIDE_SHIFT)]
        left[found] = i
        found += count == _UNSURE
        means[i] = means[i] if count == _UNSURE else np.float32(count)
    return found


def _expand(bits: Bits, normal: Counts, means: Light, left: NDArray[np.int64]) -> int:
    """Replace means by their Poisson quantiles where the expansion gives them.

    The expansion is the one of `camctl.sim.photon_counts.poisson_quantiles`.

    Returns:
        how many are not replaced; their places are the first of `left`
    """
    third, sixth, p, q, r, s, t = EXPANSION
    count = means.size
    tail, w, value = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        tail[i] = (np.float64(min(bits[i], ~bits[i])) + 0.5) * _UNIT
    places = tail.view(np.uint64)
    for i in range(count):
        place = (places[i] >> _CELL) - _FIRST
        part = np.float64(np.int32((places[i] >> _PART) & _PART_MASK)) * _PART_UNIT
        z = normal[place] + part * (normal[place + _ONE] - normal[place])
        w[i] = z if bits[i] > _HALF else -z
    for i in range(count):
        mean = max(np.float64(means[i]), 1.0)  # lower ones are left
        root = np.sqrt(mean)
        over = 1.0 / root
        square = w[i] * w[i]
        v = mean + w[i] * root + (third + square * sixth)
        v -= w[i] * (p + square * q) * over
        value[i] = v + (r + square * (s + square * t)) * over * over
    found = 0
    for i in range(count):
        whole = max(math.floor(value[i]), 0.0)
        if means[i] < LARGEST_CHECKED:
            off = value[i] - whole
            is_sure = DOUBT <= off <= 1.0 - DOUBT and abs(w[i]) <= DOUBTED_NOISE
            if means[i] < LEAST_EXPANDED or not is_sure:
                left[found] = i
                found += 1
                continue
        means[i] = whole
    return found


def _add_up(
    bits: Bits, exponentials: Counts, inverses: Counts, means: Light, left: NDArray[np.int64]
) -> None:
    """Replace the means at the places `left` by their Poisson quantiles: probabilities added up.

    All take the same number of steps, which vector instructions do, and few go on alone.
    """
    count = left.size
    mean, u, number = np.empty(count), np.empty(count), np.zeros(count)
    term, total, highest = np.empty(count), np.empty(count), 0.0
    for j in range(count):
        mean[j], u[j] = means[left[j]], (np.float64(bits[left[j]]) + 0.5) * _UNIT
        highest = max(highest, mean[j])
    for j in range(count):
        step = math.floor(mean[j] * STEPS + 0.5)
        rest = mean[j] - step * (1.0 / STEPS)
        power = EXPONENTIAL[7]
        for k in range(6, -1, -1):
            power = power * rest + EXPONENTIAL[k]
        term[j] = power * exponentials[np.uint64(step)]
        total[j] = term[j]
    together = min(int(highest + 2 * math.sqrt(highest)) + 1, MOST_COUNTED - 1)
    for k in range(together):
        inverse = inverses[k]
        for j in range(count):
            number[j] += 1.0 if u[j] > total[j] else 0.0
            term[j] *= mean[j] * inverse
            total[j] += term[j]
    for j in range(count):
        k = together
        while k < MOST_COUNTED - 1 and u[j] > total[j]:
            term[j] *= mean[j] * inverses[k]
            total[j] += term[j]
            k += 1
        means[left[j]] = number[j] + (k - together)


def _quantise(
    values: Light, scale: np.float32, offset: np.float32, top: np.float32, out: NDArray[Any]
) -> None:
    """Multiply by `scale`, add `offset`, clip to 0..top, and floor into `out`."""
    for i in range(values.size):
        out[i] = min(max(values[i] * scale + offset, _ZERO), top)


def _add_bow(dn: Light, top: np.float32, factor: np.float32) -> None:
    """Add ``factor u (1 - u / top)``, u brightness limited to 0..top."""
    for i in range(dn.size):
        u = min(max(dn[i], _ZERO), top)
        dn[i] += u * (_WHOLE - u / top) * factor


def _add_lag(values: Light, ratio: np.float32, full: np.float32, lag: np.float32) -> None:
    """Add the share `lag` of the charge before, `ratio` times this one and at most a full well."""
    for i in range(values.size):
        values[i] += min(values[i] * ratio, full) * lag


_COLUMNS = 1 << 6  # columns in which charge flows at a time: their arrays stay in a cache of 1 MB


def _bloom(picture: Light, columns: NDArray[np.intp], full: float, share: float) -> None:
    """Let `share` of the charge beyond `full` flow down these columns, and as much up; in place.

    See `camctl.sim.effects.charge`.
    """
    rows = len(picture)
    charge, flowing = np.empty((rows, _COLUMNS)), np.empty((rows, _COLUMNS))
    carried = np.empty(_COLUMNS)
    for first in range(0, columns.size, _COLUMNS):
        some = columns[first : first + _COLUMNS]
        for row in range(rows):
            for i in range(some.size):
                value = np.float64(picture[row, some[i]])
                flowing[row, i] = max(value - full, 0.0) * share
                charge[row, i] = min(value, full)
        for turn in range(2):
            carried[:] = 0.0
            for step in range(rows):
                row = step if turn == 0 else rows - 1 - step
                for i in range(some.size):
                    more = min(carried[i] + flowing[row, i], full * rows)
                    taken = min(more, full - charge[row, i])
                    charge[row, i] += taken
                    carried[i] = more - taken
        for row in range(rows):
            for i in range(some.size):
                picture[row, some[i]] = charge[row, i]


@dataclass(frozen=True)
class Kernels:
    """The compiled functions; all release the lock of Python."""

    add_noise: Callable[[NDArray[np.uint64], Light, Light, bool], None]
    draw: Callable[[NDArray[np.uint64], NDArray[np.uint64], Bits], None]
    look_up: Callable[[Bits, NDArray[np.uint8], Light, NDArray[np.int64]], int]
    expand: Callable[[Bits, Counts, Light, NDArray[np.int64]], int]
    add_up: Callable[[Bits, Counts, Counts, Light, NDArray[np.int64]], None]
    add_bow: Callable[[Light, np.float32, np.float32], None]
    quantise: Callable[[Light, np.float32, np.float32, np.float32, NDArray[Any]], None]
    add_lag: Callable[[Light, np.float32, np.float32, np.float32], None]
    bloom: Callable[[Light, NDArray[np.intp], float, float], None]


@lru_cache(maxsize=1)
def load() -> Kernels | None:
    """Return the compiled functions; None without numba.

    It takes a second: numba is imported, and the machine code read.  The first time in a folder
    and for a processor, it is made, in some seconds.
    """
    compiled = compiler()
    if compiled is None:
        return None
    functions = (_add_noise, _draw, _look_up, _expand, _add_up, _add_bow, _quantise)
    kernels = Kernels(*(compiled(each) for each in (*functions, _add_lag, _bloom)))
    light, table = np.ones(1, np.float32), np.ones(1 << 16, np.float32)
    table.setflags(write=False)
    kernels.add_noise(np.ones(4, np.uint64), table, light, False)
    bits = np.full(4, 1 << 31, np.uint32)
    kernels.draw(np.ones(4, np.uint64), np.ones(4, np.uint64), bits)
    normal, exponentials, inverses = tables()
    left = np.zeros(1, np.int64)
    kernels.look_up(bits, guide(), light, left)
    kernels.expand(bits, normal, light, left)
    kernels.add_up(bits, exponentials, inverses, light, left)
    kernels.add_bow(light, _TWO, _ZERO)
    for dtype in (np.uint8, np.uint16):
        kernels.quantise(light, _TWO, _ZERO, _TWO, np.empty(1, dtype))
    kernels.add_lag(light, _ZERO, _TWO, _ZERO)
    kernels.bloom(np.ones((1, 1), np.float32), np.zeros(1, np.intp), 1.0, 0.5)
    return kernels


class KernelChoice(LoadedLater[Kernels]):
    """Whether a camera uses the compiled functions; `is_used` as in `LoadedLater`."""

    def __init__(self, is_used: bool | None) -> None:
        super().__init__(load, SAMPLES_WORTH_LOADING, is_used)
