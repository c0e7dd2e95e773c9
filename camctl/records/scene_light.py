"""Which light of a scene a picture holds: what may clip at its upper end, and how far it goes down.

The scene's light comes as a histogram of the metering frames.  Nothing clips unless light that
covers little of the picture is far brighter than the rest, as lamps and reflections are, or the
user says how much may clip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camctl.model.response.camera import FloatArray

DARK_SHARE = 0.01
"""Share of the samples, the darkest, that may be below the range that the scene decides."""

LAMP_SHARE = 0.005
"""Share of the samples, the brightest, that clips unless the request says how much: street lamps
and reflections cover 0.1 % to 0.3 % of a picture, a window covers more."""

NOTABLE_SHARE = 5e-4
"""Share of the samples from which the line on the metered light names what the picture lacks."""

LAMP_FACTOR = 4.0
"""They clip only if they are this many times as bright as the rest, so that the range gains two
stops."""

#: Lamps are apart from the rest where the stop between them has fewer samples than this share.
_GAP_SHARE = 1e-5

LEAST_RANGE = 16.0
"""A smaller one would show noise as contrast."""

#: Where the metering frames cannot tell the shadows from black, these are assumed to be darker by
#: so many stops at least and at most.
_LEAST_UNSEEN_STOPS, _MOST_UNSEEN_STOPS = 1.0, 4.0
#: The range is larger than what it must hold by this factor, for the noise of the metering.
_MARGIN = 1.05


@dataclass(frozen=True, eq=False)
class SceneLight:
    """Histogram of the light of a scene.

    Attributes:
        irradiance: (K,) ascending; E = 1 saturates an exposure of `Metering.limit_s`
        shares: (K,) of the samples, sum 1
        darkest: less light is the same as none in the metering frames
        brightest: the highlights, without hot pixels
    """

    irradiance: FloatArray
    shares: FloatArray
    darkest: float
    brightest: float = 1.0

    def relative_to(self, E: float) -> SceneLight:
        """Return the same histogram in units of E."""
        return SceneLight(self.irradiance / E, self.shares, self.darkest / E, self.brightest / E)

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
        stops = unseen / max(in_stop, unseen / _MOST_UNSEEN_STOPS)
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
        if end * LAMP_FACTOR > self.brightest or dynamic_range == math.inf:
            return self.brightest
        end = self._below_lamps(end)
        if dynamic_range is None:
            return end
        return min(self.brightest, max(end, self.shadows * dynamic_range))

    def needed_range(self, upper_end: float) -> float:
        """Return the range from `upper_end` down to the shadows, with a margin for noise."""
        return _MARGIN * upper_end / self.shadows


@dataclass(frozen=True)
class PlannedLight:
    """The metered light of a scene, and how much of it the picture will hold.

    Attributes:
        span: ratio of the highlights to the light that the darkest hundredth is below
        is_open: whether the shadows are darker than metering could tell: then the scene spans more
        clips: share of the samples that will be saturated in every frame
        clips_stops: how far the brightest of them are above the range, stops
        dark: share of the samples that will be darker than the range, or than the frames can show,
            where the unseen ones are just too dark for the metering; at most `unseen` more are
        needed: the range that would hold the light; larger than the planned one where the camera
            does not hold it at the accuracy asked for
        needed_levels: effective levels that `needed` would have; None where it is planned, or
            where they are not known
        unseen: share of the samples that metering could not tell from black
        is_cut: whether the brightest light saturates the camera's shortest exposure: then, too, the
            scene spans more
        advice: what to do where light is darker than the range; None where none is known
        bright_advice: the same where light is brighter
    """

    span: float
    is_open: bool
    clips: float
    clips_stops: float
    dark: float
    needed: float
    needed_levels: float | None = None
    unseen: float = 0.0
    is_cut: bool = False
    advice: str | None = None
    bright_advice: str | None = None
