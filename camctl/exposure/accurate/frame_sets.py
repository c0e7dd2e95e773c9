"""Sets of frames with what each contributes to their accuracy, and what each takes.

The estimate of `camctl.exposure.accurate.estimate` adds up over the frames of a set.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.exposure_choices import MAX_CHOICES, SAME, AccuracyProblem, Shot, Shots
from camctl.model.response.camera import FloatArray

LATTICE = 0.2
"""Step in ln(exposure) of the frames that are exchanged where any time can be set; their times are
tuned afterwards."""

DELTA = 0.02
"""Step in ln(exposure) of the table of what frames contribute, and for derivatives: that of the
tables of the estimate."""


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


class FrameSets:
    """Makes sets of frames with one shortest exposure.

    Args:
        frames: what frames of the camera contribute
        base: product of time and gain of the shortest exposure
        counts: fewest and most frames of a set

    Attributes:
        log_exposure: (F,) ln(exposure) of the frames that sets are exchanged with, the options
        gain: (F,) index of the gain of each
        cost, saved: (F,) what each takes, and what it takes less as the last one of a set
        bases: the indices of those that can be the shortest
    """

    def __init__(self, frames: FrameAccuracy, base: float, counts: tuple[int, int]) -> None:
        self.problem: AccuracyProblem = frames.problem
        self.frames, self.base, self.counts = frames, base, counts
        available = self.problem.available
        self.gains = np.unique(available.gains)
        self.costs = available.costs
        self.is_list = available.times is not None
        shift, least = np.log(self.gains / base), math.log(max(self.costs.least, 1e-300))
        self._low = np.maximum(0.0, math.log(max(available.shortest, 1e-300)) + shift)
        self._high = np.minimum(math.log(self.problem.reach), math.log(available.longest) + shift)
        self._idle, self._unit = least + shift, base / self.gains
        self.log_exposure, self.gain = self._options()
        self.cost = self._cost(self.log_exposure, self.gain)
        self.saved = self._saved(self.log_exposure, self.gain)
        self.bases = np.flatnonzero(self.log_exposure <= SAME)

    @cached_property
    def parts(self) -> NDArray[np.float32]:
        """What each of the options contributes, (3, F, NODES)."""
        return self._parts(self.log_exposure, self.gain)

    def _options(self) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return ln(exposure) and gain of the frames that sets are exchanged with."""
        available, reach = self.problem.available, math.log(self.problem.reach)
        if available.times is None:
            steps = np.linspace(0.0, reach, math.ceil(reach / LATTICE) + 1)
            log_exposure = np.tile(steps, self.gains.size)
            gain = np.repeat(np.arange(self.gains.size), steps.size)
            each = np.arange(self.gains.size)
            log_exposure, gain = np.append(log_exposure, self.idle(each)), np.append(gain, each)
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
        return self._low[gain], self._high[gain]

    def idle(self, gain: NDArray[np.intp]) -> FloatArray:
        """Return ln(exposure) at gains up to which more time costs nothing; -690 where it does."""
        return self._idle[gain]

    def _times(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> FloatArray:
        return np.exp(log_exposure) * self._unit[gain]

    def _cost(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> FloatArray:
        return self.costs.each(self._times(log_exposure, gain))

    def _saved(self, log_exposure: FloatArray, gain: NDArray[np.intp]) -> FloatArray:
        return self.costs.saved(self._times(log_exposure, gain))

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

    @cached_property
    def _table_size(self) -> int:
        return math.ceil(math.log(self.problem.reach) / DELTA) + 4

    def _parts(
        self,
        log_exposure: FloatArray,
        gain: NDArray[np.intp],
        shift: int | NDArray[np.intp] = 0,
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
        time = (
            self._cost(log_exposure, gain).sum() - self._saved(log_exposure[-1:], gain[-1:]).sum()
        )
        return Design(log_exposure, gain, parts, mse, float(time))

    def at_each_gain(self, design: Design) -> tuple[NDArray[np.float32], FloatArray]:
        """Return what the frames of a set contribute and take at each gain, the first as it is.

        (3, K, n, NODES) and (K, n); exposures that a gain does not reach are changed to its next.
        The last one is the last of the set.
        """
        gain = np.repeat(np.arange(self.gains.size)[:, np.newaxis], design.n, axis=1)
        gain[:, 0] = design.gain[0]
        log_exposure = np.clip(design.log_exposure, *self.limits(gain))
        cost = self._cost(log_exposure, gain)
        cost[:, -1:] -= self._saved(log_exposure[:, -1:], gain[:, -1:])
        return self._parts(log_exposure, gain), cost

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

    def merits(self, mse: FloatArray, time: FloatArray, weight: float) -> FloatArray:
        """Return ln(mse) + w ln(time) of sets, the fixed time of each counted in."""
        total = np.maximum(time + self.costs.fixed, 1e-300)  # a set without frames takes no time
        return np.asarray(np.log(mse) + weight * np.log(total))

    def merit(self, design: Design, weight: float) -> float:
        """Return ln(mse) + w ln(time), the fixed time of a set counted in."""
        return math.log(design.mse) + weight * math.log(design.time + self.costs.fixed)

    def least_time(self, n: int) -> float:
        """Return what the n frames take that are over soonest, without the fixed time."""
        if n == 1:
            return float((self.cost - self.saved)[self.bases].min())
        others = (n - 1) * self.cost.min() - self.saved[self.cost.argmin()]
        return float(self.cost[self.bases].min() + others)

    def fastest(self, n: int) -> Design:
        """Return the set of n frames of the least time; of equal times the most accurate."""
        return self.filled(n, np.flatnonzero(self.cost <= self.cost.min() * (1 + SAME)))

    def filled(self, n: int, options: NDArray[np.intp] | None = None) -> Design:
        """Return the soonest shortest exposure and, one after the other, the best of options."""
        if options is None:
            options = np.arange(self.cost.size)
        first = self.bases[np.lexsort((self.gain[self.bases], self.cost[self.bases]))[:1]]
        chosen = self.design(self.log_exposure[first], self.gain[first])
        parts = self.parts[:, options]
        while chosen.n < n:
            total = chosen.parts.sum(axis=1)[:, np.newaxis] + parts
            chosen = self.changed(chosen, [int(options[self.frames.mse(total).argmin()])], [])
        return chosen

    def spaced(self, n: int) -> Design:
        """Return n frames from the shortest exposure to the longest, at equal ratios.

        All but the first have one gain, the one with which they are most accurate.
        """
        first, found = self.fastest(1), []
        for gain in range(self.gains.size):
            gains = np.append(first.gain, np.full(n - 1, gain))
            low, high = self.limits(gains)
            found.append(self.design(np.clip(np.linspace(0.0, high[-1], n), low, high), gains))
        return min(found, key=lambda each: each.mse)

    def changed(self, design: Design, added: Sequence[int], removed: Sequence[int]) -> Design:
        """Return a set with some options added and some of its places removed."""
        rows = np.array(added, dtype=np.intp)
        log_exposure = np.append(np.delete(design.log_exposure, removed), self.log_exposure[rows])
        return self.design(
            log_exposure, np.append(np.delete(design.gain, removed), self.gain[rows])
        )

    def rests(self, design: Design) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return a set without each of its frames in turn, and at last the whole set.

        The sums of its parts (3, n + 1, NODES), its time (n + 1,) and whether it has a frame of the
        shortest exposure.
        """
        is_base = design.log_exposure <= SAME
        cost = np.append(self._cost(design.log_exposure, design.gain), 0.0)
        saved = np.append(0.0, self._saved(design.log_exposure, design.gain)[-2:])
        cost[-2] += saved[-2] - saved[-1]  # the one before becomes the last
        total = design.parts.sum(axis=1, keepdims=True)
        rest = np.concatenate([total - design.parts, total], axis=1)
        return rest, design.time - cost, is_base.sum() - np.append(is_base, False) > 0

    def times_with(
        self, design: Design, rest_time: FloatArray, places: NDArray[np.intp]
    ) -> FloatArray:
        """Return what a set takes with an option in place of each of its frames, (P, F).

        `rest_time` is what it takes without the frame at each of `places`, of which the number of
        its frames means none.
        """
        time = rest_time[:, np.newaxis] + self.cost
        if self.costs.waiting:
            last = np.where(places == design.n - 1, design.n - 2, design.n - 1)
            at = np.where(last < 0, -np.inf, design.log_exposure[last])[:, np.newaxis]
            saved = np.where(last < 0, 0.0, self._saved(design.log_exposure, design.gain)[last])
            is_last = self.log_exposure >= at
            time -= np.where(is_last, self.saved - saved[:, np.newaxis], 0.0)
        return time


def _thinned(log_exposure: FloatArray) -> NDArray[np.intp]:
    """Return indices of all settings of a list, or of `MAX_CHOICES` evenly over ln(exposure)."""
    order = np.argsort(log_exposure, kind="stable")
    if order.size <= MAX_CHOICES:
        return order
    targets = np.linspace(0.0, float(log_exposure.max()), MAX_CHOICES)
    return np.unique(order[np.searchsorted(log_exposure[order], targets - SAME)])
