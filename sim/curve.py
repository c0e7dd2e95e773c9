"""The ADC of a sensor with a curve: from irradiance to the number of levels below it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_BINS = 1 << 14


@dataclass(frozen=True, eq=False)
class Curve:
    """Levels of a non-linear response, found by a bin and then by comparing: exact and fast."""

    levels_below: NDArray[np.uint16]
    next_level: NDArray[np.float32]
    most_in_bin: int

    @classmethod
    def of(cls, levels: NDArray[np.float64]) -> Curve:
        """Return the curve of `levels`, (M,) irradiances in ascending order."""
        edges = np.arange(_BINS + 1) / _BINS
        # float32 levels here and float32 irradiance there: one rounding decides on both sides.
        rounded = levels.astype(np.float32)
        below = np.searchsorted(rounded, edges.astype(np.float32), side="right")
        ahead = np.append(rounded, np.float32(np.inf))
        return cls(below[:-1].astype(np.uint16), ahead, int(np.diff(below).max()))

    def brightness(self, irradiance: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return how many levels are <= each irradiance (clipped to 0..1)."""
        inside = np.clip(irradiance, 0, np.float32(1))
        place = np.minimum((inside * np.float32(_BINS)).astype(np.intp), _BINS - 1)
        count = self.levels_below[place]
        for _ in range(self.most_in_bin):
            count += inside >= self.next_level[count]
        return count
