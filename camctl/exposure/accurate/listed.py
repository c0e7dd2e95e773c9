"""All sets of settings of a short list: the best of them, and the quickest of a given accuracy.

All are estimated; those whose estimate, or whose quantisation error without noise, makes it
possible are rated by the exact prediction, the most promising first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.exposure_choices import SAME, Rated, Shots
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import FloatArray

MAX_ENUMERATED = 20_000
"""Sets of one number of exposures that are all estimated, at most: about 0.3 s."""

MAX_RATED = 1000
"""Of them, sets that are rated exactly, at most."""

MARGIN, ROUGH = 0.96, 0.8
"""Share of the levels that an estimate must reach for a set to be rated; and the same where noise
does not dither the quantiser."""

_CHUNK = 1000
"""Sets estimated at once: bounds memory."""

TIME_DIGITS = 9
"""Digits to which times are compared."""


@dataclass(frozen=True, eq=False)
class ListedSets:
    """All sets of the numbers of exposures that have few enough of them.

    Attributes:
        searches: one for each shortest exposure
        counts: fewest and most exposures of a set
        dithered: whether noise dithers the quantiser, so that the estimate holds
        rate: returns the exact rating of a set
    """

    searches: Sequence[DesignSearch]
    counts: tuple[int, int]
    dithered: bool
    rate: Callable[[Shots], Rated]

    @cached_property
    def numbers(self) -> list[int]:
        """The numbers of exposures of which all sets are considered."""
        if not self.searches[0].is_list:
            return []
        sizes = [(each.bases.size, each.gain.size) for each in self.searches]
        return [
            n
            for n in range(self.counts[0], self.counts[1] + 1)
            if sum(b * math.comb(size + n - 2, n - 1) for b, size in sizes) <= MAX_ENUMERATED
        ]

    @property
    def is_complete(self) -> bool:
        """Whether these are all sets that there are."""
        return len(self.numbers) == self.counts[1] - self.counts[0] + 1

    def most_accurate(self, limit: float) -> Rated | None:
        """Return the set of most effective levels whose time is at most `limit`."""
        sets, times, estimates = self._estimated
        best: Rated | None = None
        within = np.flatnonzero(times <= limit * (1 + SAME))
        order = within[np.argsort(-estimates[within], kind="stable")][:MAX_RATED]
        for index in order.tolist():
            if best is not None and estimates[index] < self._margin * best.levels:
                break
            rated = self.rate(sets[index])
            if best is None or rated.levels > best.levels:
                best = rated
        return best

    def quickest(self, levels: float, limit: float) -> Rated | None:
        """Return the shortest set that has `levels`; of equal times the most accurate one."""
        sets, times, estimates = self._estimated
        possible = (times <= limit * (1 + SAME)) & (estimates >= self._margin * levels)
        index = np.flatnonzero(possible)
        order = index[np.lexsort((-estimates[index], np.round(times[index], TIME_DIGITS)))]
        for each in order[:MAX_RATED].tolist():
            rated = self.rate(sets[each])
            if rated.levels >= levels:
                return rated
        return None

    @property
    def _margin(self) -> float:
        return MARGIN if self.dithered else ROUGH

    @cached_property
    def _estimated(self) -> tuple[list[Shots], FloatArray, FloatArray]:
        """All sets, their times, and the effective levels that they may have."""
        sets: list[Shots] = []
        times: list[FloatArray] = [np.empty(0)]
        levels: list[FloatArray] = [np.empty(0)]
        for search in self.searches:
            shots = search.option_shots
            for n in self.numbers:
                found = _rows(search, n)
                last = found[np.arange(len(found)), search.log_exposure[found].argmax(axis=1)]
                times.append(search.cost[found].sum(axis=1) - search.saved[last])
                for first in range(0, len(found), _CHUNK):
                    parts = search.parts[:, found[first : first + _CHUNK]].sum(axis=2)
                    levels.append((12 * search.frames.mse(parts)) ** -0.5)
                sets += [tuple(sorted(shots[index] for index in row)) for row in found.tolist()]
        estimate = np.concatenate(levels)
        if len(sets) <= MAX_RATED:
            estimate = np.full(len(sets), np.inf)  # all are rated: the estimate excludes none
        elif not self.dithered:
            estimate = np.maximum(estimate, [self._noise_free(each) for each in sets])
        return sets, np.concatenate(times), estimate

    def _noise_free(self, shots: Shots) -> float:
        problem = self.searches[0].problem
        camera = EffectiveCamera.of(problem.response, [shot.exposure for shot in shots])
        return effective_levels(camera, problem.desired)


def _rows(search: DesignSearch, n: int) -> np.ndarray:
    """Return all sets of n settings with a shortest exposure, (C, n) ascending indices."""
    rows = [
        (base, *rest)
        for base in search.bases.tolist()
        for rest in combinations_with_replacement(range(search.gain.size), n - 1)
    ]
    return np.unique(np.sort(np.array(rows, dtype=np.intp), axis=1), axis=0)
