"""Sets of frames of least estimated error: within a time, or for a weight of time.

The estimate (`FrameAccuracy`) adds up over the frames of a set, so that the best frame to add, to
leave out or to replace follows from one pass over all there are.  Exchanges find how many frames of
which gain a set has; then its shutter times are tuned, where any can be set.

A set of least ln(mse) + w ln(time) lies on the front of accuracy and time, where the effective
levels grow as time^(w/2).  For w = 1 more time brings what averaging would bring.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.accurate.frame_sets import Design
from camctl.exposure.accurate.tuning import BETTER, LEAST_WEIGHT, TunedSets
from camctl.exposure.exposure_choices import SAME
from camctl.model.effective import MOST_SEARCHED
from camctl.model.response.camera import FloatArray

WEIGHTS = (10.0, 5.0, 3.0, 2.0, 1.6, 1.3, 1.15, 1.0, 0.85, 0.7, 0.5, 0.35, 0.2, 0.1, 0.05)
"""Weights of time whose sets are traced along the front; at the last one, twice the time brings
1.7 % more effective levels."""

COARSER = 2
"""Every how many nodes of u are used to compare exchanges; the sets that result are compared by
all of them.  With each node 18 cases differ by at most 0.05 %, with every fourth by 0.35 %."""

MAX_ROUNDS = 60
"""Exchanges in a row, at most: a set of 16 is replaced some times over."""

MOST_EXCHANGED = 16
"""Frames of a set of which one may be exchanged: of more frames, neighbours are nearly the same."""

REFINED = 2
"""Sets of different numbers of frames whose times are tuned, if it is quick, and of which frames
are then exchanged: with 4 of them 124 cases have at most 0.0024 % fewer, with 1 none of 36 has
fewer levels."""

REGAINED = 2
"""Sets whose gains are shared among their frames in other ways: with 1 of them, and with 4, 18
cases have as many levels; with 1 an earlier search had up to 0.8 % fewer in others."""

NEAR_MSE = 1.02
"""Ratio of estimated errors up to which either set may be the better one: 1 % of the levels."""

ENOUGH = 1e-4
"""Gain in the estimated error up to which a round of changes is the last: 0.005 % of the levels,
while the ratios of exact levels to the estimate differ by 0.22 % between sets.  With 2e-6 and 1e-3,
18 cases differ by at most 0.0022 %."""

MOST_PATTERNS = 4000
"""Ways to share the gains among frames that are compared at once, at most: some 10 ms.  16 frames
share 5 gains in 3,876 ways; of more frames, neighbours keep the same gain.  With 1,000 ways, 124
cases differ by at most 0.011 %, with 16,000 18 cases by 0.001 %."""

NEAR_PATTERN = 1.1
"""Ratio of estimated errors up to which a set with other gains may become the better one by
exchanges of its frames."""

NEAR = 7
"""Settings of a list that are tried for each frame of a pair."""


class DesignSearch(TunedSets):
    """Finds sets of frames with one shortest exposure.

    Args:
        frames: what frames of the camera contribute
        base: product of time and gain of the shortest exposure
        counts: fewest and most frames of a set
    """

    def __init__(self, frames: FrameAccuracy, base: float, counts: tuple[int, int]) -> None:
        super().__init__(frames, base, counts)
        self._traced: list[list[Design]] = []  # for each weight
        self._numbered = 0  # of these with all numbers of frames
        self._untraced: dict[int, Design] = {}

    @cached_property
    def _coarse(self) -> NDArray[np.float32]:
        return np.ascontiguousarray(self.parts[:, :, ::COARSER])

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
            if changed is None or not self.merit(changed, weight) < best - BETTER:
                break
            current, best = changed, self.merit(changed, weight)
        return current

    def _best_exchange(
        self, design: Design, weight: float, limit: float, *, sizes: bool
    ) -> Design | None:
        """Return the best set with one frame changed; None: none is within `limit`."""
        rest, rest_time, has_base = self.rests(design)
        places = np.append(_some_of(design.n), design.n)
        rest, rest_time, has_base = rest[:, places, ::COARSER], rest_time[places], has_base[places]
        fewer = np.where(
            has_base, self.merits(self.frames.mse(rest, COARSER), rest_time, weight), np.inf
        )
        if design.n == self.counts[1] or not sizes:
            rest, rest_time, has_base = rest[:, :-1], rest_time[:-1], has_base[:-1]
        time = self.times_with(design, rest_time, places[: rest_time.size])
        mse = self.frames.mse(rest[:, :, np.newaxis] + self._coarse[:, np.newaxis], COARSER)
        allowed = (time <= limit) & (has_base[:, np.newaxis] | (self.log_exposure <= SAME))
        values = np.where(allowed, self.merits(mse, time, weight), np.inf)
        row, option = divmod(int(values.argmin()), self.cost.size)
        added, found = [option], float(values[row, option])
        if sizes and design.n > self.counts[0]:
            least = int(fewer[:-1].argmin())
            if fewer[least] < found:
                row, added, found = least, [], float(fewer[least])
        if not math.isfinite(found):
            return None
        place = int(places[row])
        return self.changed(design, added, [place] if place < design.n else [])

    def trace(
        self,
        *,
        time: float = math.inf,
        levels: float = math.inf,
        weight: float = 0.0,
        count: float = math.inf,
        rough: bool = False,
    ) -> list[Design]:
        """Return sets along the front, the shortest first: for `WEIGHTS`, and for each number.

        They go on until two take longer than `time`, one has more than `levels`, one is for a
        smaller `weight`, or one has more frames than `count`; what was traced before is not traced
        again.  If it is `rough` one that takes longer is enough, and numbers may be left out.
        """
        beyond = 1 if rough else 2
        while True:
            if not rough:
                self._trace_numbers()
            traced = [each for group in self._traced for each in group]
            if (
                len(self._traced) == len(WEIGHTS)
                or sum(each.time > time * (1 + SAME) for each in traced[-beyond:]) == beyond
                or (traced and traced[-1].levels > levels)
                or (traced and traced[-1].n > count)
                or (traced and WEIGHTS[len(self._traced) - 1] < weight)
            ):
                break
            next_weight = WEIGHTS[len(self._traced)]
            current = traced[-1] if traced else self.fastest(self.counts[0])
            self._traced.append([self.tuned(self.exchanged(current, next_weight), next_weight)])
        ordered = sorted(traced, key=lambda each: (each.time, each.mse))
        least = np.minimum.accumulate([math.inf, *(each.mse for each in ordered)])
        return [each for each, before in zip(ordered, least, strict=False) if each.mse < before]

    def _trace_numbers(self) -> None:
        """Add sets of the numbers of frames between those for one weight and for the next."""
        for place in range(self._numbered, len(self._traced)):
            weight, (best,) = WEIGHTS[place], self._traced[place]
            current = self._traced[place - 1][-1] if place else self.fastest(self.counts[0])
            between = []
            while current.n + 1 < best.n:
                current = self.tuned(self._added(current, weight), weight)
                between.append(current)
            self._traced[place] = [*between, best]
        self._numbered = len(self._traced)

    def _added(self, design: Design, weight: float) -> Design:
        """Return a set with the best frame added, and each frame then exchanged."""
        (larger,) = self._larger(design, math.inf, weight)
        return self.exchanged(larger, weight, sizes=False)

    def at_weight(self, weight: float) -> Design:
        """Return the set of least ln(mse) + w ln(time)."""
        traced = self.trace(weight=weight)
        current = min(traced, key=lambda each: self.merit(each, weight))
        for _ in range(4):
            improved = self.tuned(self.exchanged(current, weight), weight)
            if not self.merit(improved, weight) < self.merit(current, weight) - BETTER:
                break
            current = improved
        return current

    @property
    def most_accurate(self) -> Design:
        """The set of least error, for which time is worth next to nothing."""
        return self._most_accurate[0]

    @cached_property
    def _most_accurate(self) -> list[Design]:
        """It and, of a given number of frames, another one that is found in another way.

        Of many frames it is this one alone: 44 cases of 24 to 64 frames have at most 0.05 % fewer
        levels by the estimate.
        """
        fewest, most = self.counts
        if fewest == most > MOST_SEARCHED:
            return [self.untraced(most)]
        last = self.trace()[-1]
        found = self._shared_again(self.tuned(self.exchanged(last, LEAST_WEIGHT), LEAST_WEIGHT))
        return sorted([found] if fewest < most else [found, self.untraced(most)], key=_mse)

    def of_count(self, n: int) -> Design:
        """Return the most accurate set of n frames, for which time is worth next to nothing."""
        traced = [each for each in self.trace(count=n) if each.n == n]
        return min([self.untraced(n), *map(self._tuned_number, traced)], key=_mse)

    def untraced(self, n: int) -> Design:
        """Return about the most accurate set of n frames, in a quarter of the time of a trace.

        It begins with frames of equal ratios, and with frames added in turn.  With 12 presets, 3 to
        64 frames and log 1:256 to 1:262,144, it has at most 1.2 % fewer levels by the estimate than
        the better one of it and of the last traced set, which has up to 3.6 % fewer.
        """
        if n not in self._untraced:
            starts = [self.filled(n)] if self.is_list else [self.filled(n), self.spaced(n)]
            best = min(map(self._tuned_number, starts), key=_mse)
            self._untraced[n] = self._shared_again(best)
        return self._untraced[n]

    def _shared_again(self, design: Design) -> Design:
        """Return the most accurate set of as many frames, with gains shared in another way, too."""
        shared = self._regained_together(design, design.time)
        return design if shared is design else self._tuned_number(shared)

    def _tuned_number(self, design: Design) -> Design:
        """Return the most accurate set of as many frames that exchanges find."""
        return self.tuned(self.exchanged(design, LEAST_WEIGHT, sizes=False), LEAST_WEIGHT)

    def nearly(self, best: Design, levels: float) -> Design:
        """Return about the shortest set of as many frames as the most accurate with `levels`."""
        weight = WEIGHTS[-1]
        shorter = self.tuned(self.exchanged(best, weight, sizes=False), weight)
        starts = [each for each in (best, shorter) if each.levels >= levels]
        return min((self.reduced(each, levels) for each in starts), key=lambda each: each.time)

    def within(self, limit: float) -> Design:
        """Return about the set of least error that takes `limit` at most, without the fixed time.

        `limit` is at least `least_time` of the fewest frames.
        """
        return self.several_within(limit, thorough=False)[0]

    def roughly_within(self, limit: float) -> Design:
        """Return the better of the traced sets beside a time, scaled to it; it takes next to none.

        `limit` is as for `within`.  Without one, a given number of frames is not traced.
        """
        if math.isinf(limit) and self.counts[0] == self.counts[1]:
            return self.untraced(self.counts[0])
        traced = self.trace(time=limit, rough=True)
        beside = [each for each in traced if each.time <= limit][-1:]
        beside += [each for each in traced if each.time > limit][:1]
        possible = [each for each in beside if self.least_time(each.n) <= limit * (1 + SAME)]
        starts = possible or [self.fastest(self.counts[0])]
        return min((self.fitted(each, limit) for each in starts), key=_mse)

    def several_within(self, limit: float, *, thorough: bool = True) -> list[Design]:
        """Return sets of little error that take `limit` at most, the best of each number of frames.

        A thorough search also adds frames, and leaves out others, for as long as that costs next to
        nothing: by the estimate, sets of different numbers are often equal, which the exact
        prediction tells apart.
        """
        if math.isinf(limit):
            return self._most_accurate
        traced = self.trace(time=limit)
        below = [each for each in traced if each.time <= limit]
        above = [each for each in traced if each.time > limit]
        if not above and self.most_accurate.time <= limit * (1 + SAME):
            return self._most_accurate
        starts = [self.fastest(self.counts[0])]
        for start in below[-2:] + above[:2]:
            if self.least_time(start.n) <= limit * (1 + SAME):
                starts.append(start)
            starts += self._smaller(start, limit) + self._larger(start, limit)
        fitted = _best_of_each(self.fitted(each, limit) for each in starts)
        tuned = [self.refitted(each, limit) for each in fitted[: None if thorough else REFINED]]
        tuned = _best_of_each(tuned)
        kept = [each for each in tuned if each.mse < tuned[0].mse * NEAR_MSE]
        kept = kept[:REFINED]
        if thorough and not self.is_list:
            kept.append(self.scaled(self.evened(kept[0]), limit))
        found = _best_of_each([*(self._improved(each, limit) for each in kept), *tuned])
        known: dict[int, float] = {}
        while thorough:
            found = _best_of_each([*found, *self._resized_on(found[0], limit, known)])
            known, best = {each.n: each.mse for each in found}, found[0].mse
            near = [each for each in found if each.mse < best * NEAR_MSE][:REGAINED]
            regained = (self._regained_together(each, limit) for each in near)
            found = _best_of_each([*found, *regained])
            if not found[0].mse < best * (1 - ENOUGH):
                break
        return found

    def _resized_on(self, design: Design, limit: float, known: dict[int, float]) -> list[Design]:
        """Return sets with one frame more each, and with one less, down to those clearly worse.

        It ends where a set is no better than one of so many frames for which it was done before,
        whose errors are `known`.
        """
        found: list[Design] = []
        for resized in (self._larger, self._smaller):
            current = design
            while current.mse < design.mse * NEAR_MSE:
                trials = resized(current, limit, self.weight_of(current))
                if not trials:
                    break
                current = self.refitted(self.fitted(trials[0], limit), limit)
                if not self.is_list:  # there it would change the number
                    current = self._improved(current, limit)
                found.append(current)
                if current.mse >= known.get(current.n, math.inf) * (1 - ENOUGH):
                    break
        return found

    def _improved(self, design: Design, limit: float) -> Design:
        """Return a set with exchanged frames and tuned times, for as long as it becomes better."""
        best = design
        for _ in range(6):
            if self.is_list:
                improved = self.exchanged(best, 0.0, limit=limit * (1 + SAME))
                improved = self._paired(improved, limit * (1 + SAME))
            else:
                improved = self.exchanged(best, self.weight_of(best), rounds=1, sizes=False)
                improved = self.scaled(improved, limit)
            if improved.time > limit * (1 + SAME) or not improved.mse < best.mse * (1 - BETTER):
                break
            best = improved
        return best

    def _regained_together(self, design: Design, limit: float) -> Design:
        """Return a set, or a better one whose gains are shared among the frames in another way.

        Exchanges of one frame do not lead from a few long frames to more and shorter ones of a
        higher gain, since each set between the two is worse.
        """
        if self.is_list or self.gains.size == 1 or design.n == 1:
            return design
        trials = (self.fitted(each, limit) for each in self._shared(design))
        best = min(trials, key=_mse, default=design)
        best = self.refitted(best, limit)
        if best.mse < design.mse * NEAR_PATTERN:
            best = self._improved(best, limit)
        return min(design, best, key=_mse)

    def _shared(self, design: Design) -> list[Design]:
        """Return sets of the same exposures with other gains, for each largest gain the best one.

        The gains rise with the exposure: light that only long exposures show has little noise.
        """
        parts, cost = self.at_each_gain(design)
        ends = _shares(design.n, self.gains.size)
        coarse = parts[..., ::COARSER]
        sums = np.concatenate([np.zeros_like(coarse[:, :, :1]), coarse.cumsum(axis=2)], axis=2)
        times = np.concatenate([np.zeros_like(cost[:, :1]), cost.cumsum(axis=1)], axis=1)
        # From all frames at the last gain: up to each end, one gain takes the place of the next.
        total, time = sums[:, -1, -1:], times[-1, -1]
        for gain in range(self.gains.size - 1):
            total = total + (sums[:, gain] - sums[:, gain + 1])[:, ends[:, gain]]
            time = time + (times[gain] - times[gain + 1])[ends[:, gain]]
        merit = self.merits(self.frames.mse(total, COARSER), time, self.weight_of(design))
        frames = np.diff(ends, axis=1, prepend=0)  # of each gain
        largest = np.where(frames > 0, np.arange(self.gains.size), 0).max(axis=1)
        found = []
        for gain in np.unique(largest).tolist():
            index = np.flatnonzero(largest == gain)
            chosen = int(index[merit[index].argmin()])
            gains = np.repeat(np.arange(self.gains.size), frames[chosen])
            gains[0] = design.gain[0]
            if np.any(gains != design.gain):
                place = np.clip(design.log_exposure, *self.limits(gains))
                found.append(self.design(place, gains))
        return found

    def _smaller(self, design: Design, limit: float, weight: float = 1.0) -> list[Design]:
        """Return a set without the frame that is worth least; none where there are too few."""
        if design.n == self.counts[0] or self.least_time(design.n - 1) > limit * (1 + SAME):
            return []
        rest, time, has_base = self.rests(design)
        merits = np.where(has_base, self.merits(self.frames.mse(rest), time, weight), np.inf)
        return [self.changed(design, [], [int(merits[:-1].argmin())])]

    def _larger(self, design: Design, limit: float, weight: float = 1.0) -> list[Design]:
        """Return a set with the frame that is worth most; none where it does not fit."""
        if design.n == self.counts[1] or self.least_time(design.n + 1) > limit * (1 + SAME):
            return []
        mse = self.frames.mse(design.parts.sum(axis=1)[:, np.newaxis] + self.parts)
        (time,) = self.times_with(design, np.array([design.time]), np.array([design.n]))
        return [self.changed(design, [int(self.merits(mse, time, weight).argmin())], [])]

    def _paired(self, design: Design, limit: float) -> Design:
        """Return a set on a list improved by exchanges of pairs with near settings."""
        current = design
        for one, other in combinations(range(design.n), 2):
            first, second = (self._near(current, place) for place in (one, other))
            rest = current.parts.sum(axis=1) - current.parts[:, one] - current.parts[:, other]
            time = self.times_of_pairs(current, (one, other), (first, second))
            pairs = self.parts[:, first, np.newaxis] + self.parts[:, np.newaxis, second]
            total = rest[:, np.newaxis, np.newaxis] + pairs
            mse = np.where(time <= limit, self.frames.mse(total), np.inf)
            row, column = divmod(int(mse.argmin()), second.size)
            if mse[row, column] < current.mse * (1 - BETTER):
                current = self.changed(
                    current, [int(first[row]), int(second[column])], [one, other]
                )
        return current

    def times_of_pairs(
        self,
        design: Design,
        places: tuple[int, int],
        options: tuple[NDArray[np.intp], NDArray[np.intp]],
    ) -> FloatArray:
        """Return what a set takes with each pair of options in place of two frames, (A, B)."""
        first, second = options
        kept = np.ones(design.n, np.bool_)
        kept[list(places)] = False
        log_exposure, gain = design.log_exposure[kept], design.gain[kept]
        time = self._cost(log_exposure, gain).sum() + self.cost[first, np.newaxis]
        time = time + self.cost[second]
        last, saved = self.log_exposure[first, np.newaxis], self.saved[first, np.newaxis]
        others = [(self.log_exposure[second], self.saved[second])]
        if log_exposure.size:
            others.append((log_exposure[-1:], self._saved(log_exposure[-1:], gain[-1:])))
        for at, less in others:
            last, saved = np.maximum(last, at), np.where(at >= last, less, saved)
        return np.asarray(time - saved)

    def _near(self, design: Design, place: int) -> NDArray[np.intp]:
        """Return the settings of a list near a frame, at its gain and at the gains beside it."""
        if not self.rests(design)[2][place]:
            return self.bases
        distance = np.abs(self.log_exposure - design.log_exposure[place])
        distance = distance + np.abs(self.gain - design.gain[place])
        return np.asarray(np.argsort(distance, kind="stable")[:NEAR])


def _some_of(n: int) -> NDArray[np.intp]:
    """Return all places of n frames, or `MOST_EXCHANGED` of them."""
    return np.unique(np.linspace(0, n - 1, min(n, MOST_EXCHANGED)).astype(np.intp))


def _best_of_each(designs: Iterable[Design]) -> list[Design]:
    """Return the set of least error of each number of frames, the best first."""
    found = {each.n: each for each in sorted(designs, key=lambda each: -each.mse)}
    return sorted(found.values(), key=_mse)


def _shares(n: int, gains: int) -> NDArray[np.intp]:
    """Return ways to share rising gains among n frames: the ends of the frames of each gain."""
    step = 1
    while math.comb(math.ceil(n / step) + gains - 1, gains - 1) > MOST_PATTERNS:
        step += 1
    places = [*range(0, n, step), n]
    rows = [(*ends, n) for ends in combinations_with_replacement(places, gains - 1)]
    return np.array(rows, dtype=np.intp)


def _mse(design: Design) -> float:
    return design.mse
