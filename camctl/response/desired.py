"""Desired cameras: u from 0 at E_min = 1/DR to 1 at E = 1, as closed forms or monotone tables.

The wanted response is g = G u, with G the wanted number of levels.  All methods take arrays of
irradiance (float64, any shape, within [e_min, 1]) and return arrays of the same shape.
"""

from __future__ import annotations

import hashlib
import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError, unknown_name
from camctl.response.camera import FloatArray

RANGES: dict[str, float] = {"low": 256.0, "medium": 1000.0, "high": 16000.0}
RESPONSES: tuple[str, ...] = ("linear", "gamma", "log")


class DesiredResponse(ABC):
    """What every desired response can tell.

    Attributes:
        name: what a person calls it, e.g. "log"
        dynamic_range: DR, > 1; infinite means e_min = 0
        e_min: 1 / DR
        bend: -1 where the slope falls with E, +1 where it rises, 0 where it is constant between
            neighbouring `knots`
        knots: (K,) float64 strictly inside (e_min, 1), where the slope of a table changes
    """

    name: str
    bend: int = 0
    knots: FloatArray = np.empty(0)

    def __init__(self, dynamic_range: float) -> None:
        if math.isnan(dynamic_range) or dynamic_range <= 1:
            raise UsageError(
                f"dynamic range {dynamic_range:g}", hint="brightest over darkest must be above 1"
            )
        self.dynamic_range = float(dynamic_range)
        self.e_min = 1.0 / self.dynamic_range

    @property
    def key(self) -> str:
        """What tells this response from any other of the same dynamic range."""
        return self.name

    @property
    @abstractmethod
    def description(self) -> str:
        """One line for people."""

    @abstractmethod
    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped to 0..1 outside [e_min, 1]."""

    @abstractmethod
    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u, for u in 0..1."""

    @abstractmethod
    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a) to full relative accuracy however near a and b >= a are."""

    @abstractmethod
    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE; on a knot of a table, the slope on the right."""

    def where_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope (> 0); only where `bend` is not 0."""
        raise NotImplementedError(f"{self.name} has no single place for a slope")

    def _clamp(self, E: ArrayLike) -> FloatArray:
        return np.clip(np.asarray(E, dtype=np.float64), self.e_min, 1.0)


class LinearDesired(DesiredResponse):
    """u = (E - e_min) / (1 - e_min)."""

    name = "linear"

    @property
    def description(self) -> str:
        """One line for people."""
        return f"linear, range 1:{self.dynamic_range:g}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        return (self._clamp(E) - self.e_min) / (1 - self.e_min)

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u."""
        return self.e_min + np.asarray(u, dtype=np.float64) * (1 - self.e_min)

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a)."""
        return (b - a) / (1 - self.e_min)

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE, a constant."""
        return np.full_like(E, 1 / (1 - self.e_min))


class GammaDesired(DesiredResponse):
    """u = (E^q - e_min^q) / (1 - e_min^q), q > 0 and not 1."""

    def __init__(self, dynamic_range: float, q: float = 0.5) -> None:
        super().__init__(dynamic_range)
        if not (math.isfinite(q) and 0.01 <= q <= 100):
            raise UsageError(f"gamma exponent {q:g}", hint="q lies between 0.01 and 100")
        self.q = q
        self.name = "gamma" if q == 0.5 else f"gamma {q:.12g}"
        self.bend = -1 if q < 1 else int(q > 1)
        self._span = -math.expm1(-q * math.log(self.dynamic_range))

    @property
    def description(self) -> str:
        """One line for people."""
        return f"gamma {self.q:g}, range 1:{self.dynamic_range:g}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        E = self._clamp(E)
        return self.rise(np.full_like(E, self.e_min), E)

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u."""
        power = self.e_min**self.q + np.asarray(u, dtype=np.float64) * self._span
        return np.asarray(np.clip(power ** (1 / self.q), self.e_min, 1.0))

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a); the square root without subtraction, other powers by expm1."""
        if self.q == 0.5:
            root = np.sqrt(a) + np.sqrt(b)
            return (b - a) / np.where(root > 0, root, 1.0) / self._span
        positive = np.where(a > 0, a, 1.0)
        near = positive**self.q * np.expm1(self.q * np.log1p((b - a) / positive))
        return np.where(a > 0, near, b**self.q) / self._span

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE, infinite at E = 0 where q < 1."""
        at_zero = np.inf if self.q < 1 else 0.0
        positive = np.where(E > 0, E, 1.0)
        return np.where(E > 0, self.q * positive ** (self.q - 1) / self._span, at_zero)

    def where_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope."""
        return np.asarray((slope * (self._span / self.q)) ** (1 / (self.q - 1)))


class LogDesired(DesiredResponse):
    """Constant contrast: u = ln(E / e_min) / ln(1 / e_min)."""

    name = "log"
    bend = -1

    def __init__(self, dynamic_range: float) -> None:
        super().__init__(dynamic_range)
        if math.isinf(dynamic_range):
            raise UsageError(
                "constant contrast down to no light at all", hint="give a finite range"
            )
        self._span = math.log(self.dynamic_range)

    @property
    def description(self) -> str:
        """One line for people."""
        return f"constant contrast, range 1:{self.dynamic_range:g}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        E = self._clamp(E)
        return self.rise(np.full_like(E, self.e_min), E)

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u."""
        return np.exp((np.asarray(u, dtype=np.float64) - 1) * self._span)

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a)."""
        return np.log1p((b - a) / a) / self._span

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE."""
        return 1 / (E * self._span)

    def where_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope."""
        return 1 / (slope * self._span)


class TabulatedDesired(DesiredResponse):
    """A monotone table, linear between its points."""

    def __init__(self, irradiance: ArrayLike, u: ArrayLike, name: str) -> None:
        E = np.array(irradiance, dtype=np.float64)
        values = np.array(u, dtype=np.float64)
        if E.ndim != 1 or E.shape != values.shape or E.size < 2:
            raise DataError(f"{name}: a desired response needs two or more pairs (irradiance, u)")
        if not (np.all(np.isfinite(E)) and np.all(np.isfinite(values))):
            raise DataError(f"{name}: a number of the desired response is not finite")
        if np.any(np.diff(E) <= 0) or E[0] <= 0:
            raise DataError(f"{name}: irradiance must be positive and increase from row to row")
        if np.any(np.diff(values) < 0) or values[-1] <= values[0]:
            raise DataError(f"{name}: u must not decrease and must rise somewhere")
        super().__init__(float(E[-1] / E[0]))
        self.name = name
        self._E = E / E[-1]
        self.e_min = float(self._E[0])
        self._u = (values - values[0]) / (values[-1] - values[0])
        self._slopes = np.diff(self._u) / np.diff(self._E)
        self.knots = self._E[1:-1]

    @property
    def key(self) -> str:
        """The name and a hash of the table."""
        data = np.concatenate([self._E, self._u]).astype("<f8").tobytes()
        return f"{self.name}#{hashlib.sha256(data).hexdigest()[:16]}"

    @property
    def description(self) -> str:
        """One line for people."""
        return f"{self.name}, {self._E.size} points, range 1:{self.dynamic_range:g}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        return np.asarray(np.interp(np.asarray(E, dtype=np.float64), self._E, self._u))

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u; on a flat run, its left end."""
        wanted = np.clip(np.asarray(u, dtype=np.float64), 0.0, 1.0)
        right = np.maximum(np.searchsorted(self._u, wanted, side="left"), 1)
        left = right - 1
        height = self._u[right] - self._u[left]
        share = (wanted - self._u[left]) / np.where(height > 0, height, 1.0)
        return np.asarray(self._E[left] + share * (self._E[right] - self._E[left]))

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a); exact to rounding within one piece of the table."""
        same = self._piece(a) == self._piece_below(b)
        return np.where(same, self.slope(a) * (b - a), self.u(b) - self.u(a))

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE, on a knot that of the right side."""
        return np.asarray(self._slopes[self._piece(E)])

    def _piece(self, E: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
        last = self._slopes.size - 1
        return np.clip(np.searchsorted(self._E, E, side="right") - 1, 0, last)

    def _piece_below(self, E: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.intp]]:
        last = self._slopes.size - 1
        return np.clip(np.searchsorted(self._E, E, side="left") - 1, 0, last)


def desired_response(name: str, dynamic_range: float | str, *, q: float = 0.5) -> DesiredResponse:
    """Return the desired response that a menu names.

    `name` is one of `RESPONSES`; `dynamic_range` a number above 1 or one of `RANGES`; `q` is the
    exponent of gamma.  Raises `UsageError`.

    >>> desired_response("log", 100.0).u(0.1).item()
    0.5
    """
    if isinstance(dynamic_range, str):
        if dynamic_range not in RANGES:
            raise unknown_name("dynamic range", dynamic_range, RANGES)
        dynamic_range = RANGES[dynamic_range]
    if name == "gamma":
        return LinearDesired(dynamic_range) if q == 1 else GammaDesired(dynamic_range, q)
    if name == "linear":
        return LinearDesired(dynamic_range)
    if name == "log":
        return LogDesired(dynamic_range)
    raise unknown_name("response", name, RESPONSES)


def tabulated_desired(
    irradiance: ArrayLike, u: ArrayLike, *, name: str = "table"
) -> DesiredResponse:
    """Return a desired response from a monotone table of two or more rows.

    Irradiance (> 0, increasing) is scaled so that its last row is E = 1, u so that it runs from 0
    to 1.  Raises `DataError`.
    """
    return TabulatedDesired(irradiance, u, name)
