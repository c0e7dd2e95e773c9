"""How good a set can be at all: a lower bound on the objective over every set of n exposures.

Branch and bound over boxes of t = ln e, by a Lipschitz constant that needs no derivative of the
kinked objective.  Let w(E) = E u'(E), which does not fall with E for linear, gamma q <= 1 and
constant contrast.  A gap (a, b) adds phi = G [u(x) - u(a)] - (x - a)/(b - a) with
x = clip(g'^-1(1/(b-a)), a, b), so that, where it adds anything,

    b dphi/db = G u'(x) b (x - a)/(b - a) <= G w(x) <= G w(b)   if x < b,   G w(b)   if x = b
    a dphi/da lies in [-G w(a), 0]

(with (x - a)/(b - a) <= x/b).  A level L is the end of one gap and the beginning of the next: as
ln L moves, xi changes at most G w(L) times as fast.  Of the levels below e_min only the nearest
counts, with at most G w(e_min).  Raising exposure j by dt moves all its levels by -dt in ln E:

    |d xi / d t_j| <= G [ w(e_min) + sum over levels of frame j above e_min of w(E_k / e_j) ]

which falls with t_j, so that its value at the low side of a box holds throughout the box.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.batch import BatchScore
from camctl.exposure.effective import union_of_levels
from camctl.exposure.objective import Objective, xi
from camctl.exposure.solver import check_count, solve
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse, GammaDesired, LinearDesired, LogDesired

BEYOND = 3.0
"""How far in ln e the search goes past the point where all levels of a frame lie below e_min."""

ROUNDING = 1e-10
"""Taken off every bound, in units of G: float64 sums of a million gaps err by less."""

TOGETHER = 20_000
TABLE_POINTS = 4096


@dataclass(frozen=True)
class Certificate:
    """What is proven about the best n exposures.

    Attributes:
        exposures: the best set found
        xi: its objective
        lower_bound: no set of n exposures scores less
        evaluations: sets scored for the proof
        seconds: CPU time, s
    """

    exposures: tuple[float, ...]
    xi: float
    lower_bound: float
    evaluations: int
    seconds: float

    @property
    def gap(self) -> float:
        """How far the found set may be from the best one, relative to its xi."""
        return (self.xi - self.lower_bound) / self.xi if self.xi > 0 else 0.0

    def __str__(self) -> str:
        n = len(self.exposures)
        best = ", ".join(f"{e:.7g}" for e in self.exposures)
        return (
            f"({best}) scores {self.xi:.6f}; no {n} exposures score below {self.lower_bound:.6f} "
            f"(gap {100 * self.gap:.2g} %, {self.evaluations} sets bounded)"
        )


class _Lipschitz:
    """Upper bounds on |d xi / d t| as a function of t."""

    def __init__(self, response: CameraResponse, desired: DesiredResponse, G: float, top: float):
        self.t = np.linspace(0.0, top, TABLE_POINTS)
        levels = response.levels / np.exp(self.t)[:, np.newaxis]
        inside = np.clip(levels, desired.e_min, 1.0)
        weight = np.where(levels > desired.e_min, inside * desired.slope(inside), 0.0)
        edge = desired.e_min * float(desired.slope(np.array([desired.e_min]))[0])
        self.value = G * (weight.sum(axis=1) + edge)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the bound at the table's point at or below t: it holds from there on."""
        place = np.searchsorted(self.t, t, side="right") - 1
        return np.asarray(self.value[np.maximum(place, 0)])


def certify(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int = 2,
    *,
    levels_wanted: float | None = None,
    tolerance: float = 1e-4,
    most_evaluations: int = 400_000,
    seed: int = 0,
) -> Certificate:
    """Return the best n exposures found, and a proven lower bound for all sets of n exposures.

    Two exposures are settled to the relative `tolerance`: a proof that nothing better exists.  For
    three and more the boxes are too many; the bound is what `most_evaluations` yield, never less
    than 0, and how loose it is `Certificate.gap` says.

    Raises:
        UsageError: for responses other than linear, gamma q <= 1 and log, or without a finite range
    """
    check_count(n)
    falling = isinstance(desired, LinearDesired | LogDesired) or (
        isinstance(desired, GammaDesired) and desired.q <= 1
    )
    if not falling or desired.e_min == 0:
        raise UsageError(
            f"no bound is known for {desired.description}",
            hint="certificates are for linear, gamma q <= 1 and log with a finite range",
        )
    started = time.process_time()
    G = n * response.M if levels_wanted is None else levels_wanted
    found = solve(response, desired, n, levels_wanted=G, seed=seed)
    if n == 1:
        return Certificate((1.0,), found.xi, found.xi, 1, time.process_time() - started)
    top = max(0.0, math.log(float(response.levels[-1]) / desired.e_min)) + BEYOND
    search = _Boxes(response, desired, n, G, top)
    best, bound = search.run(found.exposures, found.xi, tolerance, most_evaluations)
    edge = desired.e_min * float(desired.slope(np.array([desired.e_min]))[0])
    alone = _beyond(response, desired, n, G) - G * edge * math.exp(-BEYOND)
    value = xi(union_of_levels(response.levels, best), desired, G)
    return Certificate(
        exposures=best,
        xi=value,
        lower_bound=max(0.0, min(bound, alone, value)),
        evaluations=search.score.evaluations,
        seconds=time.process_time() - started,
    )


def _beyond(response: CameraResponse, desired: DesiredResponse, n: int, G: float) -> float:
    """Return a lower bound for sets with an exposure past the box: as good as one fewer."""
    if n == 2:
        return xi(response.levels, desired, G)
    return certify(
        response, desired, n - 1, levels_wanted=G, tolerance=1e-3, most_evaluations=50_000
    ).lower_bound


class _Boxes:
    """Boxes of (t_2 .. t_n), each a centre and half widths, (B, n - 1) float64."""

    def __init__(
        self, response: CameraResponse, desired: DesiredResponse, n: int, G: float, top: float
    ) -> None:
        self.score = BatchScore(response, desired, Objective(G), n, exact=True)
        self.slope = _Lipschitz(response, desired, G, top)
        self.rounding = ROUNDING * G
        self.dimensions = n - 1
        parts = {1: 1024, 2: 48}.get(self.dimensions, 4)
        edges = (np.arange(parts) + 0.5) * top / parts
        mesh = np.meshgrid(*[edges] * self.dimensions, indexing="ij")
        self.start = np.stack([axis.ravel() for axis in mesh], axis=1)
        self.half = top / parts / 2

    def run(
        self, exposures: tuple[float, ...], value: float, tolerance: float, most: int
    ) -> tuple[tuple[float, ...], float]:
        """Return the best set met and the lower bound over all boxes."""
        centre = self.start[self._ordered(self.start, np.full_like(self.start, self.half))]
        half = np.full_like(centre, self.half)
        scores = self._scores(centre)
        proven = math.inf
        while len(centre):
            least = int(scores.argmin())
            if scores[least] < value:
                value = float(scores[least])
                exposures = (1.0, *np.sort(np.exp(centre[least])).tolist())
            steepness = self.slope(centre - half) * half
            bound = scores - steepness.sum(axis=1) - self.rounding
            target = value * (1 - tolerance)
            settled = bound >= target
            if settled.any():
                proven = min(proven, float(bound[settled].min()))
            centre, half, bound = centre[~settled], half[~settled], bound[~settled]
            steepness, scores = steepness[~settled], scores[~settled]
            if not len(centre) or self.score.evaluations >= most:
                return exposures, min(proven, *bound.tolist(), value)
            worst = np.argsort(bound, kind="stable")
            now, later = worst[:TOGETHER], worst[TOGETHER:]
            kids, widths = self._split(centre[now], half[now], steepness[now])
            new = self._scores(kids)
            centre = np.concatenate([centre[later], kids])
            half = np.concatenate([half[later], widths])
            scores = np.concatenate([scores[later], new])
        return exposures, proven

    def _scores(self, centre: FloatArray) -> FloatArray:
        ones = np.ones((len(centre), 1))
        return self.score(np.concatenate([ones, np.exp(centre)], axis=1))

    def _split(
        self, centre: FloatArray, half: FloatArray, steepness: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Halve each box across the axis that costs its bound most."""
        axis = steepness.argmax(axis=1)
        row = np.arange(len(centre))
        half = half.copy()
        half[row, axis] /= 2
        low, high = centre.copy(), centre.copy()
        low[row, axis] -= half[row, axis]
        high[row, axis] += half[row, axis]
        kids, widths = np.concatenate([low, high]), np.concatenate([half, half])
        kept = self._ordered(kids, widths)
        return kids[kept], widths[kept]

    def _ordered(self, centre: FloatArray, half: FloatArray) -> np.ndarray:
        """Return which boxes hold some t_2 <= t_3 <= ...: the others only repeat them."""
        low, high = centre - half, centre + half
        return np.asarray(np.all(np.maximum.accumulate(low, axis=1) <= high, axis=1))
