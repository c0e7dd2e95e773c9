"""The estimate of accuracy where a set shows nothing of the darkest light.

Below the light at which the first frame leaves its lowest level, the sum is the least that there
is, and one value stands for all of these irradiances.  Where noise does not dither the quantiser,
this zone ends abruptly, and the estimate, which averages over the phases of the quantiser, does not
see where.  The logarithm of the probability that a frame is at its lowest level adds up over the
frames, as what they contribute does: the least sum counts by the variance of u that it leaves,
exactly, and all others as they are estimated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.accurate.estimate import EDGES, NODES, FrameAccuracy
from camctl.exposure.exposure_choices import AccuracyProblem
from camctl.exposure.noise import DITHERS
from camctl.model.distribution import NORMAL_REACH, deviation, normal_cdf, quantiser_input
from camctl.model.response.camera import FloatArray

ZONE_NODES = 24
"""Steps of u over which the darkest zone is averaged.  Where those of the estimate are as short
(log 1:1,000), the zone changes nothing: the sets that are found differ by less than 0.1 %."""

_LEAST = 1e-30
"""Probabilities, and noise in levels, that are less count as this much."""


def frame_accuracy(problem: AccuracyProblem) -> FrameAccuracy:
    """Return what frames of a camera contribute, with the darkest zone where it is to be seen."""
    end = _zone_end(problem)
    if not 0 < end < ZONE_NODES / NODES:
        return FrameAccuracy(problem)
    return ZoneAccuracy(
        problem, np.append(np.linspace(0.0, end, ZONE_NODES + 1), EDGES[end < EDGES])
    )


def _zone_end(problem: AccuracyProblem) -> float:
    """Return the u up to which the shortest exposure may be at its lowest level.

    0: noise dithers the quantiser there, or there is none.
    """
    noise = problem.noise.frame(gain=min(problem.available.gains), time_s=0.0)
    dark = deviation(problem.response, np.zeros(1), noise)
    if problem.noise.is_none or dark[0] >= DITHERS:
        return 0.0
    E = problem.desired.inverse(EDGES)
    above = quantiser_input(problem.response, E) - (1 - problem.black)
    is_left = above >= NORMAL_REACH * deviation(problem.response, E, noise)
    return float(EDGES[is_left.argmax()])


class ZoneAccuracy(FrameAccuracy):
    """What frames contribute to the accuracy of a sum, and to the zone of its least value.

    The first `ZONE_NODES` of its steps are those of the zone.
    """

    def _more_rows(self, signal: FloatArray, noise: FloatArray) -> list[FloatArray]:
        """Return the logarithm of the probability of the lowest level."""
        first = 1 - self.problem.black
        lowest = normal_cdf((first - signal) / np.maximum(noise, _LEAST))
        return [np.log(np.maximum(lowest, _LEAST))]

    def mse(self, parts: NDArray[np.floating[Any]], step: int = 1) -> FloatArray:
        """Return the mean square error in u of summed parts, (...) from (4, ..., NODES)."""
        share, u = self.share[::step] / self.share[::step].sum(), self.u[::step]
        errors, count = self.errors(parts[:3], step), -(-ZONE_NODES // step)
        lowest = np.exp(parts[3, ..., :count].astype(np.float64)) * share[:count]
        moments = lowest @ (u[:count, np.newaxis] ** np.arange(3))
        known, mean, square = np.moveaxis(moments, -1, 0)
        left = np.maximum(square - mean**2 / np.maximum(known, _LEAST), 0.0)
        seen = errors @ share.astype(errors.dtype) - np.sum(lowest * errors[..., :count], axis=-1)
        return np.asarray(seen + left + self.fixed, dtype=np.float64)

    def derivatives(
        self, total: FloatArray, one: FloatArray, two: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return gradient and Hessian of `mse`.

        The Hessian is without the products of a change of the zone and one of the other errors.
        """
        lowest = np.exp(total[3]) * self.share
        known = max(float(lowest.sum()), _LEAST)
        from_mean = self.u - float(lowest @ self.u) / known
        gradient, hessian = super().derivatives(total, one, two)
        rate = lowest * (from_mean**2 - self.errors(total[:3]))
        moved = one[3] @ (lowest * from_mean)
        gradient += one[3] @ rate
        hessian += (one[3] * rate) @ one[3].T + np.diag(two[3] @ rate)
        return gradient, hessian - 2 / known * np.outer(moved, moved)
