"""Desired responses given by a table: monotone, linear between the points."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError
from camctl.model.response.camera import FloatArray
from camctl.model.response.desired import DesiredResponse
from camctl.system.number_text import range_text


class TabulatedDesired(DesiredResponse):
    """A monotone table, linear between its points; see `tabulated_desired`."""

    def __init__(self, irradiance: ArrayLike, u: ArrayLike, name: str) -> None:
        E = np.array(irradiance, dtype=np.float64)
        values = np.array(u, dtype=np.float64)
        if E.ndim != 1 or E.shape != values.shape or E.size < 2:
            raise DataError(
                f"invalid desired response '{name}': expected two or more pairs (irradiance, u)"
            )
        if not (np.all(np.isfinite(E)) and np.all(np.isfinite(values))):
            raise DataError(f"invalid desired response '{name}': a number is not finite")
        if np.any(np.diff(E) <= 0) or E[0] <= 0:
            raise DataError(
                f"invalid desired response '{name}': irradiance must be positive and increase "
                "from row to row"
            )
        if np.any(np.diff(values) < 0) or values[-1] <= values[0]:
            raise DataError(
                f"invalid desired response '{name}': u must not decrease and must not be constant"
            )
        super().__init__(float(E[-1] / E[0]))
        self.name = name
        self._E = E / E[-1]
        self.e_min = float(self._E[0])
        self._u = (values - values[0]) / (values[-1] - values[0])
        self._slopes = np.diff(self._u) / np.diff(self._E)
        self.knots = self._E[1:-1]

    @property
    def key(self) -> str:
        """The name, and the start of a hash of the table."""
        data = np.concatenate([self._E, self._u]).astype("<f8").tobytes()
        return f"{self.name}#{hashlib.sha256(data).hexdigest()[:16]}"

    @property
    def description(self) -> str:
        """Name and range in one line, for messages."""
        return f"{self.name}, {self._E.size} points, range {range_text(self.dynamic_range)}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        return np.asarray(np.interp(np.asarray(E, dtype=np.float64), self._E, self._u))

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u; on a flat run, its left end."""
        target = np.clip(np.asarray(u, dtype=np.float64), 0.0, 1.0)
        right = np.maximum(np.searchsorted(self._u, target, side="left"), 1)
        left = right - 1
        height = self._u[right] - self._u[left]
        share = (target - self._u[left]) / np.where(height > 0, height, 1.0)
        return np.asarray(self._E[left] + share * (self._E[right] - self._E[left]))

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a), by the slope where a and b lie between the same points."""
        same = self._piece(a) == self._piece_below(b)
        return np.where(same, self.slope(a) * (b - a), self.u(b) - self.u(a))

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE; at a knot, the slope to the right of it."""
        return np.asarray(self._slopes[self._piece(E)])

    def _piece(self, E: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
        last = self._slopes.size - 1
        return np.clip(np.searchsorted(self._E, E, side="right") - 1, 0, last)

    def _piece_below(self, E: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
        last = self._slopes.size - 1
        return np.clip(np.searchsorted(self._E, E, side="left") - 1, 0, last)


def tabulated_desired(
    irradiance: ArrayLike, u: ArrayLike, *, name: str = "table"
) -> DesiredResponse:
    """Return a desired response given by points, linear between them.

    The last irradiance over the first is the dynamic range.  Irradiance is scaled so that the last
    is E = 1, and u so that it goes from 0 to 1.

    Args:
        irradiance: (K,) increasing, > 0, K >= 2
        u: (K,) not decreasing, not constant: the desired brightness at each irradiance, any unit
        name: name shown to people

    Raises:
        DataError: the points do not meet these conditions

    >>> tabulated_desired([0.01, 0.1, 1.0], [0, 3, 4]).u([0.01, 0.1, 1.0]).tolist()
    [0.0, 0.75, 1.0]
    """
    return TabulatedDesired(irradiance, u, name)
