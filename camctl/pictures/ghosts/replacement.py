"""Pictures whose places where things moved are as single frames show them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.model.light import Floats32
from camctl.pictures.single_light import SingleLight, least_light

#: Cells have 4 x 4 parts, of 2 x 2 pixels at least, in which a frame is compared with all frames.
COMPARED = 4
#: Weights whose sum is 1 may be so much less by the rounding of float32.
_ROUNDED = 1e-6

_Between = tuple[NDArray[np.intp], NDArray[np.intp], Floats32]
_Mask = NDArray[np.bool_]


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

    def weights(self, rows: slice, columns: int) -> Iterator[tuple[int, Floats32, Floats32]]:
        """Yield the frames shown in some rows, their share in each pixel, and their certainty.

        Both are (rows, columns), and interpolated linearly between the middles of cells.
        """
        pixels = np.arange(rows.start, rows.stop), np.arange(columns)
        cells, parts = (
            [
                _interpolation(each, self.cell / count, length * count)
                for each, length in zip(pixels, self.labels.shape, strict=True)
            ]
            for count in (1, COMPARED)
        )
        near = self.labels[cells[0][0].min() : cells[0][1].max() + 1]
        for frame in np.unique(near[near >= 0]).tolist():
            weight = _enlarged((self.labels == frame).astype(np.float32), *cells)
            yield frame, weight, _enlarged(self.certainty[frame], *parts)

    def replaced(
        self,
        frames: Sequence[Pixels],
        rows: slice,
        light: Floats32,
        deviation: Floats32,
        *,
        scale: float = 1.0,
    ) -> tuple[Floats32, Floats32, _Mask]:
        """Return light and its deviation with single frames where things moved, and where.

        Where a frame is saturated, and all of them show more light, these are believed.  The
        deviation is the frame's, also where all frames have a share by its lack of certainty.

        Args:
            frames: these rows of each, black included
            rows: of the frame
            light: from all frames, in the shape of a frame
            deviation: of it, likewise
            scale: of `light` over the unit of the pictures
        """
        shape, channels = light.shape, light.shape[2:]
        total = np.zeros(shape[:2], np.float32)
        parts = list(self.weights(rows, shape[1]))
        for _, weight, _ in parts:
            total += weight
        some = total > 0
        places = np.nonzero(some)
        if not places[0].size:
            return light, deviation, some
        least = np.float32(least_light(self.lights) * scale)
        before, error_before = np.maximum(light[places], least), deviation[places]
        rest = (np.float32(1) - total[places]).reshape(-1, *[1] * len(channels))
        rest[rest < _ROUNDED] = 0
        logarithm = np.log(before)
        found = logarithm.copy()
        relative = _times(rest, np.asarray(error_before / before))
        for frame, weight, certainty in parts:
            share = weight[places].reshape(rest.shape)
            single, error = self._of_frame(frame, frames[frame], places, rows.start)
            single *= np.float32(scale)
            error *= np.float32(scale)
            np.maximum(single, least, out=single)
            brighter = np.isinf(error) & (before > single)
            single[brighter], error[brighter] = before[brighter], error_before[brighter]
            believed = share * certainty[places].reshape(rest.shape)
            found += believed * (np.log(single) - logarithm)
            relative += _times(share, error / single)
        result, errors = light.copy(), deviation.copy()
        result[places] = np.exp(found)
        errors[places] = relative * result[places]
        return result, errors, some

    def _of_frame(
        self, frame: int, pixels: Pixels, places: tuple[NDArray[np.intp], ...], first: int
    ) -> tuple[Floats32, Floats32]:
        """Return the light of a frame and its deviation at some places, (N,) or (N, channels)."""
        size = (places[0].size, *pixels.shape[2:])
        light, deviation = np.empty(size, np.float32), np.empty(size, np.float32)
        for single, chosen, values in _parts_at(self.lights, pixels, places, first):
            clipped = np.minimum(values, single.irradiance.shape[1] - 1)
            light[chosen] = single.irradiance[frame].take(clipped)
            deviation[chosen] = single.deviation[frame].take(clipped)
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
