"""Whether two frames of a still scene have the exposures that are assumed: by their pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
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
