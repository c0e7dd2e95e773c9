"""The light of a picture at the size of its preview, reduced strip by strip."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.pictures.development import Development
from camctl.pictures.render import DARK, SATURATED, Strip
from camctl.system.picture_operations import reduced_by_area

PREVIEW_SIDE = 2560
"""Longest side of the preview, pixels."""

ALL = 255
"""All samples, as a share in `Light`."""

Floats = NDArray[np.float32]

#: Light that counts as none.
NO_LIGHT = np.float32(1e-30)
#: The noise counts as this share of the light at most: its logarithm is no longer normal.
_LARGEST_NOISE = 2.0
#: Irradiance that is saturated is rounded by less than this share, see `render`.
_ROUNDED = 2.0**-8


@dataclass(frozen=True, eq=False)
class Light:
    """The light of a picture, reduced in size.

    Attributes:
        irradiance: float32, (rows, columns, 1 or 3)
        noise: predicted standard deviation / irradiance, at most 2, in its shape
        saturated: share of the samples that are saturated, of the channel with most of them; as the
            following ones uint8, 255 = all, (rows, columns)
        dark: share of the samples that are too dark
        unlit: share of the samples without any light
        white: share of the pixels of which every channel is saturated
        development: how the camera developed its pictures; None: it did not
    """

    irradiance: Floats
    noise: Floats
    saturated: NDArray[np.uint8]
    dark: NDArray[np.uint8]
    unlit: NDArray[np.uint8]
    white: NDArray[np.uint8]
    development: Development | None = field(default=None, kw_only=True)


class LightReducer:
    """Reduces the strips of a picture to at most so many pixels a side, by averages.

    Args:
        rows: of the picture
        columns: of the picture
        full: least irradiance of samples that every frame saturated
        side: most pixels a side; None: `PREVIEW_SIDE`
        development: see `Light`
    """

    def __init__(
        self,
        rows: int,
        columns: int,
        full: float,
        side: int | None = None,
        development: Development | None = None,
    ) -> None:
        # What is saturated was rounded to so many bits as noise allows.
        self._full = np.float32(full * (1 - _ROUNDED))
        self._step = -(-max(rows, columns) // (side or PREVIEW_SIDE))
        self._shape = max(1, rows // self._step), max(1, columns // self._step)
        self._rest: tuple[NDArray[Any], ...] = ()
        self._light: Light | None = None
        self._development = development
        self._done = 0

    def add(self, strip: Strip) -> None:
        """Take the next strip, from top to bottom."""
        # Noise that is not known counts as none, and light that may be saturated is not noise.
        deviation = tuple(
            sd if np.isfinite(sd.max()) else np.where(np.isfinite(sd), sd, np.float32(0))
            for sd in strip.deviation
        )
        none = np.zeros(strip.mask[0].shape, np.bool_)
        flags = [int(np.bitwise_or.reduce(mask, axis=None)) for mask in strip.mask]
        saturated, dark = (
            [
                (mask & bit) != 0 if some & bit else none
                for mask, some in zip(strip.mask, flags, strict=True)
            ]
            for bit in (SATURATED, DARK)
        )
        white = none
        if any(some & SATURATED for some in flags):
            pairs = zip(saturated, deviation, strict=True)
            deviation = tuple(np.where(full, np.float32(0), sd) for full, sd in pairs)
            # The mask of a mosaic does not say which of its channels is saturated.
            white = reduce(np.minimum, strip.light) >= self._full
        unlit = [none if light.min() > 0 else light <= 0 for light in strip.light]
        parts = (*strip.light, *deviation, *saturated, _counts(dark), _counts(unlit), white)
        if self._rest:
            missing = self._step - len(self._rest[0])
            pairs = zip(self._rest, parts, strict=True)
            self._add(tuple(np.concatenate((rest, part[:missing])) for rest, part in pairs))
            parts = tuple(part[missing:] for part in parts)
        if not self._rest:
            self._add(parts)

    def _add(self, parts: tuple[NDArray[Any], ...]) -> None:
        """Reduce the rows of these parts that are whole, and keep the rest."""
        whole = len(parts[0]) // self._step
        used = whole * self._step
        self._rest = tuple(part[used:].copy() for part in parts) if used < len(parts[0]) else ()
        if whole:
            self._reduce(parts, whole)

    def light(self) -> Light:
        """Return the light of all strips."""
        if self._light is None:  # fewer rows than are averaged
            self._reduce(self._rest, 1)
        assert self._light is not None
        return self._light

    def _reduce(self, parts: tuple[NDArray[Any], ...], rows: int) -> None:
        """Reduce these rows of the light of each channel, its deviation, and the flags."""
        channels = (len(parts) - 3) // 3
        if self._light is None:
            shape = (*self._shape, channels)
            irradiance, noise = np.empty(shape, np.float32), np.empty(shape, np.float32)
            shares = (np.empty(self._shape, np.uint8) for _ in range(4))
            self._light = Light(irradiance, noise, *shares, development=self._development)
        light, place = self._light, slice(self._done, self._done + rows)
        self._done += rows
        for channel in range(channels):
            mean = self._mean(parts[channel], rows)
            light.irradiance[place][..., channel] = mean
            # The errors of neighbouring pixels are independent.
            error = self._mean(parts[channels + channel], rows) / np.float32(self._step)
            error /= np.maximum(mean, NO_LIGHT)
            np.minimum(error, _LARGEST_NOISE, out=light.noise[place][..., channel])
        *saturated, dark, unlit, white = parts[2 * channels :]
        light.saturated[place] = reduce(np.maximum, [self._share(each, rows) for each in saturated])
        light.dark[place] = self._share(dark, rows, channels)
        light.unlit[place] = self._share(unlit, rows, channels)
        light.white[place] = self._share(white, rows)

    def _share(self, counts: NDArray[Any], rows: int, most: int = 1) -> NDArray[Any]:
        """Return the means of counts up to `most`, which becomes `ALL`."""
        if not counts.any():
            return np.zeros((rows, self._shape[1]), np.uint8)
        return self._mean(counts.view(np.uint8) * np.uint8(ALL // most), rows)

    def _mean(self, part: NDArray[Any], rows: int) -> NDArray[Any]:
        cut = part[: rows * self._step, : self._shape[1] * self._step]
        if self._step == 1:
            return cut
        size = (self._shape[1], rows)
        return reduced_by_area(np.ascontiguousarray(cut), size)


def _counts(flags: list[NDArray[np.bool_]]) -> NDArray[np.uint8]:
    """Return in how many channels each pixel has a flag."""
    if len(flags) == 1:
        return flags[0].view(np.uint8)
    return np.asarray(sum(flag.view(np.uint8) for flag in flags), np.uint8)


def largest_channel(values: NDArray[Any]) -> NDArray[Any]:
    """Return the largest channel; numpy's maximum over a short last axis is far slower."""
    return reduce(np.maximum, channels_of(values))


def channels_of(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return views of the channels."""
    return [values[..., channel] for channel in range(values.shape[2])]
