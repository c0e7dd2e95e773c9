"""95 % intervals of what calibrations measure, and how much is certainly no noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from camctl.evidence.ratio_check import SIGNIFICANCE
from camctl.evidence.ratio_fit import BLOCKS
from camctl.model.quantiles import Z_95, student
from camctl.model.response.camera import FloatArray
from camctl.profiles.noise import Figure


def certain(tests: int) -> float:
    """Return the standard errors that noise exceeds in none of so many tests, with certainty.

    It does in one in all of `SIGNIFICANCE` of the calibrations (Bonferroni).
    """
    return NormalDist().inv_cdf(1 - SIGNIFICANCE / (2 * max(1, tests)))


def chi_squared_limit(freedom: int) -> float:
    """Return the mean square of `freedom` deviations that is no noise (Wilson and Hilferty)."""
    width = 2 / (9 * freedom)
    return float((1 - width + NormalDist().inv_cdf(1 - SIGNIFICANCE) * math.sqrt(width)) ** 3)


def root_of_ratio(sums: Sequence[FloatArray]) -> Figure:
    """Return the root of the ratio of two sums over the picture, with its interval.

    Parts of the picture are left out in turn (jackknife), in all colours: they see the same scene.

    Args:
        sums: of each colour, (patches, 2), row by row
    """
    parts = np.zeros((BLOCKS, 2))
    for colour in sums:
        parts += [part.sum(axis=0) for part in np.array_split(colour, BLOCKS)]
    whole = parts.sum(axis=0)
    squared = float(whole[0] / whole[1])
    others = (whole - parts)[:, 0] / (whole - parts)[:, 1]
    error = math.sqrt(float(np.square(others - others.mean()).sum()) * (BLOCKS - 1) / BLOCKS)
    half = student(Z_95, BLOCKS - 1) * error
    low, value, high = (math.sqrt(max(0.0, squared + turn * half)) for turn in (-1, 0, 1))
    return Figure(value=value, low=low, high=high)
