"""Lines of a frame that were lost, shifted or overwritten on their way from the camera.

A frame is sent line by line, so that what goes wrong is wrong in whole lines, from one side of the
picture to the other, while the lines beside them fit the other frames.  A thing that moves covers
a part of the width, and wrong exposures all lines.  Of three frames the others agree with each
other where one is wrong, however few contours show it.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.light_ratio import FrameSample
from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.ratio_check import SIGNIFICANCE, SMALL_THING
from camctl.model.sensor import BLACK_ERROR_LEVELS, RESPONSE_ERROR, SensorModel

#: Parts of the width, in each of which lines that are wrong contradict the other frame.
_PARTS = 4
#: Share of the comparable patches of a line that contradict where it is wrong, at least: of shifted
#: lines those on contours.  Where it is right, noise and spread light leave small things at most.
_WRONG = 0.2

_Marks = NDArray[np.bool_]
_Floats = NDArray[np.float64]


class LightLimits(NamedTuple):
    """Between which limits the light of each patch of a frame is: infinite where it is saturated.

    Attributes:
        low, high: (patches,)
    """

    low: _Floats
    high: _Floats


def wrong_lines(pair: tuple[LightLimits, LightLimits], ratio: float, grid: tuple[int, int]) -> bool:
    """Return whether some lines of one of two frames contradict the other frame, and others not.

    Args:
        pair: the frames, see `light_limits`
        ratio: of their exposures, the second over the first
        grid: rows and columns of the patches of a colour; colours of other grids do not count
    """
    contradicts, compared = _contradictions(*pair, ratio)
    return _are_lines(_by_line(contradicts, grid), _by_line(compared, grid))


def is_wrong_alone(
    frames: tuple[LightLimits, LightLimits, LightLimits], exposures: tuple[float, float, float]
) -> bool:
    """Return whether the second of three frames contradicts the others where these agree.

    A thing that moves on, or a camera, is in another place in each frame: then the others disagree,
    too.

    Args:
        frames: that were taken one after the other, in any order
        exposures: of them
    """
    first, second, third = (
        _contradictions(frames[one], frames[other], exposures[other] / exposures[one])
        for one, other in ((0, 1), (1, 2), (0, 2))
    )
    wrong = (first[0] | second[0]) & third[1]
    count = np.count_nonzero(wrong)
    return bool(
        count >= LEAST_PATCHES
        and np.count_nonzero(third[0] & wrong) <= SMALL_THING * count
        and np.count_nonzero(first[0] & second[0] & wrong) > SMALL_THING * count
    )


def _contradictions(one: LightLimits, other: LightLimits, ratio: float) -> tuple[_Marks, _Marks]:
    """Return which patches of two frames contradict, and which can be compared."""
    low, high = (each / ratio for each in other)
    # Nothing is known of the light of a patch that is saturated in both, or dark in both.
    compared = (np.isfinite(one.high) | np.isfinite(high)) & ((one.low > 0) | (low > 0))
    return compared & ((one.low > high) | (low > one.high)), compared


def _by_line(marks: _Marks, grid: tuple[int, int]) -> _Marks:
    """Return marks of patches, colour by colour, as (rows, columns x colours)."""
    size = math.prod(grid)
    whole = marks[: len(marks) // size * size].reshape(-1, *grid)
    return whole.transpose(1, 2, 0).reshape(grid[0], -1)


def _are_lines(contradicts: _Marks, compared: _Marks) -> bool:
    """Return whether patches, (rows, columns), contradict in whole lines and not beside them."""
    usable = np.count_nonzero(compared, axis=1)
    share = np.count_nonzero(contradicts, axis=1) / np.maximum(usable, 1)
    seen = usable >= _PARTS
    wrong = seen & (share >= _WRONG)
    between = seen & (share > SMALL_THING) & ~wrong
    # A line that begins or ends within a patch is between: two for each run of wrong lines.
    runs = np.count_nonzero(np.diff(wrong[seen].astype(np.int8), prepend=0, append=0)) // 2
    if wrong.sum() == seen.sum() or np.count_nonzero(between) > 2 * runs:
        return False
    return _is_wide(contradicts[wrong], compared[wrong])


def _is_wide(contradicts: _Marks, compared: _Marks) -> bool:
    """Return whether many patches of some lines contradict, from one side to the other."""
    # From left to right, as many comparable patches in each part.
    row, column = np.nonzero(compared)
    marks = contradicts[row, column][np.argsort(column, kind="stable")]
    parts = np.array_split(marks, _PARTS)
    is_wide = all(np.count_nonzero(part) > SMALL_THING * part.size for part in parts)
    return is_wide and int(np.count_nonzero(marks)) >= LEAST_PATCHES


def light_limits(frame: FrameSample, sensor: SensorModel) -> LightLimits:
    """Return those of a frame of a camera, at the significance level divided over the patches."""
    count = frame.patches.shape[1]
    values = sensor.light[frame.patches]
    mean = values.mean(axis=1)
    own = values.var(axis=1) if frame.noise is None else sensor.spread(mean, frame.noise)
    error = own / count + np.square(sensor.step(mean)) / 12
    error += np.square(BLACK_ERROR_LEVELS * sensor.level) + np.square(RESPONSE_ERROR * mean)
    limit = -NormalDist().inv_cdf(SIGNIFICANCE / 2 / len(mean)) * np.sqrt(error)
    is_cut = (frame.patches > sensor.highest(frame.noise)).any(axis=1)
    return LightLimits(mean - limit, np.where(is_cut, math.inf, mean + limit))
