"""Lines of a frame that were lost, shifted or overwritten on their way from the camera.

A frame is sent line by line, so that what goes wrong is wrong in whole lines, from one side of the
picture to the other, while the lines beside them fit the other frames.  A thing that moves covers
a part of the width, and wrong exposures all lines.  Of three frames the others agree with each
other where one is wrong, however few contours show it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.light_ratio import FrameSample
from camctl.evidence.patch_errors import LEAST_PATCHES
from camctl.evidence.ratio_check import MOST, SIGNIFICANCE, SMALL_THING
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
        is_flat: patches of one code, which is not saturated, (patches,)
    """

    low: _Floats
    high: _Floats
    is_flat: _Marks


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


def damaged_lines(
    limits: Sequence[LightLimits], exposures: Sequence[float], grid: tuple[int, int]
) -> dict[int, tuple[int, int]]:
    """Return which lines of patches of which frames contradict most other frames.

    The frame that others contradict most is taken out first, so that frames that are wrong in the
    same lines do not hide each other.  Where the frames that are left contradict each other, too,
    or are not most of them, something moves.

    Args:
        limits: of each frame, see `light_limits`
        exposures: of the frames
        grid: see `wrong_lines`

    Returns:
        first line, and the one after the last, by the position of the frame
    """
    scale = np.asarray(exposures, np.float64)[:, np.newaxis]
    low = np.stack([each.low for each in limits]) / scale
    high = np.maximum(np.stack([each.high for each in limits]) / scale, 0.0)  # no light is below 0
    is_flat = np.stack([each.is_flat for each in limits])
    kept, found = list(range(len(low))), dict[int, _WrongPatches]()
    while 2 * len(kept) > len(low):
        wrong = _most_wrong(low[kept], high[kept], is_flat[kept], grid)
        if wrong is None:
            break
        found[kept.pop(wrong.place)] = wrong
    if 2 * len(kept) <= len(low):
        return {}
    contested = low[kept].max(axis=0) > high[kept].min(axis=0)
    lines = {}
    for position, wrong in sorted(found.items()):
        others = np.count_nonzero(contested & wrong.marks)
        if wrong.is_lost or others <= SMALL_THING * np.count_nonzero(wrong.marks):
            rows = np.flatnonzero(_by_line(wrong.marks, grid).any(axis=1))
            lines[position] = int(rows[0]), int(rows[-1]) + 1
    return lines


class _WrongPatches(NamedTuple):
    """Patches of a frame in lines that are wrong.

    Attributes:
        place: of the frame among those compared
        marks: which patches
        is_lost: most of them have one code, as nothing in a scene has
    """

    place: int
    marks: _Marks
    is_lost: bool


def _most_wrong(
    low: _Floats, high: _Floats, is_flat: _Marks, grid: tuple[int, int]
) -> _WrongPatches | None:
    """Return the patches of the frame whose lines others contradict most; None where none has any.

    Args:
        low: limit of the light, (frames, patches)
        high: likewise
        is_flat: see `LightLimits`, (frames, patches)
        grid: see `wrong_lines`
    """
    contested = low.max(axis=0) > high.min(axis=0)
    if len(low) < 3 or np.count_nonzero(contested) < LEAST_PATCHES:
        return None
    count = np.stack(
        [(high < low[k]).sum(axis=0) + (low > high[k]).sum(axis=0) for k in range(len(low))]
    )
    most = count.max(axis=0)
    wrong = contested & (count == most)
    # Much of a picture is dark or saturated: that a patch is, as it should be, tells nothing.
    tells = wrong | (np.isfinite(high) & (low > 0))
    for k in np.argsort(-count.sum(axis=1), kind="stable").tolist():
        marks, size = wrong[k], np.count_nonzero(wrong[k])
        if np.count_nonzero(marks & (most > 1)) <= SMALL_THING * size:
            continue  # of two frames that contradict each other alone either may be wrong
        lines, telling = _by_line(marks, grid), _by_line(tells[k], grid)
        is_right = np.count_nonzero(lines, axis=1) == 0
        telling[is_right] = True
        is_lost = bool(np.count_nonzero(is_flat[k] & marks) > MOST * size)
        if (
            np.count_nonzero(lines.any(axis=0)) > MOST * lines.shape[1]
            and _are_lines(lines, telling)
            and (is_lost or _shows_rest(is_right, low[k], high[k], grid))
        ):
            return _WrongPatches(k, marks, is_lost)
    return None


def _shows_rest(is_right: _Marks, low: _Floats, high: _Floats, grid: tuple[int, int]) -> bool:
    """Return whether the lines that are right, from the first one on, show that nothing moved.

    If the whole picture had moved, each contour in them would contradict with a probability of
    `_WRONG` at least, as in a line that is wrong.
    """
    low, high = (each[: _whole(each, grid)].reshape(-1, *grid) for each in (low, high))
    on_contour = np.zeros(low.shape, np.bool_)
    across = (low[..., 1:] > high[..., :-1]) | (high[..., 1:] < low[..., :-1])
    down = (low[:, 1:] > high[:, :-1]) | (high[:, 1:] < low[:, :-1])
    on_contour[..., 1:] |= across
    on_contour[:, 1:] |= down
    count = int(np.count_nonzero(on_contour[:, is_right]))
    return bool(is_right[0]) and (1 - _WRONG) ** count <= SIGNIFICANCE


def _contradictions(one: LightLimits, other: LightLimits, ratio: float) -> tuple[_Marks, _Marks]:
    """Return which patches of two frames contradict, and which can be compared."""
    low, high = other.low / ratio, other.high / ratio
    # Nothing is known of the light of a patch that is saturated in both, or dark in both.
    compared = (np.isfinite(one.high) | np.isfinite(high)) & ((one.low > 0) | (low > 0))
    return compared & ((one.low > high) | (low > one.high)), compared


def _by_line(marks: _Marks, grid: tuple[int, int]) -> _Marks:
    """Return marks of patches, colour by colour, as (rows, columns x colours)."""
    whole = marks[: _whole(marks, grid)].reshape(-1, *grid)
    return whole.transpose(1, 2, 0).reshape(grid[0], -1)


def _whole(marks: _Marks | _Floats, grid: tuple[int, int]) -> int:
    """Return how many patches are those of the colours that have this grid."""
    size = math.prod(grid)
    return len(marks) // size * size


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
    is_flat = ~is_cut & (frame.patches == frame.patches[:, :1]).all(axis=1)
    return LightLimits(mean - limit, np.where(is_cut, math.inf, mean + limit), is_flat)
