"""The exact prediction of the accuracy of sets of exposures, each computed once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camctl.exposure.accurate.estimate import FrameAccuracy
from camctl.exposure.exposure_choices import AccuracyProblem, Rated, Shot, Shots
from camctl.exposure.noise import noisy_effective_levels
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import every_nth_level

MAX_JUDGED_LEVELS = 2047
"""Cameras of more levels are judged by every second, fourth, ... of them, corrected by the ratio of
the estimates: within 0.3 % of the result with all of them, for two and more frames of a sensor
whose noise dithers the quantiser (12 and 14 bits, 1:256 to 1:16,000).  Of more than `JUDGED_FRAMES`
frames half as many levels are as good (40 and 64 frames of 16 bits, the same ranges)."""


JUDGED_FRAMES = 32
"""Frames of sets that are judged at once, at most, for at least `MOST_SMOOTH` sets.  What a rating
costs grows with the frames of the set, and the estimate errs less for more of them.  With the
fewest sets alone one of 36 cases has 0.53 % fewer levels; with 16 and 64 frames, 18 cases have as
many."""

MOST_LEVELS_OF_MANY = 8191
"""Levels of a camera up to which a set of more frames than that, of which few are judged, is judged
by all of them: of 14 bits and more that takes seconds."""


class Judge:
    """Rates sets of exposures by the exact distribution of their sum.

    Args:
        frames: what frames contribute by the estimate
        dithered: whether noise dithers the quantiser; if not, all levels are used
    """

    def __init__(self, frames: FrameAccuracy, *, dithered: bool) -> None:
        self._rated: dict[Shots, Rated] = {}
        self._frames, self._dithered = frames, dithered
        self._coarse: dict[int, FrameAccuracy] = {0: frames}

    @property
    def ratings(self) -> int:
        """Sets rated so far."""
        return len(self._rated)

    def __call__(self, shots: Shots) -> Rated:
        """Return the set with its effective levels, noise included."""
        if shots not in self._rated:
            time = self._frames.problem.available.costs.total([shot.time for shot in shots])
            self._rated[shots] = Rated(shots, self._levels(shots), time)
        return self._rated[shots]

    def _levels(self, shots: Shots) -> float:
        by_all, is_many = self._frames.problem, len(shots) > JUDGED_FRAMES
        if not self._dithered or (is_many and by_all.response.M <= MOST_LEVELS_OF_MANY):
            return _exact(by_all, shots)
        halvings = math.ceil(math.log2((by_all.response.M + 1) / (MAX_JUDGED_LEVELS + 1))) + is_many
        halvings = max(halvings, 0)
        if halvings not in self._coarse:
            self._coarse[halvings] = FrameAccuracy(_coarser(by_all, 2**halvings))
        coarse = self._coarse[halvings]
        levels = _exact(coarse.problem, shots)
        return levels * self.estimated(shots) / _estimate(coarse, shots) if halvings else levels

    def estimated(self, shots: Shots) -> float:
        """Return the effective levels of a set by the estimate."""
        return _estimate(self._frames, shots)


def _coarser(problem: AccuracyProblem, step: int) -> AccuracyProblem:
    """Return the problem for a camera with each `step`-th level."""
    response = every_nth_level(problem.response, step)
    finer = (problem.response.M + 1) / (response.M + 1)
    noise = replace(problem.noise, conversion_e_per_dn=problem.noise.conversion_e_per_dn * finer)
    return replace(problem, response=response, noise=noise, black=round(problem.black / finer))


def _exact(problem: AccuracyProblem, shots: Shots) -> float:
    """Return the predicted effective levels of a set."""
    camera = EffectiveCamera.of(problem.response, [shot.exposure for shot in shots])
    noise = [problem.frame_noise(shot) for shot in shots]
    return noisy_effective_levels(camera, problem.desired, noise)


def _estimate(frames: FrameAccuracy, shots: Sequence[Shot]) -> float:
    """Return the estimated effective levels of a set."""
    parts = [
        frames.parts(np.log([shot.exposure]), shot.gain, np.array([shot.time]))[:, 0]
        for shot in shots
    ]
    return float((12 * frames.mse(np.sum(parts, axis=0, dtype=np.float64))) ** -0.5)
