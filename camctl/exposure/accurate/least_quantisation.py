"""Sets of least quantisation error, for cameras whose noise does not dither the quantiser.

Without noise the accuracy follows from the gaps between the levels, which the estimate of
`camctl.exposure.accurate.estimate` takes no account of: levels of several exposures can interleave.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.accurate.frame_sets import Design
from camctl.exposure.candidates import BatchScore
from camctl.exposure.exposure_choices import Shot, Shots
from camctl.exposure.objective import ExposureProblem, Objective
from camctl.exposure.random_sets import RandomSets
from camctl.exposure.settings_grid import SAME
from camctl.model.response.camera import FloatArray, every_nth_level

STARTS, KEPT, MOVES, ROUNDS = 48, 8, 24, 24
"""Random sets, sets that are improved, changes of each, and rounds, at most; half as many sets and
changes, and of the rounds, where the search is quick."""

MOST_SORTED = 12_000_000
"""Levels that are sorted for a number of exposures, at most: about 0.2 s."""

COUNTS = (2, 3, 4, 6, 8, 11, 16)
"""Numbers of exposures that are tried first."""

QUICK, TRIED, EVEN = 1 / 20, 2, 6
"""Share of that work for each of them; numbers that are then searched at length; and starts of
equal factors."""

MAX_LEVELS, QUICK_LEVELS = 511, 127
"""Cameras of more levels (the second where the search is quick) are searched by every second,
fourth, ... of them; the distances between levels that interleave are then reduced as much."""

NEWTON_STEPS = 8
"""Steps by which sets are scaled to a time: from a thousand times it to 1e-9 above it."""

BEST = 2
"""Best sets that are returned."""


def least_quantisation(
    search: DesignSearch,
    design: Design,
    limit: float,
    *,
    thorough: bool,
    counts: Sequence[int] = COUNTS,
) -> list[Shots]:
    """Return sets of little quantisation error that take `limit` at most, at the lowest gain.

    The number of exposures is free: with noise in the quantiser's place, the estimate takes fewer.

    Args:
        search: for one shortest exposure, where any time can be set
        design: a set from which the search starts, too
        limit: longest time of the sets, without their fixed time
        thorough: whether the best numbers of exposures are searched at length
        counts: numbers of exposures that are tried first
    """
    fewest, most = search.counts

    def best(numbers: Iterable[int], share: float) -> list[_Found]:
        possible = [n for n in sorted(set(numbers)) if max(2, fewest) <= n <= most]
        shorter = [n for n in possible if search.least_time(n) <= limit * (1 + SAME)]
        found = [_best_of(search, n, design, limit, share) for n in shorter]
        return sorted(found, key=lambda each: each.error)[:TRIED]

    found = best([min(max(n, fewest), most) for n in counts], QUICK)
    if thorough:
        found = best([each.n for each in found], 1.0)
    return [shots for each in found for shots in each.sets]


@dataclass(frozen=True)
class _Found:
    """The best sets of n exposures, and the least error among them."""

    n: int
    error: float
    sets: list[Shots]


def _best_of(search: DesignSearch, n: int, design: Design, limit: float, share: float) -> _Found:
    """Return the best sets of n exposures; `share` is that of `MOST_SORTED`."""
    problem = search.problem
    most, part, rounds = MAX_LEVELS, 1.0, ROUNDS
    if share < 1:
        most, part, rounds = QUICK_LEVELS, 0.5, ROUNDS // 2
    finer = 2 ** max(0, math.ceil(math.log2((problem.response.M + 1) / (most + 1))))
    response = every_nth_level(problem.response, finer)
    score = BatchScore(ExposureProblem(response, problem.desired, n, Objective(kind="levels")))
    reach = float(search.limits(np.zeros(1, dtype=np.intp))[1][0])
    moves = RandomSets(np.random.default_rng(0), n, response, reach)
    starts = np.concatenate([moves.starts(int(STARTS * part)), moves.even(EVEN)])
    if n == design.n:
        spread = moves.interleave * np.arange(n) * np.array([[0.0], [0.5], [1.0]])
        starts = np.concatenate([starts, design.log_exposure + spread])
    sets = _in_time(search, moves.normalised(starts), limit)
    scores = score(np.exp(sets))
    evaluations = share * MOST_SORTED / (n * response.M)
    for _ in range(rounds):
        if score.evaluations > evaluations:
            break
        best = np.argsort(scores, kind="stable")[:KEPT]
        changed = moves.around(sets[best], int(MOVES * part)).reshape(-1, n)
        changed = _in_time(search, changed, limit)
        sets = np.concatenate([sets[best], changed])
        scores = np.concatenate([scores[best], score(np.exp(changed))])
    found = sets[np.argsort(scores, kind="stable")[:BEST]]
    if finer > 1:
        steps = np.diff(found, axis=1, prepend=0.0)
        reduced = np.where(steps < 4 * moves.interleave, steps / finer, steps).cumsum(axis=1)
        found = np.concatenate([found, reduced])
    gain = float(search.gains[0])
    shots = (
        tuple(Shot(e, e * search.base / gain, gain) for e in row) for row in np.exp(found).tolist()
    )
    costs = search.costs
    fitting = [s for s in shots if costs.total([shot.time for shot in s]) <= limit * (1 + SAME)]
    return _Found(n, float(scores.min()), fitting)


def _in_time(search: DesignSearch, sets: FloatArray, limit: float) -> FloatArray:
    """Return sets of ln(exposure), scaled towards 0 until they take `limit` at most."""
    unit, costs = search.base / float(search.gains[0]), search.costs

    def total(logs: FloatArray) -> FloatArray:
        times = np.exp(logs) * unit
        return np.asarray(costs.each(times).sum(axis=1) - costs.saved(times[:, -1]))

    over = np.flatnonzero(total(sets) > limit)
    rows, factor = sets[over], np.ones(over.size)
    # ln(time) is a convex function of the factor: Newton's steps approach its root from above.
    for _ in range(NEWTON_STEPS):
        scaled = rows * factor[:, np.newaxis]
        times = np.exp(scaled) * unit
        changes = np.where(times > costs.least, rows * times, 0.0)
        slope = changes.sum(axis=1) * costs.factor - changes[:, -1] * costs.waiting
        time = total(scaled)
        excess = time * np.log(np.maximum(time / limit, 1.0))
        factor = np.maximum(factor - excess / np.maximum(slope, 1e-300), 0.0)
    found = sets.copy()
    found[over] = rows * factor[:, np.newaxis]
    return found
