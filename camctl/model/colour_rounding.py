"""What a JPEG file of colours makes of noise (ITU-T T.81, T.871).

Of red, green and blue with noise of variance v each, the file has brightness Y of each pixel, and
Cb and Cr of each cell of 2 x 2 pixels (4:2:0), whose noise is partly the same.  Blocks of 8 x 8 of
each are rounded by frequency, see `block_rounding`.  Decoders put Cb and Cr at the centres of the
cells and interpolate linearly.  Noise of a decoded colour is the sum of these, in each frequency of
8 x 8 pixels; of what Y and the others have in common, rounding keeps the share that it keeps of a
small change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from camctl.model.block_rounding import BlockRounding, nodes_of, rounded_gain, rounded_moments
from camctl.model.distribution import normal_cdf
from camctl.model.response.camera import FloatArray

ENCODED = np.array(
    (
        (0.299, 0.587, 0.114),
        (-0.299 / 1.772, -0.587 / 1.772, 0.5),
        (0.5, -0.587 / 1.402, -0.114 / 1.402),
    )
)
"""Y, Cb and Cr of red, green and blue (ITU-T T.871), (3, 3)."""

DECODED = np.linalg.inv(ENCODED)
"""Red, green and blue of Y, Cb and Cr, (3, 3)."""

_SIDE = 8
#: Variance of the mean of four cells that a pixel of Cb or Cr is, with weights 9, 3, 3 and 1.
_SMOOTHED = 100 / 256
#: Phases of a quantiser, noise from which on they do not matter, and thresholds on either side.
_PHASES, _DITHERED, _THRESHOLDS = 16, 1.0, 6


@dataclass(frozen=True)
class ColourRounding(BlockRounding):
    """The rounding of a file of colours.

    Attributes:
        chroma_steps: of the frequencies of Cb and of Cr, levels, the mean first
        colour: 0 red, 1 green, 2 blue
        noise: variance of the noise of red, green and blue over that of the colour
    """

    chroma_steps: tuple[float, ...] = ()
    colour: int = 0
    noise: tuple[float, ...] = (1.0, 1.0, 1.0)
    colours: ClassVar[int] = 3

    @cached_property
    def _common(self) -> FloatArray:
        """Covariances of Y, Cb and Cr by noise of the colour of variance 1."""
        return np.asarray((ENCODED * self.noise) @ ENCODED.T)

    @cached_property
    def _kept(self) -> FloatArray:
        """Variance of each frequency by noise of variance 1, without rounding, (64,)."""
        decoded, common, geometry = DECODED[self.colour], self._common, _geometry()
        chroma = decoded[1:] @ common[1:, 1:] @ decoded[1:] / 4
        return np.asarray(
            common[0, 0]
            + chroma * geometry.spread.sum(axis=1)
            + 2 * (decoded[1:] @ common[0, 1:]) * geometry.shared.sum(axis=1)
        )

    @cached_property
    def _rounding(self) -> FloatArray:
        """What rounding makes of the mean of each frequency of contrast, (64,)."""
        chroma = np.square(DECODED[self.colour, 1:]).sum()
        of_chroma = _geometry().spread @ np.square(self.chroma_steps)
        return np.asarray((np.square(self.steps) + chroma * of_chroma) / 12)

    def by_contrast(self, variance: FloatArray) -> FloatArray:
        """Return the variance within blocks where all frequencies show contrast."""
        return np.asarray(self._kept.mean() * variance + float(self._rounding.mean()))

    def cells(self, variance: FloatArray) -> CellContrast:
        """Return what noise of this colour shows as contrast of cells, if the scene is smooth.

        Args:
            variance: of the noise before the file was made, levels squared
        """
        rows = [self._of(variance, each) for each in self._cell_tables]
        return CellContrast(*rows)

    @cached_property
    def _cell_tables(self) -> FloatArray:
        """What `cells` returns over the variance of the noise, (4, nodes)."""
        of_one, geometry = np.diagonal(self._common).tolist(), _cell_geometry()
        steps = self.steps, self.chroma_steps, self.chroma_steps
        bright, blue, red = (
            _plane(each, step, is_chroma=at > 0).mean[1:]
            for at, (each, step) in enumerate(zip(of_one, steps, strict=True))
        )
        scales = np.square((DECODED[0, 2], DECODED[2, 1]))
        rows = geometry.of_y @ bright, geometry.within @ bright
        others = scales[0] * (geometry.of_cells @ red), scales[1] * (geometry.of_cells @ blue)
        return np.stack([*others, *rows]) / nodes_of()

    @cached_property
    def _tables(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        variance = nodes_of()
        decoded, geometry = DECODED[self.colour], _geometry()
        common = self._common
        of_one = np.diagonal(common).tolist()
        bright = _plane(of_one[0], self.steps, is_chroma=False)
        chroma = [_plane(each, self.chroma_steps, is_chroma=True) for each in of_one[1:]]
        found = bright.mean.copy()
        beyond = bright.spread - 2 * np.square(bright.mean)
        # Decoders round Y, Cb and Cr of cells, these again of pixels, and colours.  Where Cb and Cr
        # are even, all samples of a patch are rounded alike.
        dither = bright.dithered(bright.mean[1:].mean(axis=0))
        phases, fine = np.zeros((2, variance.size))
        for at, plane in enumerate(chroma, 1):
            square = decoded[at] ** 2
            shown = geometry.spread @ plane.mean
            found += square * shown
            even = shown[1:].mean(axis=0)
            added = plane.dithered(even)
            dither += square * (1 + _SMOOTHED) * added
            fine += square * (even + added)
            phases += square**2 * phase_variance(even / plane.share) * plane.share
            both = bright.gain * (geometry.shared @ plane.gain)
            found += 2 * decoded[at] * common[0, at] * variance * both
            more = plane.spread - 2 * np.square(plane.mean)
            beyond += square**2 * (np.square(geometry.spread) @ more)
        share = np.maximum(chroma[0].share, chroma[1].share)
        both = geometry.spread @ (chroma[0].gain * chroma[1].gain)
        found += decoded[1] * decoded[2] * common[1, 2] / 2 * variance * both
        within = found[1:].mean(axis=0)
        dither += share * dithered(fine / share)
        scatter = np.square(found[1:]).mean(axis=0) + beyond[1:].mean(axis=0) / 2
        scatter = np.sqrt(scatter + phases * (len(found) - 1) / 2)
        # The mean of a block is any multiple and a part of a step.
        means = self._kept[0] * variance + self._rounding[0]
        error = (found[1:].sum(axis=0) + means) / len(found)
        return (within + dither) / variance, (scatter + dither) / variance, error / variance


class _Plane(NamedTuple):
    """What rounding makes of frequencies of Y, Cb or Cr, (64, nodes) each.

    Attributes:
        mean: of their squares
        spread: variance of these
        gain: share of a small change that is kept
        share: of the blocks that have any noise after rounding, (nodes,)
    """

    mean: FloatArray
    spread: FloatArray
    gain: FloatArray
    share: FloatArray

    def dithered(self, variance: FloatArray) -> FloatArray:
        """Return `dithered` of the mean variance of all blocks."""
        return np.asarray(self.share * dithered(variance / self.share))


@lru_cache(maxsize=16)
def _plane(of_one: float, steps: tuple[float, ...], *, is_chroma: bool) -> _Plane:
    """Return what rounding makes of a plane.

    Args:
        of_one: variance of its noise by one of 1
        steps: of its frequencies
        is_chroma: whether it has means of 2 x 2 pixels
    """
    square = of_one * nodes_of()
    square = square + dithered(square)
    if is_chroma:
        square = square / 4
        square = square + dithered(square)
    different, each = np.unique(steps, return_inverse=True)
    noise = np.sqrt(square)
    rows = [
        [*rounded_moments(noise, step), rounded_gain(noise, step)] for step in different.tolist()
    ]
    mean, spread, gain = np.stack(rows, axis=1)[:, each]
    # Frequencies that are not 0 are rare and independent where they are few.
    number = (mean[1:] / np.square(steps[1:])[:, np.newaxis]).sum(axis=0)
    return _Plane(mean, spread, gain, np.maximum(-np.expm1(-number), 1e-9))


class CellContrast(NamedTuple):
    """Variances that noise makes, levels squared.

    Attributes:
        red: of R - Y of the cells of 3 x 3
        blue: of B - Y, likewise
        Y: of Y, likewise
        detail: of Y within a cell, beside what linear interpolation between cells shows
    """

    red: FloatArray
    blue: FloatArray
    Y: FloatArray
    detail: FloatArray


class _CellGeometry(NamedTuple):
    """How much of a frequency of variance 1 is in `CellContrast`, (63,).

    Attributes:
        of_cells: frequencies of cells, which are decoded and of which pixels have means again
        of_y: frequencies of pixels, in the means of cells
        within: the same, within cells
    """

    of_cells: FloatArray
    of_y: FloatArray
    within: FloatArray


@lru_cache(maxsize=1)
def _cell_geometry() -> _CellGeometry:
    angle = np.arange(_SIDE) * (math.pi / _SIDE)

    def local(gain: FloatArray, step: int) -> FloatArray:
        """Return the variance among 3 x 3 cells of frequencies that have this gain on one axis."""
        around = (1 + 2 * np.cos(step * angle)) / 3
        kept = np.outer(gain, gain)
        return np.asarray(np.square(kept) * (1 - np.square(np.outer(around, around))))

    pairs = np.cos(angle / 2)
    # A pixel is 3/4 of its cell's mean and 1/4 of the one beside it.
    product, square = np.zeros((2, _SIDE))
    place = np.arange(-6, 10)
    for at, each in enumerate(angle.tolist()):
        wave = np.cos((place + 0.5) * each)
        means = wave.reshape(-1, 2).mean(axis=1)
        shown = np.stack(
            [0.75 * means[1:-1] + 0.25 * means[:-2], 0.75 * means[1:-1] + 0.25 * means[2:]], axis=1
        ).ravel()
        middle, shown = wave[6:14], shown[4:12]
        product[at] = middle @ shown / (middle @ middle)
        square[at] = shown @ shown / (middle @ middle)
    within = 1 - 2 * np.outer(product, product) + np.outer(square, square)
    rows = local(0.75 + 0.25 * np.cos(angle), 1), local(pairs, 2), within
    return _CellGeometry(*(each.ravel()[1:] / _SIDE**2 for each in rows))


def dithered(variance: FloatArray) -> FloatArray:
    """Return the variance of rounding to levels that noise makes independent, levels squared."""
    return np.asarray(-np.expm1(-4 * np.square(np.pi) * variance) / 12)


def phase_variance(variance: FloatArray) -> FloatArray:
    """Return how the variance of samples rounded to levels varies with the level that all have.

    Args:
        variance: of their noise, levels squared, ascending

    Returns:
        variance over all fractions of a level
    """
    few = np.flatnonzero(variance < _DITHERED)
    noise = np.sqrt(np.maximum(variance[few, np.newaxis, np.newaxis], 1e-18))
    phase = ((np.arange(_PHASES) + 0.5) / _PHASES)[:, np.newaxis]
    number = np.arange(2 * _THRESHOLDS + 1)
    # The number N of thresholds below a sample has E[N] = sum P and E[N^2] = sum (2 k + 1) P.
    below = normal_cdf((phase - (number - _THRESHOLDS + 0.5)) / noise)
    of_phase = below @ (2.0 * number + 1) - np.square(below.sum(axis=-1))
    found = np.zeros_like(variance)
    found[few] = of_phase.var(axis=1)
    return found


class _Geometry(NamedTuple):
    """What frequencies of 8 x 8 cells are in those of 8 x 8 pixels, (64 pixels', 64 cells').

    Attributes:
        spread: variance there of a frequency of cells of variance 1, its neighbours' included
        shared: what is kept there of a frequency of pixels through this one of the cells
    """

    spread: FloatArray
    shared: FloatArray


@lru_cache(maxsize=1)
def _geometry() -> _Geometry:
    cosines = _cosines()
    # Three blocks of cells in a row, of which the pixels of the middle one are looked at.
    cells = 3 * _SIDE
    weights = np.zeros((2 * cells, cells))
    for pixel in range(2 * cells):
        cell = pixel // 2
        weights[pixel, cell] = 0.75
        weights[pixel, min(max(cell + (1 if pixel % 2 else -1), 0), cells - 1)] += 0.25
    spread, shared = np.zeros((2, _SIDE, _SIDE))
    for half in (0, 1):
        pixels = slice(2 * _SIDE + half * _SIDE, 2 * _SIDE + (half + 1) * _SIDE)
        for block in range(3):
            of_cells = cosines @ weights[pixels, block * _SIDE : (block + 1) * _SIDE] @ cosines.T
            spread += np.square(of_cells) / 2
            if block == 1:
                averages = np.zeros((_SIDE, _SIDE))
                for k in range(_SIDE):
                    averages[half * _SIDE // 2 + k // 2, k] = 0.5
                shared += of_cells * (cosines @ averages @ cosines.T).T / 2
    return _Geometry(*(np.asarray(np.kron(each, each), np.float64) for each in (spread, shared)))


def _cosines() -> FloatArray:
    """Return the cosine transform of 8 samples, (frequencies, samples)."""
    place, frequency = np.arange(_SIDE), np.arange(_SIDE)[:, np.newaxis]
    rows = np.cos((2 * place + 1) * frequency * (math.pi / (2 * _SIDE))) * math.sqrt(2 / _SIDE)
    rows[0] *= math.sqrt(0.5)
    return np.asarray(rows)
