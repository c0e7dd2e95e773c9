"""Fast scores for sets taken out of one grid of settings."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import DataError, UsageError
from camctl.exposure.batch import CACHE_ELEMENTS, BatchScore
from camctl.exposure.objective import Objective
from camctl.exposure.solver import Solution, check_count, describe, solve
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse, TabulatedDesired

MOST_KEPT = 8_000_000


class SubsetScore:
    """Scores (C, n) index sets into an ascending grid of exposures (S,).

    For a desired response in a table u of every level at every ratio is worked out once, so that a
    set costs a sort of n M numbers and no look-up; the score is then the lower bound by the mean
    slope of each gap.  Closed forms go through `BatchScore`.
    """

    def __init__(
        self,
        response: CameraResponse,
        desired: DesiredResponse,
        goal: Objective,
        grid: FloatArray,
        n: int,
    ) -> None:
        self.evaluations = 0
        self._grid, self._goal, self._n = grid, goal, n
        self._batch = BatchScore(response, desired, goal, n)
        self._levels, self._desired = response.levels, desired
        self._tabulated = isinstance(desired, TabulatedDesired) and goal.p == 1

    def __call__(self, sets: NDArray[np.intp]) -> FloatArray:
        """Return the objective of each set, (C,) float64."""
        self.evaluations += len(sets)
        chosen = self._grid[sets]
        ratios = chosen / chosen[:, :1]
        if self._tabulated:
            distinct, which = np.unique(np.round(np.log(ratios), 9), return_inverse=True)
            if distinct.size * self._levels.size <= MOST_KEPT:
                return self._by_table(np.exp(distinct), which.reshape(ratios.shape))
        return self._batch(ratios)

    def _by_table(self, ratios: FloatArray, which: NDArray[np.intp]) -> FloatArray:
        G = np.float32(self._goal.levels_wanted)
        heights = self._desired.u(self._levels / ratios[:, np.newaxis]).astype(np.float32) * G
        rows, M = len(which), self._levels.size
        scores = np.empty(rows)
        size = max(1, CACHE_ELEMENTS // (self._n * M))
        for first in range(0, rows, size):
            part = which[first : first + size]
            edges = np.empty((len(part), self._n * M + 2), dtype=np.float32)
            edges[:, 0], edges[:, -1] = 0, G
            edges[:, 1:-1] = heights[part].reshape(len(part), -1)
            edges.sort(axis=1)
            gaps = np.diff(edges, axis=1)
            gaps -= 1
            np.maximum(gaps, 0, out=gaps)
            scores[first : first + size] = gaps.sum(axis=1)
        return scores


ENUMERATED = 400_000
MOST_SETTINGS = 200_000
SAME_RATIO = 1e-9
ROUNDS = 40
POPULATION = 48
MOVES = 48
EXACT = 24

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class SettingsSolution(Solution):
    """A solution on a grid of settings.

    Attributes:
        settings: the settings to use, ascending, in the unit they were given in
        enumerated: True where every set was scored, so that this is the best one there is
    """

    settings: tuple[float, ...] = ()
    enumerated: bool = False


def stepped(minimum: float, maximum: float, step: float) -> FloatArray:
    """Return a control's settings from `minimum` to `maximum`, (S,) float64 ascending."""
    values = (minimum, maximum, step)
    if not all(math.isfinite(v) for v in values) or not (0 < minimum <= maximum and step > 0):
        raise UsageError(
            f"settings from {minimum:g} to {maximum:g} by {step:g}",
            hint="give 0 < minimum <= maximum and a step above 0",
        )
    count = math.floor((maximum - minimum) / step * (1 + 1e-12) + 1e-9) + 1
    if count > MOST_SETTINGS:
        raise UsageError(f"{count} settings", hint=f"at most {MOST_SETTINGS}: take a coarser step")
    return np.asarray(minimum + step * np.arange(count))


def true_time(label_s: float) -> float:
    """Return the time that a shutter dial's label means: the nearest power of 2^(1/3) of a second.

    >>> true_time(1 / 30)
    0.03125
    """
    return float(2.0 ** (round(3 * math.log2(label_s)) / 3))


def combined(times: ArrayLike, gains: ArrayLike = (1.0,)) -> FloatArray:
    """Return the different exposures time x gain, (S,) float64 ascending; checks both lists.

    Products that agree to 1e-9 are one exposure.  Raises `UsageError` for an empty list and
    `DataError` for settings that are not positive and finite.
    """
    lists = [
        np.atleast_1d(np.asarray(values, dtype=np.float64)).ravel() for values in (times, gains)
    ]
    for values in lists:
        if values.size == 0:
            raise UsageError("an empty list of settings", hint="give one time or more")
        wrong = values[~(np.isfinite(values) & (values > 0))]
        if wrong.size:
            raise DataError(f"setting {wrong[0]:g} is not a positive, finite number")
    products = np.sort((lists[0][:, np.newaxis] * lists[1]).ravel())
    new = np.concatenate([[True], np.diff(np.log(products)) > SAME_RATIO])
    return np.asarray(products[new])


def solve_settings(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    settings: ArrayLike,
    *,
    gains: ArrayLike = (1.0,),
    base: tuple[float, float] | None = None,
    total_limit: float | None = None,
    levels_wanted: float | None = None,
    p: float = 1.0,
    seed: int = 0,
) -> SettingsSolution:
    """Return the best n different exposures out of a camera's settings.

    Args:
        response: the real camera
        desired: the wanted response and dynamic range, reckoned from the shortest exposure chosen
        n: number of exposures, 1 to 16
        settings: (S,) true exposure times (or relative exposures), any order
        gains: gains that combine with each time
        base: (least, greatest) that the shortest exposure may be, in the unit of `settings`
        total_limit: what the exposures may sum to, in the unit of `settings`
        levels_wanted: G; n * M where not given
        p: norm of the objective
        seed: same seed, same result (only where the grid is too large to enumerate)

    Raises:
        UsageError: too few settings, or a base or limit that no set meets; says what the least is
        DataError: a setting that is not positive and finite
    """
    check_count(n)
    started = time.process_time()
    grid = combined(settings, gains)
    goal = Objective(n * response.M if levels_wanted is None else levels_wanted, p)
    limit = math.inf if total_limit is None else total_limit
    bases = _bases(grid, n, base, limit)
    starts = _enumerate(grid, n, bases, limit)
    score = SubsetScore(response, desired, goal, grid, n)
    if starts is not None:
        ranked = _ranked(starts, score(starts))
    else:
        ranked = _searched(response, desired, goal, grid, n, bases, limit, score, seed)
    best = min(
        (goal.score(response, (grid[row] / grid[row[0]]).tolist(), desired), tuple(row.tolist()))
        for row in ranked[:EXACT]
    )[1]
    chosen = grid[list(best)]
    exposures = tuple((chosen / chosen[0]).tolist())
    found = describe(response, desired, exposures, goal)
    return SettingsSolution(
        exposures=found.exposures,
        xi=found.xi,
        levels_wanted=found.levels_wanted,
        effective_levels=found.effective_levels,
        total_exposure=found.total_exposure,
        seconds=time.process_time() - started,
        evaluations=score.evaluations + len(ranked[:EXACT]),
        settings=tuple(chosen.tolist()),
        enumerated=starts is not None,
    )


def _bases(
    grid: FloatArray, n: int, base: tuple[float, float] | None, limit: float
) -> tuple[int, int]:
    """Return (first, behind last) index that the shortest exposure may have."""
    if grid.size < n:
        raise UsageError(
            f"{n} different exposures from {grid.size} settings",
            hint=f"ask for at most {grid.size}, or give more settings",
        )
    first, stop = 0, grid.size - n + 1
    if base is not None:
        first = int(np.searchsorted(grid, base[0] * (1 - SAME_RATIO)))
        stop = min(stop, int(np.searchsorted(grid, base[1] * (1 + SAME_RATIO), side="right")))
    if first >= stop:
        raise UsageError(
            f"no setting leaves {n} exposures from a base in {base}",
            hint=f"bases of this grid lie in {grid[0]:.6g} .. {grid[grid.size - n]:.6g}",
        )
    least = float(grid[first : first + n].sum())
    if not least <= limit:
        raise UsageError(
            f"no {n} settings sum to {limit:.6g} or less", hint=f"the least is {least:.6g}"
        )
    return first, stop


def _enumerate(grid: FloatArray, n: int, bases: tuple[int, int], limit: float) -> Indices | None:
    """Return all index sets (C, n) of different ratios within limits; None if they are too many."""
    logs = np.log(grid)
    steps = np.diff(logs)
    even = steps.size > 0 and bool(np.all(np.abs(steps - steps[0]) < SAME_RATIO))
    first, stop = bases
    if even:  # ratios repeat from base to base: the first base has all of them
        stop = first + 1
    count = sum(math.comb(grid.size - 1 - start, n - 1) for start in range(first, stop))
    if count > ENUMERATED:
        return None
    sets = np.array(
        [
            (start, *rest)
            for start in range(first, stop)
            for rest in combinations(range(start + 1, grid.size), n - 1)
        ],
        dtype=np.intp,
    )
    return np.asarray(sets[grid[sets].sum(axis=1) <= limit])


def _ranked(sets: Indices, scores: FloatArray) -> Indices:
    """Return the sets, best first; equal scores in the order of shutter time."""
    return sets[np.lexsort((sets.sum(axis=1), scores))]


def _searched(
    response: CameraResponse,
    desired: DesiredResponse,
    goal: Objective,
    grid: FloatArray,
    n: int,
    bases: tuple[int, int],
    limit: float,
    score: SubsetScore,
    seed: int,
) -> Indices:
    """Return good index sets, best first: the continuous optimum on the grid, then moves on it."""
    rng = np.random.default_rng(seed)
    ideal = solve(response, desired, n, levels_wanted=goal.levels_wanted, p=goal.p, seed=seed)
    first, stop = bases
    where = np.unique(np.linspace(first, stop - 1, 4096).astype(np.intp))
    wanted = np.log(grid[where])[:, np.newaxis] + np.log(ideal.exposures)
    logs = np.log(grid)
    middles = (logs[1:] + logs[:-1]) / 2
    sets = np.searchsorted(middles, wanted)
    random = rng.integers(first, grid.size, (256, n))
    sets = _apart(np.concatenate([sets, random]), grid.size)
    sets = np.concatenate([sets, np.arange(first, first + n)[np.newaxis]])

    def value(candidates: Indices) -> FloatArray:
        starts = candidates[:, 0]
        fits = (starts >= first) & (starts < stop) & (grid[candidates].sum(axis=1) <= limit)
        scores = np.full(len(candidates), np.inf)
        scores[fits] = score(candidates[fits])
        return scores

    scores = value(sets)
    keep = POPULATION
    for turn in range(ROUNDS):
        best = np.argsort(scores, kind="stable")[:keep]
        sets, scores = sets[best], scores[best]
        changed = _moved(rng, sets, grid.size)
        sets = np.concatenate([sets, changed])
        scores = np.concatenate([scores, value(changed)])
        sets, unique = np.unique(sets, axis=0, return_index=True)
        scores = scores[unique]
        if turn in (10, 20, 30):
            keep //= 2
    return _ranked(sets[np.isfinite(scores)], scores[np.isfinite(scores)])


def _moved(rng: np.random.Generator, sets: Indices, size: int) -> Indices:
    """Return changed copies: one exposure, all from one on, or all, by steps of every size."""
    n = sets.shape[1]
    copies = np.repeat(sets, MOVES, axis=0)
    step = np.exp(rng.uniform(0, math.log(max(2.0, size / 2)), len(copies)))
    step = np.round(step * rng.choice([-1, 1], len(copies))).astype(np.intp)
    one = rng.integers(0, n, len(copies))[:, np.newaxis]
    index = np.arange(n)
    kind = rng.random(len(copies))[:, np.newaxis]
    block = np.where(kind < 0.6, index == one, index >= np.where(kind < 0.85, one, 0))
    return _apart(copies + block * step[:, np.newaxis], size)


def _apart(sets: Indices, size: int) -> Indices:
    """Return the index sets ascending, different within each row, inside the grid."""
    n = sets.shape[1]
    ladder = np.arange(n)
    spread = np.sort(sets, axis=1) - ladder
    spread = np.maximum.accumulate(np.clip(spread, 0, size - n), axis=1)
    return np.asarray(spread + ladder)


def against_ideal(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    settings: Sequence[float],
    *,
    levels_wanted: float | None = None,
    seed: int = 0,
) -> tuple[SettingsSolution, Solution]:
    """Return what the camera's settings can do beside what free exposures could."""
    possible = solve_settings(
        response, desired, n, settings, levels_wanted=levels_wanted, seed=seed
    )
    return possible, solve(response, desired, n, levels_wanted=levels_wanted, seed=seed)
