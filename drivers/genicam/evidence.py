"""Whether two frames of a still scene have the exposures that are assumed: by their pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Frame, Pixels
from camctl.interface.controls import ExposureSetting
from camctl.model.response.camera import CameraResponse

#: Samples of a frame that are compared, about: noise averages out.
_SAMPLES = 1 << 14
#: Share of full scale that is added to both sides of a ratio: noise in the dark counts less.
_FLOOR = 0.01
#: Samples that are darker than so many floors in both frames show nothing.
_DARK = 3.0
#: At least this share of the samples has to show something.
_LEAST_SHARE = 0.02
#: Mean difference of the light, stops, up to which an assumption fits; another one that is to be
#: ruled out has `RULED_OUT` at least.  Steps of a third of a stop are distinguished.
FITS, RULED_OUT = 0.1, 0.25
#: Light from which a sample may be white.
_WHITE = 0.97
#: Settings differ where their exposures differ by more than this share.
SAME_EXPOSURE = 0.01


@dataclass(frozen=True, eq=False)
class Scale:
    """What samples stand for.

    Attributes:
        black, white: levels, DN
        irradiance: of each level from black to white, white is 1
    """

    black: int
    white: int
    irradiance: NDArray[np.float64]

    @classmethod
    def of(cls, black: int, white: int, response: CameraResponse) -> Self:
        """Return the scale of a camera with this response."""
        low, high = (np.asarray(each, np.float64) for each in response.gaps)
        middle = (low + high) / 2
        return cls(black, white, middle / middle[-1])

    def light(self, pixels: Pixels) -> NDArray[np.float64]:
        """Return the light of about `_SAMPLES` samples; white is 1."""
        step = max(1, int((pixels.size / _SAMPLES) ** 0.5))
        levels = pixels[::step, ::step].astype(np.intp).reshape(-1) - self.black
        return self.irradiance[np.clip(levels, 0, self.white - self.black)]

    def misfit(self, first: Pixels, second: Pixels, ratio: float) -> float:
        """Return how far the light of two frames is from a ratio of their exposures, stops.

        The darker frame predicts the brighter one, up to white.  Where both are white, or both are
        dark, any ratio fits: it is 0 where hardly a sample is left.
        """
        dark, bright = self.light(first), self.light(second)
        if ratio < 1:
            dark, bright, ratio = bright, dark, 1 / ratio
        expected = np.minimum(dark * ratio, 1.0)
        most = np.maximum(expected, bright)
        shows = (np.minimum(expected, bright) < _WHITE) & (most > _DARK * _FLOOR)
        if shows.sum() < _LEAST_SHARE * shows.size:
            return 0.0
        stops = np.log2((bright[shows] + _FLOOR) / (expected[shows] + _FLOOR))
        return abs(float(np.mean(stops)))


def differ(first: ExposureSetting, second: ExposureSetting) -> bool:
    """Return whether two settings have different exposures."""
    return abs(math.log(first.exposure / second.exposure)) > SAME_EXPOSURE


@dataclass(frozen=True)
class _Seen:
    pixels: Pixels
    applied: ExposureSetting
    stated: ExposureSetting


class StatedExposures:
    """Compares what frames state by their chunks with what was set; pixels decide.

    Cameras are known that state the exposure of the frame before (aravis#312), and that apply a
    setting to another frame than their control delay says.

    Args:
        scale: of the frames

    Attributes:
        is_late: the chunks belong to another frame, and are not used any more
    """

    def __init__(self, scale: Scale) -> None:
        self._scale = scale
        self._last: _Seen | None = None
        self._reference: _Seen | None = None  # the last frame whose exposure is known
        self.is_late = False

    def remember(self, frame: Frame) -> None:
        """Compare the next frames with this one, whose exposure is known."""
        self._reference = _Seen(frame.pixels, frame.applied, frame.applied)

    def begin(self) -> None:
        """Forget the frames of the sequence before: the scene may have changed."""
        self._last = None

    def judged(self, frame: Frame, stated: ExposureSetting | None) -> Frame:
        """Return a frame with the exposure that it has.

        Where it states another exposure than was set, and its pixels do not show which is true, it
        has the one that was set: the control delay was measured, or the stream has settled.
        """
        if stated is None or self.is_late:
            return frame
        last, self._last = self._last, _Seen(frame.pixels, frame.applied, stated)
        self._reference = self._last
        shown = {"stated_time_s": stated.time_s, "stated_gain": stated.gain}
        is_same = not differ(stated, frame.applied)
        if last is not None and not is_same:
            as_set = self._misfit(last.applied, frame.applied, last, frame)
            as_stated = self._misfit(last.stated, stated, last, frame)
            if as_set < FITS and as_stated > RULED_OUT:
                self.is_late = True
            elif as_stated < FITS and as_set > RULED_OUT:
                return replace(frame, applied=stated, details={**frame.details, **shown})
        return replace(frame, details={**frame.details, **shown}) if is_same else frame

    def proves(
        self, pixels: Pixels, setting: ExposureSetting, stated: ExposureSetting | None
    ) -> bool:
        """Return whether a frame has a setting: it states it, and its pixels show a new exposure.

        They are compared with the last frame whose exposure is known; where the scene has changed
        since, or the two exposures are alike, they show nothing.
        """
        known = self._reference
        if stated is None or known is None or self.is_late or differ(stated, setting):
            return False
        ratio = setting.exposure / known.applied.exposure
        is_new = self._scale.misfit(known.pixels, pixels, 1.0) > RULED_OUT
        return is_new and self._scale.misfit(known.pixels, pixels, ratio) < FITS

    def _misfit(
        self, before: ExposureSetting, after: ExposureSetting, last: _Seen, frame: Frame
    ) -> float:
        return self._scale.misfit(last.pixels, frame.pixels, after.exposure / before.exposure)


def first_in_order(
    frames: Sequence[Pixels], settings: Sequence[ExposureSetting], scale: Scale
) -> int | None:
    """Return which setting the first of n frames of a cycle of n settings has, by their pixels.

    None: no place in the cycle fits, or more than one does.
    """
    count = len(settings)
    errors = []
    for place in range(count):
        order = [settings[(place + k) % count] for k in range(count)]
        errors.append(
            max(
                scale.misfit(frames[k], frames[k + 1], order[k + 1].exposure / order[k].exposure)
                for k in range(count - 1)
            )
        )
    best = int(np.argmin(errors))
    others = [error for place, error in enumerate(errors) if place != best]
    is_decided = errors[best] < FITS and all(error > RULED_OUT for error in others)
    return best if is_decided else None
