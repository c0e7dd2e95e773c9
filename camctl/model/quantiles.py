"""Quantiles of the normal distribution and of Student's, and the median of numbers."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

Z_95 = NormalDist().inv_cdf(0.975)
"""Half the width of a 95 % confidence interval in standard deviations."""

NORMAL_MAD = NormalDist().inv_cdf(0.75)
"""Median absolute deviation of a normal variable, standard deviations."""


def student(sigmas: float, freedom: float) -> float:
    """Return the quantile of Student's t that is as probable as so many standard deviations.

    Wallace, "Bounds on normal approximations to Student's and the chi-square distributions", 1959:
    it is exact to 0.04 % from 10 degrees of freedom on, and too large by 4 % at 2, for 95 %.
    """
    wider = sigmas * (8 * freedom + 3) / (8 * freedom + 1)
    return math.sqrt(freedom * math.expm1(wider**2 / freedom))


def median(values: NDArray[Any]) -> float:
    """Return the median of at least one number, as `np.median` does in eight times the time."""
    return median_of_ascending(np.sort(values, axis=None))


def median_of_ascending(values: NDArray[Any]) -> float:
    """Return the median of at least one number; they ascend."""
    middle = values.size // 2
    if values.size % 2:
        return float(values[middle])
    return float(values[middle - 1] / 2 + values[middle] / 2)  # whole numbers do not overflow
