"""The values that one control of a camera has: a list, or equal steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np


def _ratio_distance(value: float) -> Callable[[float], float]:
    return lambda choice: abs(math.log(choice / value))


@dataclass(frozen=True)
class Choices:
    """A control with a list of settings.

    Attributes:
        values: the settings, different, ascending, > 0

    Raises:
        ValueError: `values` is empty or not ascending
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.values or list(self.values) != sorted(set(self.values)):
            raise ValueError(f"invalid choices {self.values}: expected different ascending values")

    @property
    def minimum(self) -> float:
        """The smallest setting."""
        return self.values[0]

    @property
    def maximum(self) -> float:
        """The largest setting."""
        return self.values[-1]

    def nearest(self, value: float) -> float:
        """Return the setting nearest to `value` (> 0) as a ratio."""
        return min(self.values, key=_ratio_distance(value))

    def near(self, value: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings nearest to `value` (> 0) as ratios, ascending.

        >>> Choices((1.0, 3.0)).near(1.9, 1)
        (3.0,)
        """
        ranked = sorted(self.values, key=_ratio_distance(value))
        return tuple(sorted(ranked[:count]))

    def between(self, low: float, high: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings within [low, high], the largest ones, ascending."""
        return tuple(value for value in self.values if low <= value <= high)[-count:]


@dataclass(frozen=True)
class Steps:
    """A control that goes from `minimum` to `maximum` in equal steps.

    Attributes:
        minimum: smallest setting, > 0
        maximum: largest setting
        step: distance between neighbouring settings; 0: continuous

    Raises:
        ValueError: the values do not meet 0 < minimum <= maximum and step >= 0
    """

    minimum: float
    maximum: float
    step: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.minimum <= self.maximum < math.inf and 0 <= self.step < math.inf):
            raise ValueError(
                f"invalid range {self.minimum:g} to {self.maximum:g} in steps of {self.step:g}: "
                "expected 0 < minimum <= maximum and step >= 0"
            )

    @property
    def _last(self) -> int:
        return math.floor((self.maximum - self.minimum) / self.step * (1 + 1e-12) + 1e-9)

    def _at(self, index: int) -> float:
        return self.minimum + min(max(index, 0), self._last) * self.step

    def nearest(self, value: float) -> float:
        """Return the setting nearest to `value`."""
        value = min(max(value, self.minimum), self.maximum)
        return self._at(round((value - self.minimum) / self.step)) if self.step else value

    def near(self, value: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings nearest to `value`, ascending; one where continuous."""
        value = min(max(value, self.minimum), self.maximum)
        if self.step == 0:
            return (value,)
        first = round((value - self.minimum) / self.step - (count - 1) / 2)
        first = max(0, min(first, self._last - count + 1))
        return tuple(self._at(i) for i in range(first, min(first + count, self._last + 1)))

    def between(self, low: float, high: float, count: int) -> tuple[float, ...]:
        """Return up to `count` settings within [low, high], the largest ones, ascending."""
        low, high = max(low, self.minimum), min(high, self.maximum)
        if low > high:
            return ()
        if self.step == 0:
            return tuple(float(v) for v in np.unique(np.geomspace(low, high, count)))
        first = math.ceil((low - self.minimum) / self.step - 1e-9)
        last = math.floor((high - self.minimum) / self.step + 1e-9)
        return tuple(self._at(i) for i in range(max(first, last - count + 1), last + 1))


Control: TypeAlias = Choices | Steps
