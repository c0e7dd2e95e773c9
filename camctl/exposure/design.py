"""Sets of frames of least estimated error: within a time, or for a weight of time.

The estimate of `camctl.exposure.estimate` adds up over the frames of a set, so that the best
frame to add, to leave out or to replace follows from one pass over all there are.  Exchanges find
how many frames of which gain a set has; then its shutter times are tuned, where any can be set.

A set of least ln(mse) + w ln(time) lies on the front of accuracy and time, where the effective
levels grow as time^(w/2).  For w = 1 more time brings what averaging would bring.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.estimate import FrameAccuracy
from camctl.exposure.exposure_choices import MAX_CHOICES, SAME, AccuracyProblem, Shot, Shots
from camctl.model.response.camera import FloatArray

WEIGHTS = (10.0, 5.0, 3.0, 2.0, 1.6, 1.3, 1.15, 1.0, 0.85, 0.7, 0.5, 0.35, 0.2, 0.1, 0.05)
"""Weights of time whose sets are traced along the front; at the last one, twice the time brings
1.7 % more effective levels."""

LEAST_WEIGHT = 1e-4
"""Weight of time for the most accurate set: what takes twice the time for 0.003 % is left out."""

LATTICE = 0.2
"""Step in ln(exposure) of the frames that are exchanged where any time can be set; their times are
tuned afterwards."""

COARSER = 2
"""Every how many nodes of u are used to compare exchanges; the sets that result are compared by
all of them."""

DELTA = 0.02
"""Step in ln(exposure) of the table of what frames contribute, and for derivatives: that of the
tables of the estimate."""

LONGEST_STEP = 0.4
"""Longest step of a time in ln(exposure): two steps of the lattice."""

SHORTEST_STEP = 2e-3
"""Step in ln(exposure) from which the times are tuned: the error then changes by some 1e-6."""

MAX_STEPS = 12
"""Newton steps of the times, at most: they converge in 3 to 6."""

MAX_ROUNDS = 60
"""Exchanges in a row, at most: a set of 16 is replaced some times over."""

TUNED, IMPROVED = 4, 3
"""Sets that are tuned to a time, and sets of which frames are then exchanged if it is thorough."""

SAME_TIME = 1e-6
"""Relative difference up to which a set takes the time that it may."""

NEAR = 7
"""Settings of a list that are tried for each frame of a pair."""

_BETTER = 2e-6
"""Gain in ln(mse) from which a set counts as better: 1e-6 of the effective levels."""


@dataclass(frozen=True, eq=False)
class Design:
    """A set of frames, by exposure.

    Attributes:
        log_exposure: (n,) ln of the exposures relative to the shortest, which is 0
        gain: (n,) index of the gain of each
        parts: (3, n, NODES) what each contributes
        mse: estimated mean square error in u
        time: what the set takes, without its fixed time
    """

    log_exposure: FloatArray
    gain: NDArray[np.intp]
    parts: NDArray[np.float32]
    mse: float
    time: float

    @property
    def n(self) -> int:
        """Number of frames."""
        return self.gain.size

    @property
    def levels(self) -> float:
        """Estimated effective levels."""
        return float((12 * self.mse) ** -0.5)


class DesignSearch:
    """Finds sets of frames with one shortest exposure.

    Args:
        frames: what frames of the camera contribute
        base: product of time and gain of the shortest exposure
        counts: fewest and most frames of a set
    """

    def __init__(self, frames: FrameAccuracy, base: float, counts: tuple[int, int]) -> None:
        self.problem: AccuracyProblem = frames.problem
        self.frames, self.base, self.counts = frames, base, counts
        available = self.problem.available
        self.gains = np.unique(available.gains)
        self.costs = available.costs
        self.is_list = available.times is not None
        self.log_exposure, self.gain = self._options()
        self.parts = self._parts(self.log_exposure, self.gain)
        self._coarse = np.ascontiguousarray(self.parts[:, :, ::COARSER])
        self.cost = self._cost(self.log_exposure, self.gain)
        self.bases = np.flatnonzero(self.log_exposure <= SAME)
        self._trace: list[Design] = []
        self._weights, self._traced_weight = list(WEIGHTS), math.inf

    def _options(self) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return ln(exposure) and gain of the frames that sets are exchanged with."""
        available, reach = self.problem.available, math.log(self.problem.reach)
        if available.times is None:
            steps = np.linspace(0.0, reach, math.ceil(reach / LATTICE) + 1)
            log_exposure = np.tile(steps, self.gains.size)
            gain = np.repeat(np.arange(self.gains.size), steps.size)
            low, high = self.limits(gain)
            kept = (log_exposure >= low - SAME) & (log_exposure <= high + SAME)
            # What is over within a frame at a lower gain takes no more time for it.
            lower = np.maximum(gain - 1, 0)
            within = self._times(log_exposure, lower) <= min(self.costs.least, available.longest)
            kept &= ~within | (gain == 0)
        else:
            each = np.unique(np.asarray(available.times, dtype=np.float64))
            log_exposure = np.log(each[:, np.newaxis] * self.gains / self.base).ravel()
            gain = np.tile(np.arange(self.gains.size), each.size)
            kept = (log_exposure >= -SAME) & (log_exposure <= reach + SAME)
            log_exposure, gain = log_exposure[kept], gain[kept]
            kept = np.sort(_thinned(log_exposure))
        return np.maximum(log_exposure[kept], 0.0), gain[kept]

    def limits(self, gain: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest ln(exposure) at gains, where any time can be set."""
        available = self.problem.available
        shift = np.log(self.gains[gain] / self.base)
        low = np.maximum(0.0, math.log(max(available.shortest, 1e-300)) + shift)
        return low, np.minimum(math.log(self.problem.reach), math.log(available.longest) + shift)

    def _times(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> FloatArray:
        return np.asarray(np.exp(log_exposure) * self.base / self.gains[gain])

    def _cost(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> FloatArray:
        return self.costs.each(self._times(log_exposure, gain))

    @cached_property
    def _table(self) -> NDArray[np.float32]:
        """What a frame contributes at each gain and each `DELTA` of ln(exposure)."""
        size = self._table_size
        log_exposure = np.asarray(DELTA * (np.arange(size) - 1.0), dtype=np.float64)
        rows = []
        for gain, value in enumerate(self.gains.tolist()):
            times = self._times(log_exposure, np.full(size, gain))
            rows.append(self.frames.parts(log_exposure, value, times))
        return np.ascontiguousarray(np.concatenate(rows, axis=1))

    @property
    def _table_size(self) -> int:
        return math.ceil(math.log(self.problem.reach) / DELTA) + 4

    def _parts(
        self, log_exposure: FloatArray, gain: NDArray[np.intp], shift: int = 0
    ) -> NDArray[np.float32]:
        """Return what frames contribute, (3, ..., NODES), `shift` steps of `DELTA` further on."""
        place = log_exposure / DELTA + 1.0
        index = place.astype(np.intp)
        share = (place - index).astype(np.float32)[..., np.newaxis]
        index = index + (gain * self._table_size + shift)
        low = self._table.take(index, axis=1)
        high = self._table.take(index + 1, axis=1)
        high -= low
        high *= share
        high += low
        return high

    def design(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> Design:
        """Return the set of these frames."""
        order = np.lexsort((gain, log_exposure))
        log_exposure, gain = log_exposure[order], gain[order]
        parts = self._parts(log_exposure, gain)
        mse = float(self.frames.mse(parts.sum(axis=1)))
        return Design(log_exposure, gain, parts, mse, float(self._cost(log_exposure, gain).sum()))

    def shots(self, design: Design) -> Shots:
        """Return the frames of a set, ascending in exposure."""
        return self._shots(design.log_exposure, design.gain)

    @property
    def option_shots(self) -> Shots:
        """The frames that sets are exchanged with, in the order of `log_exposure`."""
        return self._shots(self.log_exposure, self.gain)

    def _shots(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> Shots:
        times = self._times(log_exposure, gain)
        if self.is_list:  # without what the logarithms round
            listed = np.unique(np.asarray(self.problem.available.times, dtype=np.float64))
            times = listed[np.abs(listed - times[:, np.newaxis]).argmin(axis=1)]
        rows = zip(np.exp(log_exposure), times, self.gains[gain], strict=True)
        return tuple(Shot(float(e), float(t), float(g)) for e, t, g in rows)

    def _merit(self, mse: FloatArray, time: FloatArray, weight: float) -> FloatArray:
        total = np.maximum(time + self.costs.fixed, 1e-300)  # a set without frames takes no time
        return np.asarray(np.log(mse) + weight * np.log(total))

    def merit(self, design: Design, weight: float) -> float:
        """Return ln(mse) + w ln(time), the fixed time of a set counted in."""
        return math.log(design.mse) + weight * math.log(design.time + self.costs.fixed)

    def least_time(self, n: int) -> float:
        """Return what the n frames take that are over soonest, without the fixed time."""
        return float(self.cost[self.bases].min() + (n - 1) * self.cost.min())

    def fastest(self, n: int) -> Design:
        """Return the set of n frames of the least time; of equal times the most accurate."""
        first = self.bases[np.lexsort((self.gain[self.bases], self.cost[self.bases]))[:1]]
        chosen = self.design(self.log_exposure[first], self.gain[first])
        quick = np.flatnonzero(self.cost <= self.cost.min() * (1 + SAME))
        while chosen.n < n:
            total = chosen.parts.sum(axis=1)[:, np.newaxis] + self.parts[:, quick]
            chosen = self._changed(chosen, [int(quick[self.frames.mse(total).argmin()])], [])
        return chosen

    def _changed(self, design: Design, added: Sequence[int], removed: Sequence[int]) -> Design:
        """Return a set with some options added and some of its places removed."""
        rows = np.array(added, dtype=np.intp)
        log_exposure = np.append(np.delete(design.log_exposure, removed), self.log_exposure[rows])
        return self.design(
            log_exposure, np.append(np.delete(design.gain, removed), self.gain[rows])
        )

    def _rests(self, design: Design) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return a set without each of its frames in turn, and at last the whole set.

        The sums of its parts (3, n + 1, NODES), its time (n + 1,) and whether it has a frame of the
        shortest exposure.
        """
        is_base = design.log_exposure <= SAME
        cost = np.append(self._cost(design.log_exposure, design.gain), 0.0)
        total = design.parts.sum(axis=1, keepdims=True)
        rest = np.concatenate([total - design.parts, total], axis=1)
        return rest, design.time - cost, is_base.sum() - np.append(is_base, False) > 0

    def exchanged(
        self,
        design: Design,
        weight: float,
        *,
        limit: float = math.inf,
        rounds: int = MAX_ROUNDS,
        sizes: bool = True,
    ) -> Design:
        """Return a set to which no added, removed or replaced frame brings a smaller merit.

        Args:
            design: the set to begin with
            weight: of the time
            limit: longest time of the set
            rounds: exchanges, at most
            sizes: whether frames are added and removed, too
        """
        current, best = design, self.merit(design, weight)
        for _ in range(rounds):
            changed = self._best_exchange(current, weight, limit, sizes=sizes)
            if changed is None or not self.merit(changed, weight) < best - _BETTER:
                break
            current, best = changed, self.merit(changed, weight)
        return current

    def _best_exchange(
        self, design: Design, weight: float, limit: float, *, sizes: bool
    ) -> Design | None:
        """Return the best set with one frame changed; None: none is within `limit`."""
        rest, rest_time, has_base = self._rests(design)
        rest = rest[:, :, ::COARSER]
        fewer = np.where(
            has_base, self._merit(self.frames.mse(rest, COARSER), rest_time, weight), np.inf
        )
        if design.n == self.counts[1] or not sizes:
            rest, rest_time, has_base = rest[:, :-1], rest_time[:-1], has_base[:-1]
        time = rest_time[:, np.newaxis] + self.cost
        mse = self.frames.mse(rest[:, :, np.newaxis] + self._coarse[:, np.newaxis], COARSER)
        allowed = (time <= limit) & (has_base[:, np.newaxis] | (self.log_exposure <= SAME))
        values = np.where(allowed, self._merit(mse, time, weight), np.inf)
        place, option = divmod(int(values.argmin()), self.cost.size)
        added, found = [option], float(values[place, option])
        if sizes and design.n > self.counts[0]:
            least = int(fewer[: design.n].argmin())
            if fewer[least] < found:
                place, added, found = least, [], float(fewer[least])
        if not math.isfinite(found):
            return None
        return self._changed(design, added, [place] if place < design.n else [])

    def tuned(self, design: Design, weight: float) -> Design:
        """Return the set with its times tuned to the least merit, at the same gains."""

        def step(current: Design) -> FloatArray:
            error, time = self._derivatives(current)
            return _newton(error[0] + weight * time[0], error[1] + weight * time[1])

        def is_better(found: Design, best: Design) -> bool:
            return self.merit(found, weight) < self.merit(best, weight) - _BETTER

        return self._descended(design, step, self._moved, is_better)

    def _refitted(self, design: Design, limit: float) -> Design:
        """Return the set with its times tuned at the time that it takes, `limit` at most."""

        def step(current: Design) -> FloatArray:
            error, time = self._derivatives(current)
            along = float(time[0] @ time[0])
            weight = max(0.0, -float(error[0] @ time[0]) / along) if along > 0 else 0.0
            return _newton(error[0] + weight * time[0], error[1] + weight * time[1])

        def moved(current: Design, step: FloatArray) -> Design:
            place = self._stepped(current, step)
            fitting = self._scaled_to(place, current.gain, limit)
            return (
                self.fastest(current.n) if fitting is None else self.design(fitting, current.gain)
            )

        def is_better(found: Design, best: Design) -> bool:
            return found.mse < best.mse * (1 - _BETTER)

        return self._descended(design, step, moved, is_better)

    def _descended(
        self,
        design: Design,
        step: Callable[[Design], FloatArray],
        moved: Callable[[Design, FloatArray], Design],
        is_better: Callable[[Design, Design], bool],
    ) -> Design:
        """Return the set after Newton steps of its times for as long as they make it better.

        A step that does not is tried once more at 0.3 of its length.
        """
        if self.is_list or design.n == 1:
            return design
        best = design
        for _ in range(MAX_STEPS):
            change = step(best)
            if np.abs(change).max() < SHORTEST_STEP:
                break
            found = moved(best, change)
            if not is_better(found, best):
                found = moved(best, 0.3 * change)
                if not is_better(found, best):
                    break
            best = found
        return best

    def _moved(self, design: Design, step: FloatArray) -> Design:
        return self.design(self._stepped(design, step), design.gain)

    def _stepped(self, design: Design, step: FloatArray) -> FloatArray:
        """Return ln(exposure) of a set after a step of all but the first, within the limits."""
        low, high = self.limits(design.gain)
        moved = np.clip(design.log_exposure + np.append(0.0, step), low, high)
        moved[0] = 0.0  # the shortest exposure
        return np.asarray(moved)

    def _derivatives(
        self, design: Design
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """Return gradient and Hessian of ln(mse), and of ln(time), by ln(exposure) but the first.

        What an exposure contributes has its derivatives by differences over `DELTA`; those of the
        sum follow from them.
        """
        at, gain = design.log_exposure[1:], design.gain[1:]
        low, high = (self._parts(at, gain, shift).astype(np.float64) for shift in (-1, 1))
        one = (high - low) / (2 * DELTA)
        two = (high + low - 2 * design.parts[:, 1:]) / DELTA**2
        S, V, C = design.parts.sum(axis=1, dtype=np.float64)
        V = V + C * C
        S = np.maximum(S, 1e-30)
        weight = self.frames.weight / S**2 / self.frames.log_E.size
        weight = np.where(self.frames.weight * V / S**2 < self.frames.largest, weight, 0.0)
        ds, dv = one[0] / S, one[1] + 2 * C * one[2]
        gradient = (dv - 2 * V * ds) @ weight
        cross = -2 * (dv * weight) @ ds.T
        hessian = cross + cross.T + 6 * (ds * (V * weight)) @ ds.T
        hessian[np.diag_indices(at.size)] += (two[1] - 2 * V * two[0] / S) @ weight
        gradient, hessian = gradient / design.mse, hessian / design.mse
        hessian -= np.outer(gradient, gradient)
        times = self._times(at, gain)
        total = design.time + self.costs.fixed
        rate = np.where(times > self.costs.least, self.costs.factor * times / total, 0.0)
        return (gradient, hessian), (rate, np.diag(rate) - np.outer(rate, rate))

    def trace(
        self, *, time: float = math.inf, levels: float = math.inf, weight: float = 0.0
    ) -> list[Design]:
        """Return sets along the front, the shortest first: for `WEIGHTS`, and for each number.

        They go on until two take longer than `time`, one has more than `levels`, or one is for a
        smaller `weight`; what was traced before is not traced again.
        """
        while (
            len(self._weights) > 0
            and sum(each.time > time * (1 + SAME) for each in self._trace[-2:]) < 2
            and not (self._trace and self._trace[-1].levels > levels)
            and not (self._trace and self._traced_weight < weight)
        ):
            self._traced_weight = next_weight = self._weights.pop(0)
            current = self._trace[-1] if self._trace else self.fastest(self.counts[0])
            best = self.tuned(self.exchanged(current, next_weight), next_weight)
            while current.n + 1 < best.n:
                current = self.tuned(self._added(current, next_weight), next_weight)
                self._trace.append(current)
            self._trace.append(best)
        ordered = sorted(self._trace, key=lambda each: (each.time, each.mse))
        least = np.minimum.accumulate([math.inf, *(each.mse for each in ordered)])
        return [each for each, before in zip(ordered, least, strict=False) if each.mse < before]

    def _added(self, design: Design, weight: float) -> Design:
        """Return a set with the best frame added, and each frame then exchanged."""
        mse = self.frames.mse(design.parts.sum(axis=1)[:, np.newaxis] + self.parts)
        option = int(self._merit(mse, design.time + self.cost, weight).argmin())
        return self.exchanged(self._changed(design, [option], []), weight, sizes=False)

    def at_weight(self, weight: float) -> Design:
        """Return the set of least ln(mse) + w ln(time)."""
        traced = self.trace(weight=weight)
        current = min(traced, key=lambda each: self.merit(each, weight))
        for _ in range(4):
            improved = self.tuned(self.exchanged(current, weight), weight)
            if not self.merit(improved, weight) < self.merit(current, weight) - _BETTER:
                break
            current = improved
        return current

    @cached_property
    def most_accurate(self) -> Design:
        """The set of least error, for which time is worth next to nothing."""
        last = self.trace()[-1]
        return self.tuned(self.exchanged(last, LEAST_WEIGHT), LEAST_WEIGHT)

    def of_count(self, n: int) -> Design:
        """Return the most accurate set of n frames, for which time is worth next to nothing."""
        best = self.fastest(n)
        for start in [best, *(each for each in self.trace() if each.n == n)]:
            found = self.tuned(self.exchanged(start, LEAST_WEIGHT, sizes=False), LEAST_WEIGHT)
            best = min(best, found, key=lambda each: each.mse)
        return best

    def within(self, limit: float, *, thorough: bool = False) -> Design:
        """Return the set of least error that takes `limit` at most, without the fixed time.

        `limit` is at least `least_time` of the fewest frames.  A `thorough` search takes three
        times as long: it is then within 0.1 % of the best of many, else within 0.4 %.
        """
        traced = self.trace(time=limit)
        below = [each for each in traced if each.time <= limit]
        above = [each for each in traced if each.time > limit]
        if not above and self.most_accurate.time <= limit * (1 + SAME):
            return self.most_accurate
        starts = [self.fastest(self.counts[0])]
        for start in below[-2:] + above[:2]:
            starts += self._resized(start, limit)
        fitted = sorted((self._fitted(each, limit) for each in starts), key=lambda each: each.mse)
        of_count = {each.n: each for each in reversed(fitted)}
        some = sorted(of_count.values(), key=lambda each: each.mse)[: None if thorough else TUNED]
        tuned = [self._refitted(each, limit) for each in some]
        tuned.sort(key=lambda each: each.mse)
        kept = tuned[: IMPROVED if thorough else IMPROVED - 1]
        return min((self._improved(each, limit) for each in kept), key=lambda each: each.mse)

    def _improved(self, design: Design, limit: float) -> Design:
        """Return a set with exchanged frames and tuned times, for as long as it becomes better."""
        best = design
        for _ in range(6):
            if self.is_list:
                improved = self.exchanged(best, 0.0, limit=limit * (1 + SAME))
                improved = self._paired(improved, limit * (1 + SAME))
            else:
                improved = self.exchanged(best, self._weight_of(best), rounds=1)
                improved = self.scaled(improved, limit)
            if improved.time > limit * (1 + SAME) or not improved.mse < best.mse * (1 - _BETTER):
                break
            best = improved
        return best

    def time_of(self, design: Design, factor: float) -> float:
        """Return about the time in which such a set has `factor` times the levels."""
        power = 2 * math.log(factor) / self._weight_of(design)
        scale = math.exp(min(max(power, -1.0), 1.0))
        return (design.time + self.costs.fixed) * scale - self.costs.fixed

    def scaled(self, design: Design, limit: float) -> Design:
        """Return the set with other times, tuned for a time, at the same gains."""
        return self._refitted(self._fitted(design, limit), limit)

    def spread(self, design: Design, limit: float, step: float) -> Design:
        """Return a set with its nearly equal exposures `step` apart, so that levels interleave."""
        at, first, count = design.log_exposure.copy(), 0.0, 0
        for place in range(1, design.n):
            count += 1
            if at[place] > first + 2 * step * count:
                first, count = float(at[place]), 0
            at[place] = first + step * count
        return self._fitted(self._moved(design, at[1:] - design.log_exposure[1:]), limit)

    def regained(self, design: Design) -> list[Design]:
        """Return a set with the next gain up or down in all frames but the first, or in one."""
        found = []
        masks = [np.arange(design.n) > 0, *(np.arange(design.n) == k for k in range(1, design.n))]
        for mask in masks if self.gains.size > 1 else []:
            for step in (-1, 1):
                gain = np.clip(design.gain + step * mask, 0, self.gains.size - 1)
                moved = design.log_exposure + np.log(self.gains[gain] / self.gains[design.gain])
                low, high = 0.0, math.log(self.problem.reach)
                if np.any(gain != design.gain) and np.all((moved >= low) & (moved <= high)):
                    found.append(self.design(moved, gain))
        return found

    def neighbours(self, design: Design, limit: float, share: float) -> list[Design]:
        """Return a set with each time but the first `share` longer or shorter.

        Where the set takes `limit`, they are scaled to it; none on a list of settings.
        """
        if self.is_list or design.n == 1:
            return []
        steps = np.eye(design.n - 1) * math.log1p(share)
        moved = [self._moved(design, step) for step in (*steps, *-steps)]
        is_bound = design.time > limit * (1 - SAME_TIME)
        found = [self._fitted(each, limit) if is_bound else each for each in moved]
        return [each for each in found if each.time <= limit * (1 + SAME)]

    def _resized(self, design: Design, limit: float) -> list[Design]:
        """Return a set as it is, with one frame less, and with one frame more."""
        found = [design]
        rest, time, has_base = self._rests(design)
        if design.n > self.counts[0]:
            merit = self._merit(self.frames.mse(rest), time, 1.0)
            fewer = np.where(has_base, merit, np.inf)[:-1]
            found.append(self._changed(design, [], [int(fewer.argmin())]))
        if design.n < self.counts[1]:
            mse = self.frames.mse(rest[:, -1, np.newaxis] + self.parts)
            option = int(self._merit(mse, design.time + self.cost, 1.0).argmin())
            found.append(self._changed(design, [option], []))
        return [each for each in found if self.least_time(each.n) <= limit * (1 + SAME)]

    def _weight_of(self, design: Design) -> float:
        """Return the w for which a set is the best of its kind, from scaling its times."""
        longer = self._fitted(design, 1.02 * design.time)
        change = math.log((longer.time + self.costs.fixed) / (design.time + self.costs.fixed))
        if change < SAME:
            return LEAST_WEIGHT
        return max(LEAST_WEIGHT, math.log(design.mse / longer.mse) / change)

    def _fitted(self, design: Design, limit: float) -> Design:
        """Return the set with its times scaled to `limit`, or as it is if that is better."""
        if self.is_list:
            return self._shortened(design, limit)
        fitting = self._scaled_to(design.log_exposure, design.gain, limit)
        if fitting is None:
            return self.fastest(design.n)
        found = self.design(fitting, design.gain)
        fits = design.time <= limit * (1 + SAME)
        return design if fits and design.mse <= found.mse else found

    def _scaled_to(
        self, log_exposure: FloatArray, gain: NDArray[np.intp], limit: float
    ) -> FloatArray | None:
        """Return ln(exposure) with the times scaled to `limit`; None: no scale is short enough."""
        low, high = self.limits(gain)
        # What is shorter than a frame does not take less time for being shorter.
        idle = math.log(max(self.costs.least, 1e-300)) + np.log(self.gains[gain] / self.base)
        floor = np.clip(np.minimum(idle, log_exposure), low, high)
        low[0] = high[0] = floor[0] = 0.0  # the shortest exposure
        time, bottom, top = (self._times(each, gain) for each in (log_exposure, floor, high))
        bottom = np.maximum(bottom, self.costs.least)
        left = (limit * (1 - SAME) - gain.size * self.costs.extra) / self.costs.factor
        if bottom.sum() > left * (1 + 3 * SAME):
            return None
        change = math.log(_scale(time, bottom, np.maximum(bottom, top), left))
        return np.clip(log_exposure + change, floor if change < 0 else low, high)

    def _shortened(self, design: Design, limit: float) -> Design:
        """Return a set on a list with its longest times replaced by shorter ones until it fits."""
        current = design
        while current.time > limit * (1 + SAME):
            cost = self._cost(current.log_exposure, current.gain)
            _, _, has_base = self._rests(current)
            for place in np.argsort(-cost, kind="stable").tolist():
                options = np.arange(self.gain.size) if has_base[place] else self.bases
                shorter = options[self.cost[options] < cost[place] * (1 - SAME)]
                if shorter.size:
                    added = int(shorter[self.cost[shorter].argmax()])
                    current = self._changed(current, [added], [place])
                    break
            else:
                return self.fastest(design.n)
        return current

    def _paired(self, design: Design, limit: float) -> Design:
        """Return a set on a list improved by exchanges of pairs with near settings."""
        current = design
        for one, other in combinations(range(design.n), 2):
            first, second = (self._near(current, place) for place in (one, other))
            rest = current.parts.sum(axis=1) - current.parts[:, one] - current.parts[:, other]
            cost = self._cost(current.log_exposure, current.gain)
            time = current.time - cost[one] - cost[other]
            time = time + self.cost[first, np.newaxis] + self.cost[second]
            pairs = self.parts[:, first, np.newaxis] + self.parts[:, np.newaxis, second]
            total = rest[:, np.newaxis, np.newaxis] + pairs
            mse = np.where(time <= limit, self.frames.mse(total), np.inf)
            row, column = divmod(int(mse.argmin()), second.size)
            if mse[row, column] < current.mse * (1 - _BETTER):
                current = self._changed(
                    current, [int(first[row]), int(second[column])], [one, other]
                )
        return current

    def _near(self, design: Design, place: int) -> NDArray[np.intp]:
        """Return the settings of a list near a frame, at its gain and at the gains beside it."""
        if not self._rests(design)[2][place]:
            return self.bases
        distance = np.abs(self.log_exposure - design.log_exposure[place])
        distance = distance + np.abs(self.gain - design.gain[place])
        return np.asarray(np.argsort(distance, kind="stable")[:NEAR])


def _scale(time: FloatArray, bottom: FloatArray, top: FloatArray, total: float) -> float:
    """Return x for which the sum of x * time, each clipped to [bottom, top], is `total`.

    Between the points where one is clipped the sum is linear in x.
    """
    ends = np.sort(np.concatenate([bottom / time, top / time]))
    sums = np.clip(ends[:, np.newaxis] * time, bottom, top).sum(axis=1)
    place = int(np.searchsorted(sums, total))
    if place == 0 or place == sums.size:
        return float(ends[min(place, sums.size - 1)])
    share = (total - sums[place - 1]) / (sums[place] - sums[place - 1])
    return float(ends[place - 1] + share * (ends[place] - ends[place - 1]))


def _newton(gradient: FloatArray, hessian: FloatArray) -> FloatArray:
    """Return Newton's step downwards, each component at most `LONGEST_STEP`."""
    values, vectors = np.linalg.eigh(hessian)
    along = gradient @ vectors
    values = np.maximum(np.abs(values), np.abs(along) / LONGEST_STEP + 1e-9)
    return np.asarray(np.clip(vectors @ (-along / values), -LONGEST_STEP, LONGEST_STEP))


def _thinned(log_exposure: FloatArray) -> NDArray[np.intp]:
    """Return indices of all settings of a list, or of `MAX_CHOICES` evenly over ln(exposure)."""
    order = np.argsort(log_exposure, kind="stable")
    if order.size <= MAX_CHOICES:
        return order
    targets = np.linspace(0.0, float(log_exposure.max()), MAX_CHOICES)
    return np.unique(order[np.searchsorted(log_exposure[order], targets - SAME)])
