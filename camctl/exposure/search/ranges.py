"""The range of the picture where the metered light decides it."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from camctl.errors import CaptureError, UsageError
from camctl.exposure.accuracy import TooInaccurateError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.exposure_choices import SAME
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.light import LEAST_RANGE, Light
from camctl.exposure.search.front import Front
from camctl.exposure.search.settings import relative_exposures
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.response.desired import DesiredResponse
from camctl.model.response.names import RANGES
from camctl.system.number_text import range_text

LEAST_SHARE = 0.5
"""Share of the effective levels at 1:256 that a range must have, unless the request says how many
levels: so the steps of constant contrast over 1:250,000 are four times as large at most."""

STOPS = tuple(LEAST_RANGE * 2.0**n for n in range(17))
"""Ranges that are chosen from where the camera's noise is known: exposures for one of them are
solved in about a second, and kept for all scenes of this range.  The light that a lens scatters
hides what a larger one has."""

TABLE = tuple(sorted(RANGES.values()))
"""Ranges that are chosen from where it is not: solving by xi takes up to minutes for many levels,
and the table that is part of camctl has these."""

#: Factor by which a range may be too small.
_MARGIN = 1.02
#: Share of the levels that are enough from which, by the estimate, a range may have them.
_NEARLY = 0.95


@dataclass(frozen=True)
class Chosen:
    """Exposures chosen for a desired response.

    Attributes:
        desired: the desired response, with its range
        settings: in ascending order of exposure
        ratios: the exposures that were asked of the camera, relative to the shortest
        levels: predicted effective levels, where the settings are a point of a front
        needed_levels: effective levels of a larger range that would hold the scene
        front: the front that the settings are a point of; None where they are chosen by xi
    """

    desired: DesiredResponse
    settings: tuple[ExposureSetting, ...]
    ratios: tuple[float, ...]
    levels: float | None = None
    needed_levels: float | None = None
    front: Front | None = None


def _largest(top: int, low: int, levels: Callable[[int], float], least: float) -> int:
    """Return the largest place from `low` up to `top` that has the least levels.

    `top` where `low` has not, or is not below it.  The levels fall about evenly in their logarithm,
    so that it is looked for where a straight line between both ends has the least.
    """
    if low >= top or levels(top) >= least or levels(low) < least:
        return top
    high = top
    while high - low > 1:
        above, below = levels(low) / least, levels(high) / least
        share = math.log(above) / math.log(above / below) if below > 0 else 0.5
        middle = min(max(low + round(share * (high - low)), low + 1), high - 1)
        low, high = (middle, high) if levels(middle) >= least else (low, middle)
    return low


def choose_range(
    controls: ExposureControls,
    request: CaptureRequest,
    light: Light,
    limit_s: float,
    choose: Callable[[DesiredResponse], Chosen],
    estimate: Callable[[DesiredResponse], float | None] | None = None,
) -> Chosen:
    """Return exposures for the range that holds the metered light.

    Where the camera would not be accurate enough over it, it is the largest range that is: the
    request says how many effective levels are enough, or `LEAST_SHARE` does.

    Args:
        controls: of the camera
        request: what the user asks for
        light: of the scene
        limit_s: the longest shutter time of the shortest exposure, s
        choose: returns the exposures for a desired response
        estimate: where they are chosen by accuracy: returns about the effective levels that they
            will have, in much less time, or None; ranges far from accurate enough are not solved

    Raises:
        UsageError, CaptureError: as `choose` does for the range in which most is possible
    """
    ladder = TABLE if estimate is None else STOPS
    needed = light.needed_from(replace(light.metering.setting, time_s=limit_s))
    top = min(bisect_left(ladder, needed * (1 - SAME)), len(ladder) - 1)

    def desired(place: int) -> DesiredResponse:
        return light.desired(request, ladder[place])

    @cache
    def solved(place: int) -> tuple[Chosen | None, float]:
        """Return exposures and their effective levels; None and 0 where there are none."""
        try:
            chosen = choose(desired(place))
        except (UsageError, CaptureError):  # an accuracy or a range is beyond the camera
            return None, 0.0
        if chosen.levels is not None:
            return chosen, chosen.levels
        noise = None if controls.noise is None else controls.frame_noise(chosen.settings)
        exposures = relative_exposures(chosen.settings)
        quality = evaluate(controls.levels, chosen.desired, exposures, noise=noise)
        return chosen, quality.effective_levels

    @cache
    def possible(place: int) -> float:
        """Return the effective levels over a range, or about them where that is much faster."""
        levels = None if estimate is None else estimate(desired(place))
        return solved(place)[1] if levels is None else levels

    if request.ratios is not None:
        return choose(desired(top))
    low = ladder.index(RANGES["low"])
    least = LEAST_SHARE * possible(low)
    if request.accuracy is not None:
        low, least = 0, _NEARLY * request.accuracy
    # A smaller range may have a few levels less, but not half of them.
    for place in range(_largest(top, low, possible, least), -1, -1):
        if possible(place) < least:
            continue
        chosen, levels = solved(place)
        if chosen is not None and levels >= (request.accuracy or 0.0):
            if place < top:
                return replace(chosen, needed_levels=possible(top))
            # The shortest exposure that the camera can set may be shorter than the limit.
            is_short = light.needed_from(chosen.settings[0]) > ladder[top] * _MARGIN
            if is_short and top + 1 < len(ladder) and possible(top + 1) >= least:
                longer, more = solved(top + 1)
                return chosen if longer is None or more < (request.accuracy or 0.0) else longer
            return chosen
    best = max(range(top + 1), key=possible)
    try:
        return replace(choose(desired(best)), needed_levels=possible(top))
    except TooInaccurateError as error:
        raise UsageError(
            f"{error.what}, over any range up to {range_text(ladder[top])}",
            hint=f"over {range_text(ladder[best])} {error.hint}",
        ) from None
