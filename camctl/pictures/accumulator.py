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

    def accumulate(self, pixels: Pixels) -> None:
        """Add one frame, clipped at white.

        Raises:
            CaptureError: the frame's shape or type differs from the others
        """
        self._each_tile((pixels, False))

    def withdraw(self, pixels: Pixels) -> None:
        """Subtract a frame that was added before, exactly."""
        self._each_tile((pixels, True))

    def exchange(self, old: Pixels, new: Pixels) -> None:
        """Subtract a frame that was added before, and add one in its place, in one pass."""
        self._each_tile((new, False), (old, True))

    def _each_tile(self, *steps: tuple[Pixels, bool]) -> None:
        """Add or subtract (True) frames tile by tile."""
        sources = [self._samples(pixels) for pixels, _ in steps]
        total = self.total.reshape(-1)
        sums = CHOICE.after(total.size)
        # Compiled, one step is one pass already; two steps go over a tile in the cache.
        size = total.size if sums is not None and len(steps) == 1 else _TILE
        for start in range(0, total.size, max(size, 1)):
            here = total[start : start + size]
            for source, (_, is_subtracted) in zip(sources, steps, strict=True):
                tile = source[start : start + size]
                if sums is not None:
                    work = sums.subtract if is_subtracted else sums.add
                    work(here, tile, self._highest)
                    continue
                if self._clips:
                    narrow = self._narrow[: tile.size]
                    tile = np.minimum(tile, self._ceiling[: tile.size], out=narrow)
                operation = np.subtract if is_subtracted else np.add
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
