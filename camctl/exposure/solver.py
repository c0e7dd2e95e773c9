"""Search for the best exposures: many starts, moves of every scale, successive halving.

The objective is continuous, has a kink wherever two levels cross (tens of thousands of times along
each exposure), and has many good minima that differ in how the exposures form groups.  The search
starts from a large batch of random sets, improves each by the best of many random moves at every
scale from 1e-5 to 2 in ln e, discards the worse half again and again, and ends with the exact
objective in float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time
from typing import Self

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.candidates import MAX_FLOAT32_LEVELS, BatchScore
from camctl.exposure.evaluation import evaluate
from camctl.exposure.objective import MAX_DIRECT_LEVELS, ExposureProblem, Objective
from camctl.exposure.random_sets import RandomSets
from camctl.model.effective import MOST_SEARCHED, check_count
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse

Progress = Callable[[float], None]

STARTS = 64
"""Sets that are improved at first; they are the best of 8 times as many."""

KNOWN_MOVES = 14
"""Changes of a start that is known from a coarse camera, instead of random starts."""

MOVES = 32
"""Moves tried for each set in a step; they double when the sets are halved."""

MAX_MOVES = 256

STAGE_SHARES = (0.07, 0.07, 0.11, 0.15, 0.22, 0.38)
"""Share of the evaluations in each stage; after each the worse half of the sets is discarded."""

EVALUATIONS = {2: 10_000, 3: 25_000, 4: 100_000, 5: 160_000, 6: 330_000}
"""Evaluations of a search for n exposures: enough for 0.5 % of the best known objective."""

MAX_EVALUATIONS = 400_000
"""Evaluations for more than 6 exposures."""

CURVED_EFFORT = 2.0
"""Factor on the evaluations for a curved camera, whose levels interleave in more ways."""

SAME_SET = 4.0
"""Interleave steps within which two sets for a curved camera count as the same.  Many starts end
in the same minimum; only the best of them is kept, so that a better minimum which is reached more
slowly is not discarded before."""

MAX_SORTED_LEVELS = 2.5e9
"""Levels sorted in one search, at most (about 15 s): bounds the search for cameras of many bits."""

MAX_SORTED_LEVELS_FLOAT64 = 5e7
"""The same for cameras that are scored in float64, which start near a good set (about 2 s)."""

MAX_FINAL_LEVELS = 2e7
"""Levels sorted by the exact objective at the end, at most."""

FINAL_PASSES = 100
"""Passes over all exposures at the end, at most; a quarter of it for non-integer p."""

FINALISTS = 4
"""Sets of the coarse search that the finer one starts from: their order may be another one."""

QUICK_EFFORT = 0.1
"""Effort of the first search for each number of exposures: within a few per cent of the best."""

QUICK_MARGIN = 1.25
"""A quick search with more than this many times the tolerance is not repeated with full effort."""

SHARE_BETWEEN = 0.05
"""Share of the evaluations for a camera between the coarsest and the finest one."""

MOST_SECONDS = 36.0
"""Processor time of a search, about, at most, where it is not limited further: a command may take
60 s and does more than to search."""

QUICK_SHARE = 0.5
"""Share of it for the quick searches for each number of exposures, together, at most."""

STEP_SHARE = 0.2
"""Share of it for one step of all sets, at most, where a search has to be limited."""

FIRST_STEP, NEXT_STEP = STARTS * MOVES, 2 * MAX_MOVES
"""Changes tried in the longest step: from random starts, and from known ones."""

NEXT_STARTS = 32
"""Starts from known sets, at most: 12 of them, and `KNOWN_MOVES`."""


@dataclass(frozen=True)
class SearchOptions:
    """How long to search, and with which random numbers.

    Attributes:
        seed: seed of the random numbers, >= 0; the same seed gives the same result, bit for bit
        effort: factor on the number of sets evaluated, > 0
        processor_s: processor time of the search, about, at most, s, > 0: by `BatchScore.seconds`
            and `ExposureProblem.seconds`, so that results are the same on each machine

    Raises:
        UsageError: a value is out of range
    """

    seed: int = 0
    effort: float = 1.0
    processor_s: float = MOST_SECONDS

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise UsageError(f"invalid seed {self.seed}: expected a whole number >= 0")
        for name, value in (
            ("search effort", self.effort),
            ("processor time", self.processor_s),
        ):
            if not (math.isfinite(value) and value > 0):
                raise UsageError(f"invalid {name} {value:g}: expected a positive number")


@dataclass(frozen=True)
class Solution:
    """Exposures found, and their quality.

    Attributes:
        exposures: relative, ascending from 1
        xi: the objective, including noise and jitter if requested
        levels_wanted: G, the number of levels of the desired camera
        effective_levels: L of the effective camera, without noise
        total_exposure: sum of the exposures: total exposure time in units of the shortest
        seconds: CPU time of the search, s
        evaluations: sets of exposures scored
    """

    exposures: tuple[float, ...]
    xi: float
    levels_wanted: float
    effective_levels: float
    total_exposure: float
    seconds: float
    evaluations: int

    @classmethod
    def of(
        cls,
        problem: ExposureProblem,
        exposures: tuple[float, ...],
        *,
        seconds: float = 0.0,
        evaluations: int = 1,
    ) -> Self:
        """Return the solution that consists of `exposures`, ascending from 1."""
        quality = evaluate(
            problem.response, problem.desired, exposures, objective=problem.objective
        )
        return cls(
            exposures=exposures,
            xi=quality.xi,
            levels_wanted=quality.levels_wanted,
            effective_levels=quality.effective_levels,
            total_exposure=quality.total_exposure,
            seconds=seconds,
            evaluations=evaluations,
        )


def solve(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    *,
    objective: Objective | None = None,
    tolerance: float | None = None,
    total_limit: float = math.inf,
    search: SearchOptions | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Return the best n exposures found for a camera to approximate a desired response.

    With a `tolerance` they are the fewest, n at most, that leave so few levels missing (Grossberg
    and Nayar, section 3.2); with a `total_limit` they take no more time in all (footnote 10).

    Args:
        response: the response of the real camera
        desired: the desired response
        n: number of exposures, 1 to 16; with a `tolerance` the largest number
        objective: the quantity to minimise; None: missing levels of n * M
        tolerance: largest objective, >= 0; it needs `Objective.levels_wanted`, since the default
            n * M grows with n; None: as small as n exposures make it
        total_limit: largest sum of the exposures, in units of the shortest; infinite: no limit
        search: how long to search, and with which random numbers
        progress: called with the completed share, 0 to 1

    Raises:
        UsageError: n is out of range, the limit is below n, the tolerance is negative, or n
            exposures do not reach it; states the objective that they reach

    >>> from camctl.model.response.camera import linear_response
    >>> from camctl.model.response.desired import desired_response
    >>> found = solve(linear_response(8), desired_response("log", 1000.0), 2)
    >>> [round(e, 1) for e in found.exposures]
    [1.0, 32.4]
    """
    check_count(n, MOST_SEARCHED)
    problem = ExposureProblem(response, desired, n, objective or Objective())
    options, started = search or SearchOptions(), process_time()
    if tolerance is None:
        found, _ = _best_of_count(problem, options, total_limit, progress, options.processor_s)
    else:
        found = _fewest(problem, options, total_limit, tolerance, progress)
    if progress is not None:
        progress(1.0)
    return replace(found, seconds=process_time() - started)


def part_of(progress: Progress | None, first: float, last: float) -> Progress | None:
    """Return what reports the progress of a part of the work: from one share of it to another."""
    if progress is None:
        return None
    return lambda share: progress(first + (last - first) * share)


def _best_of_count(
    problem: ExposureProblem,
    options: SearchOptions,
    total_limit: float,
    progress: Progress | None,
    seconds: float,
) -> tuple[Solution, float]:
    """Return the best set found within a processor time, and the time for it, both s, about."""
    n = problem.n
    if not total_limit >= n:
        raise UsageError(
            f"invalid limit {total_limit:g} of the total exposure: {n} exposures have at least {n} "
            "times the shortest",
            hint="raise the limit, or request fewer exposures",
        )
    equal = (1.0,) * n
    # xi is never below 0, and no set is shorter than equal exposures.
    if n == 1 or total_limit == n or problem.score(equal) == 0:
        return Solution.of(problem, equal), 0.0
    searches = _searches(problem, options, total_limit)
    needed = [each.needed_s for each in searches]
    share = seconds / sum(needed)
    first, known, exposures = 0.0, None, equal
    for k, (running, needed_s) in enumerate(zip(searches, needed, strict=True)):
        if k > 0:
            known = searches[k - 1].starts_for(running.problem.response)
        if share < 1:
            running.limit_to(share)
        last = first + needed_s / sum(needed)
        running.progress, first = part_of(progress, first, last), last
        exposures = running.run(known)
    found = Solution.of(problem, exposures, evaluations=running.score.evaluations)
    return found, min(seconds, sum(needed))


def _fewest(
    problem: ExposureProblem,
    options: SearchOptions,
    total_limit: float,
    tolerance: float,
    progress: Progress | None,
) -> Solution:
    """Return the best set of the fewest exposures whose objective is `tolerance` at most.

    The last search may take all the time that is left for full searches, each before it half of it.
    """
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise UsageError(f"invalid tolerance {tolerance:g}: expected a number of levels >= 0")
    if problem.objective.levels_wanted is None:
        raise UsageError("a tolerance needs the number of desired levels")
    most, best = int(min(problem.n, max(1.0, total_limit))), math.inf
    quick = replace(options, effort=QUICK_EFFORT * options.effort)
    quick_s = QUICK_SHARE * options.processor_s / most
    left_s = (1 - QUICK_SHARE) * options.processor_s
    for n in range(1, most + 1):
        fewer = replace(problem, n=n)
        here = part_of(progress, (n - 1) / most, (n - 0.5) / most)
        found, _ = _best_of_count(fewer, quick, total_limit, here, quick_s)
        if tolerance < found.xi < QUICK_MARGIN * tolerance or n == most:
            here = part_of(progress, (n - 0.5) / most, n / most)
            in_s = left_s if n == most else left_s / 2
            found, spent_s = _best_of_count(fewer, options, total_limit, here, in_s)
            left_s -= spent_s
        if found.xi <= tolerance:
            return found
        best = min(best, found.xi)
    raise UsageError(
        f"no set of up to {most} exposures reduces xi to {tolerance:g}",
        hint=f"the best one has {best:.4g}: allow that many missing levels, or request fewer "
        f"levels than {problem.levels_wanted:g}",
    )


def _searches(
    problem: ExposureProblem, options: SearchOptions, total_limit: float
) -> list[_Search]:
    """Return the searches for a camera, and for cameras of fewer levels before it.

    What each finds is where the next one starts.
    """
    found = [_Search(problem, options, total_limit)]
    while problem.response.M > MAX_DIRECT_LEVELS and problem.objective.noise is None:
        problem = problem.coarser
        found.insert(0, _Search(problem, options, total_limit))
    for between in found[1:-1]:
        between.budget *= SHARE_BETWEEN
    for each in found[1:]:
        each.most_starts, each.longest_step = NEXT_STARTS, NEXT_STEP
    return found


class _Search:
    """One search, with the arguments of `solve`; sets are natural logarithms of the exposures."""

    def __init__(
        self,
        problem: ExposureProblem,
        search: SearchOptions,
        limit: float,
    ) -> None:
        self.problem, self.limit = problem, limit
        self.progress: Progress | None = None
        self.score, self.exact_scores = BatchScore(problem), 0
        self.most_s = search.processor_s
        n, M, levels = problem.n, problem.response.M, problem.response.levels
        darkest = problem.desired.e_min or float(levels[levels > 0][0]) / MOST_SEARCHED
        self.moves = RandomSets(
            np.random.default_rng(search.seed), n, problem.response, -math.log(darkest)
        )
        sorted_at_once = problem.sorted_levels
        max_sorted = MAX_SORTED_LEVELS if M <= MAX_FLOAT32_LEVELS else MAX_SORTED_LEVELS_FLOAT64
        evaluations, self.same = float(EVALUATIONS.get(n, MAX_EVALUATIONS)), 0.0
        if self.moves.is_curved:
            evaluations *= CURVED_EFFORT
            self.same = SAME_SET * self.moves.interleave
        budget = search.effort * min(evaluations, max_sorted / sorted_at_once)
        self.budget = max(budget, 20.0 * STARTS) if M <= MAX_DIRECT_LEVELS else budget
        self.most_starts = 8 * STARTS
        self.longest_step = self.most_changes = FIRST_STEP
        p = problem.objective.p
        passes = FINAL_PASSES if p == round(p) else FINAL_PASSES // 4
        final = min(2 * n * passes, max(20.0, MAX_FINAL_LEVELS / sorted_at_once))
        self.finalists: FloatArray = np.empty((0, n))
        self.final_evaluations = int(final)
        self.most_final = math.inf

    @property
    def needed_s(self) -> float:
        """About the processor time that the search takes, s, if it is not limited."""
        scored = self.most_starts + self.budget + self.longest_step
        return self.score.seconds * scored + self.problem.seconds * 2 * self.final_evaluations

    def limit_to(self, share: float) -> None:
        """Let the search take a share of the time that it needs."""
        in_time = STEP_SHARE * self.most_s / self.score.seconds
        self.most_starts = max(2, int(min(share * self.most_starts, in_time)))
        self.most_changes = int(min(share * self.longest_step, in_time))
        rest = share * (self.budget + self.longest_step) - self.most_changes
        self.budget = max(share * self.budget, rest)
        self.most_final = int(share * self.final_evaluations)

    def starts_for(self, camera: CameraResponse) -> FloatArray:
        """Return (K, n) starts, as logarithms, for a camera of more levels.

        Half of them are the sets that were found; in the others, each after the set that it is
        from, the distances of ratios from multiples of 1/2, by which levels interleave, are
        reduced as the gaps are.
        """
        logs = self.finalists
        steps = np.diff(logs, axis=1, prepend=0.0)
        whole = np.log(np.maximum(np.round(2 * np.exp(steps)), 2) / 2)
        near = np.abs(steps - whole) < 4 / (self.problem.response.M + 1)
        finer = camera.M / self.problem.response.M
        reduced = np.where(near, whole + (steps - whole) / finer, steps)
        return np.stack([logs, np.cumsum(reduced, axis=1)], axis=1).reshape(-1, self.problem.n)

    def run(self, known: FloatArray | None = None) -> tuple[float, ...]:
        """Return the best exposures found; `known` (K, n) replaces some of the random starts."""
        starts = [self.moves.even(STARTS), self.moves.starts(7 * STARTS)]
        if known is not None:
            starts = [self.moves.normalised(known), self.moves.around(known, KNOWN_MOVES)[0]]
        sets = self._within_limit(np.concatenate(starts)[: self.most_starts])
        count = STARTS if known is None else len(known) // 2
        sets, scores = _best(sets, self.score(np.exp(sets)), count)
        self._report()
        moves = MOVES
        end = self.score.evaluations
        for share in STAGE_SHARES:
            end += int(share * self.budget)
            while self.score.evaluations < end:
                most = max(1, self.most_changes // len(sets))
                sets, scores = self._improve(sets, scores, min(moves, most))
                self._report()
            sets, scores = _best(sets, scores, max(2, len(sets) // 2), apart=self.same)
            if len(sets) >= FINALISTS or not self.finalists.size:
                self.finalists = sets[:FINALISTS]
            moves = min(2 * moves, MAX_MOVES)
        sets = sets[: int(max(1, min(len(sets), self.most_final)))]
        finished = sorted((self._finish(row) for row in sets), key=lambda found: found[1])
        best = [np.log(exposures) for exposures, _ in finished]
        self.finalists = np.concatenate([best, self.finalists])
        return finished[0][0]

    def _report(self) -> None:
        """Report the share of the time that is planned for all scores."""
        if self.progress is None:
            return
        batch, exact = self.score.seconds, self.problem.seconds
        finals = 2 * min(self.final_evaluations, self.most_final)
        planned = batch * (self.budget + self.most_starts) + exact * finals
        scored = self.score.evaluations - self.exact_scores
        self.progress(min((batch * scored + exact * self.exact_scores) / planned, 0.99))

    def _improve(
        self, sets: FloatArray, scores: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Replace each set by the best of `count` changed copies if that is better."""
        changed = self._within_limit(self.moves.around(sets, count))
        n = self.problem.n
        found = self.score(np.exp(changed.reshape(-1, n))).reshape(len(sets), count)
        row = np.arange(len(sets))
        best = found.argmin(axis=1)
        better = found[row, best] < scores
        sets = np.where(better[:, np.newaxis], changed[row, best], sets)
        return sets, np.where(better, found[row, best], scores)

    def _within_limit(self, sets: FloatArray) -> FloatArray:
        """Return the sets; those whose sum exceeds the limit are scaled towards 1."""
        if math.isinf(self.limit):
            return sets
        low, high = np.zeros((*sets.shape[:-1], 1)), np.ones((*sets.shape[:-1], 1))
        over = np.exp(sets).sum(axis=-1, keepdims=True) > self.limit
        for _ in range(40):
            middle = (low + high) / 2
            too_long = np.exp(sets * middle).sum(axis=-1, keepdims=True) > self.limit
            high, low = np.where(too_long, middle, high), np.where(too_long, low, middle)
        return np.where(over, sets * low, sets)

    def _finish(self, logs: FloatArray) -> tuple[tuple[float, ...], float]:
        """Coordinate steps of 1e-4 down to 1e-8 in ln e with the exact objective."""
        current, value = logs.copy(), self._exact(logs)
        step, before = 1e-4, self.score.evaluations
        last = before + self.final_evaluations
        while step > 1e-8 and self.score.evaluations < last:
            improved = False
            for index in range(1, len(current)):
                for sign in (1, -1):
                    if self.score.evaluations - before >= self.most_final:
                        return tuple(np.exp(current).tolist()), value
                    trial = current.copy()
                    trial[index] += sign * step
                    trial = self._within_limit(self.moves.normalised(trial))
                    score = self._exact(trial)
                    if score < value:
                        current, value, improved = trial, score, True
            if not improved:
                step /= 4
        return tuple(np.exp(current).tolist()), value

    def _exact(self, logs: FloatArray) -> float:
        self.score.evaluations += 1
        self.exact_scores += 1
        self._report()
        return self.problem.score(np.exp(logs).tolist())


def _best(
    sets: FloatArray, scores: FloatArray, count: int, *, apart: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the best sets, those within `apart` of a better one after all others."""
    order = np.argsort(scores, kind="stable")
    if apart > 0:
        distance = np.abs(sets[order][:, np.newaxis] - sets[order]).max(axis=2)
        repeated = np.any(np.tril(distance < apart, -1), axis=1)
        order = np.concatenate([order[~repeated], order[repeated]])
    order = order[:count]
    return sets[order], scores[order]
