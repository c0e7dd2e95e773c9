"""Search for the set of exposures of least estimated error, or of least time, by exchanges.

The estimate of `camctl.exposure.frame_accuracy` is smooth, so that replacing one exposure of a set
by the best of all there are, again and again, leads to the best set or near it.  Where a limit
binds, one exposure can become longer only if another becomes shorter: then pairs are exchanged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.frame_accuracy import FrameTable
from camctl.model.response.camera import FloatArray

Merit: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]
"""Returns what is minimised from mean square errors and total times of the same shape."""

Set: TypeAlias = tuple[int, ...]

TIME_WEIGHTS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Weights of ln(time) beside ln(error) whose minima lie along the front of time and error."""

RANDOM_STARTS = 4
"""Random sets from which the search without a limit starts."""

REACHES = (1.0, 0.3, 0.1)
"""How far, in ln(exposure), an exposure moves while pairs are exchanged: far, then near."""

PAIR_CHOICES = 20
"""Choices for each exposure of a pair, at most."""

SLACK_WEIGHT = 1e-4
"""Weight of the error beside the time where a set is shortened: of sets that take the same time,
the one that leaves more room to shorten another exposure."""

MOST_IMPROVED = 2
"""Sets of which pairs are exchanged within a limit, of time or of error."""

MAX_ROUNDS = 50
"""Rounds of exchanges, at most; a handful is usual."""

_BETTER = 1e-9
"""Relative gain below which a set does not count as better."""


@dataclass(frozen=True, eq=False)
class Choices:
    """The exposures that a set is chosen from; a set is a tuple of their indices, ascending.

    Attributes:
        exposures: (K,) exposures relative to the shortest, >= 1
        times: (K,) time that each takes, any unit
        is_base: (K,) whether it may be the shortest exposure of a set (exposure 1)
        frames: what each contributes to the accuracy
    """

    exposures: FloatArray
    times: FloatArray
    is_base: NDArray[np.bool_]
    frames: FrameTable

    def mse(self, chosen: Set) -> float:
        """Return the estimated mean square error of a set."""
        return float(self.frames.mse(np.array([chosen]))[0])

    def time(self, chosen: Set) -> float:
        """Return the total time of a set."""
        return float(self.times[list(chosen)].sum())

    @property
    def bases(self) -> NDArray[np.intp]:
        """Indices of the exposures that may be the shortest of a set."""
        return np.flatnonzero(self.is_base)


def _within(limit: float) -> Merit:
    """Return the error as merit, of sets of at most `limit`."""
    return lambda error, time: np.where(time <= limit, error, np.inf)


class ExchangeSearch:
    """Finds sets of n of the choices; the first of a set is the shortest exposure."""

    def __init__(self, choices: Choices, n: int) -> None:
        self.choices, self.n = choices, n
        self.evaluations = 0
        self._all = np.arange(choices.exposures.size)
        self._rng = np.random.default_rng(0)
        self._front: list[Set] | None = None

    @property
    def least_time(self) -> float:
        """The shortest total time of n exposures, one of them the shortest exposure."""
        base = float(self.choices.times[self.choices.bases].min())
        return base + (self.n - 1) * float(self.choices.times.min())

    def most_accurate(self, limit: float = math.inf) -> list[Set]:
        """Return sets of least error, best first, of a time up to `limit` (>= `least_time`)."""
        front = self._fronts()
        within = [found for found in front if self.choices.time(found) <= limit]
        if within and within[0] == front[0]:
            return front[:1]
        starts = sorted(within, key=self.choices.mse)[:1] or [self._fastest()]
        above = [found for found in front if self.choices.time(found) > limit]
        starts += [self._shortened(found, limit) for found in above[-1:]]
        # The gain of the shortest exposure, and with it of the others, changes in large steps.
        starts += [
            self._shortened((base, *start[1:]), limit)
            for base in self.choices.bases.tolist()
            for start in starts[-1:]
            if base != start[0]
        ]
        singly = {self._exchange(start, _within(limit))[0] for start in starts}
        best = sorted(singly, key=lambda each: (self.choices.mse(each), each))[:MOST_IMPROVED]
        improved = {self._improved_within(each, limit) for each in best}
        return sorted(improved, key=lambda each: (self.choices.mse(each), each))

    def _improved_within(self, start: Set, limit: float) -> Set:
        return self._exchange_pairs(start, _within(limit))

    def shortest(self, error: float) -> Set | None:
        """Return the set of least time whose error is at most `error`, or None."""
        within = [found for found in self._fronts() if self.choices.mse(found) <= error]

        def merit(errors: FloatArray, time: FloatArray) -> FloatArray:
            return np.where(errors <= error, time * (1 + SLACK_WEIGHT * errors / error), np.inf)

        starts = sorted(within, key=self.choices.time)[:MOST_IMPROVED]
        improved = [self._exchange_pairs(start, merit) for start in starts]
        return min(improved, key=self.choices.time, default=None)

    def _fronts(self) -> list[Set]:
        """Return sets along the front of time and error, the most accurate first."""
        if self._front is None:
            bases = self.choices.bases
            starts = [
                (int(bases[0]), *self._rng.choice(self._all, self.n - 1).tolist())
                for _ in range(RANDOM_STARTS)
            ]
            spread = np.linspace(0, len(self._all) - 1, self.n).astype(np.intp)
            starts.append((int(bases[0]), *spread[1:].tolist()))
            found: list[Set] = []
            for weight in TIME_WEIGHTS:

                def merit(
                    error: FloatArray, time: FloatArray, weight: float = weight
                ) -> FloatArray:
                    return np.asarray(np.log(error) + weight * np.log(time))

                reached = [self._exchange(start, merit) for start in starts]
                best = min(reached, key=lambda pair: pair[1])[0]
                if weight == 0:
                    best = self._exchange_pairs(best, merit)
                found.append(best)
                starts = [best]
            self._front = found
        return self._front

    def _fastest(self) -> Set:
        """Return the set of least time."""
        times, bases = self.choices.times, self.choices.bases
        return (int(bases[times[bases].argmin()]), *[int(times.argmin())] * (self.n - 1))

    def _shortened(self, chosen: Set, limit: float) -> Set:
        """Return the set with its longest times shortened until they fit into `limit`."""
        times = self.choices.times
        current = list(chosen)
        while self.choices.time(tuple(current)) > limit:
            place = int(np.argmax(times[current]))
            shorter = self._all if place else self.choices.bases
            shorter = shorter[times[shorter] < times[current[place]]]
            if not shorter.size:
                return self._fastest()
            current[place] = int(shorter[times[shorter].argmax()])
        return tuple(current)

    def _exchange(self, chosen: Set, merit: Merit) -> tuple[Set, float]:
        """Replace one exposure after the other by the best choice; return the set and its merit."""
        current, best = list(chosen), math.inf
        for _ in range(MAX_ROUNDS):
            improved = False
            for place in range(self.n):
                options = self._all if place else self.choices.bases
                values = self._merits(current, [place], [options], merit)
                least = int(values.argmin())
                if values[least] < best - _BETTER:
                    best, improved = float(values[least]), True
                    current[place] = int(options[least])
            if not improved:
                break
        return tuple(current), best

    def _exchange_pairs(self, chosen: Set, merit: Merit) -> Set:
        """Replace single exposures and pairs by near ones until no exchange is better."""
        current, best = self._exchange(chosen, merit)
        for reach in REACHES:
            for _ in range(MAX_ROUNDS):
                before = best
                for one in range(self.n):
                    for other in range(one + 1, self.n):
                        current, best = self._exchange_pair(
                            current, (one, other), reach, merit, best
                        )
                if not best < before - _BETTER * abs(before):
                    break
        return current

    def _exchange_pair(
        self, chosen: Set, places: tuple[int, int], reach: float, merit: Merit, best: float
    ) -> tuple[Set, float]:
        options = [self._near(chosen[place], reach, base=place == 0) for place in places]
        values = self._merits(list(chosen), list(places), options, merit)
        least = int(values.argmin())
        if not values[least] < best - _BETTER * abs(best):
            return chosen, best
        current = list(chosen)
        first, second = divmod(least, options[1].size)
        current[places[0]], current[places[1]] = int(options[0][first]), int(options[1][second])
        return tuple(current), float(values[least])

    def _near(self, index: int, reach: float, *, base: bool) -> NDArray[np.intp]:
        """Return choices whose exposure or time is within `reach` of one, evenly thinned out."""
        exposures, times = self.choices.exposures, self.choices.times
        options = self.choices.bases if base else self._all
        far_exposure = np.abs(np.log(exposures[options] / exposures[index]))
        far_time = np.abs(np.log(times[options] / times[index]))
        near = options[np.maximum(far_exposure, far_time) <= reach]
        if near.size > PAIR_CHOICES:
            near = near[np.linspace(0, near.size - 1, PAIR_CHOICES).astype(np.intp)]
        return np.union1d(near, [index])

    def _merits(
        self,
        chosen: list[int],
        places: list[int],
        options: list[NDArray[np.intp]],
        merit: Merit,
    ) -> FloatArray:
        """Return the merit of the set with all combinations of `options` at `places`, flat."""
        frames, times = self.choices.frames, self.choices.times
        rest = [index for place, index in enumerate(chosen) if place not in places]
        slope, variance = frames.slope[rest].sum(axis=0), frames.variance[rest].sum(axis=0)
        time = np.full((), times[rest].sum())
        for option in options:
            slope = slope[..., np.newaxis, :] + frames.slope[option]
            variance = variance[..., np.newaxis, :] + frames.variance[option]
            time = time[..., np.newaxis] + times[option]
        self.evaluations += time.size
        return np.asarray(merit(frames.error(slope, variance), time)).ravel()
