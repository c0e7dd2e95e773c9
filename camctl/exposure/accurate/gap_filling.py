"""Improves sets for cameras without noise: exchanges exposures for those that fill gaps better.

The mean square error of a set is proportional to the sum of g^3 over the gaps g in brightness u
between its levels.  A level that divides a gap into a and g - a lowers the sum by 3 a g (g - a).
Over ln E, the levels of an exposure e are those of the shortest one shifted by -ln e, so that what
one more exposure would lower the sum by is, for all e at once, a cross-correlation: transforms
compute it.  It takes no account of levels that divide the same gap; the best e are rated exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from camctl.exposure.candidates import CACHE_ELEMENTS
from camctl.exposure.exposure_choices import SAME, TimeCosts
from camctl.model.convolution import even_length
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse, LogDesired

EXCHANGED = 3
"""Exposures that are exchanged at once, at most."""

RATED = 12
"""Exposures of those that fill the gaps best that are rated exactly."""

NEAR = 1.03
"""Factor on the least error up to which an exchanged set is settled."""

STEPS = 4
"""Steps of Newton's method for each such set."""

COARSE, FEWEST = 5, 4096
"""Step of the exposures that are compared, in mean gaps of ln E between the levels of a set near
full scale; and how many values are transformed at least, which takes 20 us.  With 3 mean gaps
14 problems have 0.3 % fewer levels within a time and take 8 % more time to plan, with 8 they have
0.6 % fewer and take 3 % less."""

MOVES = 3 ** np.arange(5.0)
"""Steps of the camera's times by which an exposure is moved: with both signs, powers of three add
up to every number.  Twelve moves up to 192 take 1.7 times as long for 0.25 % more levels (60 sets
of random cameras)."""

LEAST_GAIN = 1e-6
"""Relative gain in the error from which an exposure is moved."""

SCALINGS, SCALED = 8, 1e-9
"""Steps by which sets are scaled to a time, at most, from a thousand times it; and by what share
they may take more."""

_FRAME_BITS = 6
"""Lowest bits of a level that hold the number of its exposure: a relative change of 1e-14."""

_RIDGE = 1e-6
"""Share of the mean curvature that is added, so that exposures without levels in range stay."""


@dataclass(frozen=True)
class TimeLimit:
    """The time that sets may take, without their fixed time.

    Sets are natural logarithms of ascending exposures (B, n), relative to the shortest.

    Attributes:
        limit: longest time of a set
        costs: what is counted as time
        unit: shutter time of the shortest exposure
    """

    limit: float
    costs: TimeCosts
    unit: float

    def total(self, sets: FloatArray) -> FloatArray:
        """Return the time of each set, (B,)."""
        times = np.exp(sets) * self.unit
        return np.asarray(self.costs.each(times).sum(axis=1) - self.costs.saved(times[:, -1]))

    def slopes(self, sets: FloatArray) -> FloatArray:
        """Return the derivatives of the time by each ln(exposure), (B, n)."""
        times = np.exp(sets) * self.unit
        slopes = np.where(times > self.costs.least, times, 0.0)
        slopes[:, -1] *= 1 - self.costs.waiting / self.costs.factor
        return np.asarray(slopes * self.costs.factor)

    def scaled(self, sets: FloatArray) -> FloatArray:
        """Return the sets, scaled towards 0 until they take `limit` at most."""
        over = np.flatnonzero(self.total(sets) > self.limit)
        rows, factor = sets[over], np.ones(over.size)
        # ln(time) is a convex function of the factor: Newton's steps approach its root from above.
        for _ in range(SCALINGS):
            scaled = rows * factor[:, np.newaxis]
            time = self.total(scaled)
            excess = time * np.log(np.maximum(time / self.limit, 1.0))
            if not np.any(excess > SCALED * time):
                break
            slope = (rows * self.slopes(scaled)).sum(axis=1)
            factor = np.maximum(factor - excess / np.maximum(slope, 1e-300), 0.0)
        found = sets.copy()
        found[over] = rows * factor[:, np.newaxis]
        return found


@dataclass
class GapFilling:
    """Exchanges exposures of sets for a camera without noise.

    Attributes:
        response: of the camera
        desired: the desired response
        within: the time that sets may take
        reach: largest ln(exposure)
        counts: fewest and most exposures of a set
    """

    response: CameraResponse
    desired: DesiredResponse
    within: TimeLimit
    reach: float
    counts: tuple[int, int]

    @cached_property
    def _log_levels(self) -> FloatArray:
        return np.log(np.maximum(self.response.levels, 1e-300))

    @cached_property
    def _is_log(self) -> bool:
        return isinstance(self.desired, LogDesired)

    @cached_property
    def darkest(self) -> float:
        """ln(E) of the darkest light of the range; where it has no end, of what a set can show."""
        if self.desired.e_min:
            return math.log(self.desired.e_min)
        return float(self._log_levels[self.response.levels > 0][0]) - self.reach

    def error(self, row: FloatArray) -> float:
        """Return the sum of g^3 of one set (n,)."""
        return _Gaps(self, row).error

    def u(self, log_light: FloatArray) -> FloatArray:
        """Return u at ln(E), clamped to 0..1."""
        if self._is_log:
            u = log_light * (-1 / self.darkest)
            u += 1.0
            np.maximum(u, 0.0, out=u)
            return np.asarray(np.minimum(u, 1.0, out=u))
        return self.desired.u(np.exp(np.minimum(log_light, 0.0)))

    def log_light(self, sets: FloatArray) -> FloatArray:
        """Return ln(E) at the levels of sets (..., n), ascending, (..., n M)."""
        light = self._log_levels - sets[..., np.newaxis]
        light = light.reshape(*sets.shape[:-1], -1)
        if sets.shape[-1] > 1:
            light.sort(axis=-1, kind="stable")  # merges sorted runs
        return light

    def improved(
        self, row: FloatArray, exchanges: int, rng: np.random.Generator
    ) -> tuple[FloatArray, float]:
        """Return a set (n,) with exposures exchanged, possibly of another length, and its error."""
        places = _Places(self, row.size)
        error = self.error(row)
        for _ in range(exchanges):
            trial, found = self._exchanged(row, places, rng)
            if found > NEAR * error:
                continue
            trial, found = self.settled(trial, error)
            if found < error:
                row, error = trial, found
        return row, error

    def _exchanged(
        self, row: FloatArray, places: _Places, rng: np.random.Generator
    ) -> tuple[FloatArray, float]:
        """Return a set with some exposures taken out and about as many put in, and its error.

        The error is infinite where none of them fit.
        """
        n, (fewest, most) = row.size, self.counts
        first = int(rng.integers(1, n))
        out = rng.permutation(np.arange(1, n)) if rng.random() < 0.5 else np.arange(first, n)
        out = out[: int(rng.integers(1, EXCHANGED + 1))]
        left = n - out.size
        more = rng.choice([-1, 0, 0, 0, 1])
        inserted = min(max(out.size + more, max(2, fewest) - left), most - left)
        trial, error = np.delete(row, out), math.inf
        if not inserted:
            return trial, self.error(trial)
        for missing in range(inserted - 1, -1, -1):
            trials, errors = places.filled(trial, missing)
            if not len(trials):
                return trial, math.inf
            place = int(rng.integers(len(trials)))
            if missing and rng.random() < 0.5:
                trial = trials[place]
                continue
            rated = errors()
            place = int(np.argmin(rated))
            trial, error = trials[place], float(rated[place])
        return trial, error

    def settled(self, row: FloatArray, least: float = 0.0) -> tuple[FloatArray, float]:
        """Return a set (n,) after steps of Newton's method within the time, and its error.

        They end where as much for each one that is left would not lower the error to `least`.
        """
        error, slope, curvature = self._derivatives(row)
        length = 1.0
        for left in range(STEPS - 1, -1, -1):
            step = length * self._step(row, slope, curvature)
            trial = np.clip(row + step, 0.0, self.reach)
            trial = self.within.scaled(np.sort(trial)[np.newaxis])[0]
            found, *derivatives = self._derivatives(trial)
            gain = max(0.0, error - found)
            if found < error:
                row, error, (slope, curvature) = trial, found, derivatives
                length = min(1.0, 1.5 * length)
            else:
                length /= 3
            if error - left * gain > least > 0:
                break
        return row, error

    def rounded(self, row: FloatArray, step: float) -> FloatArray:
        """Return a set (n,) in whole steps of the exposure, down where it else takes too long.

        Args:
            row: natural logarithms of ascending exposures
            step: distance of two exposures, relative to the shortest
        """
        return np.log1p(self._numbers(row, step) * step)

    def _numbers(self, row: FloatArray, step: float) -> FloatArray:
        """Return the numbers of steps of `rounded`, (n,)."""
        longest = math.floor(math.expm1(self.reach) / step * (1 + SAME))
        number = np.minimum(np.round(np.expm1(row) / step), longest)
        if self.within.total(np.log1p(number * step)[np.newaxis])[0] > self.within.limit:
            number = np.floor(np.expm1(row) / step + SAME)
        return np.asarray(number)

    def stepped(self, row: FloatArray, step: float, most: int) -> FloatArray:
        """Return a set (n,) in whole steps of the exposure, of little error among its neighbours.

        One exposure after the other is moved by a few steps, for as long as that lowers the error.

        Args:
            row: natural logarithms of ascending exposures
            step: distance of two exposures, relative to the shortest
            most: levels that are placed and sorted for this, at most
        """
        number, moves = self._numbers(row, step), np.concatenate([-MOVES, MOVES])
        left = most // self.response.M
        error, since, place = self.error(np.log1p(number * step)), 0, 0
        while since < row.size - 1 and left > 0:
            place = place % (row.size - 1) + 1
            trials, errors = self._moved(number, place, moves, step)
            left, since = left - len(trials) - row.size, since + 1
            if len(errors) and errors.min() < error * (1 - LEAST_GAIN):
                error, number, since = float(errors.min()), trials[errors.argmin()], 0
        return np.log1p(number * step)

    def _moved(
        self, number: FloatArray, place: int, moves: FloatArray, step: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return sets in whole steps with one exposure moved, those within time and reach (B, n).

        And their errors, (B,).  What a set takes too long is taken from its longest exposure.
        """
        others, moved = np.delete(number, place), number[place] + moves
        moved = moved[moved >= 0]
        pairs = np.sort(np.column_stack([moved, np.full(moved.size, others[-1])]), axis=1)
        rest = np.broadcast_to(others[:-1], (moved.size, others.size - 1))
        within, costs = self.within, self.within.costs
        over = within.total(np.log1p(np.column_stack([rest, pairs]) * step)) - within.limit
        each = step * within.unit * (costs.factor - costs.waiting)
        pairs[:, 1] -= np.ceil(np.maximum(over, 0.0) / each - SAME)
        sets = np.log1p(np.maximum(np.column_stack([rest, pairs]), 0.0) * step)
        fits = (pairs[:, 1] >= np.maximum(pairs[:, 0], others[-2:-1].max(initial=0.0))) & (
            sets[:, -1] <= self.reach
        )
        fits &= within.total(sets) <= within.limit
        changed = np.log1p(pairs[fits] * step)
        errors = _Gaps(self, np.log1p(others[:-1] * step)).errors_with(changed)
        return np.sort(np.column_stack([rest, pairs])[fits], axis=1), errors

    def _step(self, row: FloatArray, slope: FloatArray, curvature: FloatArray) -> FloatArray:
        """Return Newton's step; the shortest exposure stays, and so does a time at its limit."""
        n = row.size
        scale = max(float(np.trace(curvature)) / n, 1e-300)
        system = np.eye(n) * _RIDGE
        system[1:, 1:] += curvature[1:, 1:] / scale
        # The row of the shortest exposure, which does not move, holds the constraint of the time.
        system[0, 0] = 1.0
        costs = self.within.slopes(row[np.newaxis])[0, 1:]
        size = float(np.linalg.norm(costs))
        if size and self.within.total(row[np.newaxis])[0] >= self.within.limit * (1 - 1e-6):
            system[0, 1:] = system[1:, 0] = costs / size
            system[0, 0] = 0.0
        right = np.append(0.0, -slope[1:] / scale)
        return np.append(0.0, np.linalg.solve(system, right)[1:])

    def _derivatives(self, row: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the error of a set (n,), its derivatives (n,), and their own (n, n).

        A change of u's slope within a gap is left out of the latter.
        """
        n = row.size
        light = self._log_levels - row[:, np.newaxis]
        bits = light.view(np.int64)
        bits &= -1 << _FRAME_BITS
        bits |= np.arange(n)[:, np.newaxis]
        light = light.ravel()
        light.sort(kind="stable")  # merges sorted runs
        first, last = light.searchsorted((self.darkest, 0.0))
        light = light[first:last]
        frame = light.view(np.int64) & ((1 << _FRAME_BITS) - 1)
        u = self.u(light)
        if self._is_log:
            moved = np.full(u.size, -1 / self.darkest)
        else:
            light = np.exp(light)
            moved = self.desired.slope(light) * light
        edges = np.concatenate([[0.0], u, [1.0]])
        gaps = edges[1:] - edges[:-1]
        squares = gaps * gaps
        slope = 3 * moved * (squares[1:] - squares[:-1])
        own = 6 * moved * moved * (gaps[1:] + gaps[:-1])
        shared = -6 * gaps[1:-1] * moved[1:] * moved[:-1]
        pairs = np.bincount(frame[1:] * n + frame[:-1], weights=shared, minlength=n * n)
        curvature = pairs.reshape(n, n)
        curvature = curvature + curvature.T
        curvature[np.diag_indices(n)] += np.bincount(frame, weights=own, minlength=n)
        slopes = np.bincount(frame, weights=slope, minlength=n)
        return float(squares @ gaps), slopes.astype(np.float64), curvature.astype(np.float64)


class _Places:
    """Where one more exposure fills the gaps of a set best."""

    def __init__(self, filling: GapFilling, n: int) -> None:
        self._filling = filling
        levels = filling.response.levels
        span = -filling.darkest
        # Near full scale, n exposures have n M levels for each 1 of ln E.
        step = COARSE / (n * filling.response.M)
        self._length = max(FEWEST, even_length(math.ceil((span + filling.reach) / step) + 2))
        self._step = (span + filling.reach) / (self._length - 2)
        self._lowest = -span
        places = np.arange(round(span / self._step) + 1, dtype=np.float64)
        self._u = filling.u(self._lowest + self._step * places).astype(np.float32)
        at = (np.log(levels[levels > 0]) + span) / self._step
        at = at[at >= 0]
        below = np.floor(at).astype(np.intp)
        comb = np.bincount(below, weights=below + 1 - at, minlength=self._length)
        comb += np.bincount(below + 1, weights=at - below, minlength=self._length)
        self._comb = np.fft.rfft(comb.astype(np.float32))
        self._exposures = self._step * np.arange(int(filling.reach / self._step) + 1.0)
        within = filling.within
        self._costs = within.costs.each(np.exp(self._exposures) * within.unit)

    def filled(self, row: FloatArray, missing: int) -> tuple[FloatArray, Callable[[], FloatArray]]:
        """Return sets (B, n + 1) with one more exposure, and what computes their errors (B,).

        B is up to `RATED`; they are those within the time alone.

        Args:
            row: (n,) set
            missing: further exposures that are to follow
        """
        within = self._filling.within
        left = within.limit - float(within.total(row[np.newaxis])[0]) - missing * self._costs[0]
        gaps = _Gaps(self._filling, row)
        lowered = self._lowered(gaps)[: self._exposures.size]
        middle = lowered[1:-1]
        peaks = (middle > lowered[:-2]) & (middle >= lowered[2:]) & (self._costs[1:-1] <= left)
        best = np.flatnonzero(peaks) + 1
        best = best[np.argsort(-lowered[best])[:RATED]]
        more = self._exposures[best][:, np.newaxis]
        sets = np.column_stack([np.broadcast_to(row, (best.size, row.size)), more])
        sets.sort(axis=1)
        fits = within.total(sets) <= within.limit
        return sets[fits], partial(gaps.errors_with, more[fits])

    def _lowered(self, gaps: _Gaps) -> FloatArray:
        """Return what one more exposure lowers the error by, for each of `_exposures`."""
        first = np.ceil((gaps.log_light - self._lowest) / self._step).astype(np.intp)
        ends = np.concatenate([[0], first, [self._u.size]])
        count, u = ends[1:] - ends[:-1], gaps.u.astype(np.float32)
        gap = (u[1:] - u[:-1]).repeat(count)
        above = self._u - u[:-1].repeat(count)
        fall = 3 * above * (gap - above) * gap
        # From float32 numpy's rfft takes 1.6 times as long as from float64; its irfft takes half.
        transform = np.fft.rfft(fall.astype(np.float64), self._length).astype(np.complex64)
        return np.asarray(np.fft.irfft(self._comb * transform.conj(), self._length))


class _Gaps:
    """The gaps in u between the levels of a set (n,), and what levels that divide them change.

    Attributes:
        log_light: ln(E) at the levels within the range, ascending
        u: brightness at them, and 0 and 1 at the ends
        error: sum of the g^3
    """

    def __init__(self, filling: GapFilling, row: FloatArray) -> None:
        self._filling = filling
        light = filling.log_light(row)
        first, last = light.searchsorted((filling.darkest, 0.0))
        self.log_light = light[first:last]
        self.u = np.concatenate([[0.0], filling.u(self.log_light), [1.0]])
        gaps = self.u[1:] - self.u[:-1]
        self.error = float((gaps * gaps) @ gaps)

    def errors_with(self, more: FloatArray) -> FloatArray:
        """Return the error with further exposures (B, k), their logarithms, (B,)."""
        size = max(1, CACHE_ELEMENTS // (more.shape[1] * self._filling.response.M))
        parts = [self._errors_with(more[k : k + size]) for k in range(0, len(more), size)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _errors_with(self, more: FloatArray) -> FloatArray:
        added = self._filling.u(self._filling.log_light(more))
        gap = self.u.searchsorted(added.ravel(), side="right").reshape(added.shape)
        np.minimum(gap, self.u.size - 1, out=gap)
        above, below = self.u[gap], self.u[gap - 1]
        np.maximum(below[:, 1:], added[:, :-1], out=below[:, 1:])
        divided = above - below
        divided *= np.subtract(added, below, out=below)
        above -= added
        return np.asarray(self.error - 3 * np.einsum("ij,ij->i", divided, above))
