"""The settings that a camera has: shutter times and gains, and the exposures that they give."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError
from camctl.model.response.camera import FloatArray

MAX_SETTINGS = 200_000
"""Settings of one control, at most: bounds memory."""

MAX_PRODUCTS = 4_000_000
"""Pairs of a time and a gain, at most: 100 MB while they are sorted."""

SETTING_LIMITS = 1e-12, 1e12
"""Of a shutter time, in seconds or relative, and of a gain: no camera comes near them."""

SAME = 1e-9
"""Relative difference up to which two exposures, times, or steps of a grid are the same."""


@dataclass(frozen=True, eq=False)
class SettingsGrid:
    """The settings of a camera, and the limits on sets of them.

    Attributes:
        times: (S,) true exposure times or relative exposures, any order
        gains: gains that combine with each time
        base: smallest and largest value of the shortest exposure, in the unit of `times`
        total_limit: largest sum of the exposures, in the unit of `times`; infinite: no limit
    """

    times: ArrayLike
    gains: ArrayLike = (1.0,)
    base: tuple[float, float] | None = None
    total_limit: float = math.inf

    @cached_property
    def exposures(self) -> FloatArray:
        """The different products time x gain, (S,) float64 ascending.

        Products that agree to `SAME` count as one.

        Raises:
            UsageError: one of the lists is empty, or there are more than `MAX_PRODUCTS` pairs
            DataError: a setting is beyond `SETTING_LIMITS`
        """
        low, high = SETTING_LIMITS
        times, gains = (np.ravel(np.asarray(v, np.float64)) for v in (self.times, self.gains))
        for values in (times, gains):
            if values.size == 0:
                raise UsageError("the list of settings is empty", hint="give one setting or more")
            wrong = values[~((values >= low) & (values <= high))]
            if wrong.size:
                raise DataError(f"invalid setting {wrong[0]:g}: expected {low:g} to {high:g}")
        if times.size * gains.size > MAX_PRODUCTS:
            raise UsageError(
                f"too many pairs of a time and a gain ({times.size * gains.size:,}): expected at "
                f"most {MAX_PRODUCTS:,}",
                hint="give fewer times or fewer gains",
            )
        products = np.sort((times[:, np.newaxis] * gains).ravel())
        new = np.concatenate([[True], np.diff(np.log(products)) > SAME])
        return np.asarray(products[new])


def stepped(minimum: float, maximum: float, step: float) -> FloatArray:
    """Return the settings from `minimum` to `maximum` in equal steps, (S,) float64 ascending.

    Raises:
        UsageError: the values are out of range, or give more than 200,000 settings
    """
    if not (0 < minimum <= maximum < math.inf and 0 < step < math.inf):
        raise UsageError(
            f"invalid settings {minimum:g} to {maximum:g} in steps of {step:g}: "
            "expected 0 < minimum <= maximum and a step above 0"
        )
    steps = (maximum - minimum) / step * (1 + 1e-12) + 1e-9
    if not steps < MAX_SETTINGS:
        raise UsageError(
            f"too many settings ({steps + 1:.12g}): expected at most {MAX_SETTINGS}",
            hint="choose a larger step",
        )
    return np.asarray(minimum + step * np.arange(math.floor(steps) + 1))
