"""Sets of least quantisation error, for cameras whose noise does not dither the quantiser.

Without noise the accuracy follows from the gaps between the levels, which the estimate of
`camctl.exposure.accurate.estimate` takes no account of: levels of several exposures can interleave.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.accurate.frame_sets import Design
from camctl.exposure.accurate.gap_filling import GapFilling, TimeLimit
from camctl.exposure.exposure_choices import SAME, Shot, Shots
from camctl.exposure.random_sets import RandomSets, interleave_step
from camctl.model.effective import MOST_SEARCHED
from camctl.model.response.camera import FloatArray, every_nth_level

STARTS, EVEN = 36, 6
"""Random sets of each number of exposures of which the best is a start, more of more exposures
than are searched where their number is free: groups, and as many of equal factors between two
random ones; and sets of equal factors from the shortest on.  Random changes of them bring less than
exchanges of exposures in the same time."""

COUNTS = (2, 3, 4, 6, 8, 11, 16)
"""Numbers of exposures of the starts where the search is quick and begins from no other set."""

MORE = (0, 2)
"""How many more exposures than the set from which it begins its other starts have."""

QUICK = ((2, 2), (1, 5))
"""How many of the best starts are improved, and by how many exchanges of exposures, in turn."""

THOROUGH = ((12, 3), (6, 6), (3, 12), (2, 18), (1, 30))
"""The same where the search is thorough: the best of about ten such plans over 20 cases.  With
other random numbers the levels of single cases differ by up to 10 %."""

MOST_EXCHANGED = 40_000
"""Levels of the exposures that are exchanged, at most, in a set for all levels of the camera where
fewer were searched with and the search is thorough; sets of more are not settled for all of them
either, which is worth at most 0.2 % of their levels."""

MOST_STEPPED = 2_000_000
"""Levels that are placed and sorted for the steps of the camera's times, at most, some 0.05 s; a
32nd where the search is quick: with an eighth, 18 fronts have 0.1 % more levels and take 2 % more
time."""

MOST_LEVELS, FEWEST_LEVELS = 4096, 128
"""Levels of all exposures together, at most, but at least so many of each: cameras of more are
searched by every second, fourth, ... level, and the distances between levels that interleave are
then reduced as much."""

CLOSE_STEPS = 4.0
"""Distances of exposures up to which their levels interleave, in `interleave_step`."""


def least_quantisation(
    search: DesignSearch,
    design: Design,
    limit: float,
    *,
    thorough: bool,
    start: Shots = (),
) -> Shots | None:
    """Return a set of little quantisation error that takes `limit` at most, at the lowest gain.

    The number of exposures is free: with noise in the quantiser's place, the estimate takes fewer.

    Args:
        search: for one shortest exposure, where any time can be set
        design: a set from which the search starts, too
        limit: longest time of the sets, without their fixed time
        thorough: whether the search starts with every number of exposures, and goes on for longer
        start: a set of a shorter time from which it starts, too; none
    """
    fewest, most = search.counts
    numbers: Iterable[int] = range(fewest, most + 1)
    if not thorough:
        numbers = [max(2, len(start) + more) for more in MORE] if start else COUNTS
        numbers = {min(max(n, fewest), most) for n in numbers}
    possible = [n for n in numbers if n > 1 and search.least_time(n) <= limit * (1 + SAME)]
    found = [_start(search, n, design, limit) for n in possible]
    if len(start) > 1:
        found.append(_start_from(search, start, limit))
    for kept, exchanges in THOROUGH if thorough else QUICK:
        found = sorted(found, key=lambda each: each.error)[:kept]
        found = [each.improved(exchanges) for each in found]
    return _best(search, found, design, settles=thorough) if found else None


@dataclass(frozen=True)
class _Found:
    """A set and what improves it.

    Attributes:
        row: natural logarithms of the exposures, (n,)
        error: sum of g^3 over the gaps, about that for all levels of the camera
        finer: levels of the camera for each that is searched with
        filling: what exchanges exposures
        rng: what chooses them
    """

    row: FloatArray
    error: float
    finer: int
    filling: GapFilling
    rng: np.random.Generator

    def improved(self, exchanges: int) -> _Found:
        """Return the best set after some exchanges of exposures."""
        levels = self.row.size * self.filling.response.M
        share = MOST_LEVELS / levels  # of few levels an exchange takes less time, of many more
        more = share / 2 if share < 1 else min(max(1.0, share / 2), 2.0)
        row, error = self.filling.improved(self.row, round(more * exchanges), self.rng)
        return replace(self, row=row, error=error / self.finer**2)


def _filling(search: DesignSearch, n: int, limit: float) -> tuple[GapFilling, int]:
    """Return what exchanges exposures of sets of n, and how many levels it has one for."""
    problem = search.problem
    most = max(MOST_LEVELS // n, FEWEST_LEVELS)
    finer = 2 ** max(0, math.ceil(math.log2((problem.response.M + 1) / most)))
    response = every_nth_level(problem.response, finer)
    reach = float(search.limits(np.zeros(1, dtype=np.intp))[1][0])
    within = TimeLimit(limit, search.costs, search.base / float(search.gains[0]))
    return GapFilling(response, problem.desired, within, reach, search.counts), finer


def _start(search: DesignSearch, n: int, design: Design, limit: float) -> _Found:
    """Return the best of some sets of n exposures."""
    filling, finer = _filling(search, n, limit)
    rng = np.random.default_rng(n)
    moves = RandomSets(rng, n, filling.response, filling.reach)
    count = STARTS * math.ceil(n / MOST_SEARCHED)
    ends = np.sort(rng.uniform(0.0, filling.reach, (count, 2)))
    between = np.linspace(ends[:, 0], ends[:, 1], n - 1, axis=1)
    spaced = np.column_stack([np.zeros(count), between])
    starts = np.concatenate([moves.starts(count), spaced, moves.even(EVEN)])
    if n == design.n:
        spread = moves.interleave * np.arange(n) * np.array([[0.0], [0.5], [1.0]])
        starts = np.concatenate([starts, design.log_exposure + spread])
    sets = filling.within.scaled(moves.normalised(starts))
    best = min(sets, key=filling.error)
    return _Found(best, filling.error(best) / finer**2, finer, filling, rng)


def _start_from(search: DesignSearch, start: Shots, limit: float) -> _Found:
    """Return a set as a start of the search within another time."""
    filling, finer = _filling(search, len(start), limit)
    exposures = np.log([shot.exposure for shot in start])
    row = _with_distances(exposures, interleave_step(filling.response) / finer, finer)
    (row,) = filling.within.scaled(np.minimum(row, filling.reach)[np.newaxis])
    return _Found(row, filling.error(row) / finer**2, finer, filling, np.random.default_rng(0))


def _with_distances(row: FloatArray, step: float, factor: float) -> FloatArray:
    """Return a set whose distances, where levels interleave, are a multiple of what they were.

    Args:
        row: natural logarithms of ascending exposures from 0, (n,)
        step: distance that shifts levels by one gap
        factor: on the distances
    """
    steps = np.diff(row, prepend=0.0)
    return np.asarray(np.where(steps < CLOSE_STEPS * step, steps * factor, steps).cumsum())


def _best(search: DesignSearch, found: list[_Found], design: Design, *, settles: bool) -> Shots:
    """Return the best of some sets for all levels of the camera, in the steps of its times.

    Those searched with fewer levels are taken as they are and with their distances reduced, and
    beside them `design`: the steps may not let the levels of many exposures interleave.
    """
    problem, step = search.problem, search.problem.available.step
    finest = replace(found[0].filling, response=problem.response)

    def least(rows: list[FloatArray]) -> FloatArray:
        if len(rows) == 1:
            return rows[0]
        return min(rows, key=lambda row: finest.error(finest.rounded(row, step) if step else row))

    rows, is_fine = [each.row for each in found], found[0].finer > 1
    for each in found:
        if each.finer > 1:
            distance = interleave_step(each.filling.response)
            rows.append(_with_distances(each.row, distance, 1 / each.finer))
    own = finest.within.scaled(np.minimum(design.log_exposure, finest.reach)[np.newaxis])
    own = own[: is_fine and design.n > 1]
    kept = [least(rows), *own] if settles else [least([*rows, *own])]
    most = MOST_STEPPED if settles else MOST_STEPPED // 32
    for place, row in enumerate(kept):
        exchanges = MOST_EXCHANGED // (row.size * problem.response.M)
        if settles and is_fine and exchanges:
            row, _ = finest.improved(finest.settled(row)[0], exchanges, found[0].rng)
        kept[place] = finest.stepped(row, step, most) if step else row
    row = least(kept)
    gain = float(search.gains[0])
    return tuple(Shot(e, e * search.base / gain, gain) for e in np.exp(row).tolist())
