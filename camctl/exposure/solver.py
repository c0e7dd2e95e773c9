"""The best exposures by search: many starts, moves of every scale, successive halving.

The objective is continuous but kinked wherever two levels cross, tens of thousands of times along
each exposure, and has many good minima that differ in how the exposures group.  What finds the best
ones: a large batch of starts, each improved by the best of many random moves at every scale from
1e-5 to 2 in ln e, the worse half given up again and again, and an exact finish in float64.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.batch import FINEST_FLOAT32, BatchScore
from camctl.exposure.effective import MAX_EXPOSURES, EffectiveCamera, effective_levels
from camctl.exposure.moves import Moves
from camctl.exposure.objective import NoiseTerm, Objective
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.desired import DesiredResponse

Progress = Callable[[float], None]

STARTS = 64
MOVES = 32
MOST_MOVES = 256
SHARE_OF_ROUNDS = (0.07, 0.07, 0.11, 0.15, 0.22, 0.38)
EFFORT = {2: 10_000, 3: 25_000, 4: 100_000, 5: 160_000, 6: 330_000}
MOST_EFFORT = 400_000
MOST_LEVELS = 2.5e9
"""Levels sorted in one search, at most: what many-bit cameras are held to (about 15 s)."""

MOST_FLOAT64_LEVELS = 1e9

MOST_FINISH_LEVELS = 5e8
FINISH_PASSES = 100

QUICK = 0.1
HOPELESS = 1.25
"""A quick search this far above a tolerance ends the matter: the full one gains a few per cent."""

COARSE = 255
FINE = 1023
"""Cameras of more levels than this start from the solution for `COARSE` of their levels."""


@dataclass(frozen=True)
class Solution:
    """Exposures found, and what they are worth.

    Attributes:
        exposures: relative, ascending from 1
        xi: the objective, noise and jitter included where they were asked for
        levels_wanted: G
        effective_levels: L of the effective camera, without noise
        total_exposure: sum of the exposures: shutter time in units of the shortest
        seconds: CPU time that the search took
        evaluations: candidates scored
    """

    exposures: tuple[float, ...]
    xi: float
    levels_wanted: float
    effective_levels: float
    total_exposure: float
    seconds: float
    evaluations: int


def check_count(n: int) -> None:
    """Raise `UsageError` unless n lies in 1..16."""
    if not 1 <= n <= MAX_EXPOSURES:
        raise UsageError(f"{n} exposures", hint=f"ask for 1 to {MAX_EXPOSURES}")


def describe(
    response: CameraResponse,
    desired: DesiredResponse,
    exposures: tuple[float, ...],
    goal: Objective,
    *,
    seconds: float = 0.0,
    evaluations: int = 1,
) -> Solution:
    """Return what a given set of exposures, ascending from 1, is worth."""
    camera = EffectiveCamera.of(response, exposures)
    return Solution(
        exposures=camera.exposures,
        xi=goal.score(response, exposures, desired),
        levels_wanted=goal.levels_wanted,
        effective_levels=effective_levels(camera, desired),
        total_exposure=math.fsum(camera.exposures),
        seconds=seconds,
        evaluations=evaluations,
    )


class _Search:
    """One search; `solve` says what the arguments mean."""

    def __init__(
        self,
        response: CameraResponse,
        desired: DesiredResponse,
        n: int,
        goal: Objective,
        *,
        seed: int,
        effort: float,
        limit: float,
        deadline: float,
        progress: Progress | None,
    ) -> None:
        self.score = BatchScore(response, desired, goal, n)
        self.response, self.desired, self.goal = response, desired, goal
        self.limit, self.deadline, self.progress = limit, deadline, progress
        ladder = response.levels
        darkest = max(desired.e_min, float(ladder[ladder > 0][0]) / MAX_EXPOSURES)
        self.moves = Moves(np.random.default_rng(seed), n, response.M, -math.log(darkest))
        most = MOST_LEVELS if response.M <= FINEST_FLOAT32 else MOST_FLOAT64_LEVELS
        most /= n * response.M * len(goal.draws(n))
        budget = effort * min(EFFORT.get(n, MOST_EFFORT), most)
        self.budget = max(budget, 20.0 * STARTS)
        passes = FINISH_PASSES if goal.p == round(goal.p) else FINISH_PASSES // 4
        most_steps = MOST_FINISH_LEVELS / (n * response.M * len(goal.draws(n)))
        self.finishing = int(min(2 * n * passes, max(20.0, most_steps)))

    def run(self, known: FloatArray | None = None) -> tuple[float, ...]:
        """Return the best exposures; `known` (K, n) logarithms are starts beside random ones."""
        starts = self._affordable(self.moves.starts(8 * STARTS))
        if known is not None:
            starts[: len(known)] = self._affordable(self.moves.inside(known))
        scores = self.score(np.exp(starts))
        sets, scores = _best(starts, scores, STARTS)
        moves = MOVES
        spent = self.score.evaluations
        for share in SHARE_OF_ROUNDS:
            spent += int(share * self.budget)
            while self.score.evaluations < spent and time.monotonic() < self.deadline:
                sets, scores = self._improve(sets, scores, moves)
                if self.progress is not None:
                    self.progress(min(self.score.evaluations / self.budget, 0.99))
            sets, scores = _best(sets, scores, max(2, len(sets) // 2))
            moves = min(2 * moves, MOST_MOVES)
        return min((self._finish(row) for row in sets), key=lambda found: found[1])[0]

    def _improve(
        self, sets: FloatArray, scores: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        changed = self._affordable(self.moves.around(sets, count))
        found = self.score(np.exp(changed.reshape(-1, self.score.n))).reshape(len(sets), count)
        row = np.arange(len(sets))
        best = found.argmin(axis=1)
        better = found[row, best] < scores
        sets = np.where(better[:, np.newaxis], changed[row, best], sets)
        return sets, np.where(better, found[row, best], scores)

    def _affordable(self, sets: FloatArray) -> FloatArray:
        """Return the sets, those that sum to more than the limit drawn in towards 1."""
        if math.isinf(self.limit):
            return sets
        high = np.ones((*sets.shape[:-1], 1))
        low = np.zeros_like(high)
        over = np.exp(sets).sum(axis=-1, keepdims=True) > self.limit
        for _ in range(40):
            middle = (low + high) / 2
            dear = np.exp(sets * middle).sum(axis=-1, keepdims=True) > self.limit
            high, low = np.where(dear, middle, high), np.where(dear, low, middle)
        return np.where(over, sets * low, sets)

    def _finish(self, logs: FloatArray) -> tuple[tuple[float, ...], float]:
        """Coordinate steps of 1e-4 down to 1e-8 in ln e with the exact objective."""
        here, value = logs.copy(), self._exact(logs)
        last = self.score.evaluations + self.finishing
        step = 1e-4
        while step > 1e-8 and self.score.evaluations < last:
            improved = False
            for index in range(1, len(here)):
                for sign in (1, -1):
                    if time.monotonic() > self.deadline:
                        return tuple(np.exp(here).tolist()), value
                    trial = here.copy()
                    trial[index] += sign * step
                    trial = self._affordable(self.moves.inside(trial))
                    score = self._exact(trial)
                    if score < value:
                        here, value, improved = trial, score, True
            if not improved:
                step /= 4
        return tuple(np.exp(here).tolist()), value

    def _exact(self, logs: FloatArray) -> float:
        self.score.evaluations += 1
        return self.goal.score(self.response, np.exp(logs).tolist(), self.desired)


def _best(sets: FloatArray, scores: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(scores, kind="stable")[:count]
    return sets[order], scores[order]


def _from_coarse(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    goal: Objective,
    *,
    seed: int,
    limit: float,
    effort: float,
) -> FloatArray:
    """Return (2, n) starts from the solution for a camera with `COARSE` of the levels.

    One as it is, one with the small ratios, which interleave levels, shrunk as the levels are.
    """
    kept = np.arange(1, COARSE + 1) * (response.M + 1) // (COARSE + 1) - 1
    coarse = CameraResponse(response.levels[kept], f"{response.name}, {COARSE} of its levels")
    found = solve(
        coarse,
        desired,
        n,
        levels_wanted=goal.levels_wanted * COARSE / response.M,
        seed=seed,
        p=goal.p,
        total_limit=None if math.isinf(limit) else limit,
        effort=effort,
    )
    logs = np.log(found.exposures)
    steps = np.diff(logs, prepend=0.0)
    shrunk = np.where(steps < 4 / COARSE, steps * COARSE / response.M, steps)
    return np.array([logs, np.cumsum(shrunk)])


def solve(
    response: CameraResponse,
    desired: DesiredResponse,
    n: int,
    *,
    levels_wanted: float | None = None,
    seed: int = 0,
    time_limit_s: float | None = None,
    progress: Progress | None = None,
    p: float = 1.0,
    noise: NoiseTerm | None = None,
    jitter: float = 0.0,
    total_limit: float | None = None,
    effort: float = 1.0,
) -> Solution:
    """Return the best n exposures found for a real camera to emulate a desired one.

    Args:
        response: the real camera
        desired: the wanted response and dynamic range
        n: number of exposures, 1 to 16
        levels_wanted: G; n * M where not given, as many levels as the frames hold
        seed: same seed, same result, bit for bit (unless `time_limit_s` cuts the search short)
        time_limit_s: wall time after which the best so far is returned, s
        progress: called with the share done, 0 to 1
        p: norm of the objective
        noise: adds c V to the objective
        jitter: averages the objective over exposures off by this relative standard deviation
        total_limit: the exposures may sum to this at most (shutter time in units of the shortest)
        effort: scales the number of candidates

    Raises:
        UsageError: for n, G, p or a limit that cannot be
    """
    check_count(n)
    goal = Objective(n * response.M if levels_wanted is None else levels_wanted, p, noise, jitter)
    limit = math.inf if total_limit is None else total_limit
    if not limit >= n:
        raise UsageError(
            f"{n} exposures cannot last only {limit:g} times the shortest",
            hint=f"the least is {n}: raise the limit or ask for fewer exposures",
        )
    started = time.process_time()
    if n == 1 or limit == n:
        found = describe(response, desired, (1.0,) * n, goal)
    else:
        search = _Search(
            response,
            desired,
            n,
            goal,
            seed=seed,
            effort=effort,
            limit=limit,
            deadline=math.inf if time_limit_s is None else time.monotonic() + time_limit_s,
            progress=progress,
        )
        known = None
        if response.M > FINE and goal.noise is None:
            known = _from_coarse(response, desired, n, goal, seed=seed, limit=limit, effort=effort)
        exposures = search.run(known)
        found = describe(response, desired, exposures, goal, evaluations=search.score.evaluations)
    if progress is not None:
        progress(1.0)
    return replace(found, seconds=time.process_time() - started)


def fewest(
    response: CameraResponse,
    desired: DesiredResponse,
    tolerance: float,
    levels_wanted: float,
    *,
    seed: int = 0,
    most: int = MAX_EXPOSURES,
    progress: Progress | None = None,
) -> Solution:
    """Return the solution with the fewest exposures whose xi is at most `tolerance`.

    The paper's section 3.2: one exposure more until the objective falls below the tolerance.
    `levels_wanted` must be explicit, since the default n * M grows with n.

    Raises:
        UsageError: where `most` exposures do not reach it; says what they do reach
    """
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise UsageError(f"tolerance {tolerance:g}", hint="give xi to reach, a number >= 0")
    best = math.inf
    for n in range(1, most + 1):
        solution = solve(response, desired, n, levels_wanted=levels_wanted, seed=seed, effort=QUICK)
        if tolerance < solution.xi < HOPELESS * tolerance or n == most:
            solution = solve(response, desired, n, levels_wanted=levels_wanted, seed=seed)
        if progress is not None:
            progress(n / most)
        if solution.xi <= tolerance:
            return solution
        best = min(best, solution.xi)
    raise UsageError(
        f"{most} exposures do not bring xi down to {tolerance:g}",
        hint=f"they reach {best:.4g}: allow that much, or want fewer levels than {levels_wanted:g}",
    )
