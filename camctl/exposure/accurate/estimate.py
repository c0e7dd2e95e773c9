"""A fast estimate of the accuracy of a sum of noisy frames, from what each frame contributes.

The brightness of frame j rises by s_j levels for each unit of ln(irradiance) and has the variance
v_j; the pixels' offsets (DSNU) shift it by c_j, the same in each frame of a sum.  All three add up
over the frames, and the mean square error of the sum in the desired response u is::

    mse = integral over u of  (E du/dE)^2 [ sum of v_j + (sum of c_j)^2 ] / (sum of s_j)^2  du

At one gain s, v and c depend on e E alone, the light times the exposure, so that one table for each
gain serves for every exposure; the charge that a dark current adds in a shutter time is light to
the quantiser, and shows nothing of E.  Samples
are clipped normal variables with 1/12 of quantisation (EMVA 1288): noise dithers the quantiser.
Near black a frame of little noise does not leave its lowest level, and contributes nothing, noise
included (`_near_black`).  Where noise does not dither the quantiser elsewhere, sums are up to some
10 % more or less accurate than this, and the exact distribution
(`camctl.exposure.noise.predicted_mse`) has to judge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.exposure_choices import AccuracyProblem
from camctl.exposure.noise import DITHERS
from camctl.model.distribution import NORMAL_REACH, deviation, normal_cdf, quantiser_input
from camctl.model.response.camera import FloatArray

NODES = 96
"""Steps of u over which the error is averaged; with 1,024 the effective levels differ by 0.5 %."""

EDGES = np.linspace(0.0, 1.0, NODES + 1)
"""Edges of these steps.  What a frame contributes is averaged within each: where the range is long,
several levels of a dark frame lie within one.  The ratios of the exact levels to the estimate then
differ by 0.22 % between sets (one standard deviation; sensor standard, log 1:16,000, 8 s), by
0.33 % with the middle of each step alone."""

FEW_LEVELS = 15
"""Cameras of so few levels (photon counters of 1 to 4 bits) have errors as large as the range."""

_STEP = 0.02
"""Step of the tables in ln(e E): photon noise of 1 % at white is as wide as that."""

_BEYOND = 8.0
"""Standard deviations above white at which a table ends: a frame shows nothing more there."""


_PHASES = 0.25
"""Share of a signal within which the phases of the quantiser are averaged near black, so that from
two levels on all of them are.  The ratios of the exact levels to the estimate differ by 15 %
with 1/12 alone, by 1.0 % with 0.25, and by 3 to 5 % with 0.05, 0.1 and 0.5, between 12 sets of the
same shutter times at gains 1 to 8 (sensor complete, log 1:16,000).  Other shares, cameras
and sets were not tried."""

_LEAST_WIDTH = 1e-9
"""Noise, and half widths of averages, that are less than so many levels count as this much: steps
remain sharp, and a curve may begin with no signal at all."""

_PHASE = np.linspace(-1.0, 1.0, 17)
"""Phases that are averaged, in halves of that width."""


_FINER = 4
"""Steps to which one of the tables is divided for their integrals."""

_NARROW = 1e-8
"""By how much steps are widened in ln(e E): where the response jumps, or dark current is nearly all
that a frame shows, their width is 0, and integrals in float64 have to differ."""


class _Table:
    """One gain: rows of s, v, c, and what a second of DCNU adds to c, at x.

    Args:
        rows: (R, X); without the last where nothing grows with time
        first: ln(x) of the first column
        dark: light that a second of dark current is to the quantiser, in the unit of x
    """

    def __init__(self, rows: FloatArray, first: float, dark: float) -> None:
        self._first, self.dark = first, dark
        places = np.arange((rows.shape[1] - 1) * _FINER + 1) / _FINER
        fine = np.array([np.interp(places, np.arange(rows.shape[1]), row) for row in rows])
        steps = (fine[:, 1:] + fine[:, :-1]) / 2 * (_STEP / _FINER)
        self._integrals = np.concatenate([np.zeros((len(rows), 1)), steps.cumsum(axis=1)], axis=1)

    def means(self, log_x: FloatArray) -> NDArray[np.float32]:
        """Return the means of the rows between edges of ln(x), (R, ..., N) from (..., N + 1)."""
        log_x, size = log_x + _NARROW * np.arange(log_x.shape[-1]), self._integrals.shape[1]
        place = np.clip((log_x - self._first) * (_FINER / _STEP), 0.0, size - 1.001)
        index = place.astype(np.intp)
        low = self._integrals.take(index, axis=1)
        low += (place - index) * (self._integrals.take(index + 1, axis=1) - low)
        return np.asarray(np.diff(low) / np.diff(log_x), dtype=np.float32)


class FrameAccuracy:
    """What frames of one camera contribute to the accuracy of a sum.

    Args:
        problem: the camera, its noise and the desired response
        edges: of the steps of u over which the error is averaged

    Attributes:
        u: (NODES,) middles of these steps
        share: (NODES,) their widths
    """

    def __init__(self, problem: AccuracyProblem, edges: FloatArray = EDGES) -> None:
        self.problem, self.edges = problem, edges
        self.u = (edges[1:] + edges[:-1]) / 2
        self.share = np.diff(edges)
        u, E = self.u, problem.desired.inverse(self.u)
        slope = problem.desired.slope(E)
        ends = problem.desired.inverse(edges)
        if not ends[0] > 0:  # a quarter of the step: its middle is the mean in ln(u)
            ends[0] = problem.desired.inverse(edges[1:2] / 4)[0]
        self._log_E = np.log(ends)
        self.weight = ((E * slope) ** 2).astype(np.float32)
        # Below the light that is seen at all, the error is that of a uniform u: u1^2 / 12 from 0 to
        # u1, which is the mean of u^2 / 4.
        self.largest = np.minimum(u**2 / 4, 1 / 12).astype(np.float32)
        noise = problem.noise
        self.fixed = float(self.share @ (noise.prnu * E * slope) ** 2)
        available = problem.available
        self.has_shift = noise.dsnu_e > 0 or noise.dcnu_e_s > 0
        has_dark = noise.dark_current_e_s > 0 or noise.dcnu_e_s > 0
        self.unit_s = available.unit_s if has_dark else 0.0
        self._tables = {gain: self._table(gain) for gain in available.gains}

    def _table(self, gain: float) -> _Table:
        response, noise = self.problem.response, self.problem.noise
        frame = noise.frame(gain=gain, time_s=0.0, black=self.problem.black)
        white = np.array([float(response.levels[-1])])
        sigma = deviation(response, white, frame) / max(float(response.slope(white)[0]), 1e-12)
        top = math.log(float((white + _BEYOND * sigma)[0])) + 2 * _STEP
        first = min(float(self._log_E[0]), top) - 2 * _STEP
        log_x = first + _STEP * np.arange(math.ceil((top - first) / _STEP) + 2)
        x = np.exp(log_x)
        slope = response.slope(x)
        noise_levels = deviation(response, x, frame)
        spread = np.sqrt(noise_levels**2 + 1 / 12)
        y = quantiser_input(response, x)
        low, high = (0.5 - frame.black - y) / spread, (response.M + 0.5 - y) / spread
        inside = normal_cdf(high) - normal_cdf(low)
        variance = spread**2 * _clipped_variance(low, high)
        near = (y < 0.5 / _PHASES) & (noise_levels < DITHERS)
        inside[near], variance[near] = _near_black(
            y[near], noise_levels[near], frame.black, response.M
        )
        unit = slope / (response.M + 1) * inside  # levels of a sample for one of the linear scale
        per_electron = gain / noise.conversion_e_per_dn
        rows = [slope * x * inside, variance, unit * frame.dsnu_levels]
        if self.unit_s:
            rows.append(unit * noise.dcnu_e_s * per_electron)
        dark = noise.dark_current_e_s * per_electron / (response.M + 1)
        return _Table(np.array(rows), first, dark)

    def parts(self, log_exposure: FloatArray, gain: float, time: FloatArray) -> NDArray[np.float32]:
        """Return s, v and c of frames at one gain, (3, F, NODES).

        Args:
            log_exposure: (F,) ln of the exposures relative to the shortest
            gain: their gain
            time: (F,) their shutter times, in the unit of the problem
        """
        table, log_x = self._tables[gain], log_exposure[:, np.newaxis] + self._log_E
        if not self.unit_s:
            return table.means(log_x)
        time_s = (time * self.unit_s)[:, np.newaxis]
        if table.dark:
            dark = np.log(np.maximum(table.dark * time_s, 1e-300))
            rows = table.means(np.logaddexp(log_x, dark))
            rows[0] *= 1 / (1 + np.exp(dark - (log_x[:, 1:] + log_x[:, :-1]) / 2))
        else:
            rows = table.means(log_x)
        rows[2] = np.hypot(rows[2], rows[-1] * time_s)
        return rows[:-1]

    def mse(self, parts: NDArray[np.floating[Any]], step: int = 1) -> FloatArray:
        """Return the mean square error in u of summed parts, (...) from (3, ..., NODES).

        With a `step` the parts are those of every second, third, ... node.
        """
        errors = self.errors(parts, step)
        mean = np.add.reduce(errors, axis=-1) / np.float32(errors.shape[-1])
        return np.asarray(mean + self.fixed, dtype=np.float64)

    def derivatives(
        self, total: FloatArray, one: FloatArray, two: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return gradient (F,) and Hessian (F, F) of `mse` by what frames are changed by.

        Args:
            total: summed parts of the set
            one: (..., F, NODES) derivatives of the parts of each frame
            two: their second derivatives
        """
        S, V, C = total
        V = V + C * C
        S = np.maximum(S, 1e-30)
        weight = self.weight / S**2 * self.share
        weight = np.where(self.weight * V / S**2 < self.largest, weight, 0.0)
        ds, dv = one[0] / S, one[1] + 2 * C * one[2]
        gradient = (dv - 2 * V * ds) @ weight
        cross = -2 * (dv * weight) @ ds.T
        hessian = cross + cross.T + 6 * (ds * (V * weight)) @ ds.T
        hessian[np.diag_indices(len(hessian))] += (two[1] - 2 * V * two[0] / S) @ weight
        return gradient, hessian

    def errors(self, parts: NDArray[np.floating[Any]], step: int = 1) -> NDArray[np.floating[Any]]:
        """Return the square error in u at each node, without that of sensitivities."""
        slope, variance, shift = parts
        squared = slope * slope
        if self.has_shift:
            error = shift * shift
            error += variance
        else:
            error = variance.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            error /= squared
        error *= self.weight[::step]
        if self.problem.response.M <= FEW_LEVELS:
            # Errors as large as the range: they and what is known without a frame combine.
            error = 1 / (1 / np.where(error > 0, error, np.inf) + 1 / self.largest[::step])
        else:
            np.fmin(error, self.largest[::step], out=error)
        return np.asarray(error)


def _near_black(
    y: FloatArray, noise: FloatArray, black: int, white: int
) -> tuple[FloatArray, FloatArray]:
    """Return the slope of the mean level by the signal, and the variance, of a quantised frame.

    A sample is at level k or above where the noisy signal is k or more.  Both are averages over
    signals within `_PHASES` of y, with the deviation of their mean levels from a straight line.

    Args:
        y: (F,) signals in levels
        noise: (F,) their noise in levels
        black: levels below 0 that a sample can have
        white: the largest level
    """
    if not y.size:
        return y, y
    reach = 1 + NORMAL_REACH * float(noise.max())
    first = max(1 - black, math.floor(-reach))
    steps = np.arange(first, min(white, math.ceil((1 + _PHASES) * float(y.max()) + reach)) + 1)
    width = np.maximum(_PHASES * y, _LEAST_WIDTH)[:, np.newaxis]
    signal = y[:, np.newaxis] + width * _PHASE
    spread = np.maximum(noise, _LEAST_WIDTH)[:, np.newaxis, np.newaxis]
    above = normal_cdf((signal[..., np.newaxis] - steps) / spread)
    mean = above.sum(axis=-1)
    variance = above @ (2.0 * np.arange(steps.size) + 1.0) - mean**2
    slope = (mean[:, -1] - mean[:, 0]) / (2 * width[:, 0])
    straight = mean.mean(axis=1, keepdims=True) + slope[:, np.newaxis] * width * _PHASE
    return slope, np.mean(variance + (mean - straight) ** 2, axis=1)


def _clipped_variance(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the variance of a standard normal variable that is clipped to [low, high]."""
    at_low, at_high = normal_cdf(low), normal_cdf(-high)
    low, high = np.clip(low, -40, 40), np.clip(high, -40, 40)
    density_low, density_high = (np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) for z in (low, high))
    inside = 1 - at_low - at_high
    mean = low * at_low + high * at_high + density_low - density_high
    square = low**2 * at_low + high**2 * at_high + inside + low * density_low - high * density_high
    return np.maximum(square - mean**2, 0.0)
