"""The range of the picture where the metered light decides it, and what the picture will hold."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from camctl.errors import CaptureError, UsageError
from camctl.exposure.accuracy import TooInaccurateError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.goal import AUTO, build_desired
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.response.auto import auto_response
from camctl.model.response.desired import DesiredResponse
from camctl.model.response.names import RANGES
from camctl.pictures.render import DARK, sum_mask
from camctl.records.capture_plan import Metering, relative_exposures
from camctl.records.request import CaptureRequest
from camctl.records.scene_light import LEAST_RANGE, PlannedLight, SceneLight
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

#: Relative difference up to which two ranges are the same, and by which a range may be too small.
_SAME, _MARGIN = 1e-9, 1.02
#: Irradiances at which the share below the range is computed: 20 in each of 20 stops.
_NODES = 400
#: Share of the levels that are enough from which, by the estimate, a range may have them.
_NEARLY = 0.95


@dataclass(frozen=True)
class Chosen:
    """Exposures chosen for a desired response.

    Attributes:
        desired: the desired response, with its range
        settings: in ascending order of exposure
        ratios: the exposures that were asked of the camera, relative to the shortest
        needed_levels: effective levels of a larger range that would hold the scene
    """

    desired: DesiredResponse
    settings: tuple[ExposureSetting, ...]
    ratios: tuple[float, ...]
    needed_levels: float | None = None


@dataclass(frozen=True)
class Metered:
    """The metered light; None where the base exposure was given.

    Attributes:
        metering: how it was metered
        limit_s: the longest shutter time of the shortest exposure, s
        light: the histogram, E = 1 at `metering.limit_s`
        last: the setting of the last metering frame
        warnings: what to know of it, one line each
    """

    metering: Metering | None
    limit_s: float
    light: SceneLight | None
    last: ExposureSetting | None = None
    warnings: tuple[str, ...] = ()

    def limited(self, request: CaptureRequest, controls: ExposureControls) -> Metered:
        """Return the same light with the shortest exposure, and the unit of light, of a request."""
        assert self.metering is not None  # it is asked for where there is light
        assert self.light is not None  # the same
        whole_s = self.metering.limit_s
        end = self.light.upper_end(request.clip, request.given_range)
        limit_s = min(whole_s / end, controls.time_s.maximum)
        return replace(
            self,
            metering=replace(self.metering, limit_s=limit_s),
            limit_s=limit_s * 2.0**request.compensation_stops,
            light=self.light.relative_to(whole_s / limit_s),
        )

    def desired(self, request: CaptureRequest, dynamic_range: float) -> DesiredResponse:
        """Return the response that is requested over a range."""
        if request.response != AUTO:
            return build_desired(
                request.response, dynamic_range, request.gamma, request.desired_curve
            )
        assert self.light is not None  # `CaptureRequest` refuses a base exposure with this response
        return auto_response(self.light.irradiance, dynamic_range, weights=self.light.shares)

    def needed(self, exposure: float) -> float:
        """Return the range that holds the light, where `exposure` is the shortest."""
        assert self.light is not None  # the same
        return self.light.needed_range(self._upper_end(exposure))

    def planned(self, chosen: Chosen, controls: ExposureControls) -> PlannedLight | None:
        """Return how much of the light the chosen exposures hold."""
        if self.light is None:
            return None
        assert self.metering is not None  # there is no light without
        end = self._upper_end(chosen.settings[0].exposure)
        return PlannedLight(
            span=self.light.brightest / self.light.seen_shadows,
            is_open=self.light.is_open,
            unseen=self.light.unseen,
            clips=self.light.share_above(end),
            clips_stops=max(0.0, math.log2(self.light.brightest / end)),
            dark=_dark_share(self.light.relative_to(end), chosen, controls),
            needed=self.light.needed_range(end),
            needed_levels=chosen.needed_levels,
            is_cut=self.metering.highlight >= 1.0 and self.metering.clipped > 0,
        )

    def _upper_end(self, exposure: float) -> float:
        """Return the light that just saturates an exposure."""
        assert self.metering is not None  # there is no light without
        setting = self.metering.setting
        return setting.exposure * self.metering.limit_s / setting.time_s / exposure


def _dark_share(light: SceneLight, chosen: Chosen, controls: ExposureControls) -> float:
    """Return the share of the light that the masks of the pictures will say is too dark.

    Args:
        light: E = 1 just saturates the shortest exposure
        chosen: the exposures
        controls: of the camera
    """
    settings = chosen.settings
    camera = EffectiveCamera.of(controls.levels, relative_exposures(settings))
    posterior = Posterior(camera, chosen.desired, controls.frame_noise(settings))
    E = np.geomspace(light.irradiance[0], light.irradiance[-1], _NODES)
    dark = posterior.shares(E, sum_mask(posterior) == DARK)
    return float(np.interp(light.irradiance, E, dark) @ light.shares)


def choose_range(
    controls: ExposureControls,
    request: CaptureRequest,
    metered: Metered,
    choose: Callable[[DesiredResponse], Chosen],
    estimate: Callable[[DesiredResponse], float | None] | None = None,
) -> Chosen:
    """Return exposures for the range that holds the metered light.

    Where the camera would not be accurate enough over it, it is the largest range that is: the
    request says how many effective levels are enough, or `LEAST_SHARE` does.

    Args:
        controls: of the camera
        request: what the user asks for
        metered: the light
        choose: returns the exposures for a desired response
        estimate: where they are chosen by accuracy: returns about the effective levels that they
            will have, in much less time, or None; ranges far from accurate enough are not solved

    Raises:
        UsageError, CaptureError: as `choose` does for the range in which most is possible
    """
    assert metered.metering is not None  # `CaptureRequest` refuses a base exposure with this range
    ladder = TABLE if estimate is None else STOPS
    setting = metered.metering.setting
    needed = metered.needed(replace(setting, time_s=metered.limit_s).exposure)
    top = min(bisect_left(ladder, needed * (1 - _SAME)), len(ladder) - 1)

    def desired(place: int) -> DesiredResponse:
        return metered.desired(request, ladder[place])

    @cache
    def solved(place: int) -> tuple[Chosen | None, float]:
        """Return exposures and their effective levels; None and 0 where there are none."""
        try:
            chosen = choose(desired(place))
        except (UsageError, CaptureError):  # an accuracy or a range is beyond the camera
            return None, 0.0
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
    least = LEAST_SHARE * possible(ladder.index(RANGES["low"]))
    if request.accuracy is not None:
        least = _NEARLY * request.accuracy
    # A smaller range does not always have more levels: all of them are considered.
    for place in range(top, -1, -1):
        if possible(place) < least:
            continue
        chosen, levels = solved(place)
        if chosen is not None and levels >= (request.accuracy or 0.0):
            if place < top:
                return replace(chosen, needed_levels=possible(top))
            # The shortest exposure that the camera can set may be shorter than the limit.
            is_short = metered.needed(chosen.settings[0].exposure) > ladder[top] * _MARGIN
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
