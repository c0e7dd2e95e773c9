"""How well responses explain an exposure series: one for all colours, one for each, or a standard.

Patches of the frames are compared, or the histograms of photographs that share no patch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.response.matches import Matches, match_levels
from camctl.calibration.response.series import Neighbours, Series
from camctl.model.quantiles import NORMAL_MAD, median
from camctl.model.response.camera import FloatArray

#: Levels of a cell, of 256, fewest patches in one, and most of a pair of frames that are compared.
_CELL, _FEWEST, _MOST = 16, 6, 500
SHARED_LEVELS = 0.3
"""Error that patches of one brightness share, levels of 255 in each frame: 1 / sqrt(12) for
rounding as JPEG does."""

SHARED = 0.005
"""The same relative, as of a linear sensor (EMVA 1288)."""

#: Neighbouring cells share errors: so many count as one.
_ALIKE = 2.0
#: Numbers that describe an estimated curve: components of EMoR (Grossberg and Nayar, 2004) from
#: which tests/bench/bench_response.py draws measured-like curves.
NUMBERS = 5

#: Brightness of well exposed patches, shares of full scale, and how far apart the colours of a grey
#: one may be: 20 of 255, a white balance of about 10 %.
_WELL_EXPOSED, _GREY = (0.2, 0.8), 0.08


@dataclass(frozen=True, eq=False)
class _Patches:
    """Patches of two neighbouring frames in cells of one brightness.

    Attributes:
        channel: place of theirs
        short: position of the frame of shorter exposure
        long: of the other one
        levels: their samples, (2, patches, samples)
        middle: the level nearest to the mean of each, (2, patches)
        cells: places of the patches of each cell that has enough
    """

    channel: int
    short: int
    long: int
    levels: NDArray[np.intp]
    middle: NDArray[np.intp]
    cells: list[NDArray[np.intp]]

    @classmethod
    def of(cls, channel: int, pair: Neighbours, unit: float) -> _Patches:
        """Put some patches of a pair into cells by their brightness in the longer frame."""
        levels = pair.levels[:, :: 1 + pair.levels.shape[1] // _MOST]
        mean = levels.mean(axis=2)
        cell = (mean[1] / (unit * _CELL)).astype(np.intp)
        cells = [
            np.flatnonzero(cell == each)
            for each in np.flatnonzero(np.bincount(cell) >= _FEWEST).tolist()
        ]
        middle = np.rint(mean).astype(np.intp)
        return cls(channel, pair.short, pair.long, levels, middle, cells)


@dataclass(frozen=True, eq=False)
class PatchRatios:
    """Patches of neighbouring frames, by which responses are compared.

    Attributes:
        pairs: of neighbouring frames, for each channel
        unit: levels of 1/255 of full scale
    """

    pairs: tuple[_Patches, ...]
    unit: float

    @property
    def has_cells(self) -> bool:
        """Whether enough patches are in a cell to compare responses by."""
        return any(pair.cells for pair in self.pairs)

    @classmethod
    def of(cls, series: Series) -> PatchRatios:
        """Return the patches that two neighbouring frames expose well."""
        unit = max(1.0, (series.white - series.black) / 255)
        found = [
            _Patches.of(place, pair, unit)
            for place, name in enumerate(series.channels)
            for pair in series.neighbours(name)
            if pair.levels.shape[1] >= _FEWEST
        ]
        return cls(tuple(found), unit)

    def misfit(
        self, lights: Sequence[FloatArray], exposures: Sequence[float], exposure_error: float
    ) -> tuple[float, int]:
        """Return the sum of squared normalised errors of the cells, and their number.

        Args:
            lights: of each channel, or one for all, (M + 1,) light of each brightness above black
            exposures: of the frames, in any unit
            exposure_error: standard deviation of the logarithm of an exposure
        """
        total, cells = 0.0, 0
        curves = [(light, np.gradient(np.log(np.maximum(light, 1e-12)))) for light in lights]
        for short, long in sorted({(pair.short, pair.long) for pair in self.pairs}):
            means, errors = [], []
            for pair in self.pairs:
                if (pair.short, pair.long) == (short, long):
                    found = self._cells(pair, *curves[pair.channel % len(curves)])
                    means += found[0]
                    errors += found[1]
            if not means:
                continue
            residuals = np.array(means) - math.log(exposures[long] / exposures[short])
            total += square_of(residuals, np.array(errors), exposure_error)
            cells += len(means)
        return total, cells

    def _cells(
        self, pair: _Patches, light: FloatArray, slope: FloatArray
    ) -> tuple[list[float], list[float]]:
        """Return the mean logarithm of the ratio of light in each cell, and its error.

        Args:
            pair: of frames
            light: of each brightness
            slope: of its logarithm
        """
        found = np.maximum(light[pair.levels].mean(axis=2), 1e-12)
        logs = np.log(found[1] / found[0])
        block = self.unit * SHARED_LEVELS
        shared = np.hypot(*(block * slope[each] for each in pair.middle))
        means, errors = [], []
        for use in pair.cells:
            here = logs[use]
            mean = median(here)
            scatter = median(np.abs(here - mean)) / NORMAL_MAD
            error = math.hypot(1.25 * scatter / math.sqrt(here.size), median(shared[use]))
            means.append(mean)
            errors.append(math.hypot(error, SHARED))
        return means, errors


def square_of(residuals: FloatArray, errors: FloatArray, exposure_error: float) -> float:
    """Return the sum of squared normalised errors of ratios of light of two frames.

    `exposure_error` is the standard deviation of the logarithm of each exposure.
    """
    weights = errors**-2.0
    square = float(weights @ residuals**2)
    if exposure_error > 0:
        common = float(weights @ residuals)
        square -= common**2 / (float(weights.sum()) + exposure_error**-2 / 2)
    return square


def score(misfit: float, cells: int, numbers: int) -> float:
    """Return how badly responses of so many numbers explain the cells: the least is the best.

    Real files have errors that no model here has, in all hypotheses: the mean square of the errors
    is taken from the cells where it is more than 1.
    """
    count = cells / _ALIKE
    return count * math.log(max(misfit / max(cells, 1), 1.0)) + numbers * math.log(max(count, 2))


def grey_scales(series: Series, lights: Sequence[FloatArray]) -> NDArray[np.float64]:
    """Return factors of the light of R, G and B, so that greys of the frames are grey, (3,).

    The factors are at most 1, and one of them is.

    Args:
        series: RGB frames
        lights: of R, G and B, (M + 1,) light of each brightness above black
    """
    planes = [
        np.concatenate([np.array_split(each, 3)[place].mean(axis=1) for each in series.patches])
        - series.black
        for place in range(3)
    ]
    span = series.white - series.black
    levels = np.array(planes)
    middle = levels.mean(axis=0)
    low, high = (each * span for each in _WELL_EXPOSED)
    use = (np.ptp(levels, axis=0) < _GREY * span) & (middle > low) & (middle < high)
    grey = middle[use] if np.count_nonzero(use) >= _FEWEST else np.linspace(low, high, 61)
    places = np.arange(span + 1)
    logs = [float(np.median(np.log(np.interp(grey, places, each)))) for each in lights]
    scales = np.exp(logs[1] - np.array(logs))
    return np.asarray(scales / scales.max())


def series_matches(series: Series, name: str, *, spill: bool = True) -> Matches:
    """Return the levels of equal irradiance of a channel.

    Args:
        series: the frames
        name: of the channel
        spill: with samples that saturated ones beside them may have changed
    """
    edges = series.edges

    def counts(*pair: int) -> NDArray[np.int64]:
        return series.counts_of_pair(name, series.black + edges, (pair[0], pair[1]), spill=spill)

    return match_levels(counts, series.exposures, edges, series.darkest(name))


@dataclass(frozen=True, eq=False)
class HistogramRatios:
    """Matched levels, by which responses are compared.

    Attributes:
        matches: of each channel
        unit: levels of 1/255 of full scale
    """

    matches: tuple[Matches, ...]
    unit: float

    @classmethod
    def of(cls, series: Series) -> HistogramRatios:
        """Return the matches of all channels."""
        found = tuple(series_matches(series, each, spill=False) for each in series.channels)
        return cls(found, max(1.0, (series.white - series.black) / 255))

    def misfit(
        self, lights: Sequence[FloatArray], exposures: Sequence[float], exposure_error: float
    ) -> tuple[float, int]:
        """Return the sum of squared normalised errors of the matches, and how many these are.

        Arguments as of `PatchRatios.misfit`.
        """
        total, count = 0.0, 0.0
        for pair in sorted({key for each in self.matches for key in each.pairs.tolist()}):
            residuals, errors = [], []
            for place, every in enumerate(self.matches):
                some = every.part(every.pairs == pair)
                if some.low.size:
                    found = self._errors(some, lights[place % len(lights)], exposures)
                    residuals.append(found[0])
                    errors.append(found[1])
                    count += some.low.size / some.alike
            alike = self.matches[0].alike
            square = square_of(
                np.concatenate(residuals), np.concatenate(errors) * alike**0.5, exposure_error
            )
            total += square
        return total, round(count)

    def _errors(
        self, matches: Matches, light: FloatArray, exposures: Sequence[float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return how far the logarithms of ratios are from those of exposures, and their errors."""
        logs = np.log(np.maximum(light, 1e-12))
        slopes, brightness = np.gradient(logs), np.arange(light.size)
        ratio = np.log([exposures[k] for k in matches.long]) - np.log(
            [exposures[k] for k in matches.short]
        )
        square = np.full(ratio.size, SHARED**2)
        ends = []
        for level, variance in (
            (matches.low, matches.low_variance),
            (matches.high, matches.high_variance),
        ):
            # What is below a level has the brightness of half a level less, and of less than that.
            middle = level - 0.5
            ends.append(np.interp(middle, brightness, logs))
            slope = np.interp(middle, brightness, slopes)
            square += slope**2 * (variance + (self.unit * SHARED_LEVELS) ** 2)
        return np.asarray(ends[1] - ends[0] - ratio), np.sqrt(square)
