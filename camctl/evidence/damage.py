"""Parts of a frame that were damaged on their way from the camera.

Their samples may be any codes.  Optics spread the light of each point, so that neighbouring samples
of a scene depend on each other.  Where the samples of a patch depend neither on their neighbours
nor on the same samples of the other frames, and all codes being as probable explains them better
than any normal distribution does, they are not of a picture.

Or lines are earlier lines once more, sent twice.  Noise is independent from line to line: that two
are equal in all of their samples is as probable as that noise leaves each sample of the second line
at the value of the first one.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import pairwise
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import SIGNIFICANCE
from camctl.model.noise import FrameNoise
from camctl.model.sensor import SensorModel

#: Standard deviation, as a share of the number of codes, at which a normal distribution of that
#: width has the entropy of a uniform one.
_UNIFORM = 1 / math.sqrt(2 * math.pi * math.e)
#: Columns whose samples are compared first, to save time: all are where these are equal.
_COLUMNS = 64

_Floats = NDArray[np.float64]


def damaged_share(frame: Patches, others: Sequence[Patches], codes: int) -> float:
    """Return which share of a frame, by its patches, shows no scene; 0.0 where it is no part.

    Args:
        frame: patches of the frame
        others: of the frames beside it
        codes: number of the codes that a sample has
    """
    side = math.isqrt(frame.shape[1])
    wide = np.flatnonzero(frame.std(axis=1) > _UNIFORM * codes)
    if wide.size < LEAST_PATCHES or side < 2:
        return 0.0
    rest = _without_mean(frame[wide])
    squares = rest.reshape(-1, side, side)
    product = (squares[:, :, 1:] * squares[:, :, :-1]).sum(axis=(1, 2))
    product += (squares[:, 1:] * squares[:, :-1]).sum(axis=(1, 2))
    variance = np.square(rest).mean(axis=1)
    random = _is_chance(product / variance, 2 * side * (side - 1))
    for other in others:
        same = _without_mean(other[wide])
        spread = np.maximum(np.sqrt(np.square(same).mean(axis=1)), 1e-9)  # 0 where it is flat
        random &= _is_chance((rest * same).sum(axis=1) / np.sqrt(variance) / spread, side**2)
    found = np.count_nonzero(random)
    return found / len(frame) if found >= LEAST_PATCHES else 0.0


def _without_mean(patches: Patches) -> _Floats:
    return np.asarray(patches - patches.mean(axis=1, keepdims=True))


def _is_chance(products: _Floats, pairs: int) -> NDArray[np.bool_]:
    """Return which sums of so many products of independent variables of variance 1 are by chance.

    Their standard deviation is the root of the number.
    """
    limit = -NormalDist().inv_cdf(SIGNIFICANCE / 2) * math.sqrt(pairs)
    return np.abs(products) <= limit


class Repeat(NamedTuple):
    """A line that is an earlier one once more."""

    line: int
    earlier: int


def repeated_lines(
    pixels: NDArray[Any], sensor: SensorModel, noise: FrameNoise
) -> frozenset[Repeat]:
    """Return the lines of a frame that noise would have made different from all earlier ones.

    Three equal lines and more are none: compression and enlargement make them.  Nor are lines that
    come twice all over the frame, as of a camera that doubles them.

    Args:
        pixels: (rows, columns) or (rows, columns, 3)
        sensor: of the camera
        noise: of the frame; of files that round it away it tells nothing
    """
    rows, columns = pixels.shape[:2]
    if noise.file is not None or noise.is_none or rows < 2:
        return frozenset()
    some = np.linspace(0, columns - 1, min(columns, _COLUMNS)).astype(np.intp)
    equal = defaultdict(list)
    for line, each in enumerate(pixels[:, some]):
        equal[each.tobytes()].append(line)
    pairs = sorted(Repeat(*lines[::-1]) for lines in equal.values() if len(lines) == 2)
    pairs = [each for each in pairs if np.array_equal(*pixels[list(each)])]
    chance = _stays(sensor, noise)
    # Over all first lines, lines that these repeat, and numbers of lines.
    limit = math.log(6 * SIGNIFICANCE / rows**3)
    found: list[Repeat] = []
    for run in _runs(pairs):
        samples = np.minimum(pixels[[each.line for each in run]], sensor.white)
        if chance[samples].sum() < limit:
            found += run
    return frozenset(() if _is_enlarged(pixels, found) else found)


def _is_enlarged(pixels: NDArray[Any], found: Iterable[Repeat]) -> bool:
    """Return whether single lines come twice all over a frame.

    Enlargement to the nearest line, by whatever factor, has distances of such lines that differ by
    1 at most: none is longer then than the shortest one that is known, and 1.  Without a second
    line they are doubled.  Where nothing is seen, in the dark or saturated, lines are equal, too.
    """
    twice = sorted(each.line for each in found if each.line - each.earlier == 1)
    if not twice:
        return False
    apart = int(np.diff(twice).min()) if len(twice) > 1 else 2
    is_equal = np.array([np.array_equal(*two) for two in pairwise(pixels)])
    equal = np.flatnonzero(is_equal) + 1
    return bool(np.diff(equal, prepend=0, append=len(pixels)).max() <= apart + 1)


def _runs(pairs: Iterable[Repeat]) -> list[list[Repeat]]:
    """Return pairs of lines, ascending, in blocks of lines that were sent twice."""
    runs: list[list[Repeat]] = []
    for each in pairs:
        if runs and each == Repeat(*(line + 1 for line in runs[-1][-1])):
            runs[-1].append(each)
        else:
            runs.append([each])
    return runs


def _stays(sensor: SensorModel, noise: FrameNoise) -> NDArray[np.float64]:
    """Return the logarithm of the probability that noise leaves a sample at a value, by value.

    No value of a normal distribution of s levels is more probable than 1 / (s sqrt(2 pi)).  Samples
    at 0, or saturated, stay.
    """
    steps = np.sqrt(sensor.variance(sensor.light, noise)) / np.maximum(sensor.gap, 1e-12)
    found = -np.log(np.maximum(steps * math.sqrt(2 * math.pi), 1.0))
    values = np.arange(found.size)
    return np.where((values > 0) & (values <= sensor.highest(noise)), found, 0.0)
