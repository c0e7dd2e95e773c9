"""The variance that noise and quantisers make of the difference of two frames, over patches.

It is the one of samples with the light of a patch.  Where noise dithers the quantisers, it hardly
depends on how that light is spread.  Elsewhere it does: the light is then the one whose samples, by
their noise, have the mean and the variance that the longer frame shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.block_rounding import BlockRounding
from camctl.model.distribution import MIN_ELECTRONS
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.sample_moments import SampleMoments, range_means

#: Half of the least range of light, places of a table.
_LEAST_RANGE = 0.05
#: Share of the variance from which on the square of the quantisers' mean errors counts.
_NOTABLE = 1e-3
LEAST_STEP = 1e-12
"""Square of a step that is not less, levels squared."""

#: Rounds in which the light of a patch is found, and standard errors up to which its contrast is
#: chance.
_CENTRING, _CHANCE = 4, 2.0

_Floats = NDArray[np.float64]


def electrons_per_level(inverse: float) -> float:
    """Return the electrons of a level from their measured inverse at the gain, infinite for 0."""
    return max(1 / inverse, MIN_ELECTRONS) if inverse > 0 else math.inf


class VarianceModel:
    """The moments of samples by noise and the quantiser, in levels of the linear scale.

    Args:
        response: the camera's response as levels
        black: black level, DN
        gains: linear gain of each frame
        file: what the files of the frames make of noise within a patch; None: nothing
    """

    def __init__(
        self,
        response: CameraResponse,
        black: int,
        gains: Sequence[float],
        file: BlockRounding | None = None,
    ) -> None:
        self.file = file
        self._moments = SampleMoments(response, black)
        self._full = response.M + 1.0
        self._gains = sorted(set(gains))

    def first(self, gain: float) -> int:
        """Return where the part of a gain begins in the tables."""
        return self._gains.index(gain) * self._moments.size

    def ends(self, light: _Floats, spread: _Floats, first: NDArray[np.intp]) -> _Floats:
        """Return the range of the light of patches as places in the tables, (2, K).

        Args:
            light: mean of each at exposure 1, levels
            spread: standard deviation of the light within each, where it is taken as even, levels
            first: place of the first light of their table
        """
        half = math.sqrt(3) * spread
        ends = self._moments.places(np.stack([light - half, light + half]) / self._full)
        ends += np.array([[-_LEAST_RANGE], [_LEAST_RANGE]])
        return np.asarray(np.clip(ends, 0, self._moments.size - 1) + first)

    def tables(self, noise: _Floats) -> _Floats:
        """Return mean error, its square, and variance for all gains, one after the other.

        Args:
            noise: inverse electrons per level, and squared read noise, at gain 1
        """
        inverse, square = noise.tolist()
        read = math.sqrt(square)
        tables = [
            self._moments.table(FrameNoise(electrons_per_level(inverse * gain), read * gain))
            for gain in self._gains
        ]
        scale = np.array([[self._full], [self._full**2], [self._full**2]])
        return np.asarray(np.concatenate(tables, axis=1) * scale)


class _Moments(NamedTuple):
    """What noise and quantisers make of patches, (K,) each, in levels of the shorter frame.

    Attributes:
        each: (2, K), variance of the shorter and of the longer frame in the difference of both
        scatter: standard deviation of the variance of the difference, over the root of 2 / freedom
        error: mean error of the longer frame's light
        is_notable: whether the quantisers' mean errors are: elsewhere the variance hardly changes
            with the light
        by_noise: (2, K), what `each` is before files change it
    """

    each: _Floats
    scatter: _Floats
    error: _Floats
    is_notable: NDArray[np.bool_]
    by_noise: _Floats

    @property
    def variance(self) -> _Floats:
        """Of the difference."""
        return np.asarray(self.each.sum(axis=0))


@dataclass(frozen=True, eq=False)
class NoisePatches:
    """Differences of a shorter and a longer frame, in levels of the former; a column for a patch.

    Attributes:
        variance: measured
        terms: (2, K): what one inverse electron per level, and read noise of one level, add
        quantisers: (2, K), what the quantisers of both frames add that noise dithers
        light: (2, K): the mean of its light, and the error of that
        contrast: (2, K): the variance of its light within it, and the error of that
        spread: the variance within it of the longer frame
        first: (2, K): where the tables of both frames begin
        ends: (4, K): ends of the range of its light in both, see `VarianceModel.ends`
        ratio: of the exposures
        freedom: degrees of freedom of the variance
        is_even: whether it has so little contrast that its variance is noise
        is_plain: whether errors of its colours, which frames share, are small
    """

    variance: _Floats
    terms: _Floats
    quantisers: _Floats
    light: _Floats
    contrast: _Floats
    spread: _Floats
    first: NDArray[np.intp]
    ends: _Floats
    ratio: _Floats
    freedom: _Floats
    is_even: NDArray[np.bool_]
    is_plain: NDArray[np.bool_]

    @staticmethod
    def joined(parts: Sequence[NoisePatches]) -> NoisePatches:
        """Return the patches of all parts."""
        names = [each.name for each in fields(NoisePatches)]
        return NoisePatches(
            *(np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names)
        )

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> NoisePatches:
        """Return some of the patches."""
        names = (each.name for each in fields(NoisePatches))
        return NoisePatches(*(getattr(self, name)[..., chosen] for name in names))

    def with_ends(self, model: VarianceModel, light: int = 0, contrast: int = 0) -> NoisePatches:
        """Return the patches with light and contrast that differ by so many of their errors."""
        mean = np.maximum(self.light[0] + light * self.light[1], 0.0)
        spread = np.sqrt(self.contrast[0] + contrast * self.contrast[1])
        ends = [
            model.ends(mean * times, spread * times, first)
            for times, first in zip((1.0, self.ratio), self.first, strict=True)
        ]
        return replace(self, ends=np.concatenate(ends))

    def fitted(self, model: VarianceModel, table: _Floats) -> NoisePatches:
        """Return the patches with the light that the longer frame shows where there is this noise.

        Args:
            model: of their variance
            table: see `VarianceModel.tables`
        """
        notable = np.flatnonzero(self.moments(model, table).is_notable)
        if not notable.size:
            return self
        some = self.where(notable)
        mean, error = some.light
        by_chance = some.spread * np.sqrt(2 / some.freedom)
        for _ in range(_CENTRING):
            found = some.moments(model, table)
            middle = (some.light[0] + mean - found.error) / 2
            beyond = some.spread - found.each[1]
            beyond[beyond < _CHANCE * by_chance] = 0.0
            some = replace(
                some, light=np.stack([middle, error]), contrast=np.stack([beyond, by_chance])
            ).with_ends(model)
        light, contrast, ends = (each.copy() for each in (self.light, self.contrast, self.ends))
        light[:, notable], contrast[:, notable] = some.light, some.contrast
        ends[:, notable] = some.ends
        return replace(self, light=light, contrast=contrast, ends=ends)

    def with_contrast(self, model: VarianceModel, by_noise: _Floats) -> _Floats:
        """Return the variance if all frequencies of a file showed contrast."""
        assert model.file is not None
        step = self._squared_steps
        noise = by_noise / step
        return np.asarray((model.file.by_contrast(noise) * step).sum(axis=0))

    @property
    def _squared_steps(self) -> _Floats:
        return np.maximum(12 * self.quantisers, LEAST_STEP)

    def moments(self, model: VarianceModel, table: _Floats) -> _Moments:
        """Return what noise and quantisers make of the patches, see `VarianceModel.tables`."""
        variance, error, is_notable = self._by_noise(table)
        if model.file is None:
            return _Moments(variance, variance.sum(axis=0), error, is_notable, variance)
        step = self._squared_steps
        noise = variance / step
        kept, scatter = model.file.within(noise) * step, model.file.scatter(noise) * step
        return _Moments(kept, scatter.sum(axis=0), error, is_notable, variance)

    def _by_noise(self, table: _Floats) -> tuple[_Floats, _Floats, NDArray[np.bool_]]:
        """Return what `moments` does before files change it."""
        error, square, variance = range_means(table, self.ends[::2], self.ends[1::2])
        error[1] /= self.ratio
        square[1] /= self.ratio**2
        variance[1] /= self.ratio**2
        variance += np.maximum(square - error**2, 0.0)
        return variance, error[1], square.sum(axis=0) > _NOTABLE * variance.sum(axis=0)

    def scatter(self, model: VarianceModel, table: _Floats) -> tuple[_Floats, _Floats]:
        """Return the expected variance, and the standard error of the measured one.

        The latter is by chance, and by what is not known of the light.
        """
        found = self.moments(model, table)
        expected, is_notable = found.variance, found.is_notable
        square = 2 / self.freedom * found.scatter**2
        notable = np.flatnonzero(is_notable)
        if notable.size:
            some = self.where(notable)
            low, high, wide = (
                some.with_ends(model, light, contrast).moments(model, table).variance
                for light, contrast in ((-1, 0), (1, 0), (0, 1))
            )
            square[notable] += np.square((high - low) / 2) + np.square(wide - expected[notable])
        if model.file is not None:
            # A frequency whose rounding contrast changes has the square of half a step of it, or
            # more, and up to a twelfth of the square of a step more of error, in both frames.
            rough = self.with_contrast(model, found.by_noise)
            most = np.minimum(2 / 3 * self.contrast[0], rough - expected)
            square += np.square(np.maximum(most, 0.0)) / 3
        return expected, np.sqrt(square)
