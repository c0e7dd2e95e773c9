"""How well assumed exposures explain the frames of a capture: a probability, by the noise model.

The logarithms of light of two frames differ by that of their exposures, with the standard deviation
that the sensor model gives.  Beside it stands what says nothing of a frame: it was damaged, or the
scene changed, and its light is anywhere in the range of the camera's exposures.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from camctl.evidence.ratio_check import SIGNIFICANCE, RatioCheck, significant_sigmas
from camctl.interface.controls import ExposureControls

#: Compares the frames of two shots at a ratio of their exposures, the second over the first.
Compare = Callable[[int, int, float], RatioCheck]

#: Returns the standard deviation of the logarithm of the ratio of two shots by what is no noise.
Flicker = Callable[[int, int], float]

NEAR = 4
"""Darker shots that each is compared with: after more wrong ones in a row, what is known of the
shots before is not used, which loses the gain of one pair."""

#: Light is computed in single precision: no ratio is more exact, not even where there is no noise.
_LEAST_ERROR = float(np.finfo(np.float32).eps)


class Had(NamedTuple):
    """An exposure that a shot may have had.

    Attributes:
        exposure: in the unit of `ExposureSetting.exposure`; where not known over the unknown one
        is_known: False: it is a multiple of one exposure that is not known
    """

    exposure: float
    is_known: bool = True


#: What each shot may have had: one of some exposures; none where nothing is known of it.
Explanation = Sequence[Sequence[Had]]


class Explanations:
    """Scores explanations by the light of the frames.

    Args:
        controls: of the camera, whose exposures have a range
        pairs: neighbouring frames in the capture, see `significant_sigmas`
        compare: two shots, which are numbered in their order
        brightness: of a shot; those that are next to each other in it are compared, whose ratio
            is known best
    """

    def __init__(
        self,
        controls: ExposureControls,
        pairs: int,
        compare: Compare,
        brightness: Callable[[int], float],
    ) -> None:
        ranges = (controls.time_s, controls.gain, controls.f_number, controls.f_number)
        self._range = sum(math.log(each.maximum / each.minimum) for each in ranges if each)
        self._sigmas = significant_sigmas(pairs)
        self._compare, self._brightness = compare, cache(brightness)
        self._checks: dict[tuple[float, ...], RatioCheck] = {}

    def score(
        self,
        explanation: Explanation,
        limits: tuple[float, float] = (0, math.inf),
        flicker: Flicker | None = None,
    ) -> float:
        """Return the logarithm of the probability of the frames over that of any light.

        A frame that does not fit counts as a wrong one, which has a probability of its own.

        Args:
            explanation: of each shot
            limits: of the exposure that is not known
            flicker: of the light, where the explanation has one
        """
        values = list(self._values(explanation))
        if not values:
            return self._score(explanation, flicker)
        # The unknown exposure has the most probable of the values that single pairs give.
        return max(
            (
                self._score(_with_unknown(explanation, value), flicker) - gain
                for value, gain in values
                if limits[0] <= value <= limits[1]
            ),
            default=-math.inf,
        )

    def score_of_known(self, explanation: Explanation) -> float:
        """Return the score where no frame is wrong, and each has one known exposure."""
        shots = [(shot, each[0]) for shot, each in self._ordered(explanation) if each]
        return sum(
            self._fit(one, other, first, second)
            for (one, first), (other, second) in pairwise(shots)
        )

    @property
    def has_others(self) -> bool:
        """Whether the camera has more than one exposure, which frames may have wrongly."""
        return self._range > 0

    def highest(self, explanation: Explanation) -> float:
        """Return the highest score that any explanation of the same shots may have."""
        shots = [(shot, each[0]) for shot, each in self._ordered(explanation) if each]
        found = 0.0
        for (one, first), (other, second) in pairwise(shots):
            ratio = second.exposure / first.exposure
            light = self._light(one, other, ratio)
            if light is not None:
                found += self._gain(light[1])
            elif not self._check(one, other, ratio).agrees:
                return math.inf
        return found

    def _score(self, explanation: Explanation, flicker: Flicker | None) -> float:
        wrong = math.log(SIGNIFICANCE / len(explanation))
        # Shots, what they had, and the scores up to them without those of the wrong ones.
        near: deque[list[tuple[int, Had, float]]] = deque()
        skipped = 0.0  # score of the shots so far if all are wrong
        far = most = 0.0  # highest scores of the shots before those that are near, and of all
        for shot, each in self._ordered(explanation):
            after = skipped + (wrong if each else 0.0)
            found = []
            for had in each:
                scores = [
                    score + self._fit(one, shot, first, had, flicker)
                    for one, first, score in chain.from_iterable(near)
                ]
                score = max([far, *scores]) + skipped - after - math.log(len(each))
                found.append((shot, had, score))
            most = max([most, *(score for _, _, score in found)])
            near.append(found)
            if len(near) > NEAR:
                far = max([far, *(score for _, _, score in near.popleft())])
            skipped = after
        return skipped + most

    def _ordered(self, explanation: Explanation) -> list[tuple[int, Sequence[Had]]]:
        """Return the shots and what they had, from the darkest on."""
        return sorted(enumerate(explanation), key=lambda each: self._brightness(each[0]))

    def _fit(
        self, one: int, other: int, first: Had, second: Had, flicker: Flicker | None = None
    ) -> float:
        if first.is_known != second.is_known:
            return 0.0  # any ratio fits
        spread = 0.0 if flicker is None else flicker(one, other)
        return self._agreement(one, other, second.exposure / first.exposure, spread)

    def _values(self, explanation: Explanation) -> Iterator[tuple[float, float]]:
        """Yield what pairs of neighbouring shots say of the unknown exposure, and their gain."""
        shots = [(shot, had) for shot, each in self._ordered(explanation) for had in each]
        for (one, first), (other, second) in pairwise(shots):
            if first.is_known == second.is_known:
                continue
            light = self._light(one, other, second.exposure / first.exposure)
            if light is not None:
                factor = second.exposure / first.exposure / math.exp(light[0])
                value = 1 / factor if first.is_known else factor
                yield value, self._gain(light[1])

    def _agreement(self, one: int, other: int, ratio: float, spread: float) -> float:
        """Return the logarithm of the density of two frames' light over that of any light."""
        light = self._light(one, other, ratio)
        if light is not None:
            sigma = math.hypot(light[1], spread)
            return self._gain(sigma) - ((light[0] - math.log(ratio)) / sigma) ** 2 / 2
        # Saturated samples contradict a ratio although none is measured.
        check = self._check(one, other, ratio)
        contradicts = check.is_one_ratio and not check.agrees
        return -(self._sigmas**2) / 2 if contradicts else 0.0

    def _gain(self, sigma: float) -> float:
        return math.log(self._range / (sigma * math.sqrt(2 * math.pi)))

    def _light(self, one: int, other: int, ratio: float) -> tuple[float, float] | None:
        """Return the logarithm of the ratio of light and its error; None: it is not measured."""
        check = self._check(one, other, ratio)
        if check.measured is None or not check.is_one_ratio:
            return None
        error = math.log1p(check.tolerance) / self._sigmas
        return math.log(check.measured), max(error, _LEAST_ERROR)

    def _check(self, one: int, other: int, ratio: float) -> RatioCheck:
        """Return the comparison of two shots: what is measured is the same at each ratio."""
        for key in ((one, other), (one, other, round(math.log(ratio), 3))):
            if key not in self._checks:
                self._checks[key] = self._compare(one, other, ratio)
            check = self._checks[key]
            if check.measured is not None:
                break
        return check


def _with_unknown(explanation: Explanation, value: float) -> Explanation:
    """Return an explanation with a value of the unknown exposure."""
    return [
        [had if had.is_known else Had(had.exposure * value) for had in each] for each in explanation
    ]
