"""Pictures whose places where things moved are as single frames show them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.model.light import Floats32
from camctl.pictures.single_light import SingleLight, least_light
from camctl.system.picture_operations import looked_up

#: Cells have 4 x 4 parts, of 2 x 2 pixels at least, in which a frame is compared with all frames.
COMPARED = 4
#: Weights whose sum is 1 may be so much less by the rounding of float32.
_ROUNDED = 1e-6

_Between = tuple[NDArray[np.intp], NDArray[np.intp], Floats32]


@dataclass(frozen=True, eq=False)
class Ghosts:
    """From which frame the places are where things moved.

    Attributes:
        labels: (cells down, cells across) int16, position of the frame; -1: from all frames
        cell: side of a cell, pixels
        certainty: (frames, `COMPARED` x cells down, likewise across) float32, share of what a
            frame shows otherwise than all frames together that is believed
        lights: of each frame, for each part of the samples
    """

    labels: NDArray[np.int16]
    cell: int
    certainty: Floats32
    lights: tuple[SingleLight, ...]

    @property
    def frames(self) -> tuple[int, ...]:
        """Positions of the frames that are shown somewhere by themselves."""
        return tuple(np.unique(self.labels[self.labels >= 0]).tolist())

    @property
    def share(self) -> float:
        """Share of the picture that is from single frames."""
        return float((self.labels >= 0).mean())

    def within(self, rows: slice, columns: int) -> GhostPlaces | None:
        """Return the pixels of some rows that single frames show; None where there are none.

        Shares and certainty are interpolated linearly between the middles of cells.
        """
        pixels = [np.arange(rows.start, rows.stop), np.arange(columns)]
        down, across = (
            _interpolation(each, self.cell, length)
            for each, length in zip(pixels, self.labels.shape, strict=True)
        )
        near = self.labels[down[0].min() : down[1].max() + 1]
        is_single = np.asarray((near >= 0).any(axis=0))
        reached = np.flatnonzero(is_single[across[0]] | is_single[across[1]])
        if not reached.size:
            return None
        first = int(reached[0])
        pixels[1] = pixels[1][first : int(reached[-1]) + 1]
        cells, parts = (
            [
                _interpolation(each, self.cell / count, length * count)
                for each, length in zip(pixels, self.labels.shape, strict=True)
            ]
            for count in (1, COMPARED)
        )
        weights = {
            frame: _enlarged((self.labels == frame).astype(np.float32), *cells)
            for frame in np.unique(near[near >= 0]).tolist()
        }
        total = np.asarray(sum(weights.values()), np.float32)
        some = np.nonzero(total > 0)
        rest = 1 - total[some]
        rest[rest < _ROUNDED] = 0
        shares = {
            frame: (weight[some], _enlarged(self.certainty[frame], *parts)[some])
            for frame, weight in weights.items()
        }
        return GhostPlaces((some[0], some[1] + first), rows.start, self.lights, rest, shares)


@dataclass(frozen=True, eq=False)
class GhostPlaces:
    """Pixels of some rows that single frames show.

    Attributes:
        places: their row, from the first one of these, and column, (N,) each
        first: the first row
        lights: of each frame, for each part of the samples
        rest: share of all frames together, (N,)
        shares: for each frame its share, and its certainty, (N,) each
    """

    places: tuple[NDArray[np.intp], NDArray[np.intp]]
    first: int
    lights: tuple[SingleLight, ...]
    rest: Floats32
    shares: dict[int, tuple[Floats32, Floats32]]
    _seen: dict[int, tuple[Floats32, Floats32]] = field(default_factory=dict, init=False)

    def show(
        self,
        frames: Sequence[Pixels],
        light: Floats32,
        deviation: Floats32 | None = None,
        *,
        scale: float = 1.0,
    ) -> None:
        """Replace light and its deviation by those of single frames.

        Where a frame is saturated, and all of them show more light, these are believed.  The
        deviation is the frame's, also where all frames have a share by its lack of certainty.

        Args:
            frames: the rows of each, black included
            light: from all frames, in the shape of a frame
            deviation: of it, likewise; None: it is of no interest
            scale: of `light` over the unit of the pictures
        """
        places, shape = self.places, (-1, *[1] * (light.ndim - 2))
        least = np.float32(least_light(self.lights) * scale)
        before = np.maximum(light[places], least)
        error_before = np.zeros_like(before) if deviation is None else deviation[places]
        logarithm = np.log(before)
        found = logarithm.copy()
        relative = _times(self.rest.reshape(shape), np.asarray(error_before / before))
        for frame, (weight, certainty) in self.shares.items():
            share = weight.reshape(shape)
            alone, error = self._of_frame(frame, frames[frame])
            single = np.maximum(alone * np.float32(scale), least)
            brighter = np.isinf(error) & (before > single)
            single[brighter] = before[brighter]
            found += share * certainty.reshape(shape) * (np.log(single) - logarithm)
            if deviation is not None:
                error = np.where(brighter, error_before, error * np.float32(scale))
                relative += _times(share, error / single)
        light[places] = shown = np.exp(found)
        if deviation is not None:
            deviation[places] = relative * shown

    def _of_frame(self, frame: int, pixels: Pixels) -> tuple[Floats32, Floats32]:
        """Return the light of a frame and its deviation, (N,) or (N, channels)."""
        if frame in self._seen:  # the image shows the same pixels as the light
            return self._seen[frame]
        size = (self.places[0].size, *pixels.shape[2:])
        light, deviation = np.empty(size, np.float32), np.empty(size, np.float32)
        for single, chosen, values in _parts_at(self.lights, pixels, self.places, self.first):
            clipped = np.minimum(values, values.dtype.type(single.irradiance.shape[1] - 1))
            light[chosen] = looked_up(single.irradiance[frame], clipped)
            deviation[chosen] = looked_up(single.deviation[frame], clipped)
        self._seen[frame] = light, deviation
        return light, deviation


def _parts_at(
    lights: Sequence[SingleLight],
    pixels: Pixels,
    places: tuple[NDArray[np.intp], ...],
    first: int,
) -> Iterator[tuple[SingleLight, Any, NDArray[Any]]]:
    """Yield each part, which of the samples at places it has, and their values."""
    if pixels.ndim == 3:
        for channel, single in enumerate(lights):
            yield single, (slice(None), channel), pixels[(*places, channel)]
        return
    if len(lights) == 1:
        yield lights[0], slice(None), pixels[places]
        return
    for row in (0, 1):
        for column in (0, 1):
            chosen = ((places[0] + first) % 2 == row) & (places[1] % 2 == column)
            yield lights[2 * row + column], chosen, pixels[tuple(each[chosen] for each in places)]


def _times(weight: Floats32, values: Floats32) -> Floats32:
    """Return products that are 0 where the weight is, also of infinity."""
    weights = np.broadcast_to(weight, values.shape)
    return np.multiply(weights, values, where=weights > 0, out=np.zeros_like(values))


def _enlarged(values: Floats32, down: _Between, across: _Between) -> Floats32:
    """Return values at pixels, interpolated linearly."""
    return np.ascontiguousarray(_between(_between(values, *down).T, *across).T)


def _between(
    values: Floats32, low: NDArray[np.intp], high: NDArray[np.intp], weight: Floats32
) -> Floats32:
    """Return rows of values, interpolated."""
    share = weight[:, np.newaxis]
    return np.asarray(values[low] * (1 - share) + values[high] * share)


def _interpolation(pixels: NDArray[np.intp], cell: float, count: int) -> _Between:
    """Return the two cells between whose middles pixels are, and the weight of the second one."""
    at = np.clip((pixels + 0.5) / cell - 0.5, 0, count - 1)
    low = at.astype(np.intp)
    return low, np.minimum(low + 1, count - 1), (at - low).astype(np.float32)
