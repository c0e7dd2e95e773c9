"""A frame's exposure compared with its neighbour's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from statistics import NormalDist

from pydantic import BaseModel, ConfigDict


class ReportModel(BaseModel):
    """A part of a report, which has no unknown fields."""

    model_config = ConfigDict(extra="forbid", defer_build=True)


SIGNIFICANCE = 0.01
"""Probability that noise alone makes a capture a finding of one kind, at most: it is divided over
the tests of a capture (Bonferroni)."""

MOST = 0.5
"""Share that is most: of a picture, and of the compared samples that changed by one ratio where an
exposure is wrong; with fewer, only parts of the picture disagree."""

#: Relative depth of the flicker of sodium and fluorescent lamps.  They change the whole picture, as
#: a wrong exposure does.
LAMP_DEPTH = 0.4

SMALL_THING = 0.02
"""A thing that covers less of a frame's samples is small."""

#: Share of a frame's samples that must be compared before its exposure counts as contradicted.
LEAST_COMPARED = 0.1


def significant_sigmas(pairs: int) -> float:
    """Return from how many standard deviations on one of `pairs` ratios is no noise."""
    return -NormalDist().inv_cdf(SIGNIFICANCE / 2 / max(pairs, 1))


class RatioCheck(ReportModel):
    """A frame's exposure compared with its neighbour's, on pixels unsaturated in both.

    Attributes:
        expected: ratio of the applied exposures
        measured: ratio of the irradiances in the pixels; None: too few pixels to measure it
        tolerance: relative difference up to which the two agree
        agrees: False where they do not
        moved: share of the compared samples that changed by another ratio than most
        compared: share of the frame's samples that were compared
        contradicting: share of them that contradict `expected`, all brighter or all darker
        contradicts: whether most of many samples contradict it, by more than lamps can or by more
            than 10 %
    """

    expected: float
    measured: float | None
    tolerance: float
    agrees: bool
    moved: float
    compared: float = 0.0
    contradicting: float = 0.0
    contradicts: bool = False

    @property
    def factor(self) -> float:
        """Factor between measured and expected ratio, at least 1; infinite where not measured."""
        if self.measured is None:
            return math.inf
        return max(self.measured / self.expected, self.expected / self.measured)

    @property
    def may_be_lamps(self) -> bool:
        """Whether flickering lamps explain it: one frame has their most light, one the least."""
        return self.is_of_whole_picture and self.factor <= (1 + LAMP_DEPTH) / (1 - LAMP_DEPTH)

    @property
    def is_certain(self) -> bool:
        """Whether enough samples were compared."""
        return self.compared >= LEAST_COMPARED

    @property
    def is_one_ratio(self) -> bool:
        """Whether most of what was compared changed by one ratio, and it is not a small thing."""
        return self.moved <= MOST and self.compared >= SMALL_THING

    @property
    def is_of_whole_picture(self) -> bool:
        """Whether the exposures disagree, and not things that moved or light that spread.

        Then many samples were compared, and most of them changed by one ratio.
        """
        return not self.agrees and self.is_certain and self.is_one_ratio

    def shows_another_exposure(self, *, exposures_exact: bool) -> bool:
        """Return whether frames contradict each other by one ratio, or in most of the picture.

        Exposures that are not exact were compared before, so that saturated samples alone are
        things that moved.
        """
        if not self.contradicts:
            return False
        if self.is_of_whole_picture and (exposures_exact or self.measured is not None):
            return True
        return self.compared * self.contradicting > MOST


def least_errors(checks: Sequence[RatioCheck | None]) -> list[float]:
    """Return for each frame the least relative error of its exposure that its neighbours show.

    `checks[k]` compares frame k with frame k - 1.  It is infinite where no error would show.
    """
    pairs = [
        math.inf if check is None or check.measured is None else check.tolerance
        for check in (*checks, None)
    ]
    return [min(pair) for pair in pairwise(pairs)]
