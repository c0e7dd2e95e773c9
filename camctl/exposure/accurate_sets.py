"""Sets of exposures rated by the exact prediction, found from the fast estimate.

The estimate ranks sets, but takes no account of how the levels of nearly equal exposures
interleave, nor that noise far below a level leaves quantisation steps.  So the best sets of the
estimate, and for a camera of little noise the sets of least quantisation error, are rated by the
exact distribution, and their neighbours too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import TypeAlias

import numpy as np

from camctl.exposure.enumerated_sets import MAX_ENUMERATED, EnumeratedSets, number_of_sets
from camctl.exposure.exchange_search import ExchangeSearch, Set
from camctl.exposure.exposure_choices import (
    AccuracyProblem,
    Rated,
    ShotChoices,
    Shots,
    shot_choices,
)
from camctl.exposure.least_quantisation import LeastQuantisation
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.set_moves import INTERLEAVES, SetMoves
from camctl.model.distribution import deviation
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import FloatArray

EXACT_RATINGS = 70
"""Exact predictions while a set is improved, for 8 bits; fewer for finer cameras, which take longer
and whose noise dithers the quantiser."""

DITHERING, HIDING = 0.3, 0.5
"""Noise in levels from which the quantiser counts as dithered, and from which distances of less
than a level between equal exposures change nothing (the levels by less than 0.1 %)."""

DARK_TO_BRIGHT = np.geomspace(1e-6, 1.0, 25)
"""Irradiances at which the noise is compared with `HIDING`."""

CORRECTIONS = 8
"""Attempts to reach a number of levels exactly by asking the estimate for more or fewer."""

MOST_STARTS, MOST_IMPROVED = 2, 1
"""Best sets of the estimate that are rated exactly, and sets that are then improved."""

IMPROVABLE = 0.98
"""Share of the effective levels of a better set from which improving a set is worth the time."""

CLOSE = 1.0015
"""Ratio of effective levels up to which a set has not more of them than asked for."""

CORRECTION = 1.001
"""Factor by which a correction exceeds what was missing, so that the next attempt succeeds."""

BINDING = 0.95
"""Share of the time limit from which the limit is what keeps a set from being better."""

SHORTER, SHORTEST = 0.8, 0.94
"""Factor by which the time is reduced step by step where the estimate does not apply; it rises to
the second one as this fails."""

MARGIN, ROUGH = 0.96, 0.93
"""Share of the effective levels that an estimate must reach for the set to be rated exactly, and
the same where noise does not dither the quantiser."""


Better: TypeAlias = Callable[[Rated, Rated], bool]


def _levels(error: float) -> float:
    return float((12 * error) ** -0.5)


class AccurateSets:
    """Finds sets for one problem; each exact rating is made once.

    Args:
        problem: the camera, its noise and the desired response
        effort: share of `EXACT_RATINGS` that are made
    """

    def __init__(self, problem: AccuracyProblem, effort: float = 1.0) -> None:
        self.problem = problem
        self.choices = list(shot_choices(problem))
        self._searches: dict[int, list[ExchangeSearch]] = {}
        self._estimated: dict[tuple[int, float], list[tuple[float, ShotChoices, Set]]] = {}
        self._best: dict[tuple[int, float], Rated] = {}
        self._enumerated: dict[int, EnumeratedSets | None] = {}
        self._rated: dict[Shots, Rated] = {}
        self._quantisation = LeastQuantisation(problem)
        self.moves = SetMoves(problem)
        M = problem.response.M
        self._ratings = max(2, int(effort * EXACT_RATINGS * 255) // max(M, 255))

    @property
    def evaluations(self) -> int:
        """Sets estimated or rated so far."""
        searches = [each for found in self._searches.values() for each in found]
        estimated = sum(search.evaluations for search in searches)
        return estimated + self._quantisation.evaluations + len(self._rated)

    def enumerates(self, n: int) -> bool:
        """Return whether all sets of n exposures are considered."""
        return self._all(n) is not None

    def least_time(self, n: int) -> float:
        """Return the shortest total time of n exposures, as `TimeCosts.total` counts it."""
        return min(search.least_time for search in self._searches_for(n))

    def may_reach(self, n: int, levels: float, limit: float) -> bool:
        """Return whether the estimate leaves it possible that n exposures reach `levels`."""
        if not self._best_estimated(n, limit):
            return False
        estimate = self.estimated(n, limit)
        return estimate is None or estimate >= (MARGIN if self._dithered else ROUGH) * levels

    def estimated(self, n: int, limit: float) -> float | None:
        """Return about the most effective levels of n exposures, within a few per cent.

        None where the quantiser is not dithered and no set without noise was found, so that the
        estimate says little.
        """
        best = self._best_estimated(n, limit)
        estimate = _levels(best[0][0]) if best else None
        if estimate is None or self._dithered:
            return estimate
        noise_free = self._quantisation.estimated(n, limit)
        return None if noise_free is None else max(estimate, noise_free)

    def most_accurate(self, n: int, limit: float, *, least: float = 0.0) -> Rated:
        """Return the set of n exposures of most effective levels within `limit` (>= least time).

        It is improved by exact ratings only if it has nearly `least` levels before.
        """
        if (every := self._all(n)) is not None:
            return every.most_accurate(limit)
        if (n, limit) not in self._best:
            self._best[n, limit] = self._search_most_accurate(n, limit, least)
        return self._best[n, limit]

    def _search_most_accurate(self, n: int, limit: float, least: float) -> Rated:
        starts = [
            (choices, self._interleaved_best(choices, choices.shots(found)))
            for _, choices, found in self._best_estimated(n, limit)
        ]
        starts += [(self.choices[0], rated) for rated in self._least_quantisation(n, limit)]
        starts.sort(key=lambda start: -start[1].levels)
        improved = [starts[0][1]]

        def better(one: Rated, other: Rated) -> bool:
            return one.levels > other.levels and one.time <= limit

        for choices, start in starts[:MOST_IMPROVED]:
            total = limit if start.time > BINDING * limit and not choices.is_list else None
            if start.levels >= IMPROVABLE * max(least, starts[0][1].levels):
                improved.append(self._improved(choices, start, better, total=total))
        return max(improved, key=lambda each: each.levels)

    def quickest(self, n: int, levels: float, limit: float) -> Rated | None:
        """Return the shortest set of n exposures found that has `levels`, or None.

        `shortened` improves it further.
        """
        if (every := self._all(n)) is not None:
            return every.quickest(levels, limit)
        if self.least_time(n) > limit:
            return None
        if not self._dithered and not self.may_reach(n, levels, limit):
            return None
        estimated = self._quickest_estimated(n, levels)
        found = [each for each in estimated if each.time <= limit]
        if not estimated or not self._dithered:
            found += [each for each in [self.most_accurate(n, limit)] if each.levels >= levels]
        if not found:
            return None
        start = min(found, key=lambda each: each.time)
        share = SHORTER
        while share < SHORTEST and not self._dithered:
            reached = self._least_quantisation(n, share * start.time, levels)
            if reached and reached[0].levels >= levels:
                start = reached[0]
            else:
                share = math.sqrt(share)
        return start

    def shortened(self, rated: Rated, levels: float) -> Rated:
        """Return the shortest of a set and its neighbours that have `levels`."""
        if self._all(len(rated.shots)) is not None:
            return rated

        def better(one: Rated, other: Rated) -> bool:
            return one.levels >= levels and one.time < other.time

        return self._improved(self.choices[0], rated, better)

    def _quickest_estimated(self, n: int, levels: float) -> list[Rated]:
        """Return sets of `levels` that the estimate finds, corrected by exact ratings."""
        wanted, found = levels, []
        for _ in range(CORRECTIONS):
            quick = [
                (search.choices.time(chosen), choices, chosen)
                for search, choices in zip(self._searches_for(n), self.choices, strict=True)
                if (chosen := search.shortest((12 * wanted**2) ** -1)) is not None
            ]
            if not quick:
                break
            _, choices, chosen = min(quick, key=lambda each: each[0])
            rated = self._interleaved_best(choices, choices.shots(chosen))
            found.append(rated)
            if levels <= rated.levels <= CLOSE * levels:
                break
            wanted *= CORRECTION * levels / rated.levels
        return [each for each in found if each.levels >= levels]

    def rate(self, shots: Shots) -> Rated:
        """Return the set with its effective levels by the exact prediction."""
        if shots not in self._rated:
            problem = self.problem
            camera = EffectiveCamera.of(problem.response, [shot.exposure for shot in shots])
            noise = [problem.frame_noise(shot) for shot in shots]
            levels = noisy_effective_levels(camera, problem.desired, noise)
            time = problem.available.costs.total([shot.time for shot in shots])
            self._rated[shots] = Rated(shots, levels, time)
        return self._rated[shots]

    @cached_property
    def _dithered(self) -> bool:
        """Whether noise dithers the quantiser: in a frame that is exposed to 1/16 of full scale."""
        return self._least_noise(np.array([1 / 16])) >= DITHERING

    @cached_property
    def _hides_levels(self) -> bool:
        """Whether noise hides how the levels of nearly equal exposures interleave."""
        return self._least_noise(DARK_TO_BRIGHT) >= HIDING

    def _least_noise(self, E: FloatArray) -> float:
        """Return the least noise of a frame at these irradiances, in levels."""
        noise = self.problem.noise.frame(gain=min(self.problem.available.gains), time_s=0.0)
        return float(deviation(self.problem.response, E, noise).min())

    def _all(self, n: int) -> EnumeratedSets | None:
        """Return all sets of a list of settings; None where they are too many, or not a list."""
        if n not in self._enumerated:
            is_short = number_of_sets(self.choices, n) <= MAX_ENUMERATED
            self._enumerated[n] = (
                EnumeratedSets(self.problem, self.choices, n, self._dithered, self.rate)
                if self.choices[0].is_list and is_short
                else None
            )
        return self._enumerated[n]

    def _searches_for(self, n: int) -> list[ExchangeSearch]:
        if n not in self._searches:
            self._searches[n] = [ExchangeSearch(choices.choices, n) for choices in self.choices]
        return self._searches[n]

    def _best_estimated(self, n: int, limit: float) -> list[tuple[float, ShotChoices, Set]]:
        """Return the best sets by the estimate: their error, their choices and their indices."""
        if (n, limit) not in self._estimated:
            found = []
            for search, choices in zip(self._searches_for(n), self.choices, strict=True):
                if search.least_time <= limit:
                    sets = search.most_accurate(limit)
                    found += [(search.choices.mse(chosen), choices, chosen) for chosen in sets]
            self._estimated[n, limit] = sorted(found, key=lambda each: each[0])[:MOST_STARTS]
        return self._estimated[n, limit]

    def _least_quantisation(self, n: int, limit: float, least: float = 0.0) -> list[Rated]:
        """Return the set of least quantisation error, if it may have `least` levels.

        It is of use for a camera whose noise does not dither.
        """
        if self._dithered:
            return []
        estimate = self._quantisation.estimated(n, limit)
        if estimate is None or estimate < ROUGH * least:
            return []
        found = self._quantisation.best(n, limit)
        return [] if found is None else [self.rate(found)]

    def _interleaved_best(self, choices: ShotChoices, shots: Shots) -> Rated:
        """Return the set, or the best one with its nearly equal exposures spread."""
        tried = [shots]
        if not (choices.is_list or self._hides_levels):
            tried += [self.moves.interleaved(distance, shots) for distance in INTERLEAVES]
        return max((self.rate(each) for each in tried), key=lambda rated: rated.levels)

    def _improved(
        self, choices: ShotChoices, start: Rated, better: Better, *, total: float | None = None
    ) -> Rated:
        """Return the best of a set and its neighbours, step by step, by exact ratings.

        With `total` the longest exposure is changed so that this is the total time.
        """
        best = start
        last = len(self._rated) + self._ratings
        improved = True
        while improved:
            improved = False
            for move in self.moves.of(choices, len(start.shots)):
                trial = move(best.shots)
                if total is not None and trial is not None:
                    trial = self.moves.filled(trial, total)
                if len(self._rated) >= last:
                    return best
                if trial is not None and better(rated := self.rate(trial), best):
                    best, improved = rated, True
        return best
