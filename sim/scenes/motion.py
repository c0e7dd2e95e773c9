"""What changes in a scene while a frame is exposed: lamps on the mains, and a moving target."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError

Light = NDArray[np.float32]
Window = tuple[NDArray[np.float64], NDArray[np.float64]]

_STANDING_PX = 1e-3  # a target that moves less in an exposure stands still


@dataclass(frozen=True)
class Lamps:
    """Lamps that flicker: light is ``1 + depth cos(2 pi 2 mains t)`` times its mean.

    Lamps on alternating current shine at both half waves: 100 Hz on 50 Hz mains.

    Attributes:
        mains_hz: of the mains, 50 or 60
        depth: 0 to 1; about 0.1 for a bulb, 0.4 for a sodium lamp, up to 1 for a cheap LED
    """

    mains_hz: float
    depth: float

    def __post_init__(self) -> None:
        if not (0 < self.mains_hz < 1e6 and 0 <= self.depth <= 1):
            raise DataError(
                f"lamps at {self.mains_hz:g} Hz with depth {self.depth:g}",
                hint="mains_hz is 50 or 60, depth is 0 to 1",
            )

    @property
    def flicker_hz(self) -> float:
        """How often a second the light peaks."""
        return 2 * self.mains_hz

    def left(self, time_s: float) -> float:
        """Return how much of the flicker an exposure of `time_s` does not average out, 0 to 1.

        The mean of ``depth cos`` over the exposure is ``depth sinc(f t)`` times a cosine.
        """
        return self.depth * abs(float(np.sinc(self.flicker_hz * time_s)))

    def factors(self, starts_s: NDArray[np.float64], time_s: float) -> Light:
        """Return the light of exposures that start at `starts_s`, 1 on average."""
        middle = 2 * np.pi * np.mod(self.flicker_hz * (starts_s + time_s / 2), 1.0)
        swing = self.depth * np.sinc(self.flicker_hz * time_s)
        return np.asarray(1 + swing * np.cos(middle), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Target:
    """A thing that moves along the rows before the scene, and comes in again where it has left.

    Attributes:
        light: (h, w) or (h, w, 3) irradiance of its surface, in the scene's unit
        cover: (h, w) from 0 (not there) to 1
        row: of its first row in the picture
        column: of its first column at time 0, pixels
        velocity_px_s: to the right, pixels a second
    """

    light: Light
    cover: Light
    row: int
    column: float
    velocity_px_s: float

    @cached_property
    def most(self) -> float:
        """Brightest irradiance."""
        return float(self.light.max())

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Largest change from one column to the next, of light x cover and of cover."""
        cover = self.cover if self.light.ndim == 2 else self.cover[..., np.newaxis]
        return _steepest(self.light * cover), _steepest(cover)

    def scaled(self, light: Light) -> Target:
        """Return the same target with another surface `light`."""
        return Target(light, self.cover, self.row, self.column, self.velocity_px_s)

    def draw(
        self,
        planes: Light,
        starts_s: NDArray[np.float64],
        time_s: float,
        *,
        is_blurred: bool,
    ) -> None:
        """Draw it into `planes` (rows, columns[, 3]), in place.

        Args:
            planes: the scene behind it
            starts_s: when the exposure of each row of the picture starts
            time_s: how long it lasts
            is_blurred: average over the exposure, exactly; else as it is in the middle of it
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
        cover = _seen(self.cover[here], window)
        area = planes[top:bottom, low:high]
        if planes.ndim == 2:
            lit = _seen(self.light[here] * self.cover[here], window)
            area[...] = lit + (1 - cover) * area
            return
        for channel in range(3):
            lit = _seen(self.light[here][..., channel] * self.cover[here], window)
            area[..., channel] = lit + (1 - cover) * area[..., channel]


def _seen(values: Light, window: Window) -> NDArray[np.float64]:
    """Return the mean of each row between two sets of places, linear between pixels, 0 outside."""
    padded = np.pad(values.astype(np.float64), [(0, 0), (1, 2)])
    start, end = (np.clip(places + 1, 0, values.shape[1] + 1) for places in window)
    # Both windows are as wide everywhere; the clipped ends lie in the padding, which is 0.
    travel = window[0] - window[1]
    if np.abs(travel).max() < _STANDING_PX:
        return _between(padded, (start + end) / 2)
    below = np.zeros_like(padded)
    np.cumsum((padded[:, 1:] + padded[:, :-1]) / 2, axis=1, out=below[:, 1:])
    return (_integral(padded, below, start) - _integral(padded, below, end)) / travel


def _between(padded: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    cell = places.astype(np.intp)
    part = places - cell
    left, right = (np.take_along_axis(padded, cell + k, axis=1) for k in (0, 1))
    return left + part * (right - left)


def _integral(
    padded: NDArray[np.float64], below: NDArray[np.float64], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    cell = places.astype(np.intp)
    part = places - cell
    left, right = (np.take_along_axis(padded, cell + k, axis=1) for k in (0, 1))
    before = np.take_along_axis(below, cell, axis=1)
    return np.asarray(before + part * left + part**2 / 2 * (right - left))


def _steepest(values: Light) -> float:
    """Return the largest change from one column to the next, nothing lying beyond the borders."""
    sides = [(0, 0), (1, 1), (0, 0)]
    return float(np.abs(np.diff(np.pad(np.atleast_3d(values), sides), axis=1)).max())
