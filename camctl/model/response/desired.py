"""Desired responses: u(E) rises from 0 at e_min = 1/DR to 1 at E = 1.

DR is the dynamic range.  A desired response is a closed form (linear, gamma, constant contrast) or
a monotone table (`model.response.tabulated`).  A desired camera with G levels has the response
g = G u.  All methods take arrays of irradiance (float64, any shape, within [e_min, 1]) and return
arrays of the same shape.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import UsageError, unknown_name
from camctl.model.response.camera import FloatArray
from camctl.model.response.names import RANGES, RESPONSES
from camctl.system.number_text import range_text

MAX_RANGE = 1e12
"""Largest finite dynamic range: 40 stops, more than any scene has."""


def check_range(dynamic_range: float) -> None:
    """Raise `UsageError` unless a dynamic range is above 1 and at most `MAX_RANGE`, or infinite."""
    if not (1 < dynamic_range <= MAX_RANGE or dynamic_range == math.inf):
        raise UsageError(
            f"invalid dynamic range {dynamic_range:g}: expected a number above 1, "
            f"at most {MAX_RANGE:,.0f}"
        )


class DesiredResponse(ABC):
    """Interface of every desired response.

    Attributes:
        name: short name, for example "log"
        dynamic_range: DR, > 1; infinite means e_min = 0
        e_min: 1 / DR
        curvature: sign of the second derivative of u: -1, +1, or 0 where u is straight between
            neighbouring `knots`
        knots: (K,) float64 strictly inside (e_min, 1), where the slope of a table changes

    Raises:
        UsageError: the dynamic range is not above 1, or is finite and above `MAX_RANGE`
    """

    name: str
    curvature: int = 0
    knots: FloatArray = np.empty(0)

    def __init__(self, dynamic_range: float) -> None:
        check_range(dynamic_range)
        self.dynamic_range = float(dynamic_range)
        self.e_min = 1.0 / self.dynamic_range

    @property
    def key(self) -> str:
        """Text that identifies this response among all of the same dynamic range."""
        return self.name

    @property
    @abstractmethod
    def description(self) -> str:
        """Name and range in one line, for messages."""

    @abstractmethod
    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped to 0..1 outside [e_min, 1]."""

    @abstractmethod
    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u, for u in 0..1."""

    @abstractmethod
    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a), b >= a, to full relative accuracy even where a and b nearly agree."""

    @abstractmethod
    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE; at a knot of a table, the slope to the right of it."""

    def inverse_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope (> 0).

        Raises:
            NotImplementedError: `curvature` is 0, so that E is not unique
        """
        raise NotImplementedError(f"the slope of {self.name} does not determine the irradiance")

    def _clamp(self, E: ArrayLike) -> FloatArray:
        return np.clip(np.asarray(E, dtype=np.float64), self.e_min, 1.0)


class LinearDesired(DesiredResponse):
    """u = (E - e_min) / (1 - e_min)."""

    name = "linear"

    @property
    def description(self) -> str:
        """Name and range in one line, for messages."""
        return f"linear, range {range_text(self.dynamic_range)}"

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
    """u = (E^gamma - e_min^gamma) / (1 - e_min^gamma).

    Args:
        dynamic_range: DR, > 1
        gamma: the exponent, 0.01 to 100
    """

    def __init__(self, dynamic_range: float, gamma: float = 0.5) -> None:
        super().__init__(dynamic_range)
        if not (math.isfinite(gamma) and 0.01 <= gamma <= 100):
            raise UsageError(f"invalid gamma {gamma:g}: expected 0.01 to 100")
        self.gamma = gamma
        self.name = "gamma" if gamma == 0.5 else f"gamma {gamma:.12g}"
        self.curvature = -1 if gamma < 1 else int(gamma > 1)
        self._span = -math.expm1(-gamma * math.log(self.dynamic_range))

    @property
    def description(self) -> str:
        """Name and range in one line, for messages."""
        return f"gamma {self.gamma:g}, range {range_text(self.dynamic_range)}"

    def u(self, E: ArrayLike) -> FloatArray:
        """Return u at E, clamped."""
        E = self._clamp(E)
        return self.rise(np.full_like(E, self.e_min), E)

    def inverse(self, u: ArrayLike) -> FloatArray:
        """Return E with u(E) = u."""
        power = self.e_min**self.gamma + np.asarray(u, dtype=np.float64) * self._span
        return np.asarray(np.clip(power ** (1 / self.gamma), self.e_min, 1.0))

    def rise(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return u(b) - u(a): (b - a) / (sqrt a + sqrt b) for the square root, else by expm1.

        b^gamma - a^gamma = -b^gamma expm1(-gamma ln(b/a)), in which nothing overflows: b <= 1, and
        expm1 of a negative number is at least -1.
        """
        if self.gamma == 0.5:
            root = np.sqrt(a) + np.sqrt(b)
            return (b - a) / np.where(root > 0, root, 1.0) / self._span
        positive = np.where(a > 0, a, 1.0)
        share = -np.expm1(-self.gamma * np.log1p((b - a) / positive))
        return b**self.gamma * np.where(a > 0, share, 1.0) / self._span

    def slope(self, E: FloatArray) -> FloatArray:
        """Return du/dE, infinite at E = 0 if gamma < 1."""
        at_zero = np.inf if self.gamma < 1 else 0.0
        positive = np.where(E > 0, E, 1.0)
        return np.where(E > 0, self.gamma * positive ** (self.gamma - 1) / self._span, at_zero)

    def inverse_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope."""
        with np.errstate(over="ignore"):  # values that overflow lie above E = 1
            return np.asarray((slope * (self._span / self.gamma)) ** (1 / (self.gamma - 1)))


class LogDesired(DesiredResponse):
    """Constant contrast: u = ln(E / e_min) / ln(1 / e_min).

    Args:
        dynamic_range: DR, > 1 and finite
    """

    name = "log"
    curvature = -1

    def __init__(self, dynamic_range: float) -> None:
        super().__init__(dynamic_range)
        if math.isinf(dynamic_range):
            raise UsageError(
                "constant contrast has no value at zero irradiance",
                hint="choose a finite dynamic range",
            )
        self._span = math.log(self.dynamic_range)

    @property
    def description(self) -> str:
        """Name and range in one line, for messages."""
        return f"constant contrast, range {range_text(self.dynamic_range)}"

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

    def inverse_slope(self, slope: FloatArray) -> FloatArray:
        """Return E with du/dE = slope."""
        return 1 / (slope * self._span)


def desired_response(
    name: str, dynamic_range: float | str, *, gamma: float | None = None
) -> DesiredResponse:
    """Return the desired response of that name.

    Args:
        name: "linear", "gamma" or "log" (constant contrast)
        dynamic_range: brightest over darkest irradiance: a number above 1, or a name in `RANGES`
        gamma: exponent of "gamma", 0.01 to 100; None: 0.5

    Raises:
        UsageError: an unknown name, a value out of range, or gamma for another response

    >>> desired_response("log", 100.0).u(0.1).item()
    0.5
    >>> desired_response("gamma", 1000.0, gamma=0.45).name
    'gamma 0.45'
    """
    if isinstance(dynamic_range, str):
        if dynamic_range not in RANGES:
            raise unknown_name("dynamic range", dynamic_range, RANGES)
        dynamic_range = RANGES[dynamic_range]
    if name not in RESPONSES:
        raise unknown_name("response", name, RESPONSES)
    if name == "gamma":
        exponent = 0.5 if gamma is None else gamma
        return (
            LinearDesired(dynamic_range) if exponent == 1 else GammaDesired(dynamic_range, exponent)
        )
    if gamma is not None:
        raise UsageError(
            f"gamma {gamma:g} does not apply to the response '{name}'",
            hint="choose the response 'gamma', or leave gamma out",
        )
    return LinearDesired(dynamic_range) if name == "linear" else LogDesired(dynamic_range)
