"""The spline that describes a response: close knots where curves bend, and an ascending fit."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camctl.model.response.camera import FloatArray

#: Number of knots, and what is added to brightness, and to its distance from full scale, before the
#: logarithm.
_KNOTS, _END = 90, 0.1
COEFFICIENTS = _KNOTS + 2
#: Least slope of ln E against ln x.
_LEAST_SLOPE = 0.02


class Knots(NamedTuple):
    """The knots of a spline over u = ln(x + 0.1) - `shoulder` ln(1.1 - x), for brightness x.

    Attributes:
        shoulder: weight of what makes the knots close at the shoulder
    """

    shoulder: float

    @property
    def step(self) -> float:
        """Distance of two knots in u."""
        return (1 + self.shoulder) * math.log((1 + _END) / _END) / (_KNOTS - 1)

    def before(self, x: FloatArray) -> FloatArray:
        """Return the place of brightness x among the knots, 0 to `_KNOTS` - 1."""
        u = np.log((x + _END) / _END) - self.shoulder * np.log((1 - x + _END) / (1 + _END))
        return np.asarray(u / self.step)

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the cubic B-splines at brightness x, (N, `COEFFICIENTS`)."""
        place = self.before(x)
        cell = np.clip(place, 0, _KNOTS - 1 - 1e-9).astype(np.intp)
        u = place - cell
        parts = ((1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3)
        values = np.zeros((x.size, COEFFICIENTS))
        for offset, part in enumerate(parts):
            values[np.arange(x.size), cell + offset] = part / 6
        return values


def ascending(
    square: FloatArray, product: FloatArray, curve: FloatArray, base: FloatArray
) -> FloatArray:
    """Return c of least c' square c / 2 - product' c, such that curve c + base ascends.

    Steps at which the solution descends become conditions, until there are none.  Hildreth's
    method solves the dual problem: one multiplier >= 0 for each condition.
    """
    inverse = np.linalg.inv(square)
    free = found = np.asarray(inverse @ product)
    rises = np.diff(curve, axis=0)
    least = (_LEAST_SLOPE - 1) * np.diff(base)
    active = np.zeros(least.size, bool)
    for _ in range(least.size):
        descending = rises @ found < least - 1e-9
        if not np.any(descending & ~active):
            break
        active |= descending
        conditions = rises[active]
        effect = inverse @ conditions.T
        gram = conditions @ effect
        lack = least[active] - conditions @ free
        multipliers = np.zeros(lack.size)
        for _ in range(200):
            before = multipliers.copy()
            for k in range(lack.size):
                step = (lack[k] - gram[k] @ multipliers) / gram[k, k]
                multipliers[k] = max(0.0, multipliers[k] + step)
            if np.array_equal(multipliers, before):
                break
        found = free + effect @ multipliers
    # What the iteration leaves is removed with certainty: h = 0 ascends with slope 1.
    rise, most = rises @ found, (1 - _LEAST_SLOPE / 2) * np.diff(base)
    falls = rise < -most
    return found * float(np.min(most[falls] / -rise[falls], initial=1.0))
