"""Two frames of different exposure: which brightness of the shorter one fits the longer one's.

The brightness of the longer frame gives the light, and noise gives the interval in which the
brightness of the shorter one then lies.  The noise model of the camera predicts it where it is
known; else, as for photographs, both the middle and the width of the interval are measured in the
frames themselves, at each brightness of each colour, without the patches in which something moved,
see `camctl.evidence.moved_parts`.  Quartiles are measured, which what moved by little in less than
a quarter of a brightness's samples does not change much.

What a noise model lacks (non-linearity, lag, rows that differ) makes samples scatter more than
predicted, and the tails of unknown noise are longer than those of a normal variable.  One factor
for the noise of each pair is therefore found on the patches of the capture that do not move, so
that a given share of their samples is outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.limits import EdgeLimits, Limits, edge_levels
from camctl.evidence.moved_parts import moved_patches
from camctl.evidence.patches import LightScale, Patches
from camctl.model.noise import FrameNoise

#: Error of the light besides noise and rounding (non-linearity, black level): in levels at least,
#: and as a share of full scale where there are many levels.
_OFFSET_LEVELS, _OFFSET_SHARE = 0.5, 1 / 4000
#: Least noise that deviations are counted in, levels.
_LEAST_NOISE = 1e-3
#: Least limits, standard deviations beside the other errors; and with them: else the few samples
#: whose noise rounding does not hide would have all false alarms, and look as if they moved.
_LEAST_LIMIT, _LEAST_REACH = 0.5, 3.0
#: With unknown noise, that of edges is in the measured one, and most samples have less.
_LEAST_REACH_UNKNOWN, _LEAST_EDGES = 2.5, 1.75
#: By how much wider they are where the longer frame is saturated: by noise, too, and no share of
#: false alarms is set there.
_AT_WHITE = 2.0
#: Share of the deviations that are put in order: more than any share of false alarms.
_TAIL = 0.02
#: Patches are at rest up to this mean square of the deviations, in the prediction or the median.
_REST = 1.8
#: Of the patches at rest those are used first that have at most so many samples outside of the
#: usual limit, standard deviations: more than two of 64 are so by noise in 1 of 30,000 patches.
_USUAL_LIMIT, _FEW_OUTSIDE = 3.5, 2
#: With unknown noise a patch is at rest if its mean deviation is that of most, up to so many
#: median absolute deviations in terms of a standard deviation.
_REST_SIGMAS = 6.0
#: With unknown noise, patches at rest that are needed, and the share of white from which the
#: samples of a file may be saturated ones: JPEG changes them by several levels.
_FEWEST, _NEARLY = 100, 0.95
#: Samples of which the quartiles at one brightness are measured, at least, and the most bins.
_BIN_SAMPLES, _MOST_BINS = 400, 128
#: Share of white up to which other brightness tells what is usual: what moved has its own.
_WINDOW = 1 / 8
#: Light beyond so many times that of these samples says nothing: the response may be wrong there.
_MOST_BEYOND = 4.0
#: Quartile of a normal variable, standard deviations.
_QUARTILE = 0.6745

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Side:
    """One of two frames that are compared.

    Attributes:
        position: of the frame in the capture
        exposure: relative to the shortest frame
        noise: of the frame; None where it is unknown
    """

    position: int
    exposure: float
    noise: FrameNoise | None


@dataclass(frozen=True, eq=False)
class Pair:
    """A shorter and a longer exposure.

    Args:
        scale: irradiance of each brightness
        short, long: the frames
        ratio: of the light in the longer frame to that in the shorter one, as most patches show
        samples: patches of both frames, colour by colour
        colours: of a pixel, 1 or 3: planes that may differ where the noise is unknown
    """

    scale: LightScale
    short: Side
    long: Side
    ratio: float
    samples: tuple[Patches, Patches]
    colours: int = 1

    @property
    def is_known(self) -> bool:
        """Whether the noise of both frames is known."""
        return self.short.noise is not None and self.long.noise is not None

    @property
    def saturated(self) -> int:
        """Brightness from which samples of the longer frame may be saturated ones."""
        white = self.scale.white
        return white if self.is_known else round(_NEARLY * white)

    @cached_property
    def _prediction(self) -> tuple[_Floats, _Floats]:
        """Mean and standard deviation of the shorter frame's light, (colours, white + 1) each.

        They are indexed by the brightness of the longer frame.
        """
        if self.short.noise is None or self.long.noise is None:
            rests = np.array_split(~self._moved, self.colours)
            planes_of = [
                [plane[rest] for plane, rest in zip(planes, rests, strict=True)]
                for planes in (np.array_split(each, self.colours) for each in self.samples)
            ]
            parts = [self._measured(*planes) for planes in zip(*planes_of, strict=True)]
            means, deviations = zip(*parts, strict=True)
            table = np.array((means, deviations))
            table[..., self.saturated :] = table[..., self.saturated, np.newaxis]
            return table[0], table[1]
        mean, deviation = self._modelled(self.short.noise, self.long.noise)
        shape = (self.colours, mean.size)
        return np.broadcast_to(mean, shape), np.broadcast_to(deviation, shape)

    def _modelled(self, short: FrameNoise, long: FrameNoise) -> tuple[_Floats, _Floats]:
        """Return the prediction of the noise model, (white + 1,) each.

        Both frames have photon and read noise; the brightness of the longer one is rounded.  Dark
        current adds to the light of each, and the offset of a pixel is the same in both.
        """
        scale, ratio, unit = self.scale, self.ratio, self.scale.level
        light = scale.light / ratio
        mean = light + (short.dark_levels - long.dark_levels / ratio) * unit
        bright = np.maximum(mean, 0.0)
        variance = bright * unit / short.electrons_per_level
        variance += bright * unit / long.electrons_per_level / ratio
        variance += (short.read_noise_levels * unit) ** 2
        variance += (long.read_noise_levels * unit / ratio) ** 2 + (scale.gap / ratio) ** 2 / 12
        variance += ((short.dsnu_levels - long.dsnu_levels / ratio) * unit) ** 2
        return mean, np.sqrt(variance)

    def _measured(self, before: Patches, after: Patches) -> tuple[_Floats, _Floats]:
        """Return what the frames show in the patches of one colour, (white + 1,) each."""
        scale = self.scale
        light = scale.light / self.ratio
        rounding = np.hypot(self._level(light), scale.gap / self.ratio) / np.sqrt(12)
        usable = (after < scale.white) & (before < scale.white)
        levels, errors = after[usable], scale.light[before[usable]] - light[after[usable]]
        if levels.size < _BIN_SAMPLES:
            return light, rounding
        order = np.argsort(levels, kind="stable")
        levels, errors = levels[order], errors[order]
        count = min(_MOST_BINS, levels.size // _BIN_SAMPLES)
        # All samples of one brightness are in one bin.
        first = levels[np.linspace(0, levels.size - 1, count + 1).astype(np.intp)[:-1]]
        edges = np.append(np.unique(np.searchsorted(levels, first)), levels.size)
        parts = [errors[start:stop] for start, stop in pairwise(edges.tolist())]
        low, middle, high = np.array([np.quantile(part, (0.25, 0.5, 0.75)) for part in parts]).T
        begins, ends = levels[edges[:-1]].astype(np.int64), levels[edges[1:] - 1].astype(np.int64)
        places, at = (begins + ends) // 2, np.arange(scale.white + 1)
        # Near black noise is cut off at one side.
        half = np.maximum(high - middle, middle - low) / _QUARTILE
        unit = self._level(light[places])
        window = np.abs(places - places[:, np.newaxis]) <= scale.white * _WINDOW
        weights = np.where(window, ends - begins + 1.0, 0.0)
        usual, usual_spread = (_weighted_medians(each / unit, weights) for each in (middle, half))
        most = 3 + 2 * usual_spread
        middle = np.clip(middle / unit, usual - most, usual + most) * unit
        half = np.minimum(half / unit, 2 * most) * unit
        middle, spread = (np.interp(at, places, each) for each in (middle, half))
        spread[scale.light > _MOST_BEYOND * scale.light[levels[-_BIN_SAMPLES]]] = np.inf
        return light + middle, np.hypot(spread, rounding)

    @cached_property
    def _moved(self) -> NDArray[np.bool_]:
        """Which patches, (P,), show what moved and would look like noise if that is measured."""
        scale = self.scale
        return moved_patches(*self.samples, self.colours, scale.black, scale.white)

    @property
    def _least_reach(self) -> float:
        return _LEAST_REACH if self.is_known else _LEAST_REACH_UNKNOWN

    @property
    def _offset(self) -> float:
        return max(_OFFSET_LEVELS * self.scale.level, _OFFSET_SHARE * self.scale.full)

    @cached_property
    def _steps(self) -> _Floats:
        """Least light of each brightness, and infinity."""
        steps = np.append(self.scale.light - self.scale.gap / 2, np.inf)
        steps[-2] = self.scale.full
        return steps

    def _level(self, light: _Floats) -> _Floats:
        """Return the light of one level of the shorter frame."""
        return np.asarray(np.interp(light, self.scale.light, self.scale.gap))

    def limits(self, sigmas: float) -> Limits:
        """Return the brightness that holds the light within `sigmas` standard deviations.

        Where the longer frame is saturated there is no largest brightness.
        """
        means, deviations = self._prediction
        white = self.scale.white
        steps = self._steps[:-1]
        reach = np.maximum(sigmas * deviations + self._offset, self._least_reach * deviations)
        reach[:, self.saturated :] *= _AT_WHITE
        low = np.searchsorted(steps, means - reach, side="right") - 1
        high = np.searchsorted(steps, means + reach, side="right") - 1
        high[:, self.saturated :] = white
        least, most = (np.clip(each, 0, white).astype(np.uint16) for each in (low, high))
        if self.is_known:
            return Limits(least, most)
        return Limits(
            least,
            most,
            EdgeLimits(means, reach, max(sigmas, _LEAST_EDGES) * self._level(means), self._steps),
        )

    @cached_property
    def resting(self) -> NDArray[np.bool_]:
        """Which patches, (P,), differ by no more than noise, or than most patches do."""
        before, after = self.samples
        usable = (after < self.scale.white) & (before < self.scale.white)
        means, deviations = (self._of_patches(each, after) for each in self._prediction)
        gap = self.scale.gap[before] / np.sqrt(12)
        step = np.maximum(np.hypot(deviations, gap), _LEAST_NOISE * self.scale.level)
        errors = self.scale.light[before] - means
        count = np.maximum(np.count_nonzero(usable, axis=1), 1)
        if not self.is_known:
            mean = np.where(usable, errors / step, 0.0).sum(axis=1) / count
            return self._usual(mean) & ~self._moved
        size = np.where(usable, np.maximum(np.abs(errors) - self._offset, 0.0) / step, 0.0)
        square = np.sum(np.minimum(size, 6.0) ** 2, axis=1) / count
        lit = square[usable.any(axis=1)]
        rests = square <= _REST * max(1.0, float(np.median(lit)) if lit.size else 1.0)
        counts = np.sum(self._outside(self.limits(_USUAL_LIMIT)), axis=1)
        few = rests & (counts <= _FEW_OUTSIDE)
        # With less noise predicted than there is, few patches have so few.
        is_enough = np.count_nonzero(few) >= np.count_nonzero(rests) / 2
        found = few if is_enough else rests
        return found if found.any() else np.ones(found.size, bool)

    def _of_patches(self, table: _Floats, levels: Patches) -> _Floats:
        """Return the values of a table, (colours, white + 1), at levels of patches."""
        parts = zip(table, np.array_split(levels, self.colours), strict=True)
        return np.concatenate([values[each] for values, each in parts])

    def _usual(self, mean: _Floats) -> NDArray[np.bool_]:
        """Return which patches deviate in the mean as most do; noise and contours average out."""
        rests = ~self._moved
        error = np.abs(mean - np.median(mean[rests]))
        spread = 1.4826 * max(float(np.median(error[rests])), 1e-3)
        return np.asarray(error <= _REST_SIGMAS * spread)

    def _outside(self, limits: Limits, rows: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
        """Return which samples of the patches contradict, or of some of the patches."""
        parts = (np.array_split(each, self.colours) for each in self.samples)
        chosen = None if rows is None else np.array_split(rows, self.colours)
        found = []
        for k, (before, after) in enumerate(zip(*parts, strict=True)):
            if chosen is not None:
                before, after = before[chosen[k]], after[chosen[k]]
            found.append((before < limits.low[k][after]) | (before > limits.high[k][after]))
        return np.concatenate(found)

    @property
    def contradicting(self) -> float:
        """Share of the samples of the patches that contradict by usual limits."""
        return float(np.mean(self._outside(self.limits(_USUAL_LIMIT))))

    @cached_property
    def _scores(self) -> _Floats:
        """Deviations of samples of patches at rest, in standard deviations, the largest ascending.

        A sample is within limits of at least so many standard deviations.
        """
        before, after = (each[self.resting] for each in self.samples)
        means, deviations = (
            self._of_patches(each, self.samples[1])[self.resting] for each in self._prediction
        )
        errors = np.maximum(self._steps[before] - means, means - self._steps[before + 1])
        noise = np.maximum(deviations, _LEAST_NOISE * self.scale.level)
        found = (errors - self._offset) / noise
        found[errors <= self._least_reach * noise] = 0.0
        if not self.is_known:
            edges = self._edge_errors()[self.resting, np.newaxis] * self._level(means)
            np.minimum(found, errors / np.maximum(edges, noise), out=found)
            found[errors <= _LEAST_EDGES * edges] = 0.0
        found = found[after < self.saturated]
        if found.size:
            few = found.size - math.ceil(_TAIL * found.size)
            found.partition(few)
            found[few:].sort()
        return np.asarray(found)

    def _edge_errors(self) -> _Floats:
        """Return the standard deviation of each patch by its range in any colour, levels, (P,)."""
        white = self.scale.white
        ranges = np.ptp(self.samples[1], axis=1).reshape(self.colours, -1).max(axis=0)
        ranges = (np.minimum(ranges, white) * (255 / white)).astype(np.uint8)
        return np.tile(edge_levels(ranges, white), self.colours)

    @property
    def compared(self) -> float:
        """Share of the samples of the patches that the longer frame does not saturate."""
        return float(np.mean(self.samples[1] < self.saturated))

    def calibrated(self, rate: float) -> tuple[Limits, float]:
        """Return limits, and the share of the samples of patches at rest that is outside of them.

        Samples that are saturated in the longer frame are not counted.  The share is `rate`, or
        less where rounding hides the noise.  With unknown noise and few patches at
        rest nothing can be said, and all is within the limits.
        """
        if not self.is_known and np.count_nonzero(self.resting) < _FEWEST:
            shape = (self.colours, self.scale.white + 1)
            everything = Limits(
                np.zeros(shape, np.uint16), np.full(shape, self.scale.white, np.uint16)
            )
            return everything, 0.0
        scores = self._scores
        if not scores.size:
            return self.limits(_USUAL_LIMIT), 0.0
        place = scores.size - max(1, math.floor(rate * scores.size))
        sigmas = max(float(scores[place]) * (1 + 1e-9), _LEAST_LIMIT)
        return self.limits(sigmas), float(np.mean(scores > sigmas))


def _weighted_medians(values: _Floats, weights: _Floats) -> _Floats:
    """Return the median of values, (N,), with each row of weights, (N, N)."""
    order = np.argsort(values)
    sums = np.cumsum(weights[:, order], axis=1)
    return np.asarray(values[order][np.argmax(sums >= sums[:, -1:] / 2, axis=1)])
