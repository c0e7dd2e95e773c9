"""Search over the settings that a camera has, instead of arbitrary exposures.

All sets of settings are scored if they are few enough; otherwise the search starts from the best
arbitrary exposures, rounded to the settings, and improves them by random moves.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.exposure.candidates import BatchScore
from camctl.exposure.exposure_choices import SAME, SettingsGrid
from camctl.exposure.objective import MAX_DIRECT_LEVELS, ExposureProblem, Objective
from camctl.exposure.solver import (
    Progress,
    SearchOptions,
    Solution,
    part_of,
    solve,
)
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse

MAX_ENUMERATED_SETS = 400_000
"""Sets that are all scored, at most: about 1 s for 8 bits."""

ROUNDS = 40
"""Rounds of random moves."""

HALVING_ROUNDS = (10, 20, 30)
"""Rounds after which the number of sets kept is halved."""

POPULATION = 48
"""Sets kept from one round to the next, at first."""

MOVES_PER_SET = 48
"""Changed copies of each set in a round."""

MAX_EXACT_SCORES = 24
"""Best sets whose exact objective decides."""

MOVED_SETS = 900
"""Sets that are changed in all rounds."""

MOST_SECONDS, RANKED_SECONDS = 8.0, 3.0
"""Processor time for all scores of random moves, and for those that decide at the end, about, at
most.  Cameras of many levels are searched with fewer of them."""

ENUMERATED_SECONDS, FINE_ENUMERATED_SECONDS = 30.0, 10.0
"""The same for the scores of all sets; less where the search for arbitrary exposures takes long."""

MAX_BASES, RANDOM_SETS = 4096, 256
"""Starts: the best arbitrary exposures rounded, at most once for each base; and random sets."""

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class SettingsSolution(Solution):
    """A solution on a grid of settings.

    Attributes:
        settings: the exposures chosen from the grid, ascending, in the unit of `SettingsGrid.times`
        enumerated: whether every set was scored, so that no set is better
    """

    settings: tuple[float, ...] = ()
    enumerated: bool = False


def solve_settings(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    grid: SettingsGrid,
    *,
    objective: Objective | None = None,
    search: SearchOptions | None = None,
    ideal: Solution | None = None,
    progress: Progress | None = None,
) -> SettingsSolution:
    """Return the best n different exposures out of the settings of a camera.

    Args:
        response: the response of the real camera
        desired: the desired response; its E = 1 is full scale of the shortest exposure chosen
        n: number of exposures, 1 to 16
        grid: the settings of the camera, and the limits on sets of them
        objective: the quantity to minimise; None: missing levels of n * M
        search: options of the search for arbitrary exposures, used where the sets are too many to
            score all
        ideal: the best arbitrary exposures, where they are known; None: they are searched
        progress: called with the completed share, 0 to 1

    Raises:
        UsageError: the settings are too few, or no set meets the limits; states the nearest limit
            that can be met
        DataError: a setting is not a positive, finite number
    """
    problem = ExposureProblem(response, desired, n, objective or Objective())
    started = time.process_time()
    exposures = grid.exposures
    bases = base_indices(grid, n)
    batch = BatchScore(problem)
    is_fine = response.M > MAX_DIRECT_LEVELS
    longest_s = FINE_ENUMERATED_SECONDS if is_fine else ENUMERATED_SECONDS
    all_sets = _enumerate(grid, n, bases, longest_s / batch.seconds)
    if all_sets is None:
        if ideal is None:
            there = part_of(progress, 0.0, 0.5)
            ideal = solve(response, desired, n, objective=objective, search=search, progress=there)
        rng = np.random.default_rng((search or SearchOptions()).seed)
        ranked = _search(problem, grid, bases, ideal, rng, part_of(progress, 0.5, 1.0))
        if ranked.shape[0] > 0 and MOVED_SETS * MOVES_PER_SET * batch.seconds > MOST_SECONDS:
            ranked = ranked[: max(1, int(RANKED_SECONDS / batch.seconds))]
            ranked = _ranked(ranked, _scores(batch, exposures, ranked))
    else:
        ranked = _ranked(all_sets, _scores(batch, exposures, all_sets))
    ranked = ranked[: max(1, min(MAX_EXACT_SCORES, int(RANKED_SECONDS / problem.seconds)))]
    best = min(
        (problem.score((exposures[row] / exposures[row[0]]).tolist()), tuple(row.tolist()))
        for row in ranked
    )[1]
    chosen = exposures[list(best)]
    found = Solution.of(
        problem,
        tuple((chosen / chosen[0]).tolist()),
        seconds=time.process_time() - started,
        evaluations=batch.evaluations + len(ranked),
    )
    return SettingsSolution(
        **vars(found), settings=tuple(chosen.tolist()), enumerated=all_sets is not None
    )


def _scores(batch: BatchScore, exposures: FloatArray, sets: Indices) -> FloatArray:
    """Return the objective of each row of indices."""
    chosen = exposures[sets]
    return batch(chosen / chosen[:, :1])


def base_indices(grid: SettingsGrid, n: int) -> range:
    """Return the indices that the shortest exposure may have.

    Raises:
        UsageError: the settings are too few, or no set meets the limits
        DataError: a setting is not a positive, finite number
    """
    exposures = grid.exposures
    if exposures.size < n:
        raise UsageError(
            f"{n} different exposures cannot be chosen from {exposures.size} settings",
            hint=f"request at most {exposures.size}, or give more settings",
        )
    first, stop = 0, exposures.size - n + 1
    if grid.base is not None:
        low, high = grid.base[0] * (1 - SAME), grid.base[1] * (1 + SAME)
        first = int(np.searchsorted(exposures, low))
        stop = min(stop, int(np.searchsorted(exposures, high, side="right")))
        if first >= stop:
            raise UsageError(
                f"no {n} exposures start from a setting of {grid.base[0]:g} to {grid.base[1]:g}",
                hint=f"the shortest exposure can be {exposures[0]:.6g} to "
                f"{exposures[exposures.size - n]:.6g}",
            )
    least = float(exposures[first : first + n].sum())
    if not least <= grid.total_limit:
        raise UsageError(
            f"no {n} settings have a sum of {grid.total_limit:.6g} or less",
            hint=f"the smallest sum is {least:.6g}",
        )
    return range(first, stop)


def _enumerate(grid: SettingsGrid, n: int, bases: range, most: float) -> Indices | None:
    """Return all index sets (C, n) of different ratios within limits; None if they are too many."""
    exposures = grid.exposures
    steps = np.diff(np.log(exposures))
    if steps.size > 0 and bool(np.all(np.abs(steps - steps[0]) < SAME)):
        bases = bases[:1]  # equal ratios: the sets of the first base have all ratios there are
    count = sum(math.comb(exposures.size - 1 - start, n - 1) for start in bases)
    if count > min(MAX_ENUMERATED_SETS, most):
        return None
    sets = np.array(
        [
            (start, *rest)
            for start in bases
            for rest in combinations(range(start + 1, exposures.size), n - 1)
        ],
        dtype=np.intp,
    )
    return np.asarray(sets[exposures[sets].sum(axis=1) <= grid.total_limit])


def _ranked(sets: Indices, scores: FloatArray) -> Indices:
    """Return the sets, best first; of equal scores the one with the shorter exposures first."""
    return sets[np.lexsort((sets.sum(axis=1), scores))]


def _search(
    problem: ExposureProblem,
    grid: SettingsGrid,
    bases: range,
    ideal: Solution,
    rng: np.random.Generator,
    progress: Progress | None,
) -> Indices:
    """Return good index sets, best first: the rounded continuous optimum, improved by moves."""
    exposures, n = grid.exposures, problem.n
    batch = BatchScore(problem)
    while (
        MOVED_SETS * MOVES_PER_SET * batch.seconds > MOST_SECONDS
        and problem.response.M > MAX_DIRECT_LEVELS
    ):
        problem = problem.coarser
        batch = BatchScore(problem)
    moves = max(2, min(MOVES_PER_SET, int(MOST_SECONDS / (MOVED_SETS * batch.seconds))))
    logs = np.log(exposures)
    starts = np.unique(np.linspace(bases.start, bases.stop - 1, MAX_BASES).astype(np.intp))
    targets = logs[starts][:, np.newaxis] + np.log(ideal.exposures)
    sets = np.searchsorted((logs[1:] + logs[:-1]) / 2, targets)
    random = rng.integers(bases.start, exposures.size, (RANDOM_SETS, n))
    sets = _separated(np.concatenate([sets, random]), exposures.size)
    sets = np.concatenate([sets, np.arange(bases.start, bases.start + n)[np.newaxis]])

    def score_within_limits(candidates: Indices) -> FloatArray:
        base, total = candidates[:, 0], exposures[candidates].sum(axis=1)
        valid = (base >= bases.start) & (base < bases.stop) & (total <= grid.total_limit)
        scores = np.full(len(candidates), np.inf)
        scores[valid] = _scores(batch, exposures, candidates[valid])
        return scores

    scores = score_within_limits(sets)
    keep = POPULATION
    for turn in range(ROUNDS):
        best = np.argsort(scores, kind="stable")[:keep]
        sets, scores = sets[best], scores[best]
        changed = _moved(rng, sets, exposures.size, moves)
        sets = np.concatenate([sets, changed])
        scores = np.concatenate([scores, score_within_limits(changed)])
        sets, unique = np.unique(sets, axis=0, return_index=True)
        scores = scores[unique]
        if turn in HALVING_ROUNDS:
            keep //= 2
        if progress is not None:
            progress((turn + 1) / ROUNDS)
    return _ranked(sets[np.isfinite(scores)], scores[np.isfinite(scores)])


def _moved(rng: np.random.Generator, sets: Indices, size: int, count: int) -> Indices:
    """Return `count` changed copies of each set.

    One exposure, all from one on, or all are moved, by steps of every size.
    """
    n = sets.shape[1]
    copies = np.repeat(sets, count, axis=0)
    step = np.exp(rng.uniform(0, math.log(max(2.0, size / 2)), len(copies)))
    step = np.round(step * rng.choice([-1, 1], len(copies))).astype(np.intp)
    one = rng.integers(0, n, len(copies))[:, np.newaxis]
    index = np.arange(n)
    kind = rng.random(len(copies))[:, np.newaxis]
    block = np.where(kind < 0.6, index == one, index >= np.where(kind < 0.85, one, 0))
    return _separated(copies + block * step[:, np.newaxis], size)


def _separated(sets: Indices, size: int) -> Indices:
    """Return the index sets ascending, different within each row, inside the grid."""
    n = sets.shape[1]
    offsets = np.arange(n)
    spread = np.sort(sets, axis=1) - offsets
    spread = np.maximum.accumulate(np.clip(spread, 0, size - n), axis=1)
    return np.asarray(spread + offsets)
