"""From the sum of the frames to irradiance and to the image in the desired response.

A table turns each value of the sum into irradiance, another one into the desired response.  A
mosaic becomes irradiance first and is interpolated afterwards, in linear light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.controls import Layout
from camctl.exposure.effective import EffectiveCamera
from camctl.response.desired import DesiredResponse

#: Values of a mask: within the levels, below the first level, saturated in every frame.
GOOD, DARK, SATURATED = 0, 1, 2
#: Largest value of image.tiff.
FULL_CODE = 65535
#: Samples of a strip: its arrays are small beside the sum, and numpy's call overhead is small.
STRIP_SAMPLES = 1 << 20

_LETTERS = "RGB"
#: Bilinear weights: every second pixel is green, every fourth one red or blue.
_GREEN_WEIGHTS = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
_RED_BLUE_WEIGHTS = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4


def planes(pixels: NDArray[Any], layout: Layout) -> list[NDArray[Any]]:
    """Return views of a frame, one for each colour (the two greens of a mosaic apart)."""
    if layout is Layout.MONO:
        return [pixels]
    if layout is Layout.RGB:
        return [pixels[..., channel] for channel in range(3)]
    return [pixels[row::2, column::2] for row in (0, 1) for column in (0, 1)]


def colour_of(layout: Layout, row: int, column: int) -> int:
    """Return which of R, G, B (0, 1, 2) a mosaic has at (row, column)."""
    return _LETTERS.index(layout.value.upper()[2 * (row % 2) + column % 2])


def demosaic(mosaic: NDArray[np.float32], layout: Layout, first_row: int) -> NDArray[np.float32]:
    """Return (rows, columns, 3) by bilinear interpolation of (rows, columns), borders mirrored.

    OpenCV's own demosaicing takes integers only, which would lose levels; this one keeps linear
    light linear.  `first_row` is the row of the whole frame at which `mosaic` begins.
    """
    import cv2

    colours = np.empty((*mosaic.shape, 3), np.float32)
    for channel in range(3):
        plane = np.zeros_like(mosaic)
        for row in (0, 1):
            for column in (0, 1):
                if colour_of(layout, first_row + row, column) == channel:
                    plane[row::2, column::2] = mosaic[row::2, column::2]
        kernel = _GREEN_WEIGHTS if channel == 1 else _RED_BLUE_WEIGHTS
        # Mirroring without repeating the border keeps the colour of every mirrored pixel.
        colours[..., channel] = cv2.filter2D(plane, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
    return colours


def demosaic_mask(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mosaic's mask as (rows, columns, 3): a mark covers all pixels it contributed to."""
    import cv2

    wide = cv2.dilate(mask, np.ones((3, 3), np.uint8))
    return np.repeat(wide[..., None], 3, axis=2)


def encode(desired: DesiredResponse, E: NDArray[Any]) -> NDArray[np.uint16]:
    """Return the desired response to irradiance, 0 to `FULL_CODE`, in E's shape."""
    return np.rint(desired.u(E) * FULL_CODE).astype(np.uint16)


@dataclass(frozen=True)
class Tables:
    """Irradiance, code and mask for each value of the sum: arrays indexed by it, black included.

    Attributes:
        irradiance: float32, E / full-scale exposure; outside the levels it is clamped
        code: uint16, the desired response, 0 to `FULL_CODE`
        mask: uint8, `GOOD`, `DARK` (below the first level) or `SATURATED` (in every frame)
    """

    irradiance: NDArray[np.float32]
    code: NDArray[np.uint16]
    mask: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        effective: EffectiveCamera,
        desired: DesiredResponse,
        black_total: int,
        full_scale_exposure: float,
    ) -> Tables:
        """Tabulate the inverse of the effective camera for sums of frames with their black."""
        inverse = effective.irradiance_table()
        top = inverse.size - 1
        signed = np.arange(top + black_total + 1) - black_total
        E = inverse[np.clip(signed, 0, top)]
        mask = np.full(signed.size, GOOD, np.uint8)
        mask[signed <= 0] = DARK
        mask[signed >= top] = SATURATED
        return cls(
            irradiance=(E / full_scale_exposure).astype(np.float32),
            code=encode(desired, E),
            mask=mask,
        )


@dataclass(frozen=True)
class Shares:
    """Share of the samples of a sum that every frame saturated, and that no frame reached."""

    saturated: float
    dark: float


def outside_shares(total: NDArray[np.unsignedinteger], tables: Tables) -> Shares:
    """Return the shares of a sum that are outside the effective camera's levels."""
    counts = np.zeros(3, np.int64)
    flat = total.reshape(-1)
    for start in range(0, flat.size, STRIP_SAMPLES):
        marks = tables.mask[flat[start : start + STRIP_SAMPLES]]
        counts += np.bincount(marks, minlength=3)
    return Shares(
        saturated=int(counts[SATURATED]) / flat.size,
        dark=int(counts[DARK]) / flat.size,
    )


@dataclass(frozen=True)
class Strip:
    """Some rows of the pictures, (rows, columns) or, in colour, (rows, columns, 3)."""

    irradiance: NDArray[np.float32]
    code: NDArray[np.uint16]
    mask: NDArray[np.uint8]


@dataclass(frozen=True)
class Rendering:
    """How a sum becomes pictures.

    Attributes:
        layout: pixel layout of the frames
        tables: irradiance, code and mask for each value of the sum
        desired: desired response of the image
        full_scale_exposure: irradiance in the pictures times this is E, 1 at full scale
    """

    layout: Layout
    tables: Tables
    desired: DesiredResponse
    full_scale_exposure: float

    @property
    def channels(self) -> str:
        """Names of the channels: "Y" or "RGB"."""
        return "Y" if self.layout is Layout.MONO else _LETTERS

    def picture_shape(self, total: NDArray[np.unsignedinteger]) -> tuple[int, ...]:
        """Return the shape of the pictures: (rows, columns) or (rows, columns, 3)."""
        return total.shape[:2] if self.layout is Layout.MONO else (*total.shape[:2], 3)

    def strip_rows(self, total: NDArray[np.unsignedinteger]) -> int:
        """Return the number of rows of a strip, even, so that a mosaic's pattern begins anew."""
        row_samples: int = total.shape[1] * len(self.channels)
        return max(2, STRIP_SAMPLES // row_samples & ~1)

    def strips(self, total: NDArray[np.unsignedinteger]) -> Iterator[Strip]:
        """Yield the pictures of a sum from top to bottom, `strip_rows` rows at a time."""
        height, rows = total.shape[0], self.strip_rows(total)
        for start in range(0, height, rows):
            stop = min(start + rows, height)
            if not self.layout.is_mosaic:
                sums = total[start:stop]
                tables = self.tables
                yield Strip(tables.irradiance[sums], tables.code[sums], tables.mask[sums])
                continue
            first, last = max(0, start - 2), min(height, stop + 2)
            sums = total[first:last]
            inner = slice(start - first, stop - first)
            irradiance = demosaic(self.tables.irradiance[sums], self.layout, first)[inner]
            yield Strip(
                irradiance,
                encode(self.desired, irradiance * self.full_scale_exposure),
                demosaic_mask(self.tables.mask[sums])[inner],
            )
