"""The knots of the spline that describes a response, close where curves bend most."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camctl.model.response.camera import FloatArray

#: Number of knots, and what is added to brightness, and to its distance from full scale, before the
#: logarithm.
_KNOTS, _END = 90, 0.1
COEFFICIENTS = _KNOTS + 2


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
