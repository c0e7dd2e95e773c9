"""Random sets of exposures for a camera, and random changes of sets, in steps of its own levels."""

from __future__ import annotations

import numpy as np

from camctl.model.response.camera import CameraResponse, FloatArray

SMALLEST_MOVE, LARGEST_MOVE = 1e-5, 2.0
"""Scales of the random moves, in ln e: far below an 8-bit interleave (4e-3) up to a factor of 7."""

SIMILAR_STEPS = 0.25
"""Relative difference up to which a camera's interleave step equals a linear camera's."""

LEAST_LEVELS = 15
"""A camera of fewer levels counts as linear: they are too few to show a step."""


def interleave_step(response: CameraResponse) -> float:
    """Return the step in ln(exposure) that shifts levels by about one gap near full scale.

    It is the median relative gap of the top eighth of the levels.  For a linear camera of M levels
    that is about 1/(M + 1), which is returned where the two differ by less than
    `SIMILAR_STEPS`: random steps are drawn from 0.3 to 1.5 times it.
    """
    linear = 1 / (response.M + 1)
    levels = np.unique(response.levels)
    if levels.size < LEAST_LEVELS:
        return linear
    step = _relative_gap(levels, levels.size - max(2, levels.size // 8))
    return linear if abs(step / linear - 1) < SIMILAR_STEPS else step


def _relative_gap(levels: FloatArray, first: int) -> float:
    """Return the median relative gap of an eighth of 15 or more ascending levels."""
    part = levels[first : first + max(2, levels.size // 8)]
    return float(np.median(np.diff(part) / part[:-1]))


class RandomSets:
    """Random sets of n exposures for a camera, and random changes of sets.

    Sets are natural logarithms of the exposures, at most `reach`.  Good sets consist of groups of
    nearly equal exposures whose levels interleave, the groups a factor apart; and good factors lie
    close to ratios of small whole numbers, at which the levels of two exposures would coincide.
    Both kinds are drawn deliberately.

    Attributes:
        interleave: step in ln(exposure) that shifts levels by about one gap near full scale
        is_curved: whether this is not the step of a linear camera
    """

    def __init__(
        self, rng: np.random.Generator, n: int, response: CameraResponse, reach: float
    ) -> None:
        self.rng = rng
        self.n = n
        self.reach = reach
        self.interleave = interleave_step(response)
        self.is_curved = self.interleave != 1 / (response.M + 1)
        self._widest = 1.0
        if self.is_curved:
            levels = np.unique(response.levels)
            self._widest = max(1.0, _relative_gap(levels, levels.size // 4) / self.interleave)

    def starts(self, count: int) -> FloatArray:
        """Return (count, n) ascending sets from 0: groups at random, or at equal factors."""
        rng, n = self.rng, self.n
        sets = np.zeros((count, n))
        for row in sets:
            groups = int(rng.integers(1, n + 1))
            sizes = 1 + np.bincount(rng.integers(0, groups, n - groups), minlength=groups)
            centres = np.sort(np.append(0.0, rng.uniform(0, 0.9 * self.reach, groups - 1)))
            if groups > 1 and rng.random() < 0.5:
                least = min(0.3, self.reach / groups)
                centres = np.arange(groups) * rng.uniform(least, self.reach / (groups - 1))
            steps = self.interleave * rng.uniform(0.3, 1.5, groups) * self._widening(groups)
            within = np.concatenate([np.arange(size) for size in sizes])
            row[:] = np.repeat(centres, sizes) + within * np.repeat(steps, sizes)
        sets.sort(axis=1)
        return self.normalised(sets)

    def even(self, count: int) -> FloatArray:
        """Return (count, n) sets of equal factors, whose largest exposures go up to the reach."""
        ends = self.reach * np.arange(1, count + 1) / count
        return ends[:, np.newaxis] * np.linspace(0.0, 1.0, self.n)

    def normalised(self, sets: FloatArray) -> FloatArray:
        """Return the sets ascending, from 0, within reach."""
        sets = np.minimum(np.abs(sets), self.reach)
        sets[..., 0] = 0.0
        sets.sort(axis=-1)
        return sets

    def around(self, sets: FloatArray, count: int) -> FloatArray:
        """Return (P, count, n) changed copies of (P, n) sets.

        Half of them move one exposure, the others a block of neighbours or all above one, by steps
        of every size; some place a factor close to a ratio of small whole numbers; some place one
        exposure anywhere.
        """
        rng, n = self.rng, self.n
        shape = (len(sets), count)
        step = np.exp(rng.uniform(np.log(SMALLEST_MOVE), np.log(LARGEST_MOVE), shape))
        step *= rng.standard_normal(shape)
        one, other = rng.integers(1, n, shape), rng.integers(1, n, shape)
        kind = rng.random(shape)
        other = np.where(kind < 0.5, one, other)
        first, last = np.minimum(one, other), np.maximum(one, other)
        last = np.where(rng.random(shape) < 0.2, n - 1, last)
        rational = rng.random(shape) < 0.35
        step = np.where(rational, self._step_to_whole_ratio(sets, first), step)
        index = np.arange(n)
        block = (index >= first[..., np.newaxis]) & (index <= last[..., np.newaxis])
        changed = sets[:, np.newaxis, :] + block * step[..., np.newaxis]
        elsewhere = (kind > 0.88) & ~rational
        beside = np.take_along_axis(sets, rng.integers(0, n, shape), axis=1)
        beside = beside + rng.uniform(-2, 2, shape) * self.interleave * self._widening(shape)
        position = np.where(rng.random(shape) < 0.5, beside, rng.uniform(0, self.reach, shape))
        replaced = elsewhere[..., np.newaxis] & (index == one[..., np.newaxis])
        return self.normalised(np.where(replaced, position[..., np.newaxis], changed))

    def _widening(self, shape: int | tuple[int, ...]) -> FloatArray | float:
        """Return factors on the interleave step of a curved camera, whose gaps differ."""
        return self._widest ** self.rng.random(shape) if self.is_curved else 1.0

    def _step_to_whole_ratio(self, sets: FloatArray, index: np.ndarray) -> FloatArray:
        """Return the step that makes an exposure a/q (1 + small) times the one below it."""
        rng, shape = self.rng, index.shape
        below = np.take_along_axis(sets, index - 1, axis=1)
        current = np.take_along_axis(sets, index, axis=1)
        q = rng.integers(1, 3, shape)
        a = np.maximum(q, np.round(np.exp(current - below) * q) + rng.integers(-2, 3, shape))
        small = 10 ** rng.uniform(-5, -1.5, shape) * rng.choice([-1, 1], shape)
        return np.asarray(below + np.log(a / q) + small - current)
