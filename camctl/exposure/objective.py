"""The objective of the search, exactly: how many desired levels are missing.

The derivative of a staircase is one level per gap: h' = 1/(b - a) on a gap (a, b) between
neighbouring levels; the first gap starts at 0 and the last ends at 1.  Then (Grossberg and Nayar,
equations 2 and 3)::

    xi = sum over gaps of  integral over (a, b) within [e_min, 1] of  max(0, g'(E) - 1/(b-a))^p dE

with g = G u the desired response.  A gap that contains e_min keeps its full width b - a.  For p = 1
each integral is a difference of g.  A gap with g' (b - a) <= 1 throughout contributes nothing and
its width is never a divisor, so that gaps of width 0 and 1e-15 cause no error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.noise import NoiseTerm
from camctl.model.effective import (
    MOST_SEARCHED,
    EffectiveCamera,
    blocks,
    check_count,
    check_exposures,
    union_of_levels,
)
from camctl.model.response.camera import CameraResponse, FloatArray, every_nth_level
from camctl.model.response.desired import DesiredResponse


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Parts of gaps within [e_min, 1], one row each.

    Attributes:
        start: (K,) float64, lower end
        stop: (K,) float64, upper end, >= start
        width: (K,) float64, the full width of the gap, >= stop - start
    """

    start: FloatArray
    stop: FloatArray
    width: FloatArray


def _pieces_of(edges: FloatArray, desired: DesiredResponse) -> _Pieces:
    """Return the gaps between edges within [e_min, 1], divided at the knots of a table."""
    low, high = edges[:-1], edges[1:]
    width = high - low
    low, high = np.maximum(low, desired.e_min), np.minimum(high, 1.0)
    kept = high > low
    low, high, width = low[kept], high[kept], width[kept]
    knots = desired.knots
    if knots.size and low.size:
        knots = knots[(knots > low[0]) & (knots < high[-1])]
        cuts = np.union1d(low, knots)
        gap = np.searchsorted(low, cuts, side="right") - 1
        ends = np.minimum(np.append(cuts[1:], 1.0), high[gap])
        low, high, width = cuts, ends, width[gap]
    return _Pieces(low, high, width)


def _excess_of(pieces: _Pieces, desired: DesiredResponse, levels_wanted: float) -> _Pieces:
    """Return the part of each piece on which g' > 1 / width; pieces without one are left out."""
    low, high, width = pieces.start, pieces.stop, pieces.width
    steepest = low if desired.curvature <= 0 else high
    in_excess = levels_wanted * desired.slope(steepest) * width > 1
    low, high, width = low[in_excess], high[in_excess], width[in_excess]
    if desired.curvature == 0 or not width.size:
        return _Pieces(low, high, width)
    crossing = np.clip(desired.inverse_slope(1 / (levels_wanted * width)), low, high)
    if desired.curvature < 0:
        return _Pieces(low, crossing, width)
    return _Pieces(crossing, high, width)


MAX_LEVELS_WANTED = 1e7
"""Ten times what 16 frames of 16 bit hold.  The powers of larger numbers overflow in searches."""


def check_levels_wanted(levels_wanted: float) -> None:
    """Raise `UsageError` unless G is a number of levels from 1 to `MAX_LEVELS_WANTED`."""
    if not 1 <= levels_wanted <= MAX_LEVELS_WANTED:
        raise UsageError(
            f"invalid number of desired levels {levels_wanted:g}: expected 1 to "
            f"{MAX_LEVELS_WANTED:,.0f}",
            hint="for example 765",
        )


def _check_norm(levels_wanted: float, p: float) -> None:
    check_levels_wanted(levels_wanted)
    if not (math.isfinite(p) and 1 <= p <= 16):
        raise UsageError(f"invalid norm p = {p:g}: expected 1 to 16")


def xi(
    camera: EffectiveCamera | FloatArray,
    desired: DesiredResponse,
    levels_wanted: float,
    *,
    p: float = 1.0,
) -> float:
    """Return the objective of a set of levels.

    Args:
        camera: an effective camera, or its levels: (N,) float64, ascending
        desired: the desired response
        levels_wanted: G, the number of levels of the desired camera over its range, > 0
        p: the norm, 1 to 16; for p = 1 the result is the number of desired levels that are missing

    Raises:
        UsageError: G or p is out of range, or p > 1 and e_min = 0, where the integral may diverge

    >>> from camctl.model.response.camera import linear_response
    >>> from camctl.model.response.desired import desired_response
    >>> camera = EffectiveCamera.of(linear_response(8), (1, 1.003))
    >>> round(xi(camera, desired_response("linear", 512.0), 510), 2)
    106.21
    """
    _check_norm(levels_wanted, p)
    levels = camera.levels if isinstance(camera, EffectiveCamera) else camera
    edges = np.concatenate([[0.0], levels, [1.0] if levels[-1] < 1 else []])
    return sum(
        _missing(_pieces_of(some, desired), desired, levels_wanted, p) for some in blocks(edges)
    )


def _missing(pieces: _Pieces, desired: DesiredResponse, levels_wanted: float, p: float) -> float:
    """Return what some pieces add to the objective."""
    excess = _excess_of(pieces, desired, levels_wanted)
    if p != 1:
        return _integral_of_power(excess, desired, levels_wanted, p)
    missing = levels_wanted * desired.rise(excess.start, excess.stop)
    missing -= (excess.stop - excess.start) / excess.width
    return float(np.sum(np.maximum(missing, 0.0)))


NODES = 16
"""Nodes of the Gauss-Legendre rule on each panel."""

HALVINGS = 26
"""Panels for non-integer p halve this often towards the point where g' = h'."""

NARROW_NODES = 6
"""Nodes for gaps whose height changes by a tenth at most: the height is 0 nineteen half lengths
away from the middle or further, which leaves an error of (19 + 360^0.5)^-12 = 1e-19."""

NARROW = 0.9
"""Least ratio of the heights g' - h' at the two ends of such a gap, and of E at them."""

CHUNK = 2048
"""Rows integrated at once, which bounds the memory used."""


def _panels(p: float, curvature: int) -> tuple[FloatArray, FloatArray]:
    """Return the starts and lengths of panels in 0..1, short towards the point where g' = h'."""
    if p == round(p):
        return np.array([0.0]), np.array([1.0])
    powers = 0.5 ** np.arange(HALVINGS + 1)
    edges = np.concatenate([1 - powers, [1.0]])
    if curvature > 0:
        edges = (1 - edges)[::-1]
    return edges[:-1], np.diff(edges)


def _integral_of_power(
    excess: _Pieces, desired: DesiredResponse, levels_wanted: float, p: float
) -> float:
    """Return the sum over rows of the integral of (g' - 1/width)^p, where g' >= 1/width."""
    start, stop, width = excess.start, excess.stop, excess.width
    if not start.size:
        return 0.0
    first = levels_wanted * desired.slope(start) - 1 / width
    if desired.curvature == 0:
        return float(np.sum(np.maximum(first, 0.0) ** p * (stop - start)))
    if start[0] <= 0:
        raise UsageError(
            f"the objective with p = {p:g} does not exist down to zero irradiance",
            hint="choose a finite dynamic range",
        )
    last = levels_wanted * desired.slope(stop) - 1 / width
    narrow = np.minimum(first, last) >= NARROW * np.maximum(first, last)
    narrow &= start >= NARROW * stop
    return _by_quadrature(
        _Pieces(start[narrow], stop[narrow], width[narrow]),
        desired,
        levels_wanted,
        p,
        nodes=NARROW_NODES,
        panels=_panels(1.0, desired.curvature),
    ) + _by_quadrature(
        _Pieces(start[~narrow], stop[~narrow], width[~narrow]),
        desired,
        levels_wanted,
        p,
        nodes=NODES,
        panels=_panels(p, desired.curvature),
    )


def _by_quadrature(
    pieces: _Pieces,
    desired: DesiredResponse,
    levels_wanted: float,
    p: float,
    *,
    nodes: int,
    panels: tuple[FloatArray, FloatArray],
) -> float:
    """Return the sum over rows of the integral of (g' - 1/width)^p over panels in ln E."""
    start, stop, width = pieces.start, pieces.stop, pieces.width
    if not start.size:
        return 0.0
    places, weights = np.polynomial.legendre.leggauss(nodes)
    places, weights = (places + 1) / 2, weights / 2
    length = np.log1p((stop - start) / start)
    longest = float(length.max())
    total = 0.0
    for first in range(0, start.size, CHUNK):
        rows = slice(first, first + CHUNK)
        parts = int(np.ceil(min(longest, float(length[rows].max())))) or 1
        for part in range(parts):
            for offset, share in zip(*panels, strict=True):
                position = (part + offset + share * places) / parts
                t = length[rows, np.newaxis] * position
                E = start[rows, np.newaxis] * np.exp(t)
                height = levels_wanted * desired.slope(E) - 1 / width[rows, np.newaxis]
                value = np.maximum(height, 0.0) ** p * E
                total += float(np.sum((value @ weights) * length[rows])) * share / parts
    return total


SECONDS_A_LEVEL, SECONDS_A_LEVEL_OF_POWER = 1e-7, 2e-7
"""Processor time for each level of the exact objective, for p = 1 and where gaps are integrated;
with that of `camctl.exposure.candidates` measured for 8 to 16 bits on one core of 2.5 GHz."""

WIDE_GAPS, SECONDS_A_WIDE_GAP = 2000, 1e-6
"""Gaps of a set that are not `NARROW`, at most, and the time for each; four times as long for p
that is no whole number."""

COARSER = 16
"""The search for a camera of many levels starts from what is found with each 16th of them."""

MAX_DIRECT_LEVELS = 1023
"""Cameras of more levels do."""

JITTER_DRAWS = 8
"""Draws over which the objective is averaged where exposures vary."""


@dataclass(frozen=True)
class Objective:
    """The quantity that a search minimises; by default the number of missing levels.

    Attributes:
        levels_wanted: G, the number of levels of the desired camera; None: n * M, as many as n
            exposures have
        p: the norm of xi, 1 to 16
        noise: noise term that is added to xi, or None
        jitter: relative standard deviation of the exposures about their nominal values, 0 to 0.2;
            xi is then the mean over `JITTER_DRAWS` fixed Gaussian draws in opposite pairs

    Raises:
        UsageError: a value is out of range
    """

    levels_wanted: float | None = None
    p: float = 1.0
    noise: NoiseTerm | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        _check_norm(1.0 if self.levels_wanted is None else self.levels_wanted, self.p)
        if not (math.isfinite(self.jitter) and 0 <= self.jitter <= 0.2):
            raise UsageError(
                f"invalid exposure jitter {self.jitter:g}: expected a fraction from 0 to 0.2"
            )


@dataclass(frozen=True, eq=False)
class ExposureProblem:
    """The problem that a search solves: choose the n exposures with the smallest objective.

    Attributes:
        response: the response of the real camera
        desired: the desired response
        n: number of exposures, 1 to 64
        objective: the quantity to minimise

    Raises:
        UsageError: n is out of range
    """

    response: CameraResponse
    desired: DesiredResponse
    n: int
    objective: Objective = Objective()

    def __post_init__(self) -> None:
        check_count(self.n)

    @property
    def levels_wanted(self) -> float:
        """G, the number of levels of the desired camera."""
        given = self.objective.levels_wanted
        return float(self.n * self.response.M if given is None else given)

    @property
    def coarser(self) -> ExposureProblem:
        """The problem for a camera of each 16th level of many, without jitter."""
        coarse = every_nth_level(self.response, COARSER)
        fewer = max(1.0, self.levels_wanted * coarse.M / self.response.M)
        return replace(self, response=coarse, objective=Objective(fewer, self.objective.p))

    @property
    def sorted_levels(self) -> int:
        """Number of levels that one score sorts, those of each draw of the jitter."""
        return self.n * self.response.M * len(self.jitter_factors())

    @property
    def seconds(self) -> float:
        """About how long one score takes, s: it bounds searches, and is the same everywhere."""
        p, levels = self.objective.p, self.sorted_levels
        if p == 1 or self.desired.curvature == 0:
            return SECONDS_A_LEVEL * levels
        wide = min(levels, WIDE_GAPS * len(self.jitter_factors()))
        each = SECONDS_A_WIDE_GAP * (1 if p == round(p) else 4)
        return SECONDS_A_LEVEL_OF_POWER * levels + each * wide

    def jitter_factors(self) -> FloatArray:
        """Return (J, n) factors of the exposures to average over; (1, n) ones without jitter.

        The first exposure is the unit and has factor 1: a common factor only shifts the base.
        """
        if self.objective.jitter == 0:
            return np.ones((1, self.n))
        draw = np.random.default_rng(20030616).standard_normal
        parts = -(-self.n // MOST_SEARCHED)  # the first exposures have the same factors in each set
        drawn = [draw((JITTER_DRAWS // 2, MOST_SEARCHED)) for _ in range(parts)]
        half = np.concatenate(drawn, axis=1)[:, : self.n]
        factors = np.exp(self.objective.jitter * np.concatenate([half, -half]))
        return np.asarray(factors / factors[:, :1])

    def score(self, exposures: Sequence[float]) -> float:
        """Return the objective of n exposures, ascending from 1, in float64."""
        values = np.array(check_exposures(exposures))
        factors = self.jitter_factors()
        total = sum(
            xi(
                union_of_levels(self.response.levels, values * factor),
                self.desired,
                self.levels_wanted,
                p=self.objective.p,
            )
            for factor in factors
        )
        noise = self.objective.noise
        cost = 0.0 if noise is None else float(noise.cost(values[np.newaxis])[0])
        return total / len(factors) + cost
