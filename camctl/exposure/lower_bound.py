"""A lower bound on the objective over every set of n exposures.

Branch and bound over boxes of t = ln e, by a Lipschitz constant that needs no derivative of the
objective (which has kinks).  Let w(E) = E u'(E), which does not decrease with E for linear,
gamma <= 1 and constant contrast.  A gap (a, b) adds phi = G [u(x) - u(a)] - (x - a)/(b - a) with
x = clip(g'^-1(1/(b-a)), a, b), so that, where it adds anything::

    b dphi/db = G u'(x) b (x - a)/(b - a) <= G w(x) <= G w(b)   if x < b,   G w(b)   if x = b
    a dphi/da lies in [-G w(a), 0]

(with (x - a)/(b - a) <= x/b).  A level L is the end of one gap and the beginning of the next: as
ln L changes, xi changes at most G w(L) times as fast.  Of the levels below e_min only the nearest
counts, with at most G w(e_min).  Raising exposure j by dt moves all its levels by -dt in ln E::

    |d xi / d t_j| <= G [ w(e_min) + sum over levels of frame j above e_min of w(E_k / e_j) ]

This bound decreases with t_j, so that its value at the lower end of a box holds in the whole box.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.exposure.candidates import BatchScore
from camctl.exposure.objective import ExposureProblem, Objective, xi
from camctl.exposure.solver import Progress, SearchOptions, Solution, solve
from camctl.model.effective import union_of_levels
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse, GammaDesired, LinearDesired, LogDesired

MARGIN = 3.0
"""Length in ln e by which the boxes extend past the exposure that has all levels below e_min."""

ROUNDING_ERROR = 1e-10
"""Subtracted from every bound, in units of G: float64 sums of a million gaps err by less."""

MAX_BOXES_AT_ONCE = 20_000
"""Boxes divided in one step, which bounds memory."""

LIPSCHITZ_POINTS, LIPSCHITZ_LEVELS = 4096, 1 << 27
"""Points of t at which the Lipschitz constant is tabulated, and levels at all of them, at most: a
few seconds.  With fewer points the bound is a little lower."""

LEVELS_AT_ONCE = 1 << 20
"""Levels at those points that are in memory at once."""


@dataclass(frozen=True)
class Certificate:
    """A proven lower bound for all sets of n exposures, and the best set found.

    Attributes:
        exposures: the best set found, ascending from 1
        xi: its objective
        lower_bound: no set of n exposures has a smaller objective
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
        """Largest possible improvement over the set found, relative to its xi."""
        return (self.xi - self.lower_bound) / self.xi if self.xi > 0 else 0.0


def certify(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int = 2,
    *,
    levels_wanted: float | None = None,
    tolerance: float = 1e-4,
    max_evaluations: int = 400_000,
    seed: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Return the best n exposures found, and a proven lower bound for all sets of n exposures.

    For two exposures the relative gap reaches `tolerance`: a proof that nothing better exists.  For
    three and more there are too many boxes; the bound, at least 0, is what `max_evaluations` give,
    and `Certificate.gap` says how close it is.

    Args:
        response: the response of the real camera
        desired: the desired response: linear, gamma <= 1 or constant contrast, of finite range
        n: number of exposures, 1 to 16
        levels_wanted: G, the number of levels of the desired camera; None: n * M
        tolerance: relative gap at which the search ends
        max_evaluations: sets scored, at most
        seed: seed of the search for the best set
        progress: called with the completed share of `max_evaluations`, 0 to 1

    Raises:
        UsageError: n is out of range, or the desired response is another one
    """
    increasing = isinstance(desired, LinearDesired | LogDesired) or (
        isinstance(desired, GammaDesired) and desired.gamma <= 1
    )
    if not increasing or desired.e_min == 0:
        raise UsageError(
            f"no lower bound is known for the desired response {desired.description}",
            hint="choose linear, gamma <= 1 or log with a finite range",
        )
    started = time.process_time()
    problem = ExposureProblem(response, desired, n, Objective(levels_wanted))
    found = solve(
        response, desired, n, objective=problem.objective, search=SearchOptions(seed=seed)
    )
    if n == 1 or found.xi == 0:  # xi is never negative: nothing is better than 0
        seconds = time.process_time() - started
        return Certificate(found.exposures, found.xi, found.xi, found.evaluations, seconds)
    top = max(0.0, math.log(float(response.levels[-1]) / desired.e_min)) + MARGIN
    search = _Boxes(problem, top)
    best, bound = search.run(found, tolerance, max_evaluations, progress)
    G = problem.levels_wanted
    at_e_min = desired.e_min * float(desired.slope(np.array([desired.e_min]))[0])
    outside = bound
    if bound > 0:  # otherwise the bound is 0 whatever lies outside
        outside = _bound_outside(problem) - G * at_e_min * math.exp(-MARGIN)
    value = xi(union_of_levels(response.levels, best), desired, G)
    return Certificate(
        exposures=best,
        xi=value,
        lower_bound=max(0.0, min(bound, outside, value)),
        evaluations=search.score.evaluations,
        seconds=time.process_time() - started,
    )


def _bound_outside(problem: ExposureProblem) -> float:
    """Return a lower bound for sets with an exposure above the boxes: the bound for n - 1."""
    response, desired, G = problem.response, problem.desired, problem.levels_wanted
    if problem.n == 2:
        return xi(response.levels, desired, G)
    fewer = certify(
        response, desired, problem.n - 1, levels_wanted=G, tolerance=1e-3, max_evaluations=50_000
    )
    return fewer.lower_bound


class _Lipschitz:
    """Upper bounds of |d xi / d t| as a function of t."""

    def __init__(self, problem: ExposureProblem, top: float) -> None:
        desired = problem.desired
        M = problem.response.M
        self.t = np.linspace(0.0, top, min(LIPSCHITZ_POINTS, LIPSCHITZ_LEVELS // M))
        total = np.zeros(self.t.size)
        step = max(1, LEVELS_AT_ONCE // M)
        for first in range(0, self.t.size, step):
            rows = slice(first, first + step)
            levels = problem.response.levels / np.exp(self.t[rows])[:, np.newaxis]
            inside = np.clip(levels, desired.e_min, 1.0)
            weight = np.where(levels > desired.e_min, inside * desired.slope(inside), 0.0)
            total[rows] = weight.sum(axis=1)
        at_e_min = desired.e_min * float(desired.slope(np.array([desired.e_min]))[0])
        self.value = problem.levels_wanted * (total + at_e_min)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the bound at the point of the table at or below t, which holds from there on."""
        point = np.searchsorted(self.t, t, side="right") - 1
        return np.asarray(self.value[np.maximum(point, 0)])


class _Boxes:
    """Boxes of (t_2 .. t_n), each a centre and half widths, (B, n - 1) float64."""

    def __init__(self, problem: ExposureProblem, top: float) -> None:
        self.score = BatchScore(problem, exact=True)
        self.lipschitz = _Lipschitz(problem, top)
        self.rounding = ROUNDING_ERROR * problem.levels_wanted
        dimensions = problem.n - 1
        most = int(MAX_BOXES_AT_ONCE ** (1 / dimensions))
        parts = {1: 1024, 2: 48}.get(dimensions, min(4, most))
        centres = (np.arange(parts) + 0.5) * top / parts
        mesh = np.meshgrid(*[centres] * dimensions, indexing="ij")
        self.start = np.stack([axis.ravel() for axis in mesh], axis=1)
        self.half = top / parts / 2

    def run(
        self,
        found: Solution,
        tolerance: float,
        max_evaluations: int,
        progress: Progress | None,
    ) -> tuple[tuple[float, ...], float]:
        """Return the best set, `found` or better, and the lower bound over all boxes."""
        exposures, value = found.exposures, found.xi
        centre = self.start[self._ordered(self.start, np.full_like(self.start, self.half))]
        half = np.full_like(centre, self.half)
        scores = self._scores(centre)
        proven = math.inf
        while len(centre):
            if progress is not None:
                progress(min(self.score.evaluations / max_evaluations, 0.99))
            least = int(scores.argmin())
            if scores[least] < value:
                value = float(scores[least])
                exposures = (1.0, *np.sort(np.exp(centre[least])).tolist())
            change = self.lipschitz(centre - half) * half
            bound = scores - change.sum(axis=1) - self.rounding
            settled = bound >= value * (1 - tolerance)
            if settled.any():
                proven = min(proven, float(bound[settled].min()))
            centre, half, bound = centre[~settled], half[~settled], bound[~settled]
            change, scores = change[~settled], scores[~settled]
            if not len(centre) or self.score.evaluations >= max_evaluations:
                return exposures, min(proven, *bound.tolist(), value)
            worst = np.argsort(bound, kind="stable")
            now, later = worst[:MAX_BOXES_AT_ONCE], worst[MAX_BOXES_AT_ONCE:]
            parts, part_half = self._split(centre[now], half[now], change[now])
            part_scores = self._scores(parts)
            centre = np.concatenate([centre[later], parts])
            half = np.concatenate([half[later], part_half])
            scores = np.concatenate([scores[later], part_scores])
        return exposures, proven

    def _scores(self, centre: FloatArray) -> FloatArray:
        ones = np.ones((len(centre), 1))
        return self.score(np.concatenate([ones, np.exp(centre)], axis=1))

    def _split(
        self, centre: FloatArray, half: FloatArray, change: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Halve each box along the axis that lowers its bound most."""
        axis = change.argmax(axis=1)
        row = np.arange(len(centre))
        half = half.copy()
        half[row, axis] /= 2
        low, high = centre.copy(), centre.copy()
        low[row, axis] -= half[row, axis]
        high[row, axis] += half[row, axis]
        parts, part_half = np.concatenate([low, high]), np.concatenate([half, half])
        kept = self._ordered(parts, part_half)
        return parts[kept], part_half[kept]

    def _ordered(self, centre: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
        """Return which boxes contain a t_2 <= t_3 <= ...: all others are permutations of them."""
        low, high = centre - half, centre + half
        return np.asarray(np.all(np.maximum.accumulate(low, axis=1) <= high, axis=1))
