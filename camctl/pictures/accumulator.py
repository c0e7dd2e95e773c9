"""The sum of frames, taken one after the other: those of a capture while they arrive.

By the paper's theorem 1 the plain sum keeps all the information of the single frames.  Each frame
is clipped at its white level first: saturated samples that still vary would otherwise add their
noise to the highlights.  Black stays in and is subtracted once, from the sum, as a signed number:
clipping each frame at black would bias the dark.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CaptureError, UsageError
from camctl.interface.camera import Pixels
from camctl.pictures.compiled_sum import CHOICE

#: Samples of a tile: its work arrays stay in the cache, and numpy's call overhead is small; of 2^14
#: to 2^20 the fastest in `tests/bench/bench_live.py`.
_TILE = 1 << 20


class Accumulator:
    """The running sum of `min(frame, white)`.

    Args:
        shape: of a frame, (rows, columns) or (rows, columns, 3)
        dtype: of a frame, uint8 or uint16
        count: number of frames that the sum is for
        white: brightness at which each frame is clipped, DN

    `total` is the sum, in the frames' shape.
    """

    def __init__(
        self, shape: tuple[int, ...], dtype: np.dtype[np.unsignedinteger], count: int, white: int
    ) -> None:
        self.total: NDArray[np.unsignedinteger] = np.zeros(shape, sum_dtype(count, white))
        self.white = white
        self._dtype = np.dtype(dtype)
        self._highest = self._dtype.type(min(white, np.iinfo(self._dtype).max))
        self._clips = white < np.iinfo(self._dtype).max
        # numpy's minimum is vectorised between arrays but not against a scalar: 9 times faster.
        self._ceiling = np.full(min(_TILE, self.total.size), white if self._clips else 0, dtype)
        self._narrow = np.empty_like(self._ceiling)

    def fit(self, count: int) -> None:
        """Make the sum of the narrowest type for `count` frames; it holds no more than these."""
        self.total = self.total.astype(sum_dtype(count, self.white), copy=False)

    def accumulate(self, pixels: Pixels) -> None:
        """Add one frame, clipped at white.

        Raises:
            CaptureError: the frame's shape or type differs from the others
        """
        sums, samples = CHOICE.after(self.total.size), self._samples(pixels)
        if sums is not None:
            sums.add(self.total.reshape(-1), samples, self._highest)
        else:
            self._each_tile((samples, np.add))

    def withdraw(self, pixels: Pixels) -> None:
        """Subtract a frame that was added before, exactly."""
        sums, samples = CHOICE.after(self.total.size), self._samples(pixels)
        if sums is not None:
            sums.subtract(self.total.reshape(-1), samples, self._highest)
        else:
            self._each_tile((samples, np.subtract))

    def exchange(self, old: Pixels, new: Pixels) -> None:
        """Subtract a frame that was added before, and add one in its place, in one pass."""
        sums, both = CHOICE.after(self.total.size), (self._samples(old), self._samples(new))
        if sums is not None:
            sums.exchange(self.total.reshape(-1), *both, self._highest)
        else:
            self._each_tile((both[1], np.add), (both[0], np.subtract))

    def _each_tile(self, *steps: tuple[NDArray[Any], np.ufunc]) -> None:
        """Add or subtract frames tile by tile."""
        total = self.total.reshape(-1)
        for start in range(0, total.size, _TILE):
            here = total[start : start + _TILE]
            for source, operation in steps:
                tile = source[start : start + _TILE]
                if self._clips:
                    narrow = self._narrow[: tile.size]
                    tile = np.minimum(tile, self._ceiling[: tile.size], out=narrow)
                operation(here, tile, out=here)

    def _samples(self, pixels: Pixels) -> NDArray[Any]:
        """Return the samples of a frame, (S,)."""
        if pixels.shape != self.total.shape or pixels.dtype != self._dtype:
            raise CaptureError(
                f"a frame of {pixels.shape} {pixels.dtype} came after frames of "
                f"{self.total.shape} {self._dtype}",
                hint="keep the camera's format fixed during a capture",
            )
        return np.ascontiguousarray(pixels).reshape(-1)


def sum_dtype(count: int, white: int) -> np.dtype[np.unsignedinteger]:
    """Return the narrowest unsigned type that holds the sum of `count` samples of up to `white`.

    Raises:
        UsageError: 32 bits are not enough
    """
    for kind in (np.uint16, np.uint32):
        if count * white <= np.iinfo(kind).max:
            return np.dtype(kind)
    raise UsageError(
        f"the sum of {count} exposures of up to {white} does not fit in 32 bits",
        hint=f"take at most {np.iinfo(np.uint32).max // white} exposures",
    )
