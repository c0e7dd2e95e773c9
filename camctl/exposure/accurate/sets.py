"""The most accurate sets of exposures of one camera, for each time.

The estimate (`DesignSearch`) finds the sets, the exact distribution of their sum judges
them.  Where noise is so low that it does not dither the quantiser, the gaps between the levels
decide, and sets of least quantisation error within the same time are judged, too.  Of short lists
of settings all sets are considered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from camctl.exposure.accurate.design import DesignSearch
from camctl.exposure.accurate.estimate import FEW_LEVELS, FrameAccuracy
from camctl.exposure.accurate.frame_sets import Design
from camctl.exposure.accurate.judge import JUDGED_FRAMES, Judge
from camctl.exposure.accurate.least_quantisation import least_quantisation
from camctl.exposure.accurate.listed import ListedSets
from camctl.exposure.accurate.tuning import CLOSE, CORRECTIONS, MIDDLE
from camctl.exposure.exposure_choices import SAME, AccuracyProblem, Rated, Shots, bases
from camctl.exposure.noise import DITHERS
from camctl.model.distribution import deviation
from camctl.model.effective import MOST_SEARCHED

DITHERING = 0.3
"""Noise in levels from which the quantiser counts as dithered: the estimate is then within 3 %."""

NEAR_BEST = 0.98
"""Share of the estimated levels of the best set from which a set is judged: the errors of the
estimates of similar sets differ by less."""

MOST_JUDGED, MOST_SMOOTH = 6, 2
"""Such sets that are judged, at most; and where noise dithers the quantiser in the dark, too, so
that the estimate errs alike for all of them."""

KNEE = 0.97
"""Share of the largest levels^2 / time from which more time counts as no better than averaging.
Predictions and an independent simulator differ by up to 1.05 % (42 cells), so that levels^2 of two
sets can be told apart from 2 sqrt(2) x 1.05 % on."""

NEAR_USUAL = 0.995
"""Share of the levels of the usual number of exposures that are enough: 0.5 % is not seen."""

FAR_ABOVE = 1.3
"""Ratio of estimated levels to the fewest from which they are enough: estimates of sets that are
this accurate err by less than 10 %."""

NEARLY = 0.98
"""Share of this from which a traced set is refined: that changes the levels by less than 1 %."""

MOST_POLISHED = 25_000
"""Levels of the sums of sets that are rated exactly beside one, at most: 0.25 s for 8 bits.  Where
the pixels' offsets differ they count three times, as often as they are summed."""

POLISHED_SHARES = (0.1, 0.05, 0.05, 0.03, 0.03, 0.02, 0.01)
"""Shares by which one exposure after the other is changed there."""

FEW = 5
"""Frames up to which every set of a front is judged: the ratio of the exact levels to the estimate
differs by some per cent between them; from there on it changes by less than 1 %."""

JUDGEMENTS = 7
"""Sets with the same gains that are judged for an accuracy, at most; two are usually enough."""

TRACED = 1.1
"""Share of an accuracy up to which the front is traced: estimates err by less."""

NEAR_TIME = 1.003
"""Ratio of times within which the shortest time for an accuracy is found."""

WEIGHT_LIMITS = 0.02, 10.0
"""Least and largest weight of time (see `DesignSearch`) that is believed there."""


MOST_LONGER = 100.0
"""Largest ln of a factor of time that is tried at once: what is longer is beyond every limit."""


class AccurateSets:
    """Finds sets of exposures for one problem; each is judged once.

    Args:
        problem: the camera, its noise and the desired response
        counts: fewest and most exposures of a set

    Raises:
        UsageError: no setting can be the shortest exposure
    """

    def __init__(self, problem: AccuracyProblem, counts: tuple[int, int]) -> None:
        self.problem, self.counts = problem, counts
        noise = problem.noise.frame(gain=min(problem.available.gains), time_s=0.0)
        at = np.array([0.0, 1 / 16])  # in the dark, and at 1/16 of full scale
        dark, lit = deviation(problem.response, at, noise).tolist()
        self.dithered = lit >= DITHERING
        self._is_smooth = dark >= DITHERS
        self._most: int | None = MOST_SMOOTH if self._is_smooth else MOST_JUDGED
        if problem.response.M <= FEW_LEVELS:
            self._most = None  # the estimate says least of them, and exact ratings cost little
        frames = FrameAccuracy(problem)
        self.searches = [DesignSearch(frames, base, counts) for base in bases(problem)]
        self.judge = Judge(frames, dithered=self.dithered)
        self._listed = ListedSets(self.searches, counts, self.dithered, self.judge)

    @property
    def enumerated(self) -> bool:
        """Whether all sets are considered, so that none is better."""
        return self._listed.is_complete

    def least_time(self, n: int) -> float:
        """Return the shortest time of n exposures, without the fixed time of a set."""
        return min(search.least_time(n) for search in self.searches)

    @property
    def longest_of_use(self) -> float:
        """The time of the most accurate set: longer ones are no better."""
        return max(search.most_accurate.time for search in self.searches)

    def is_bound(self, limit: float) -> bool:
        """Return whether longer sets than `limit` are more accurate."""
        if math.isinf(limit):
            return False
        if any(search.trace(time=limit)[-1].time > limit for search in self.searches):
            return True
        return limit < self.longest_of_use

    def estimated(self, limit: float) -> Rated:
        """Return about the most accurate set within a time, in much less time than `within`.

        It is one of the sets along the front, scaled to the time: at most 3 % less accurate.
        """
        both = [(search.roughly_within(limit), search) for search in self._possible(limit)]
        return self._roughly_rated(*min(both, key=lambda pair: pair[0].mse))

    def _roughly_rated(self, design: Design, search: DesignSearch) -> Rated:
        """Return a set with its exact levels, or by the estimate where that errs smoothly.

        So it does for many frames, too.
        """
        if self._is_smooth or design.n > JUDGED_FRAMES:
            return Rated(search.shots(design), design.levels, design.time)
        return self.judge(search.shots(design))

    def _best_estimated(
        self, limit: float, *, thorough: bool = False
    ) -> tuple[Design, DesignSearch]:
        return self._estimates(limit, thorough=thorough)[0]

    def _estimates(self, limit: float, *, thorough: bool) -> list[tuple[Design, DesignSearch]]:
        """Return sets within a time, the best by the estimate first."""
        pairs = [
            (design, search)
            for search in self._possible(limit)
            for design in search.several_within(limit, thorough=thorough)
        ]
        return sorted(pairs, key=lambda pair: pair[0].mse)

    def _possible(self, limit: float) -> list[DesignSearch]:
        fewest, limit = self.counts[0], limit * (1 + SAME)
        return [search for search in self.searches if search.least_time(fewest) <= limit]

    def within(self, limit: float, *, thorough: bool = True, start: Shots = ()) -> Rated:
        """Return the most accurate set that takes `limit` at most (>= the least time).

        A thorough search judges several sets, and improves the best one, if it has few exposures,
        by exact ratings of its neighbours.  Where noise does not dither the quantiser, the search
        starts from `start`, too, a set of a shorter time.
        """
        listed = self._listed.most_accurate(limit) if self._listed.numbers else None
        found = [] if listed is None else [listed]
        is_thorough = thorough and not self.problem.noise.is_none
        if self.enumerated:
            pairs = []
        elif self.problem.noise.is_none and not self.searches[0].is_list:
            pairs = [(self.searches[0].roughly_within(limit), self.searches[0])]
        else:
            pairs = self._estimates(limit, thorough=is_thorough)
        near = [pair for pair in pairs if pair[0].levels >= NEAR_BEST * pairs[0][0].levels]
        if not is_thorough:
            near = near[:1]
        elif near and self._most is not None:
            near = near[: max(MOST_SMOOTH, min(self._most, JUDGED_FRAMES // near[0][0].n))]
        rated = [self.judge(search.shots(design)) for design, search in near]
        if is_thorough and near:
            best = max(range(len(near)), key=lambda place: rated[place].levels)
            rated.append(self._polished(*near[best], limit))
        found += rated
        if not self.dithered:
            if start:
                found.append(self.judge(start))
            for search in dict.fromkeys(search for _, search in near if not search.is_list):
                design = next(design for design, each in near if each is search)
                least = least_quantisation(search, design, limit, thorough=thorough, start=start)
                found += [self.judge(least)] if least else []
            in_steps = self.problem.available.in_steps
            found = [self.judge(in_steps(each.shots, limit)) for each in found]
        return max(found, key=lambda each: (each.levels, -each.time))

    def front(self, limits: Sequence[float], best: Shots = ()) -> list[Rated]:
        """Return about the most accurate set within each of some ascending times.

        Where noise does not dither the quantiser, those of longer times than `best`, a set that
        was searched for thoroughly, begin with it.

        Where noise dithers the quantiser, sets of more than `FEW` frames are not all judged: the
        ratio of the exact levels to the estimate is interpolated between some of them.
        """
        if not self.dithered or self._listed.numbers:
            rated: list[Rated] = []
            others = [self.judge(best)] if best and not self.dithered else []
            for limit in limits:
                below = [each for each in others if each.time <= limit] + rated[-1:]
                start = max(below, key=lambda each: each.levels).shots if below else ()
                rated.append(self.within(limit, thorough=False, start=start))
            return rated
        both = [self._best_estimated(limit) for limit in limits]
        few = [place for place, (design, _) in enumerate(both) if design.n <= FEW]
        known = sorted({*few, (len(few) + len(both)) // 2, len(both) - 1} - {len(both)})
        times, ratios = [], []
        chosen = sorted([self._recommended, *(both[k] for k in known)], key=lambda p: p[0].time)
        for design, search in chosen:
            times.append(math.log(design.time + self.problem.available.costs.fixed))
            ratios.append(self.judge(search.shots(design)).levels / design.levels)
        found = []
        for design, search in both:
            at = math.log(design.time + self.problem.available.costs.fixed)
            levels = design.levels * float(np.interp(at, times, ratios))
            found.append(Rated(search.shots(design), levels, design.time))
        return found

    def _polished(self, design: Design, search: DesignSearch, limit: float) -> Rated:
        """Return a set, or a better one with one time after the other a little changed.

        The estimate errs most for few exposures.
        """
        best = self.judge(search.shots(design))
        work = design.n * self.problem.response.M * (3 if search.frames.has_shift else 1)
        remaining = MOST_POLISHED // work
        for share in POLISHED_SHARES:
            for trial in search.neighbours(design, limit, share)[:remaining]:
                remaining -= 1
                rated = self.judge(search.shots(trial))
                if rated.levels > best.levels and rated.time <= limit * (1 + SAME):
                    best, design = rated, trial
                    break
        return best

    def reaching(self, levels: float, limit: float) -> Rated | None:
        """Return the shortest set found within `limit` that has `levels`, or None."""
        best = self._listed.quickest(levels, limit) if self._listed.numbers else None
        if self.enumerated:
            return best
        low = self.least_time(self.counts[0])
        time = max(low, min(self._estimated_time(levels), limit))
        if not any(search.trace(levels=levels)[-1].levels >= levels for search in self.searches):
            limit = min(limit, max(low, self.longest_of_use))
        if not self.dithered or self.searches[0].is_list:
            return self._shortest(levels, limit, time, best)
        design, search = self._best_estimated(time)
        rated = self.judge(search.shots(design))
        goal = levels * design.levels / rated.levels  # as much as the estimate errs
        time = max(low, min(self._estimated_time(goal), limit))
        design, search = self._best_estimated(time, thorough=True)
        fixed, missed, top = self.problem.available.costs.fixed, low, limit
        for _ in range(JUDGEMENTS):
            rated = self.judge(search.shots(design))
            if rated.levels < levels:
                missed = max(missed, rated.time)
            elif best is None or rated.time < best.time:
                best = rated
                top = min(top, rated.time)
            is_close = levels <= rated.levels <= levels * CLOSE
            if is_close or top + fixed <= (missed + fixed) * NEAR_TIME:
                break
            time = search.time_of(design, levels * MIDDLE / rated.levels)
            if rated.levels < levels:
                # One frame more is quicker where the frames there are gain little by more time.
                quicker = self._traced(levels * design.levels / rated.levels)
                if quicker is not None and quicker[0].time < min(time, top):
                    design, search = quicker
                    continue
            if not missed < time < top:  # near the most accurate set time brings next to nothing
                far = top if math.isfinite(top) else 2 * (time + fixed)
                time = math.sqrt((missed + fixed) * (far + fixed)) - fixed
            design = search.scaled(design, max(low, min(time, limit)))
        return best

    def nearly_most_accurate(self, share: float) -> Rated | None:
        """Return the shortest set with a share of the most levels that there are, by the estimate.

        None: the estimate does not tell; for many frames it errs by as much for both.
        """
        is_few = self.counts[0] <= JUDGED_FRAMES or self._most is None
        if is_few or not self.dithered or self.searches[0].is_list:
            return None
        best, search = self._best_estimated(math.inf)
        found = search.nearly(best, share * best.levels)
        return Rated(search.shots(found), found.levels, found.time)

    def nearly_as_accurate(self, best: Rated, levels: float) -> Rated:
        """Return a shorter set that has `levels`, or `best`."""
        search = self.searches[0]
        if self.dithered or search.is_list or self.counts[0] <= MOST_SEARCHED:
            return self.reaching(levels, best.time) or self._shortened(best, levels)
        most = search.most_accurate
        shorter = search.reduced(most, levels / best.levels * most.levels).time / most.time
        low, time = self.least_time(self.counts[0]), min(most.time, best.time * shorter)
        for _ in range(CORRECTIONS):
            found = self.within(max(low, time), thorough=False)
            if found.levels < levels:
                break
            best, time = found, found.time * shorter
        return best

    def _shortened(self, best: Rated, levels: float) -> Rated:
        """Return a set with its times reduced in proportion, as far as it keeps `levels`.

        Where noise does not dither the quantiser that does not keep how levels interleave.
        """
        search = self.searches[0]
        if search.is_list or not self.dithered:
            return best
        log_exposure = np.log([shot.exposure for shot in best.shots])
        gain = np.searchsorted(search.gains, [shot.gain for shot in best.shots])
        design, rated = search.design(log_exposure, gain), best
        low = search.least_time(len(best.shots))
        for _ in range(CORRECTIONS):
            time = search.time_of(design, levels * MIDDLE / rated.levels)
            design = search.scaled(design, min(max(time, low), best.time))
            rated = self.judge(search.shots(design))
            if rated.levels >= levels and rated.time < best.time:
                best = rated
            if levels <= rated.levels <= levels * CLOSE:
                break
        return best

    def _shortest(
        self, levels: float, limit: float, time: float, best: Rated | None
    ) -> Rated | None:
        """Return the shortest set that has `levels`, by sets within different times.

        Args:
            levels: effective levels
            limit: longest time
            time: the first that is tried
            best: a set that has them
        """
        fixed, low = self.problem.available.costs.fixed, self.least_time(self.counts[0])
        # Near a time the levels grow as its power w/2; `missed` is the longest time that failed.
        weight, missed, last = 1.0, low, None
        for _ in range(CORRECTIONS):
            found = self.within(time, thorough=False)
            if found.levels >= levels and (best is None or found.time < best.time):
                best = found
            elif found.levels < levels:
                missed = max(missed, time)
            if last is not None and abs(found.time - last.time) > SAME * found.time:
                change = math.log((last.time + fixed) / (found.time + fixed))
                weight = 2 * math.log(last.levels / found.levels) / change
            if levels <= found.levels <= levels * CLOSE:
                break
            last, weight = found, min(max(weight, WEIGHT_LIMITS[0]), WEIGHT_LIMITS[1])
            goal = math.log(levels * MIDDLE / found.levels)
            longer = math.exp(min(2 * goal / weight, MOST_LONGER))
            time = (found.time + fixed) * longer - fixed
            top = limit if best is None else best.time
            if top + fixed <= (missed + fixed) * NEAR_TIME:
                break
            if not missed < time < top:
                middle = math.sqrt((missed + fixed) * (top + fixed)) - fixed
                time = top if best is None and math.isfinite(top) else middle
            if not math.isfinite(time):
                time = 2 * (found.time + fixed) - fixed
        return best

    def _traced(self, levels: float) -> tuple[Design, DesignSearch] | None:
        """Return the shortest traced set that has `levels` by the estimate; None: none has."""
        found = [
            (design, search)
            for search in self.searches
            for design in search.trace(levels=TRACED * levels)
            if design.levels >= levels
        ]
        return min(found, key=lambda pair: pair[0].time, default=None)

    def _estimated_time(self, levels: float) -> float:
        """Return about the time at which a set has `levels`, along the traced front."""
        times = []
        for search in self.searches:
            front = search.trace(levels=TRACED * levels)
            if front[-1].levels < levels:
                front = [*front, search.most_accurate]
            rising = np.maximum.accumulate([design.levels for design in front])
            times.append(float(np.interp(levels, rising, [design.time for design in front])))
        return min(times)

    @cached_property
    def _recommended(self) -> tuple[Design, DesignSearch]:
        fixed = self.problem.available.costs.fixed

        def rate(design: Design) -> float:
            return design.levels**2 / (design.time + fixed)

        both = [(search.at_weight(1.0), search) for search in self.searches]
        chosen, search = max(both, key=lambda pair: rate(pair[0]))
        least = KNEE * rate(chosen)
        for design in search.trace(weight=1.0):
            if design.time < chosen.time and rate(design) >= NEARLY * least:
                refined = search.within(design.time)
                if rate(refined) >= least:
                    return refined, search
        return chosen, search

    def recommended(self, floor: tuple[float, int] | None = None) -> Rated:
        """Return the set beyond which more time brings no more than averaging does.

        Levels of averages grow as the square root of the time.  It is the shortest set whose
        levels^2 / time, the fixed time counted in, is within `KNEE` of the largest.

        Args:
            floor: effective levels that it has at least, or a number of exposures: as many as the
                most accurate so many have, if these are fewer
        """
        design, search = self._recommended
        if self.dithered and not self.enumerated:
            found = self.judge(search.shots(design))
        else:
            found = self.within(design.time)
        if floor is None or found.levels >= floor[0]:
            return found
        design, search = self._of_count(floor[1])
        usual = self.judge(search.shots(design))
        least = min(floor[0], NEAR_USUAL * usual.levels)
        if found.levels >= least:
            return found
        return self.reaching(least, usual.time) or usual

    def _of_count(self, n: int) -> tuple[Design, DesignSearch]:
        """Return the most accurate set of n exposures by the estimate."""
        both = [(each.of_count(n), each) for each in self.searches]
        return max(both, key=lambda pair: pair[0].levels)

    def estimated_recommended(self, floor: tuple[float, int]) -> Rated:
        """Return about the recommended set, with about its levels, in much less time.

        Where it is far above the floor its levels are estimated; else the estimate is corrected as
        that of the usual number of exposures, which is judged.
        """
        design, search = self._recommended
        found = Rated(search.shots(design), design.levels, design.time)
        if design.levels >= FAR_ABOVE * floor[0]:
            return found
        usual, search = self._of_count(floor[1])
        levels = self._roughly_rated(usual, search).levels
        least = min(floor[0], NEAR_USUAL * levels)
        return replace(found, levels=max(design.levels * levels / usual.levels, least))
