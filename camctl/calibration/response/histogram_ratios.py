"""Responses compared by the histograms of photographs that share no patch.

A brightness of one frame and the one of equal irradiance in another have a ratio of light that is
the ratio of the exposures, see `camctl.calibration.response.matches`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.response.colours import SHARED, SHARED_LEVELS, square_of
from camctl.calibration.response.matches import Matches, match_levels
from camctl.calibration.response.series import Series
from camctl.model.response.camera import FloatArray


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
