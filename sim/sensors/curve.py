"""The curve of a sensor that is not linear: its samples, and the level of each irradiance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import FloatArray, srgb_to_linear

_LOOKUP_BINS = 1 << 14  # of irradiance: 4 for each level of 12 bits


@dataclass(frozen=True, eq=False)
class LevelLookup:
    """Looks up the level of an irradiance by its bin and then by comparing: exact and fast.

    Attributes:
        levels_below: (bins,) levels that are <= the start of each bin
        next_level: (levels + 1,) irradiance of each level; infinite after the last
        most_in_bin: most levels in one bin
    """

    levels_below: NDArray[np.uint16]
    next_level: NDArray[np.float32]
    most_in_bin: int

    @classmethod
    def of(cls, levels: NDArray[np.float64]) -> LevelLookup:
        """Return the lookup for `levels`, (M,) irradiances in ascending order."""
        edges = np.arange(_LOOKUP_BINS + 1) / _LOOKUP_BINS
        # Levels are rounded to float32 as irradiance is, so that equal ones compare as equal.
        rounded = levels.astype(np.float32)
        below = np.searchsorted(rounded, edges.astype(np.float32), side="right")
        ahead = np.append(rounded, np.float32(np.inf))
        return cls(below[:-1].astype(np.uint16), ahead, int(np.diff(below).max()))

    def brightness(self, irradiance: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return how many levels are <= each irradiance, which is clipped to 0..1."""
        inside = np.clip(irradiance, 0, np.float32(1))
        place = np.minimum((inside * np.float32(_LOOKUP_BINS)).astype(np.intp), _LOOKUP_BINS - 1)
        count = self.levels_below[place]
        for _ in range(self.most_in_bin):
            count += inside >= self.next_level[count]
        return count


def curve_samples(
    curve: str | float | tuple[tuple[float, float], ...],
) -> tuple[FloatArray, FloatArray]:
    """Return irradiance and brightness of samples of a curve, both from 0 to 1."""
    if isinstance(curve, tuple):
        table = np.array(curve, dtype=np.float64).reshape(-1, 2)
        return table[:, 0], table[:, 1]
    # Evenly spaced in brightness, so that the steep foot of the curve is sampled as finely.
    brightness = np.linspace(0.0, 1.0, 4097)
    if curve == "srgb":
        return srgb_to_linear(brightness), brightness
    return brightness ** (1 / float(curve)), brightness
