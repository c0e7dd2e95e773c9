"""The objective: how many wanted levels are missing (the paper's equations 2 and 3, exactly).

The derivative of a staircase is one level per gap: h' = 1/(b - a) on a gap (a, b) between
neighbouring levels, the first gap starting at 0 and the last ending at 1.  Then

    xi = sum over gaps of  integral over (a, b) within [e_min, 1] of  max(0, g'(E) - 1/(b-a))^p dE

with g = G u the wanted response.  A gap that straddles e_min keeps its full width b - a.  For p = 1
each integral is a difference of g; a gap with g' (b - a) <= 1 throughout adds nothing and is never
divided by, so that gaps of 0 and 1e-15 are harmless.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camctl.errors import UsageError, unknown_name
from camctl.exposure.effective import EffectiveCamera, check_exposures, union_of_levels
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse


@dataclass(frozen=True, eq=False)
class Pieces:
    """Stretches of gaps within [e_min, 1], one row each.

    Attributes:
        low: (K,) float64, where the stretch begins
        high: (K,) float64, where it ends, > low
        width: (K,) float64, the full width of the gap it belongs to, >= high - low
    """

    low: FloatArray
    high: FloatArray
    width: FloatArray


def pieces_of(levels: FloatArray, desired: DesiredResponse) -> Pieces:
    """Return the gaps of ascending `levels` within [e_min, 1], parted at the knots of a table."""
    last = [1.0] if levels[-1] < 1 else []
    edges = np.concatenate([[0.0], levels, last])
    low, high = edges[:-1], edges[1:]
    width = high - low
    low, high = np.maximum(low, desired.e_min), np.minimum(high, 1.0)
    kept = high > low
    low, high, width = low[kept], high[kept], width[kept]
    knots = desired.knots
    if knots.size:
        cuts = np.union1d(low, knots)
        gap = np.searchsorted(low, cuts, side="right") - 1
        ends = np.minimum(np.append(cuts[1:], 1.0), high[gap])
        low, high, width = cuts, ends, width[gap]
    return Pieces(low, high, width)


@dataclass(frozen=True, eq=False)
class Excess:
    """Where more levels are wanted than there are: on [start, stop] of a gap of `width`.

    Attributes:
        start, stop, width: (K,) float64
    """

    start: FloatArray
    stop: FloatArray
    width: FloatArray


def excess_of(pieces: Pieces, desired: DesiredResponse, levels_wanted: float) -> Excess:
    """Return the part of each piece on which g' > 1 / width; pieces without one are left out."""
    low, high, width = pieces.low, pieces.high, pieces.width
    steepest = low if desired.bend <= 0 else high
    wanting = levels_wanted * desired.slope(steepest) * width > 1
    low, high, width = low[wanting], high[wanting], width[wanting]
    if desired.bend == 0 or not width.size:
        return Excess(low, high, width)
    crossing = np.clip(desired.where_slope(1 / (levels_wanted * width)), low, high)
    if desired.bend < 0:
        return Excess(low, crossing, width)
    return Excess(crossing, high, width)


def check_objective(levels_wanted: float, p: float) -> None:
    """Raise `UsageError` unless G > 0 and p >= 1."""
    if not (math.isfinite(levels_wanted) and levels_wanted > 0):
        raise UsageError(
            f"{levels_wanted:g} wanted levels", hint="G is a positive number, for example 765"
        )
    if not (math.isfinite(p) and 1 <= p <= 16):
        raise UsageError(f"norm p = {p:g}", hint="p lies between 1 and 16")


def xi(
    camera: EffectiveCamera | FloatArray,
    desired: DesiredResponse,
    levels_wanted: float,
    *,
    p: float = 1.0,
) -> float:
    """Return the objective of a camera, or of an ascending (N,) float64 array of its levels.

    `levels_wanted` is G, the levels that the desired camera has over its range.  For p = 1 the
    unit is levels: how many of the wanted ones are missing.  Raises `UsageError` for G <= 0 and
    p < 1, and for p > 1 with e_min = 0, where the integral need not exist.

    >>> from camctl.exposure.response import desired_response, linear_response
    >>> camera = EffectiveCamera.of(linear_response(8), (1, 1.003))
    >>> round(xi(camera, desired_response("linear", 512.0), 510), 2)
    106.21
    """
    check_objective(levels_wanted, p)
    levels = camera.levels if isinstance(camera, EffectiveCamera) else camera
    found = excess_of(pieces_of(levels, desired), desired, levels_wanted)
    if p != 1:
        return power_of_excess(found.start, found.stop, found.width, desired, levels_wanted, p)
    missing = levels_wanted * desired.rise(found.start, found.stop)
    missing -= (found.stop - found.start) / found.width
    return float(np.sum(np.maximum(missing, 0.0)))


NODES = 16
HALVINGS = 26
CHUNK = 2048


def _panels(p: float, bend: int) -> tuple[FloatArray, FloatArray]:
    """Return edges in 0..1 (panels' starts and lengths), dense towards where g' meets h'."""
    if p == round(p):
        return np.array([0.0]), np.array([1.0])
    powers = 0.5 ** np.arange(HALVINGS + 1)
    edges = np.concatenate([1 - powers, [1.0]])
    if bend > 0:
        edges = (1 - edges)[::-1]
    return edges[:-1], np.diff(edges)


def power_of_excess(
    start: FloatArray,
    stop: FloatArray,
    width: FloatArray,
    desired: DesiredResponse,
    levels_wanted: float,
    p: float,
) -> float:
    """Return the sum over rows of the integral of (g' - 1/width)^p over [start, stop].

    `start`, `stop` and `width` are (K,) float64, with g' >= 1/width throughout.
    """
    if not start.size:
        return 0.0
    if desired.bend == 0:
        height = np.maximum(levels_wanted * desired.slope(start) - 1 / width, 0.0)
        return float(np.sum(height**p * (stop - start)))
    if start[0] <= 0:
        raise UsageError(f"p = {p:g} down to no light at all", hint="give a finite dynamic range")
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    nodes, weights = (nodes + 1) / 2, weights / 2
    offsets, lengths = _panels(p, desired.bend)
    length = np.log1p((stop - start) / start)
    longest = float(length.max())
    total = 0.0
    for first in range(0, start.size, CHUNK):
        rows = slice(first, first + CHUNK)
        parts = int(np.ceil(min(longest, float(length[rows].max())))) or 1
        for part in range(parts):
            for offset, share in zip(offsets, lengths, strict=True):
                place = (part + offset + share * nodes) / parts
                t = length[rows, np.newaxis] * place
                E = start[rows, np.newaxis] * np.exp(t)
                height = levels_wanted * desired.slope(E) - 1 / width[rows, np.newaxis]
                value = np.maximum(height, 0.0) ** p * E
                total += float(np.sum((value @ weights) * length[rows])) * share / parts
    return total


NOISE_KINDS: tuple[str, ...] = ("paper", "time", "aperture", "gain")
JITTER_DRAWS = 8


@dataclass(frozen=True)
class NoiseTerm:
    """The paper's equation 4: `weight` times V is added to xi.

    Attributes:
        sigma: standard deviation of one frame at exposure 1, in irradiance (1 is full scale)
        weight: c, in the unit of xi per squared irradiance
        kind: which V, for exposures e_1 = 1 <= e_2 ...:
            "paper": sigma^2 sum 1/e_j, as printed for a linear camera
            "time", "aperture": n sigma^2 / (sum e_j)^2, the variance that read noise leaves in the
            irradiance when light grows with e and read noise does not
            "gain": sigma^2 sum e_j^2 / (sum e_j)^2, where gain raises noise with the signal
    """

    sigma: float
    weight: float = 1.0
    kind: str = "paper"

    def __post_init__(self) -> None:
        if self.kind not in NOISE_KINDS:
            raise unknown_name("noise term", self.kind, NOISE_KINDS)
        for name in ("sigma", "weight"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"noise {name} {value:g}", hint="give a number >= 0")

    def cost(self, exposures: FloatArray) -> FloatArray:
        """Return c V, (B,) from (B, n) exposures."""
        n = exposures.shape[1]
        if self.kind == "paper":
            share = (1 / exposures).sum(axis=1)
        elif self.kind == "gain":
            share = (exposures**2).sum(axis=1) / exposures.sum(axis=1) ** 2
        else:
            share = n / exposures.sum(axis=1) ** 2
        return np.asarray(self.weight * self.sigma**2 * share)


@dataclass(frozen=True)
class Objective:
    """The whole objective.

    Attributes:
        levels_wanted: G
        p: the norm, >= 1
        noise: the term c V, or None
        jitter: relative standard deviation with which exposures come out; xi is then the mean over
            `JITTER_DRAWS` fixed Gaussian draws in opposite pairs
    """

    levels_wanted: float
    p: float = 1.0
    noise: NoiseTerm | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        check_objective(self.levels_wanted, self.p)
        if not (math.isfinite(self.jitter) and 0 <= self.jitter <= 0.2):
            raise UsageError(
                f"exposure jitter {self.jitter:g}", hint="give a fraction from 0 to 0.2"
            )

    def draws(self, n: int) -> FloatArray:
        """Return (J, n) factors on the exposures to average over; (1, n) ones without jitter.

        The first exposure is the unit and stays; a common factor would only shift the base.
        """
        if self.jitter == 0:
            return np.ones((1, n))
        half = np.random.default_rng(20030616).standard_normal((JITTER_DRAWS // 2, 16))[:, :n]
        factors = np.exp(self.jitter * np.concatenate([half, -half]))
        return np.asarray(factors / factors[:, :1])

    def score(
        self, response: CameraResponse, exposures: Sequence[float], desired: DesiredResponse
    ) -> float:
        """Return the objective exactly (float64); `exposures` ascending from 1."""
        values = np.array(check_exposures(exposures))
        factors = self.draws(values.size)
        total = sum(
            xi(
                union_of_levels(response.levels, values * factor),
                desired,
                self.levels_wanted,
                p=self.p,
            )
            for factor in factors
        )
        noise = 0.0 if self.noise is None else float(self.noise.cost(values[np.newaxis])[0])
        return total / len(factors) + noise
