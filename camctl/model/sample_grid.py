"""The grid of samples that were quantised in larger steps than 1.

Many cameras and drivers deliver 10 or 12 bits in 16, shifted to the left: all samples are multiples
of 64 or 16.  Their quantiser has that step, whatever the type of the samples is: what is computed
from codes, the samples in units of the step, has its rounding error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import CameraResponse, phase_of_black
from camctl.system.picture_operations import looked_up

#: Different values that show a step.  The probability that k values by chance have a common one is
#: the sum of n^(1 - k) over all n > 1: 0.0083 for 8, and 0.017 for 7, which is not significant.
_FEWEST_VALUES = 8

#: Samples that are looked at first, and then twice as many each time: few of them decide, if the
#: step is 1.
_FIRST = 1 << 10


@dataclass(frozen=True)
class SampleGrid:
    """The values that samples have: `first` + `step` k, k = 0, 1, ...

    Attributes:
        step: of the quantiser, DN; 1: samples have all values
        first: the lowest value, DN
        white: brightness from which samples are saturated, DN
    """

    step: int
    first: int
    white: int

    @classmethod
    def of(cls, frames: Iterable[NDArray[Any]], white: int, black: int = 0) -> SampleGrid:
        """Return the grid of the samples of all frames.

        Samples that are cut off, at 0 or from white on, need not lie on it.  What is not above
        black does not show it.
        """
        fine, seen = cls(1, 0, white), np.zeros(1 << 16, np.bool_)
        step, values = 0, np.zeros(0, np.intp)
        for frame in frames:
            size, start, samples = _FIRST, 0, frame.reshape(-1)
            while start < samples.size:
                seen[samples[start : start + size]] = True
                start, size = start + size, 2 * size
                values = np.flatnonzero(seen[1:white]) + 1
                step = int(np.gcd.reduce(np.diff(values))) if values.size > 1 else 0
                if step == 1:
                    return fine
        if np.count_nonzero(values > black) < _FEWEST_VALUES:
            return fine
        return cls(step, int(values[0]) % step, white)

    def code(self, level: float) -> int:
        """Return the code of the highest value that is not above a brightness."""
        return max(0, math.floor((level - self.first) / self.step))

    def bits(self, bits: int) -> int:
        """Return how many bits the codes of samples of so many have."""
        return self.code(2**bits - 1).bit_length()

    def nearest(self, level: float) -> int:
        """Return the code of the value that is nearest to a brightness."""
        return self.code(level + self.step / 2)

    def level(self, code: int) -> int:
        """Return the brightness of a code, DN."""
        return self.first + self.step * code

    def codes(self, frame: NDArray[Any]) -> NDArray[Any]:
        """Return the codes of samples, at most that of white; with step 1 the frame as it is."""
        if self.step == 1:
            return frame
        values = np.arange(np.iinfo(frame.dtype).max + 1)
        codes = np.clip((values - self.first) // self.step, 0, self.code(self.white))
        return looked_up(codes.astype(np.min_scalar_type(self.code(self.white))), frame)

    def light_scale(self, black: int) -> float:
        """Return the light of `response` over that of the response that it is of.

        Full scale, a step above white, is 1 in both.
        """
        steps = self.code(self.white) - self.nearest(black) + 1
        return (self.white - black + 1) / (self.step * steps)

    def response(self, real: CameraResponse, black: int) -> CameraResponse:
        """Return the response as the levels of codes; its unit of light is another one.

        A value is reached at its own level, and of samples that are right in the mean less black,
        in the middle between the value below and it.

        Args:
            real: as levels of brightness, white - black of them
            black: brightness without light, DN
        """
        if self.step == 1:
            return real
        values = self.first + self.step * np.arange(
            self.nearest(black) + 1, self.code(self.white) + 1
        )
        places = values - black - 1 - (self.step - 1) * phase_of_black(black)
        levels = np.interp(places, np.arange(real.M), real.levels) * self.light_scale(black)
        deviation = None if real.deviation is None else real.deviation[np.int_(np.ceil(places))]
        name = f"{real.name}, steps of {self.step}"
        return replace(real, levels=levels, name=name, deviation=deviation)
