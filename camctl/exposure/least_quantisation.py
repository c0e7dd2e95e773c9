"""Sets of least quantisation error, for cameras whose noise does not dither the quantiser.

Without noise the accuracy follows from the gaps between the levels, which the estimate of
`camctl.exposure.estimate` takes no account of: levels of several exposures can interleave.
"""

from __future__ import annotations

import math

import numpy as np

from camctl.exposure.candidates import BatchScore
from camctl.exposure.design import Design, DesignSearch
from camctl.exposure.exposure_choices import SAME, Shot, Shots
from camctl.exposure.objective import ExposureProblem, Objective
from camctl.exposure.random_sets import RandomSets
from camctl.model.response.camera import FloatArray, every_nth_level

STARTS, KEPT, MOVES, ROUNDS = 48, 8, 24, 12
"""Random sets, sets that are improved, changes of each, and rounds, at most: the result is within
about 1 % of a long search."""

MOST_SORTED = 12_000_000
"""Levels that are sorted, at most: about 0.1 s."""

MAX_LEVELS = 511
"""Cameras of more levels are searched by every second, fourth, ... of them; the distances between
levels that interleave are then reduced as much."""

BEST = 2
"""Best sets that are returned."""


def least_quantisation(
    search: DesignSearch, design: Design, limit: float, *, share: float = 1.0
) -> list[Shots]:
    """Return sets of little quantisation error that take `limit` at most, at the lowest gain.

    Args:
        search: for one shortest exposure, where any time can be set
        design: a set that the estimate found; the result has as many exposures
        limit: longest time of the sets, without their fixed time
        share: of the work that it may be, see `MOST_SORTED`
    """
    problem = search.problem
    finer = 2 ** max(0, math.ceil(math.log2((problem.response.M + 1) / (MAX_LEVELS + 1))))
    response = every_nth_level(problem.response, finer)
    objective = Objective(kind="levels")
    score = BatchScore(ExposureProblem(response, problem.desired, design.n, objective))
    reach = float(search.limits(np.zeros(1, dtype=np.intp))[1][0])
    moves = RandomSets(np.random.default_rng(0), design.n, response, reach)
    spread = moves.interleave * np.arange(design.n) * np.array([[0.0], [0.5], [1.0]])
    starts = np.concatenate([moves.starts(STARTS), design.log_exposure + spread])
    sets = _in_time(search, moves.normalised(starts), limit)
    scores = score(np.exp(sets))
    most = share * MOST_SORTED / (design.n * response.M)
    for _ in range(ROUNDS):
        if score.evaluations > most:
            break
        best = np.argsort(scores, kind="stable")[:KEPT]
        changed = moves.around(sets[best], MOVES).reshape(-1, design.n)
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
    return [s for s in shots if costs.total([shot.time for shot in s]) <= limit * (1 + SAME)]


def _in_time(search: DesignSearch, sets: FloatArray, limit: float) -> FloatArray:
    """Return sets of ln(exposure), scaled towards 0 until they take `limit` at most."""
    unit = search.base / float(search.gains[0])
    low, high = np.zeros((len(sets), 1)), np.ones((len(sets), 1))

    def is_long(factor: FloatArray | float) -> np.ndarray:
        cost = search.costs.each(np.exp(sets * factor) * unit)
        return np.asarray(cost.sum(axis=1, keepdims=True) > limit)

    over = is_long(1.0)
    for _ in range(30):
        middle = (low + high) / 2
        long = is_long(middle)
        high, low = np.where(long, middle, high), np.where(long, low, middle)
    return np.where(over, sets * low, sets)
