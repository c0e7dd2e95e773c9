"""Drawing noise and quantising in compiled code (extra `fast`): bit for bit what numpy gives.

Each function below is one pass over a tile.  `load` compiles them with numba, which keeps the
machine code beside this file or in the user's cache.  Arithmetic is float32 throughout, in the
order in which `camctl.sim.noise` and `camctl.sim.render` do it with numpy, and neither contracted
nor reordered.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]

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


@dataclass(frozen=True)
class Kernels:
    """The compiled functions; all release the lock of Python."""

    add_noise: Callable[[NDArray[np.uint64], Light, Light, bool], None]
    add_bow: Callable[[Light, np.float32, np.float32], None]
    quantise: Callable[[Light, np.float32, np.float32, np.float32, NDArray[Any]], None]


@lru_cache(maxsize=1)
def load() -> Kernels | None:
    """Return the compiled functions; None without numba.

    It takes a second: numba is imported, and the machine code read.  The first time in a folder
    and for a processor, it is made, in some seconds.
    """
    try:
        import numba
    except ImportError:
        return None

    def compiled(function: Callable[..., None]) -> Callable[..., None]:
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
        try:
            made: Callable[..., None] = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder for the machine code can be written
            made = numba.njit(**options)(function)
        return made

    functions = (_add_noise, _add_bow, _quantise)
    kernels = Kernels(*(compiled(function) for function in functions))
    light, table = np.ones(1, np.float32), np.ones(1 << 16, np.float32)
    table.setflags(write=False)
    kernels.add_noise(np.ones(4, np.uint64), table, light, False)
    kernels.add_bow(light, _TWO, _ZERO)
    for dtype in (np.uint8, np.uint16):
        kernels.quantise(light, _TWO, _ZERO, _TWO, np.empty(1, dtype))
    return kernels


class KernelChoice:
    """Whether a camera uses the compiled functions.

    Args:
        is_used: True for at once, if numba is installed; False for never; None for after many
            samples, from when on they are loaded while frames are rendered without them
    """

    def __init__(self, is_used: bool | None) -> None:
        self._kernels = load() if is_used else None
        self._samples_left: float = SAMPLES_WORTH_LOADING if is_used is None else math.inf

    def after(self, samples: int) -> Kernels | None:
        """Return the functions, or None for now, when `samples` more are to be rendered."""
        before, self._samples_left = self._samples_left, self._samples_left - samples
        if before > 0 >= self._samples_left:
            threading.Thread(target=self._load, name="sim-compile").start()
        return self._kernels

    def _load(self) -> None:
        self._kernels = load()
