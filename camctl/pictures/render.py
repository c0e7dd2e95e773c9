"""From the frames to irradiance, and from their sum to the image in the desired response.

Irradiance is estimated from all frames, see `camctl.pictures.frame_light`; a table turns each value
of the sum into the desired response.  A mosaic becomes irradiance first and is interpolated
afterwards, in linear light.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.movement import Movement
from camctl.evidence.residual import FrameRows
from camctl.interface.camera import Pixels
from camctl.interface.colour import CameraColour
from camctl.interface.controls import Layout
from camctl.model.inverse import Posterior
from camctl.model.response.desired import DesiredResponse
from camctl.model.sensor import SensorModel
from camctl.pictures.colour import deviation_in_bt709, in_gamut, to_bt709
from camctl.pictures.development import Development
from camctl.pictures.frame_light import FrameLight
from camctl.pictures.ghosts.replacement import GhostPlaces, Ghosts
from camctl.pictures.mosaic import (
    DEVIATION_BITS,
    LETTERS,
    MOST_BITS,
    Planes,
    demosaic,
    demosaic_deviation,
    demosaic_mask,
    rounded,
)
from camctl.system.picture_operations import (
    channels_apart,
    channels_together,
    looked_up,
    plane_by_plane,
)

#: Values of a mask: within the range, light below the range, saturated in every frame.
GOOD, DARK, SATURATED = 0, 1, 2
#: Bits of a mask: the frames contradict each other; the sample is from a hot pixel, or was
#: interpolated from one.
CONTRADICTING, HOT = 4, 8
#: Largest value of image.tiff.
FULL_CODE = 65535
#: Samples of a strip at most: its arrays are small beside the sum.
STRIP_SAMPLES = 1 << 21
#: Samples of all frames in a strip at most: with many frames, memory does not follow their number.
_FRAME_SAMPLES = 1 << 22
#: Rows of a strip at most: radiance.exr is compressed in blocks of 32, two of them at once.
_STRIP_ROWS = 64

#: Bits kept of the fraction of irradiance: as many as make the rounding 1/10 of the standard
#: deviation, which adds 0.5 % to it, from 8 (0.2 %) up.  Files are smaller, and are written in half
#: the time.
_LEAST_BITS, _ROUNDING = 8, 1 / 10


def encode(desired: DesiredResponse, E: NDArray[Any]) -> NDArray[np.uint16]:
    """Return the desired response to irradiance, 0 to `FULL_CODE`, in E's shape."""
    return np.rint(desired.u(E) * FULL_CODE).astype(np.uint16)


def sum_mask(posterior: Posterior) -> NDArray[np.uint8]:
    """Return for each value of the sum `GOOD`, `DARK` or `SATURATED`, black included.

    Dark is a sum that says that the light is below the desired range, or that shows no light.
    """
    mask = np.full(posterior.sum.top + 1, GOOD, np.uint8)
    mask[posterior.dark] = DARK
    mask[-1] = SATURATED
    return mask


@dataclass(frozen=True)
class Tables:
    """Code and mask for each value of the sum: arrays indexed by it, black included.

    Attributes:
        code: uint16, the desired response, 0 to `FULL_CODE`, as `Inverse.u`
        shown: float32, the irradiance of `code`, from which the image of a mosaic is interpolated
        mask: uint8, `GOOD`, `DARK` (light below the desired range) or `SATURATED` (in every frame)
        unlit: largest sum without light
        full: irradiance of a sum that is saturated in every frame
    """

    code: NDArray[np.uint16]
    shown: NDArray[np.float32]
    mask: NDArray[np.uint8]
    unlit: int
    full: float

    @classmethod
    def of(cls, posterior: Posterior) -> Tables:
        """Tabulate the inverse of the noisy sum."""
        u = posterior.inverse.u
        return cls(
            code=np.rint(u * FULL_CODE).astype(np.uint16),
            shown=posterior.desired.inverse(u).astype(np.float32),
            mask=sum_mask(posterior),
            unlit=posterior.sum.black,
            full=float(posterior.sum.camera.levels[-1]),
        )


@dataclass(frozen=True)
class Strip:
    """Some rows of the pictures.

    Attributes:
        irradiance: of each channel, (rows, columns) float32, one channel or R, G and B
        light: `irradiance`, 0 where no frame shows light, and without hot pixels
        deviation: standard deviation of each channel, float32
        mask: of each channel, uint8
        code: of the image, (rows, columns) or (rows, columns, 3) uint16
        mosaic: the irradiance before it was interpolated, float32; None: there is no mosaic
    """

    irradiance: Planes
    light: Planes
    deviation: Planes
    mask: tuple[NDArray[np.uint8], ...]
    code: NDArray[np.uint16]
    mosaic: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Rendering:
    """How frames and their sum become pictures.

    Attributes:
        layout: pixel layout of the frames
        tables: code and mask for each value of the sum: one table, or three for R, G, B
        desired: desired response of the image
        light: estimates the irradiance
        frames: returns rows of each of the frames
        count: number of frames
        hot_pixels: (row, column) of pixels that have the mask `HOT`; the image has the median of
            their neighbours of the same colour in their place, the irradiance stays as it is
        movement: where the frames contradict each other; such samples have the mask
            `CONTRADICTING`
        colour: turns R, G and B into linear BT.709; None: they stay as they are
        ghosts: places that are from single frames, since things moved; None: there are none
    """

    layout: Layout
    tables: tuple[Tables, ...]
    desired: DesiredResponse
    light: FrameLight
    frames: FrameRows
    count: int
    hot_pixels: tuple[tuple[int, int], ...] = ()
    movement: Movement | None = None
    colour: CameraColour | None = None
    ghosts: Ghosts | None = None

    @property
    def full(self) -> float:
        """The least irradiance in the pictures where every frame is saturated."""
        return min(table.full for table in self.tables) / self.light.unit

    @property
    def development(self) -> Development | None:
        """How the frames were developed; None: they were not."""
        if self.layout is not Layout.RGB or self.colour is None or self.colour.xyz_to_camera:
            return None
        responses = [part.response for part, _ in self.light.parts]
        curves = [SensorModel(each, self.light.white - each.M).light for each in responses]
        return Development(tuple(curves), self.colour)

    @cached_property
    def deviations_are_halves(self) -> bool:
        """Whether float16 has all standard deviations of the pictures.

        Below 2^-14 it has multiples of 2^-24, which changes 2^-20 by at most 1/32; the deviations
        of few samples, as between levels that nearly coincide, are less than `deviations` says.
        """
        least, most = self.light.deviations
        # Interpolation at most halves a deviation.
        halved = 2 if self.layout.is_mosaic else 1
        return bool(least / halved >= 2.0**-20 and most * 2 <= float(np.finfo(np.float16).max))

    @cached_property
    def lights_are_halves(self) -> bool:
        """Whether float16 has all irradiance of the pictures.

        Of that below 2^-14 it has multiples of 2^-24, which are far closer than the deviations of
        `deviations_are_halves`.
        """
        if self._bits > np.finfo(np.float16).nmant or not self.deviations_are_halves:
            return False
        most = max(float(part.response.levels[-1]) for part, _ in self.light.parts)
        if self.converts:
            assert self.colour is not None
            gains = np.abs(self.colour.matrix).sum(axis=1) * max(self.colour.white_balance)
            most *= float(gains.max())
        # An estimate beside saturated samples may be above full scale, by a deviation.
        return bool(2 * most / self.light.unit <= float(np.finfo(np.float16).max))

    @cached_property
    def _bits(self) -> int:
        """Bits of the fraction of irradiance: the rounding is at most 2^-bits / sqrt(12) of it."""
        least = self.light.least_relative * _ROUNDING * math.sqrt(12)
        bits = math.ceil(-math.log2(least)) if least > 0 else MOST_BITS
        return min(MOST_BITS, max(_LEAST_BITS, bits))

    @property
    def channels(self) -> str:
        """Names of the channels: "Y" or "RGB"."""
        return "Y" if self.layout is Layout.MONO else LETTERS

    def picture_shape(self, total: NDArray[np.unsignedinteger]) -> tuple[int, ...]:
        """Return the shape of the pictures: (rows, columns) or (rows, columns, 3)."""
        return total.shape[:2] if self.layout is Layout.MONO else (*total.shape[:2], 3)

    def strip_rows(self, total: NDArray[np.unsignedinteger]) -> int:
        """Return the rows of a strip, a multiple of 8: no block of a JPEG file spans two."""
        row_samples: int = total.shape[1] * len(self.channels)
        of_frames: int = _FRAME_SAMPLES // (total[0].size * self.count)
        return min(_STRIP_ROWS, max(8, min(STRIP_SAMPLES // row_samples, of_frames) & ~7))

    def strips(self, total: NDArray[np.unsignedinteger]) -> Iterator[Callable[[], Strip]]:
        """Yield what makes the pictures of a sum, from top to bottom, `strip_rows` rows at a time.

        Several threads may call what is yielded.
        """
        height, rows = total.shape[0], self.strip_rows(total)
        self.light.load(total.size)
        shown, hot = self._without_hot_pixels(total)
        for start in range(0, height, rows):
            yield partial(self._strip, total, shown, hot, slice(start, min(start + rows, height)))

    def _strip(
        self,
        total: NDArray[np.unsignedinteger],
        shown: NDArray[np.unsignedinteger],
        hot: NDArray[np.uint8] | None,
        rows: slice,
    ) -> Strip:
        """Return these rows of the pictures; `shown` and `hot` as of hot pixels."""
        # A mosaic is interpolated from its neighbouring rows, too.
        border = 2 if self.layout.is_mosaic else 0
        first, last = max(0, rows.start - border), min(len(total), rows.stop + border)
        is_as_shown = shown is total
        sums = plane_by_plane(total[first:last])
        shown = sums if is_as_shown else plane_by_plane(shown[first:last])
        marks = [] if hot is None else [hot[first:last]]
        if self.movement is not None:
            marks.append(self.movement.rows(first, last) * np.uint8(CONTRADICTING))
        frames = [self.frames(place, slice(first, last)) for place in range(self.count)]
        estimate, deviation = self.light.rows(frames, sums)
        mask, part = self._values("mask", sums), slice(first, last)
        marked = None if hot is None else hot[part]
        moved = None if self.ghosts is None else self.ghosts.within(part, total.shape[1])
        if moved is not None:
            moved.show(frames, estimate, deviation)
            mask[moved.places] = self._single_mask(estimate[moved.places], deviation[moved.places])
        bare = self._bare(estimate, sums, shown, marked)
        if self.layout.is_mosaic:
            inner = slice(rows.start - first, rows.stop - first)
            found = estimate, bare, deviation
            coded = self._coded(shown, marked, frames, moved)
            strip = self._mosaic_strip(mask, coded, found, marks, first, inner)
            return replace(strip, mosaic=bare[inner])
        for more in marks:
            mask |= plane_by_plane(more)
        masks = channels_apart(mask)
        if self.converts:
            coded = self._coded(shown, marked, frames, moved)
            lights = channels_apart(estimate), channels_apart(bare), channels_apart(deviation)
            return self._converted(*lights, masks, channels_apart(coded))
        irradiance = tuple(rounded(each, self._bits) for each in channels_apart(estimate))
        light = irradiance if bare is estimate else channels_apart(bare)
        code = self._values("code", shown)
        if moved is not None:
            coded = self._coded(shown, marked, frames, moved)
            code[moved.places] = encode(self.desired, coded[moved.places])
        errors = tuple(rounded(each, DEVIATION_BITS) for each in channels_apart(deviation))
        return Strip(irradiance, light, errors, masks, channels_together(channels_apart(code)))

    def _coded(
        self,
        shown: NDArray[np.unsignedinteger],
        hot: NDArray[np.uint8] | None,
        frames: list[Pixels],
        moved: GhostPlaces | None,
    ) -> NDArray[np.float32]:
        """Return the irradiance that the image shows, in a frame's shape."""
        coded = np.asarray(self._values("shown", shown))
        if moved is None:
            return coded
        all_frames = None if hot is None else coded.copy()
        moved.show(frames, coded, scale=self.light.unit)
        if hot is not None and all_frames is not None:  # they have the light of their neighbours
            is_hot = hot.reshape(*coded.shape[:2], -1).any(axis=2)
            coded[is_hot] = all_frames[is_hot]
        return coded

    def _single_mask(
        self, light: NDArray[np.float32], deviation: NDArray[np.float32]
    ) -> NDArray[np.uint8]:
        """Return the mask of light that single frames show."""
        dark = light * np.float32(self.light.unit) < np.float32(self.desired.e_min)
        return np.where(np.isinf(deviation), SATURATED, np.where(dark, DARK, GOOD)).astype(np.uint8)

    @property
    def converts(self) -> bool:
        """Whether colours become those of BT.709; some of their irradiance is negative then."""
        return self.colour is not None and not self.colour.is_identity and self.channels != "Y"

    def _converted(
        self,
        irradiance: Planes,
        light: Planes,
        deviation: Planes,
        mask: tuple[NDArray[np.uint8], ...],
        shown: Planes,
    ) -> Strip:
        """Return a strip in linear BT.709; irradiance and what is shown are the camera's R, G, B.

        Irradiance of a colour outside of BT.709 has negative channels.
        """
        assert self.colour is not None
        full = [table.full / self.light.unit for table in self.tables] * (3 // len(self.tables))
        found = to_bt709(self.colour, irradiance, full)
        lit = found if light is irradiance else to_bt709(self.colour, light, full)
        code = to_bt709(self.colour, shown, (1.0,) * 3)
        return Strip(
            tuple(rounded(each, self._bits) for each in found),
            in_gamut(lit, light),
            tuple(
                rounded(each, DEVIATION_BITS) for each in deviation_in_bt709(self.colour, deviation)
            ),
            mask,
            encode(self.desired, channels_together(code)),
        )

    def _bare(
        self,
        estimate: NDArray[np.float32],
        sums: NDArray[np.unsignedinteger],
        shown: NDArray[np.unsignedinteger],
        hot: NDArray[np.uint8] | None,
    ) -> NDArray[np.float32]:
        """Return irradiance without that of hot pixels, and 0 where no frame shows light.

        `estimate` itself is returned where that is the same.
        """
        unlit = sums <= max(table.unlit for table in self.tables)
        if hot is None and not unlit.any():
            return estimate
        found = np.where(unlit, np.float32(0), estimate)
        if hot is not None and hot.any():
            places = hot > 0
            found[places] = self.tables[0].shown.take(shown[places]) / np.float32(self.light.unit)
        return found

    def _mosaic_strip(
        self,
        values: NDArray[np.uint8],
        coded: NDArray[np.float32],
        light: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
        marks: list[NDArray[np.uint8]],
        first: int,
        inner: slice,
    ) -> Strip:
        """Return the `inner` rows of these of a mosaic, which begin at row `first` of the frame.

        `values` are the mask of the samples, `coded` the irradiance of the image; `light` is
        irradiance, the same without hot pixels, and its standard deviation.
        """

        def colours(values: NDArray[np.float32], bits: int) -> Planes:
            planes = demosaic(values, self.layout, first, bits)
            return tuple(each[inner] for each in planes)

        estimate, bare, error = light
        deviation = demosaic_deviation(error, self.layout, first)
        mask = demosaic_mask(values)
        for more in marks:  # each by itself: of several values the largest spreads
            mask |= demosaic_mask(more)
        irradiance = colours(estimate, self._bits)
        if self.converts:
            return self._converted(
                irradiance,
                irradiance if bare is estimate else colours(bare, self._bits),
                tuple(each[inner] for each in deviation),
                (mask[inner],) * 3,
                colours(coded, MOST_BITS),
            )
        return Strip(
            irradiance,
            irradiance if bare is estimate else colours(bare, self._bits),
            tuple(each[inner] for each in deviation),
            (mask[inner],) * 3,
            encode(self.desired, channels_together(colours(coded, MOST_BITS))),
        )

    def _values(self, name: str, sums: NDArray[np.unsignedinteger]) -> NDArray[Any]:
        """Return the values of a table for sums, in their shape, which begin at an even row."""
        if self.layout.is_mosaic:
            return self._mosaic_values(name, sums)
        planes = channels_apart(sums)
        tables = [getattr(each, name) for each in self.tables]
        if len(tables) == 1:
            tables *= len(planes)
        found = [looked_up(*each) for each in zip(tables, planes, strict=True)]
        return found[0] if sums.ndim == 2 else np.moveaxis(np.stack(found), 0, 2)

    def _mosaic_values(self, name: str, sums: NDArray[np.unsignedinteger]) -> NDArray[Any]:
        """Return the values of a table for sums of a mosaic, which begin at an even row."""
        tables = [getattr(each, name) for each in self.tables]
        if len(tables) == 1:
            return looked_up(tables[0], sums)
        found = np.empty(sums.shape, tables[0].dtype)
        colours = self.layout.value.upper()
        planes = zip(colours, self.layout.planes(found), self.layout.planes(sums), strict=True)
        for colour, values, plane in planes:
            values[...] = tables[LETTERS.index(colour)].take(plane)
        return found

    def _without_hot_pixels(
        self, total: NDArray[np.unsignedinteger]
    ) -> tuple[NDArray[np.unsignedinteger], NDArray[np.uint8] | None]:
        """Return the sum without hot pixels, and `HOT` where they are; None where there are none.

        Each is replaced by the median of up to eight neighbours of its colour that are not hot.
        """
        if not self.hot_pixels:
            return total, None
        shown, hot = total.copy(), np.zeros(total.shape, np.uint8)
        rows, columns = np.array(self.hot_pixels, np.intp).T
        hot[rows, columns] = HOT
        step = 2 if self.layout.is_mosaic else 1
        for row, column in self.hot_pixels:
            near = (
                slice(row % step if row < step else row - step, row + step + 1, step),
                slice(column % step if column < step else column - step, column + step + 1, step),
            )
            good = hot[near][..., 0] == 0 if total.ndim == 3 else hot[near] == 0
            if good.any():
                shown[row, column] = np.median(total[near][good], axis=0)
        return shown, hot
