"""Random sets of exposures and random changes of them, as natural logarithms of the ratios.

Good sets fall into groups of nearly equal exposures whose levels interleave (a share of one level's
width apart), the groups a factor apart; and good factors lie beside small whole ratios, where the
levels of two exposures would coincide.  Both are drawn on purpose.
"""

from __future__ import annotations

import numpy as np

from camctl.response.camera import FloatArray

SMALLEST_STEP = 1e-5
LARGEST_STEP = 2.0


class Moves:
    """Draws for sets of n exposures of a camera with M levels, none above exp(`reach`) times."""

    def __init__(self, rng: np.random.Generator, n: int, M: int, reach: float) -> None:
        self.rng = rng
        self.n = n
        self.reach = reach
        self.interleave = 1 / (M + 1)

    def starts(self, count: int) -> FloatArray:
        """Return (count, n) ascending logarithms from 0: groups at random, or at equal factors."""
        rng, n = self.rng, self.n
        sets = np.zeros((count, n))
        for row in sets:
            groups = int(rng.integers(1, n + 1))
            sizes = 1 + np.bincount(rng.integers(0, groups, n - groups), minlength=groups)
            centres = np.sort(np.append(0.0, rng.uniform(0, 0.9 * self.reach, groups - 1)))
            if groups > 1 and rng.random() < 0.5:
                least = min(0.3, self.reach / groups)
                centres = np.arange(groups) * rng.uniform(least, self.reach / (groups - 1))
            steps = self.interleave * rng.uniform(0.3, 1.5, groups)
            within = np.concatenate([np.arange(size) for size in sizes])
            row[:] = np.repeat(centres, sizes) + within * np.repeat(steps, sizes)
        sets.sort(axis=1)
        return self.inside(sets)

    def inside(self, sets: FloatArray) -> FloatArray:
        """Return the sets ascending, from 0, within reach."""
        sets = np.minimum(np.abs(sets), self.reach)
        sets[..., 0] = 0.0
        sets.sort(axis=-1)
        return sets

    def around(self, sets: FloatArray, count: int) -> FloatArray:
        """Return (P, count, n) changed copies of (P, n) sets.

        Half move one exposure, others a block of neighbours or all above one, by steps of every
        size; some put a factor beside a small whole ratio; some take one exposure elsewhere.
        """
        rng, n = self.rng, self.n
        shape = (len(sets), count)
        step = np.exp(rng.uniform(np.log(SMALLEST_STEP), np.log(LARGEST_STEP), shape))
        step *= rng.standard_normal(shape)
        one, other = rng.integers(1, n, shape), rng.integers(1, n, shape)
        kind = rng.random(shape)
        other = np.where(kind < 0.5, one, other)
        first, last = np.minimum(one, other), np.maximum(one, other)
        last = np.where(rng.random(shape) < 0.2, n - 1, last)
        rational = rng.random(shape) < 0.35
        step = np.where(rational, self._to_a_whole_ratio(sets, first), step)
        index = np.arange(n)
        block = (index >= first[..., np.newaxis]) & (index <= last[..., np.newaxis])
        changed = sets[:, np.newaxis, :] + block * step[..., np.newaxis]
        elsewhere = (kind > 0.88) & ~rational
        beside = np.take_along_axis(sets, rng.integers(0, n, shape), axis=1)
        beside = beside + rng.uniform(-2, 2, shape) * self.interleave
        place = np.where(rng.random(shape) < 0.5, beside, rng.uniform(0, self.reach, shape))
        taken = elsewhere[..., np.newaxis] & (index == one[..., np.newaxis])
        return self.inside(np.where(taken, place[..., np.newaxis], changed))

    def _to_a_whole_ratio(self, sets: FloatArray, index: np.ndarray) -> FloatArray:
        """Return the step that puts an exposure at a/q (1 + small) times the one below it."""
        rng, shape = self.rng, index.shape
        below = np.take_along_axis(sets, index - 1, axis=1)
        here = np.take_along_axis(sets, index, axis=1)
        q = rng.integers(1, 3, shape)
        a = np.maximum(q, np.round(np.exp(here - below) * q) + rng.integers(-2, 3, shape))
        small = 10 ** rng.uniform(-5, -1.5, shape) * rng.choice([-1, 1], shape)
        return np.asarray(below + np.log(a / q) + small - here)
