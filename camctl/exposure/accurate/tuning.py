"""Shutter times of a set of frames, tuned for accuracy: to a weight of time, or within a time.

Newton's method with the derivatives of the estimate by ln(exposure), at the same gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.accurate.frame_sets import DELTA, Design, FrameSets
from camctl.exposure.exposure_choices import SAME
from camctl.model.response.camera import FloatArray

LEAST_WEIGHT = 1e-4
"""Weight of time for the most accurate set: what takes twice the time for 0.003 % is left out."""

LONGEST_STEP = 0.4
"""Longest step of a time in ln(exposure): two steps of the lattice."""

SHORTEST_STEP = 2e-3
"""Step in ln(exposure) from which the times are tuned: the error then changes by some 1e-6."""

HALVINGS = 12
"""Halvings of a factor of e between times: 1.00025 is left."""

CORRECTIONS = 6
"""Attempts to reach an accuracy by another time; each leaves about a tenth of what was missing."""

CLOSE = 1.001
"""Ratio of effective levels up to which a set has not more of them than asked for."""

MIDDLE = (1 + CLOSE) / 2
"""Ratio that is aimed at."""

MAX_STEPS = 24
"""Newton steps of the times, at most: few frames converge in 3 to 6, 16 of them in about 20."""

SHARES = (1.0, 0.3, 0.1)
"""Shares of a step that are tried until one makes the set better."""

Derivatives: TypeAlias = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Gradient and Hessian of the error, and of the time."""

_BESIDE = np.array([[-1], [1]])
"""Steps of `DELTA` from an exposure, for derivatives."""

Step: TypeAlias = tuple[FloatArray, float]
"""Newton's step, and by how much it should reduce ln(mse), or the merit."""

SAME_TIME = 1e-6
"""Relative difference up to which a set takes the time that it may."""

BETTER = 2e-6
"""Gain in ln(mse) from which a set counts as better: 1e-6 of the effective levels."""


class TunedSets(FrameSets):
    """Sets of frames whose times are tuned."""

    def tuned(self, design: Design, weight: float) -> Design:
        """Return the set with its times tuned to the least merit, at the same gains."""

        def step(current: Design) -> Step:
            return self._step(current, self._derivatives(current), weight)

        def is_better(found: Design, best: Design) -> bool:
            return self.merit(found, weight) < self.merit(best, weight) - BETTER

        return self._descended(design, step, self._moved, is_better)

    def refitted(self, design: Design, limit: float) -> Design:
        """Return the set with its times tuned at the time that it takes, `limit` at most."""

        def step(current: Design) -> Step:
            error, time = derivatives = self._derivatives(current)
            binding = np.where(self._idles(current)[1:], 0.0, time[0])
            along = float(binding @ binding)
            weight = max(0.0, -float(error[0] @ binding) / along) if along > 0 else 0.0
            return self._step(current, derivatives, weight)

        def moved(current: Design, step: FloatArray) -> Design:
            place = self._stepped(current, step)
            fitting = self._scaled_to(place, current.gain, limit)
            return (
                self.fastest(current.n) if fitting is None else self.design(fitting, current.gain)
            )

        def is_better(found: Design, best: Design) -> bool:
            return found.mse < best.mse * (1 - BETTER)

        return self._descended(design, step, moved, is_better)

    def _descended(
        self,
        design: Design,
        step: Callable[[Design], Step],
        moved: Callable[[Design, FloatArray], Design],
        is_better: Callable[[Design, Design], bool],
    ) -> Design:
        """Return the set after Newton steps of its times for as long as they make it better.

        The first of `SHARES` of a step that does so is taken; none that should gain less than
        `BETTER`.
        """
        if self.is_list or design.n == 1:
            return design
        best = design
        for _ in range(MAX_STEPS):
            change, gain = step(best)
            if np.abs(change).max() < SHORTEST_STEP or gain < BETTER:
                break
            trials = (moved(best, share * change) for share in SHARES)
            found = next((trial for trial in trials if is_better(trial, best)), None)
            if found is None:
                break
            best = found
        return best

    def _moved(self, design: Design, step: FloatArray) -> Design:
        return self.design(self._stepped(design, step), design.gain)

    def _step(self, design: Design, derivatives: Derivatives, weight: float) -> Step:
        """Return Newton's step of all times but the first for a weight of time, and its gain.

        A frame that lasts exactly as long as costs nothing stays where it is if more costs more
        than it brings, and less costs accuracy.
        """
        (error, error_2), (time, time_2) = derivatives
        gradient = error + weight * time
        is_idle = self._idles(design)[1:]
        moves = ~(is_idle & (gradient > 0) & (error <= 0))
        step = np.zeros(gradient.size)
        gradient = np.where(is_idle & (error > 0), error, gradient)
        if moves.any():
            hessian = (error_2 + weight * time_2)[np.ix_(moves, moves)]
            step[moves] = _newton(gradient[moves], hessian)
        return step, -float(gradient @ step) / 2

    def _idles(self, design: Design) -> NDArray[np.bool_]:
        """Return which frames last exactly as long as costs nothing."""
        return np.asarray(np.abs(design.log_exposure - self.idle(design.gain)) <= SAME)

    def _stepped(self, design: Design, step: FloatArray) -> FloatArray:
        """Return ln(exposure) of a set after a step of all but the first, within the limits.

        No time passes the one up to which it costs nothing, since the cost has a kink there.
        """
        low, high = self.limits(design.gain)
        at, idle = design.log_exposure, self.idle(design.gain)
        low = np.where(at > idle + SAME, np.maximum(low, idle), low)
        high = np.where(at < idle - SAME, np.minimum(high, idle), high)
        moved = np.clip(at + np.append(0.0, step), low, np.maximum(low, high))
        moved[0] = 0.0  # the shortest exposure
        return np.asarray(moved)

    def _derivatives(self, design: Design) -> Derivatives:
        """Return gradient and Hessian of ln(mse), and of ln(time), by ln(exposure) but the first.

        Where the cost has a kink, its derivative is towards longer times.

        What an exposure contributes has its derivatives by differences over `DELTA`; those of the
        sum follow from them.
        """
        at, gain = design.log_exposure[1:], design.gain[1:]
        shifted = self._parts(at, gain, _BESIDE).astype(np.float64)
        low, high = shifted[:, 0], shifted[:, 1]
        one = (high - low) / (2 * DELTA)
        two = (high + low - 2 * design.parts[:, 1:]) / DELTA**2
        total = design.parts.sum(axis=1, dtype=np.float64)
        gradient, hessian = self.frames.derivatives(total, one, two)
        gradient, hessian = gradient / design.mse, hessian / design.mse
        hessian -= np.outer(gradient, gradient)
        times = self._times(at, gain)
        time = design.time + self.costs.fixed
        factor = self._factors(times.size)
        rate = np.where(times >= self.costs.least * (1 - SAME), factor * times / time, 0.0)
        return (gradient, hessian), (rate, np.diag(rate) - np.outer(rate, rate))

    def _factors(self, n: int) -> FloatArray:
        """Return how many frames each of the last n exposures of a set takes."""
        factor = np.full(n, self.costs.factor)
        factor[-1:] -= self.costs.waiting
        return factor

    def weight_of(self, design: Design) -> float:
        """Return the w for which a set is the best of its kind, from scaling its times."""
        longer = self.fitted(design, 1.02 * design.time)
        change = math.log((longer.time + self.costs.fixed) / (design.time + self.costs.fixed))
        if change < SAME:
            return LEAST_WEIGHT
        return max(LEAST_WEIGHT, math.log(design.mse / longer.mse) / change)

    def time_of(self, design: Design, factor: float) -> float:
        """Return about the time in which such a set, scaled, has `factor` times the levels.

        It is within a factor of e of the time that the set takes.
        """
        fixed, goal = self.costs.fixed, factor * design.levels
        low, high = (0.0, 1.0) if factor > 1 else (-1.0, 0.0)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            time = (design.time + fixed) * math.exp(middle) - fixed
            low, high = (
                (low, middle) if self.fitted(design, time).levels >= goal else (middle, high)
            )
        return (design.time + fixed) * math.exp(high) - fixed

    def reduced(self, design: Design, levels: float) -> Design:
        """Return a set with its times reduced until it has just `levels` by the estimate."""
        fixed, low = self.costs.fixed, self.least_time(design.n)
        above, below = design, None
        for _ in range(CORRECTIONS):
            goal = levels * MIDDLE / above.levels
            if above.levels <= levels * CLOSE or above.time <= low * (1 + SAME):
                break
            if below is None:
                time = self.time_of(above, goal)
            else:
                longer = math.log((above.time + fixed) / (below.time + fixed))
                share = math.log(goal) / math.log(below.levels / above.levels)
                time = (above.time + fixed) * math.exp(-share * longer) - fixed
            found = self.scaled(above, max(time, low))
            if found.levels >= levels:
                above = found
            else:
                below = found
        return above

    def scaled(self, design: Design, limit: float) -> Design:
        """Return the set with other times, tuned for a time, at the same gains."""
        return self.refitted(self.fitted(design, limit), limit)

    def evened(self, design: Design) -> Design:
        """Return a set of the same gains whose ln(exposure) are at equal distances."""
        even = np.linspace(0.0, design.log_exposure[-1], design.n)
        return self.design(np.clip(even, *self.limits(design.gain)), design.gain)

    def neighbours(self, design: Design, limit: float, share: float) -> list[Design]:
        """Return a set with each time but the first `share` longer or shorter.

        Where the set takes `limit`, they are scaled to it; none on a list of settings.  Those of
        exposures without another one near come first: what light they alone show in few levels
        depends most on where these levels are, which the estimate takes no account of.
        """
        if self.is_list or design.n == 1:
            return []
        gaps = np.append(np.diff(design.log_exposure), np.inf)
        alone = np.argsort(-np.minimum(gaps[:-1], gaps[1:]), kind="stable")
        steps = np.eye(design.n - 1)[alone] * math.log1p(share)
        moved = [self._moved(design, sign * step) for step in steps for sign in (1, -1)]
        is_bound = design.time > limit * (1 - SAME_TIME)
        found = [self.fitted(each, limit) if is_bound else each for each in moved]
        return [each for each in found if each.time <= limit * (1 + SAME)]

    def fitted(self, design: Design, limit: float) -> Design:
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
        idle = self.idle(gain)
        floor = np.clip(np.minimum(idle, log_exposure), low, high)
        if np.any(log_exposure > idle + SAME):  # nor should it become one that does
            high = np.where(log_exposure <= idle + SAME, np.maximum(log_exposure, low), high)
        low[0] = high[0] = floor[0] = 0.0  # the shortest exposure
        share = self._factors(gain.size) / self.costs.factor
        time, bottom, top = (
            self._times(each, gain) * share for each in (log_exposure, floor, high)
        )
        bottom = np.maximum(bottom, self.costs.least * share)
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
            _, _, has_base = self.rests(current)
            for place in np.argsort(-cost, kind="stable").tolist():
                options = np.arange(self.gain.size) if has_base[place] else self.bases
                shorter = options[self.cost[options] < cost[place] * (1 - SAME)]
                if shorter.size:
                    added = int(shorter[self.cost[shorter].argmax()])
                    current = self.changed(current, [added], [place])
                    break
            else:
                return self.fastest(design.n)
        return current


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
    """Return Newton's step downwards, each component at most `LONGEST_STEP`.

    Where the Hessian is positive definite and its step is no longer than that, this is it; else the
    step goes downwards along each of the eigenvectors.
    """
    try:
        np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError:
        pass
    else:
        step = np.linalg.solve(hessian, -gradient)
        if step @ step <= LONGEST_STEP**2:
            return np.asarray(step)
    values, vectors = np.linalg.eigh(hessian)
    along = gradient @ vectors
    values = np.maximum(np.abs(values), np.abs(along) / LONGEST_STEP + 1e-9)
    return np.asarray(np.clip(vectors @ (-along / values), -LONGEST_STEP, LONGEST_STEP))
