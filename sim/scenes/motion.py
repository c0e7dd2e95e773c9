"""What changes in a scene while a frame is exposed: lamps that are not steady, a moving target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]
Window = tuple[NDArray[np.float64], NDArray[np.float64]]

_STANDING_PX = 1e-3  # motion during an exposure below which a target is drawn without blur


@dataclass(frozen=True)
class Lamps:
    """Lamps that flicker: light is ``1 + depth cos(2 pi 2 mains t)`` times its mean.

    Lamps on alternating current peak twice a period: 100 times a second on 50 Hz mains.

    Attributes:
        mains_hz: frequency of the mains, 50 or 60
        depth: 0 to 1; about 0.1 for a bulb, 0.4 for a sodium lamp, up to 1 for a cheap LED
    """

    mains_hz: float
    depth: float

    @property
    def flicker_hz(self) -> float:
        """Peaks of the light a second."""
        return 2 * self.mains_hz

    def remaining_depth(self, time_s: float) -> float:
        """Return the depth of the flicker after averaging over an exposure, 0 to 1.

        The mean of ``depth cos`` over the exposure is ``depth sinc(f t)`` times a cosine.
        """
        return self.depth * abs(float(np.sinc(self.flicker_hz * time_s)))

    def swing(self, time_s: float) -> tuple[float, float]:
        """Return by which share of its mean the light of an exposure is less and more at most."""
        depth = self.remaining_depth(time_s)
        return depth, depth

    def steepest(self, time_s: float) -> float:
        """Return the largest change of `factors` for each second by which an exposure is later."""
        return 2 * np.pi * self.flicker_hz * self.remaining_depth(time_s)

    def factors(self, starts_s: NDArray[np.float64], time_s: float) -> Light:
        """Return the light in exposures that start at `starts_s`, relative to its mean."""
        middle = 2 * np.pi * np.mod(self.flicker_hz * (starts_s + time_s / 2), 1.0)
        swing = self.depth * np.sinc(self.flicker_hz * time_s)
        return np.asarray(1 + swing * np.cos(middle), dtype=np.float32)


@dataclass(frozen=True)
class PwmLamps:
    """Lamps that are switched on and off, as dimmed LEDs are (pulse-width modulation).

    Attributes:
        pwm_hz: periods a second
        duty: share of each period for which the lamps are on
        depth: share of the scene's mean light that is theirs
    """

    pwm_hz: float
    duty: float
    depth: float = 1.0

    def swing(self, time_s: float) -> tuple[float, float]:
        """Return by which share of its mean the light of an exposure is less and more at most.

        Of an exposure of n + r periods the lamps are on for ``n duty`` periods and, of the rest,
        for ``max(0, r + duty - 1)`` to ``min(r, duty)``.
        """
        periods = self.pwm_hz * time_s
        whole = math.floor(periods)
        rest = periods - whole
        mean = periods * self.duty
        least = whole * self.duty + max(0.0, rest + self.duty - 1)
        most = whole * self.duty + min(rest, self.duty)
        return self.depth * max(0.0, 1 - least / mean), self.depth * max(0.0, most / mean - 1)

    def steepest(self, time_s: float) -> float:
        """Return the largest change of `factors` for each second by which an exposure is later."""
        return self.depth / (self.duty * time_s)

    def factors(self, starts_s: NDArray[np.float64], time_s: float) -> Light:
        """Return the light in exposures that start at `starts_s`, relative to its mean."""
        periods = self.pwm_hz * time_s
        start = np.mod(self.pwm_hz * starts_s, 1.0)
        on = (self._on(start + periods) - self._on(start)) / (periods * self.duty)
        less, more = self.swing(time_s)
        factors = np.clip(1 + self.depth * (on - 1), 1 - less, 1 + more)
        return np.asarray(factors, dtype=np.float32)

    def _on(self, periods: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return for how many periods the lamps were on until `periods`."""
        whole = np.floor(periods)
        return whole * self.duty + np.minimum(periods - whole, self.duty)


@dataclass(frozen=True, eq=False)
class Target:
    """An object that moves along the rows and comes in again on the other side.

    Attributes:
        light: (h, w) or (h, w, 3) irradiance of its surface, in the scene's unit
        cover: (h, w) from 0 (transparent) to 1 (opaque)
        row: row of the picture that its first row is on
        column: position of its first column at time 0, pixels
        velocity_px_s: pixels a second to the right
    """

    light: Light
    cover: Light
    row: int
    column: float
    velocity_px_s: float

    @cached_property
    def most(self) -> float:
        """Largest irradiance of its surface."""
        return float(self.light.max())

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Largest change from one column to the next: of light x cover, and of cover."""
        cover = self.cover if self.light.ndim == 2 else self.cover[..., np.newaxis]
        return _largest_step(self.light * cover), _largest_step(cover)

    def scaled(self, light: Light) -> Target:
        """Return the target with the irradiance `light` instead."""
        return Target(light, self.cover, self.row, self.column, self.velocity_px_s)

    def draw(
        self,
        planes: Light,
        starts_s: NDArray[np.float64],
        time_s: float,
        *,
        is_blurred: bool,
    ) -> None:
        """Draw it into a picture, in place.

        Args:
            planes: (rows, columns[, 3]), the scene behind it
            starts_s: (rows,) when the exposure of each row starts
            time_s: exposure time
            is_blurred: draw the exact mean over the exposure; otherwise draw it where it is in the
                middle of the exposure
        """
        rows, columns = planes.shape[:2]
        height, width = self.cover.shape
        top, bottom = max(0, self.row), min(rows, self.row + height)
        if top >= bottom:
            return
        period = columns + width
        travelled = self.velocity_px_s * starts_s[rows // 2]
        origin = (self.column + width + travelled) % period - width
        ahead = self.velocity_px_s * (starts_s[top:bottom] - starts_s[rows // 2])
        first, last = origin + ahead, origin + ahead + self.velocity_px_s * time_s
        if not is_blurred:
            first = last = (first + last) / 2
        low = max(0, int(np.floor(min(first.min(), last.min()))) - 1)
        high = min(columns, int(np.ceil(max(first.max(), last.max()))) + width + 2)
        if low >= high:
            return
        here = slice(top - self.row, bottom - self.row)
        x = np.arange(low, high, dtype=np.float64)
        window = (x - first[:, np.newaxis], x - last[:, np.newaxis])
        surface = np.atleast_3d(self.light[here])
        layers = [surface[..., channel] * self.cover[here] for channel in range(surface.shape[2])]
        covered, *lit = _sampled([self.cover[here], *layers], window)
        # Rounding of the means may leave 0 to 1 by an ulp, and light must not become negative.
        behind = 1 - np.clip(covered, 0.0, 1.0)
        area = np.atleast_3d(planes[top:bottom, low:high])
        for channel, light in enumerate(lit):
            area[..., channel] = np.maximum(light, 0.0) + behind * area[..., channel]


def _sampled(layers: Sequence[Light], window: Window) -> list[NDArray[np.float64]]:
    """Return means of each row of layers, (h, w) each, linear between pixels and 0 outside.

    `window` is where each mean starts and ends, both (h, columns), in pixels of the layers.
    """
    padded = [np.pad(layer.astype(np.float64), [(0, 0), (1, 2)]) for layer in layers]
    most = layers[0].shape[1] + 1
    start, end = (np.clip(places + 1, 0, most) for places in window)
    # All means are over the same length; clipped ends lie in the padding, which is 0.
    travel = window[0] - window[1]
    if np.abs(travel).max() < _STANDING_PX:
        cells, part = _cells((start + end) / 2, padded[0].shape[1])
        return [_interpolated(each, cells, part) for each in padded]
    places = [_cells(each, padded[0].shape[1]) for each in (start, end)]
    found = []
    for each in padded:
        below = np.zeros_like(each)
        np.cumsum((each[:, 1:] + each[:, :-1]) / 2, axis=1, out=below[:, 1:])
        first, last = (_integral(each, below, *one) for one in places)
        found.append((first - last) / travel)
    return found


def _cells(places: NDArray[np.float64], width: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the numbers of the pixels below places in rows of so many, and the rest of each."""
    cells = places.astype(np.intp)
    part = places - cells
    cells += np.arange(len(cells))[:, np.newaxis] * width
    return cells, part


def _interpolated(
    padded: NDArray[np.float64], cells: NDArray[np.intp], part: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the values between pixels, linear."""
    left, right = padded.take(cells), padded.take(cells + 1)
    return np.asarray(left + part * (right - left))


def _integral(
    padded: NDArray[np.float64],
    below: NDArray[np.float64],
    cells: NDArray[np.intp],
    part: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the integral of each row up to places; `below` is the integral up to each pixel."""
    left, right = padded.take(cells), padded.take(cells + 1)
    return np.asarray(below.take(cells) + part * left + part**2 / 2 * (right - left))


def _largest_step(values: Light) -> float:
    """Return the largest change from one column to the next, 0 outside of the borders."""
    sides = [(0, 0), (1, 1), (0, 0)]
    return float(np.abs(np.diff(np.pad(np.atleast_3d(values), sides), axis=1)).max())
