"""The metered light of a scene: what may clip at its upper end, and how far it goes down.

The light is a histogram of the metering frames.  Nothing clips unless light that
covers little of the picture is far brighter than the rest, as lamps and reflections are, or the
user says how much may clip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from camctl.exposure.goal import AUTO, Goal
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.response.auto import auto_response
from camctl.model.response.camera import FloatArray
from camctl.model.response.desired import DesiredResponse

DARK_SHARE = 0.01
"""Share of the samples, the darkest, that may be below the range that the scene decides."""

LAMP_SHARE = 0.005
"""Share of the samples, the brightest, that clips unless the request says how much: street lamps
and reflections cover 0.1 % to 0.3 % of a picture, a window covers more."""

NOTABLE_SHARE = 5e-4
"""Share of the samples from which the line on the metered light names what the picture lacks."""

GAINED_FACTOR = 4.0
"""Factor of light that is worth another range: two stops.  Lamps clip only if they are this many
times as bright as the rest, so that the range gains as much."""

#: Lamps are apart from the rest where the stop between them has fewer samples than this share.
_GAP_SHARE = 1e-5

LEAST_RANGE = 16.0
"""A smaller one would show noise as contrast."""

#: Where the metering frames cannot tell the shadows from black, these are assumed to be darker by
#: so many stops at least and at most.
_LEAST_UNSEEN_STOPS, MOST_UNSEEN_STOPS = 1.0, 4.0
#: The range is larger than what it must hold by this factor, for the noise of the metering.
_MARGIN = 1.05

SHOWN_STOPS: FloatArray = np.arange(-64, 5) / 4
"""Edges of the histograms that pages show, in stops above saturation of the shortest exposure: 16
stops below it to one above, four bins a stop."""


@dataclass(frozen=True)
class Metering:
    """How much light there is.

    Attributes:
        limit_s: shutter time at which the highlights that may not clip would be just below
            saturation, s
        setting: the setting of the last metering frame, the nearest to `limit_s`
        highlight: brightness of the highlights in it, as a share of white minus black
        clipped: share of its samples that are saturated
        frames: number of metering frames (previews, or exposures of the shutter)
    """

    limit_s: float
    setting: ExposureSetting
    highlight: float
    clipped: float
    frames: int


@dataclass(frozen=True, eq=False)
class Light:
    """The light of a scene, as a histogram of the metering frames.

    Attributes:
        metering: how it was metered
        irradiance: (K,) ascending; E = 1 saturates an exposure of `metering.limit_s`
        shares: (K,) of the samples, sum 1
        darkest: less light is the same as none in the metering frames
        brightest: the highlights, without hot pixels
        last: the setting of the last metering frame
        has_shadows: whether light below the metered highlights was looked for: without a preview it
            costs actuations of the shutter, which are spent only where that light decides
    """

    metering: Metering
    irradiance: FloatArray
    shares: FloatArray
    darkest: float
    brightest: float = 1.0
    last: ExposureSetting | None = None
    has_shadows: bool = True

    def limited(self, goal: Goal, controls: ExposureControls) -> Light:
        """Return the same light in units of the longest shortest exposure that a goal allows."""
        whole_s = self.metering.limit_s
        # Photographs already taken hold what they hold: clipping would gain no range and no time.
        clip = 0.0 if goal.clip is None and not controls.repeatable else goal.clip
        end = self.upper_end(clip, goal.given_range)
        return self.up_to(min(whole_s / end, controls.time_s.maximum))

    def up_to(self, limit_s: float) -> Light:
        """Return the same light in units of a shutter time of the shortest exposure."""
        unit = self.metering.limit_s / limit_s
        return replace(
            self,
            metering=replace(self.metering, limit_s=limit_s),
            irradiance=self.irradiance / unit,
            darkest=self.darkest / unit,
            brightest=self.brightest / unit,
        )

    def desired(self, goal: Goal, dynamic_range: float) -> DesiredResponse:
        """Return the desired response of a goal over a range."""
        if goal.response != AUTO:
            return goal.over(dynamic_range)
        return auto_response(self.irradiance, dynamic_range, weights=self.shares)

    def saturating(self, exposure: float) -> float:
        """Return the light that just saturates an exposure."""
        setting = self.metering.setting
        return setting.exposure * self.metering.limit_s / setting.time_s / exposure

    def share_above(self, E: float) -> float:
        """Return the share of the samples with more light than E."""
        return float(self.shares[self.irradiance > E].sum())

    def share_below(self, E: float) -> float:
        """Return the share of the samples with less light than E."""
        return float(self.shares[self.irradiance < E].sum())

    @property
    def shadows(self) -> float:
        """The light that `DARK_SHARE` of the samples are below.

        Where it is not seen, as many samples are assumed in each darker stop as in the two that
        are seen last.
        """
        if not self.is_open:
            return self.seen_shadows
        unseen = self.unseen - DARK_SHARE
        in_stop = (self.share_below(4 * self.darkest) - self.share_below(self.darkest)) / 2
        stops = unseen / max(in_stop, unseen / MOST_UNSEEN_STOPS)
        return float(self.darkest * 2.0 ** -max(stops, _LEAST_UNSEEN_STOPS))

    @property
    def seen_shadows(self) -> float:
        """The same, at least what the metering frames can tell from black."""
        below = np.cumsum(self.shares)
        found = self.irradiance[min(int(np.searchsorted(below, DARK_SHARE)), below.size - 1)]
        return max(float(found), self.darkest)

    @property
    def is_open(self) -> bool:
        """Whether the shadows are darker than the metering frames can tell."""
        return self.unseen > DARK_SHARE

    @property
    def unseen(self) -> float:
        """The share of the samples that the metering frames cannot tell from black."""
        return self.share_below(self.darkest)

    def highlights(self, clip: float) -> float:
        """Return the light above which at most the share `clip` of the samples is."""
        above = np.cumsum(self.shares[::-1])[::-1]
        allowed = np.flatnonzero(above <= clip)
        end = float(self.irradiance[allowed[0]]) if allowed.size else self.brightest
        return min(self.brightest, end)

    def _below_lamps(self, end: float) -> float:
        """Return the brightest of the rest where that is apart from the lamps, else `end`.

        A range is a power of two, `LEAST_RANGE` at least: it is filled, but not made larger, and
        where unseen shadows decide it, it has no place.
        """
        if self.is_open:
            return end
        needed = self.needed_range(end)
        largest = end * max(LEAST_RANGE, 2.0 ** math.ceil(math.log2(needed))) / needed
        for light in self.irradiance[(self.irradiance >= end) & (self.irradiance <= largest)]:
            if self.share_above(light) - self.share_above(2 * light) <= _GAP_SHARE:
                return float(light)
        return end

    def upper_end(self, clip: float | None, dynamic_range: float | None) -> float:
        """Return the light that just saturates the shortest exposure.

        Args:
            clip: share of the samples that may clip; None: lamps and reflections, see `LAMP_SHARE`
            dynamic_range: a given range: no more clips than is needed for the shadows to be in it;
                None: the scene decides it
        """
        if clip is not None:
            return self.highlights(clip) if clip else self.brightest
        end = self.highlights(LAMP_SHARE)
        if end * GAINED_FACTOR > self.brightest or dynamic_range == math.inf:
            return self.brightest
        end = self._below_lamps(end)
        if dynamic_range is None:
            return end
        return min(self.brightest, max(end, self.shadows * dynamic_range))

    def needed_from(self, shortest: ExposureSetting) -> float:
        """Return the range that holds the light, where `shortest` is the shortest exposure."""
        return self.needed_range(self.saturating(shortest.exposure))

    def needed_range(self, upper_end: float) -> float:
        """Return the range from `upper_end` down to the shadows, with a margin for noise."""
        return _MARGIN * upper_end / self.shadows


def counts_in_stops(irradiance: FloatArray, weights: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the sum of the weights in each bin of a histogram over log2 of the irradiance.

    Args:
        irradiance: (K,); what is beyond the edges counts in the first or the last bin
        weights: (K,), such as numbers of samples
        edges: (N + 1,) ascending, stops
    """
    stops = np.clip(np.log2(np.maximum(irradiance, 1e-12)), edges[0], edges[-1])
    return np.asarray(np.histogram(stops, edges, weights=weights)[0])
