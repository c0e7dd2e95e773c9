"""Sets of least quantisation error, for cameras whose noise does not dither the quantiser.

Without noise the accuracy follows from the gaps between the levels, which the estimate of
`camctl.exposure.accurate.estimate` takes no account of: levels of several exposures can interleave.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.accurate.frame_sets import Design
from camctl.exposure.accurate.gap_filling import GapFilling, TimeLimit
from camctl.exposure.exposure_choices import Shot, Shots
from camctl.exposure.random_sets import RandomSets, interleave_step
from camctl.exposure.settings_grid import SAME
from camctl.model.response.camera import FloatArray, every_nth_level

STARTS, KEPT, MOVES, ROUNDS = 48, 8, 24, 24
"""Random sets, sets that are improved, changes of each, and rounds, at most; half as many sets and
changes, and of the rounds, where the search is quick."""

MOST_SORTED = 600_000
"""Levels that are sorted for a number of exposures, at most: about 10 ms."""

COUNTS = (2, 3, 4, 6, 8, 11, 16)
"""Numbers of exposures that are tried first."""

EVEN, BEST = 6, 2
"""Starts of equal factors, and best sets that are kept."""

LONGER, TRIED, LAST = 6, 5, 2
"""Factor on that work for the best numbers of exposures; how many these are; and how many of them
are improved for long."""

EXCHANGES, MORE_EXCHANGES, MOST_EXCHANGED = 6, 60, 160_000
"""Exchanges of exposures for each of these numbers, more of them for the best ones, at most, and
at most so many levels in all of these."""

MOST_LEVELS, QUICK_LEVELS = 8192, 128
"""Levels of all exposures together, at most, and of each one where the search is quick: cameras of
more are searched by every second, fourth, ... level, and the distances between levels that
interleave are then reduced as much."""


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

    def best(numbers: Iterable[int], *, quick: bool) -> list[_Found]:
        possible = [n for n in sorted(set(numbers)) if max(2, fewest) <= n <= most]
        shorter = [n for n in possible if search.least_time(n) <= limit * (1 + SAME)]
        found = [_best_of(search, n, design, limit, quick=quick) for n in shorter]
        return sorted(found, key=lambda each: each.error)

    found = best([min(max(n, fewest), most) for n in counts], quick=True)
    if not thorough:
        return [shots for each in found[:BEST] for shots in _shots(search, each, settles=False)]
    found = [each.improved(EXCHANGES) for each in best([f.n for f in found[:TRIED]], quick=False)]
    found.sort(key=lambda each: each.error)
    found = [each.improved(MORE_EXCHANGES) for each in found[:LAST]]
    return [shots for each in found for shots in _shots(search, each, settles=True)]


@dataclass(frozen=True)
class _Found:
    """The best sets of as many exposures.

    Attributes:
        sets: natural logarithms of the exposures, (n,) each, the best first
        error: sum of g^3 over the gaps of the best one, about that for all levels of the camera
        finer: levels of the camera for each that was searched with
        filling: what improves the sets
    """

    sets: tuple[FloatArray, ...]
    error: float
    finer: int
    filling: GapFilling

    @property
    def n(self) -> int:
        """Number of exposures."""
        return self.sets[0].size

    def improved(self, exchanges: int) -> _Found:
        """Return the best set after exchanges of exposures, and what it was before."""
        most = MOST_EXCHANGED // (self.n * self.filling.response.M)
        row, error = self.filling.improved(self.sets[0], min(exchanges, most))
        return replace(self, sets=(row, self.sets[0]), error=error / self.finer**2)


def _best_of(search: DesignSearch, n: int, design: Design, limit: float, *, quick: bool) -> _Found:
    """Return the best sets of n exposures."""
    most, part, rounds = MOST_LEVELS // n, 1.0, ROUNDS
    if quick:
        most, part, rounds = QUICK_LEVELS, 0.5, ROUNDS // 2
    problem = search.problem
    finer = 2 ** max(0, math.ceil(math.log2((problem.response.M + 1) / most)))
    response = every_nth_level(problem.response, finer)
    reach = float(search.limits(np.zeros(1, dtype=np.intp))[1][0])
    within = TimeLimit(limit, search.costs, search.base / float(search.gains[0]))
    filling = GapFilling(response, problem.desired, within, reach, search.counts)
    moves = RandomSets(np.random.default_rng(0), n, response, reach)
    starts = np.concatenate([moves.starts(int(STARTS * part)), moves.even(EVEN)])
    if n == design.n:
        spread = moves.interleave * np.arange(n) * np.array([[0.0], [0.5], [1.0]])
        starts = np.concatenate([starts, design.log_exposure + spread])
    sets = within.scaled(moves.normalised(starts))
    errors = filling.errors(sets)
    left = MOST_SORTED * (1 if quick else LONGER) // (n * response.M) - len(sets)
    for _ in range(rounds):
        if left < 0:
            break
        best = np.argsort(errors, kind="stable")[:KEPT]
        changed = moves.around(sets[best], int(MOVES * part)).reshape(-1, n)
        changed = within.scaled(changed)
        sets = np.concatenate([sets[best], changed])
        errors = np.concatenate([errors[best], filling.errors(changed)])
        left -= len(changed)
    best = np.argsort(errors, kind="stable")[:BEST]
    return _Found(tuple(sets[best]), float(errors[best[0]]) / finer**2, finer, filling)


def _shots(search: DesignSearch, found: _Found, *, settles: bool) -> list[Shots]:
    """Return the sets for all levels of the camera."""
    sets = found.sets
    if found.finer > 1:
        step = interleave_step(found.filling.response)
        steps = [np.diff(row, prepend=0.0) for row in sets]
        reduced = (np.where(each < 4 * step, each / found.finer, each) for each in steps)
        sets = (*sets, *(each.cumsum() for each in reduced))
        if settles:
            filling = replace(found.filling, response=search.problem.response)
            sets = tuple(filling.settled(row)[0] for row in sets)
    gain = float(search.gains[0])
    return [
        tuple(Shot(e, e * search.base / gain, gain) for e in np.exp(row).tolist()) for row in sets
    ]
