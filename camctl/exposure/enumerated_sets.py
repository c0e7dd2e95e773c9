"""All sets of n settings of a short list: the best of them, and the quickest of a given accuracy.

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

from camctl.exposure.exposure_choices import AccuracyProblem, Rated, ShotChoices, Shots
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import FloatArray

MAX_ENUMERATED = 20_000
"""Sets that are all estimated, at most."""

MAX_RATED = 250
"""Sets that are rated exactly, at most, for 8 bits and more; more for cameras of fewer levels,
which take less time and for which the estimate is less exact."""

MOST_RATED = 1000
"""The same for any camera."""

MARGIN = 0.93
"""Share of the effective levels that an estimate must reach for the set to be rated exactly."""

TIME_DIGITS = 9
"""Digits to which total times are compared."""


def number_of_sets(choices: Sequence[ShotChoices], n: int) -> int:
    """Return how many sets of n exposures, equal ones included, the choices have."""
    return sum(
        len(each.choices.bases) * math.comb(each.choices.exposures.size + n - 2, n - 1)
        for each in choices
    )


@dataclass(frozen=True, eq=False)
class EnumeratedSets:
    """All sets of n exposures, and how they are rated.

    Attributes:
        problem: the camera, its noise and the desired response
        choices: the choices for each shortest exposure
        n: number of exposures of a set
        dithered: whether noise dithers the quantiser, so that the estimate holds
        rate: returns the exact rating of a set
    """

    problem: AccuracyProblem
    choices: Sequence[ShotChoices]
    n: int
    dithered: bool
    rate: Callable[[Shots], Rated]

    def most_accurate(self, limit: float) -> Rated:
        """Return the set of most effective levels whose time is at most `limit`."""
        sets, times, levels = self._estimated
        best: Rated | None = None
        within = np.flatnonzero(times <= limit)
        for index in within[np.argsort(-levels[within], kind="stable")][
            : self._most_rated
        ].tolist():
            if best is not None and levels[index] < MARGIN * best.levels:
                break
            rated = self.rate(sets[index])
            if best is None or rated.levels > best.levels:
                best = rated
        assert best is not None  # the caller asks for no limit below the least time
        return best

    def quickest(self, levels: float, limit: float) -> Rated | None:
        """Return the shortest set that has `levels`; of equal times the most accurate one."""
        sets, times, estimates = self._estimated
        possible = np.flatnonzero((times <= limit) & (estimates >= MARGIN * levels))
        order = np.lexsort((-estimates[possible], np.round(times[possible], TIME_DIGITS)))
        for index in possible[order][: self._most_rated].tolist():
            rated = self.rate(sets[index])
            if rated.levels >= levels:
                return rated
        return None

    @property
    def _most_rated(self) -> int:
        return min(MOST_RATED, max(MAX_RATED, MAX_RATED * 255 // self.problem.response.M))

    @cached_property
    def _estimated(self) -> tuple[list[Shots], FloatArray, FloatArray]:
        """All sets, their times, and the effective levels that they may have."""
        sets: list[Shots] = []
        times: list[FloatArray] = []
        levels: list[FloatArray] = []
        for each in self.choices:
            table = each.choices
            rows = np.array(
                [
                    (int(base), *rest)
                    for base in table.bases
                    for rest in combinations_with_replacement(
                        range(table.exposures.size), self.n - 1
                    )
                ],
                dtype=np.intp,
            )
            times.append(table.times[rows].sum(axis=1))
            levels.append((12 * table.frames.mse(rows)) ** -0.5)
            sets.extend(each.shots(tuple(row)) for row in rows.tolist())
        estimate = np.concatenate(levels)
        if len(sets) <= self._most_rated:
            estimate = np.full(len(sets), np.inf)  # all are rated: the estimate excludes none
        elif not self.dithered:
            estimate = np.maximum(estimate, [self._noise_free(shots) for shots in sets])
        return sets, np.concatenate(times), estimate

    def _noise_free(self, shots: Shots) -> float:
        camera = EffectiveCamera.of(self.problem.response, [shot.exposure for shot in shots])
        return effective_levels(camera, self.problem.desired)
