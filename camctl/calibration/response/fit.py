"""The response of a camera from matched brightness levels of its frames, and from a chart.

With x = k / (M + 1), ln E = ln x + h(u), where h is a cubic spline and u = ln(x + 0.1) -
ln(1.1 - x) / 2, so that the knots are close where curves bend most: at the toe and the shoulder.
(With few levels, a chart alone, or exposures far apart that need no shoulder, u is the first term
alone.)  Linear cameras have a constant h, and E(0) = 0.  The fit is by weighted least squares,
robust to outliers, under the condition that E ascends from level to level.  The prior knowledge is
that h is smooth but for a few bends: small third derivatives (second ones, where there is only a
chart, or where exposures are far apart and such a curve explains them) count by their squares,
large ones by their size.  It is needed where the exposures are powers of one factor f: h + p with
any p of period ln f in ln E explains the frames as well.  A bend that the prior rounds off would
come back as such a p.  Therefore the last rounds expect as much curvature of each part of the curve
as was found around it: where the curve has a bend it may bend, and where it is straight it shows p,
which is the same everywhere.

The exposures may be a little wrong, or hardly known.  Then there is an ambiguity (Mitsunaga and
Nayar, "Radiometric Self Calibration", CVPR 1999): E^g fits exposures t^g as well, for every g.  The
exposures that are given decide: their corrections have no trend with the logarithm of the exposure,
among frames that matches connect.  `camctl.calibration.response.exponent` decides where they are
not known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.limits import OUTLIER
from camctl.calibration.response.colours import NUMBERS, score
from camctl.calibration.response.matches import LEAST_PIXELS, NOISE_STEPS, Matches
from camctl.calibration.response.spline import COEFFICIENTS, Knots, ascending
from camctl.errors import DataError
from camctl.model.quantiles import NORMAL_MAD, median
from camctl.model.response.camera import FloatArray

#: Size of a difference (in standard deviations of the prior) from which it counts as a bend.  A
#: ripple has a larger third derivative, beside its second one, than a bend has.
_BEND = 2.0
#: In the last rounds: weight of a difference over the mean square of those around it, the width of
#: "around" in ln E, and the least mean square.
_ADAPTED, _AROUND, _LEAST_CURVED = 1.5, 0.3, 0.024
#: Standard deviations that an outlier counts as in the mean square of all.
_MISFIT = np.array([-3.0, 3.0])
#: Rounds with the same prior for the whole curve.
_ROUNDS = 6
#: Standard deviations come from a prior weaker by the first factor, times the second one: what
#: the frames do not determine is smoothed away, and real curves are rougher.  So chosen that the
#: 95 % intervals hold at steps of 2, 4 and 8 (tests/bench/bench_response.py).
_ROUGHER, _DEVIATION = 0.0001, 0.5
#: Brightness, share of full scale, to which standard deviations of ln E are relative.
REFERENCE = 0.5
#: Standard deviations of the logarithm of an exposure: as stated by a camera or a user, and roughly
#: known; and of their trend, which would be an exponent.
STATED, ROUGH, _TREND = 0.002, 0.3, 1e-5
#: Standard deviation of the logarithm of the light on a chart: its unit, which is arbitrary; its
#: slopes along x and y; its fall towards the edge.
CHART_LIGHT = (1e3, 0.1, 0.1, 0.05)


@dataclass(frozen=True, eq=False)
class ChartSamples:
    """Brightness of patches of known reflectance.

    Attributes:
        frame: (N,) index of the frame
        patch: (N,) index of the patch
        level: (N,) mean brightness above black, levels, within (0, M)
        variance: (N,) of `level`
        place: (P, 2) position of each patch, about -1 to 1
        reflectance: (P,) of each patch, in any unit
        error: (P,) standard deviation of its logarithm
    """

    frame: NDArray[np.intp]
    patch: NDArray[np.intp]
    level: FloatArray
    variance: FloatArray
    place: FloatArray
    reflectance: FloatArray
    error: FloatArray


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """An estimated response.

    Attributes:
        edges: (K,) levels above black, ascending; the last is M, white level minus black level
        irradiance: (K,) of each edge, ascending, 1 at level M + 1
        deviation: (K,) standard deviation of its logarithm, relative to the level at `REFERENCE`
        exposures: (J,) relative exposures of the frames, as given and corrected by the fit
        residual: root mean square of the logarithm of matched irradiances, robust
        patch_errors: (P,) logarithm of the reflectance of each patch of a chart, as found, relative
            to the given one
        score: how badly it explains the matches, as `camctl.calibration.response.colours.score`
    """

    edges: FloatArray
    irradiance: FloatArray
    deviation: FloatArray
    exposures: FloatArray
    residual: float
    patch_errors: FloatArray
    score: float = 0.0

    @cached_property
    def light(self) -> FloatArray:
        """(M + 1,) irradiance in the middle of each brightness above black, M included."""
        return np.interp(np.arange(self.edges[-1] + 1) + 0.5, self.edges, self.irradiance)

    def log_at(self, share: float) -> float:
        """Return ln(irradiance) at a brightness, a share of full scale."""
        return float(np.interp(share * (self.edges[-1] + 1), self.edges, np.log(self.irradiance)))


def light_terms(across: FloatArray, down: FloatArray) -> FloatArray:
    """Return what `CHART_LIGHT` is the standard deviation of, at places of a chart, (4, N)."""
    return np.stack([np.ones(across.size), across, down, across**2 + down**2])


def fit_response(
    matches: Matches,
    exposures: Sequence[float],
    edges: FloatArray,
    *,
    phase: float = 0.0,
    exposure_error: float = STATED,
    chart: ChartSamples | None = None,
) -> ResponseFit:
    """Return the response that explains the matches and the patches of a chart.

    Args:
        matches: of pairs of frames; may be empty with a chart
        exposures: relative exposures of the frames
        edges: (K,) levels at which the response is wanted, ascending; the last is M, white level
            minus black level
        phase: of the quantiser, in [0, 1)
        exposure_error: standard deviation of the logarithm of an exposure
        chart: patches of known reflectance in the same frames

    Raises:
        DataError: there are too few matches to determine a curve
    """
    if matches.low.size < LEAST_PIXELS and chart is None:
        raise DataError(
            "the frames have too few brightness levels in common",
            hint="shoot a scene with many shades, in steps of 2 to 4 times the exposure",
        )
    logs = np.log(exposures)
    fits = [
        _fit(matches, logs, edges, phase, exposure_error, chart, each)
        for each in _priors(matches, logs, edges)
    ]
    best = min(fits, key=lambda fit: fit.score)
    # Which curve it is is not certain either: the wider interval is stated.
    return replace(best, deviation=np.max([fit.deviation for fit in fits], axis=0))


def _fit(
    matches: Matches,
    logs: FloatArray,
    edges: FloatArray,
    phase: float,
    exposure_error: float,
    chart: ChartSamples | None,
    prior: _Prior,
) -> ResponseFit:
    """Return the response by one prior; arguments as of `fit_response`."""
    x_known = (edges - phase) / (edges[-1] + 1)
    system = _System(matches, logs, chart, (edges, phase), prior.knots)
    with_top = np.append(x_known, 1.0)
    whole = system.curve(with_top)
    curve, top = whole[:-1], whole[-1:]
    known, free = (system.known_beforehand(logs, each) for each in (exposure_error, ROUGH))
    roughness, places = prior.roughness()
    log_E = 1.5 * np.log(x_known)  # a start: most responses are steeper than a linear one
    residuals = np.zeros(system.wanted.size)
    bends = np.zeros(len(roughness))
    least = 1.0
    # First with free exposures, which show what no curve explains: neither errors of exposures nor
    # those of a curve that is kept smooth count as such.
    first = -_ROUNDS if exposure_error < ROUGH and chart is None else 0
    for turn in range(first, _ROUNDS + prior.adapted):
        variance = prior.floor**2 + system.variance(edges, log_E)
        deviations = residuals / np.sqrt(variance)
        robust = 1 / np.maximum(1.0, np.abs(deviations) / OUTLIER)
        if turn == 0 > first:
            least = system.unexplained(deviations)
        # Errors beyond the variances must not outvote smoothness: they would bend the curve.  Where
        # exposures are free, they and not the curve follow such errors.
        is_free = turn < 0 or exposure_error >= ROUGH
        misfit = 1.0 if is_free else max(least, np.mean(np.clip(deviations, *_MISFIT) ** 2))
        weights = robust / (variance * system.alike * misfit)
        weighted = system.rows * np.sqrt(weights)[:, None]
        square = weighted.T @ weighted + (free if turn < 0 else known)
        around = None if turn < _ROUNDS else np.interp(places, x_known, log_E)
        smooth = roughness * _expected(bends, around)[:, None]
        square[:COEFFICIENTS, :COEFFICIENTS] += roughness.T @ smooth
        square += 1e3 * np.trace(square[:COEFFICIENTS, :COEFFICIENTS]) * top.T @ top
        product = system.rows.T @ (weights * system.wanted)
        found = ascending(square, product, whole, np.log(with_top))
        log_E = (curve - top) @ found + np.log(x_known)
        residuals = system.rows @ found - system.wanted
        bends = roughness @ found[:COEFFICIENTS]
    left = float(misfit * weights @ residuals**2)
    if matches.low.size:
        square[:COEFFICIENTS, :COEFFICIENTS] -= (1 - _ROUGHER) * roughness.T @ smooth
    covariance = np.linalg.inv(square)
    relative = curve - system.curve(np.array([REFERENCE]))
    spread = np.sum(relative @ covariance * relative, axis=1)
    # Noise shifts a level by half its variance times the slope of ln(number of pixels), about 1/x.
    shift = (1 / NOISE_STEPS / np.maximum(x_known, 1 / NOISE_STEPS)) ** 2 / 2
    return ResponseFit(
        edges=edges,
        irradiance=np.exp(log_E),
        deviation=np.sqrt(_DEVIATION**2 * np.maximum(spread, 0.0) + shift**2),
        exposures=np.exp(logs + found[system.frames]),
        residual=float(np.sqrt(np.average(residuals**2, weights=weights))),
        patch_errors=found[system.patches],
        score=score(left, round(np.sum(1 / system.alike)), prior.numbers),
    )


class _System:
    """The linear equations of a fit: the unknowns are h, errors of exposures, light, and patches.

    Attributes:
        rows: (N, unknowns)
        wanted: (N,) right-hand side: rows @ unknowns = wanted
        spreads: pairs of levels (N,) and their variances (N,) from which rows have errors
        alike: (N,) number of rows that count as one
        uncertain: (N,) variance of what noise shifts
        expected_alike: number of neighbouring matches that count as one
        starts: of the runs of matches of one pair and channel but the first
        groups: of frames that matches connect, or a chart does
        frames, light, patches: the places of these unknowns
    """

    def __init__(
        self,
        matches: Matches,
        logs: FloatArray,
        chart: ChartSamples | None,
        scale: tuple[FloatArray, float],
        knots: Knots,
    ) -> None:
        self.knots = knots
        edges, phase = scale
        count = 0 if chart is None else chart.reflectance.size
        ends = np.cumsum([COEFFICIENTS, logs.size, len(CHART_LIGHT) if count else 0, count])
        self.frames, self.light, self.patches = (
            slice(int(start), int(end)) for start, end in pairwise(ends)
        )
        self.size = int(ends[-1])
        x_low, x_high = ((level - phase) / (edges[-1] + 1) for level in (matches.low, matches.high))
        frames = np.eye(logs.size)
        rows = self.curve(x_low) - self.curve(x_high)
        rows[:, self.frames] = frames[matches.long] - frames[matches.short]
        wanted = logs[matches.short] - logs[matches.long] - np.log(x_low / x_high)
        wanted += matches.shift
        # What noise shifts is known to about a half.
        uncertain = np.square(matches.shift / 2)
        # Of all pairs of J frames only J - 1 are independent.
        pairs = np.unique(matches.pairs).size
        alike = np.full(wanted.size, matches.alike * max(1.0, pairs / max(1, logs.size - 1)))
        spreads = [(matches.low, matches.low_variance), (matches.high, matches.high_variance)]
        if chart is not None:
            x = (chart.level - phase) / (edges[-1] + 1)
            patches = self.curve(x)
            patches[:, self.frames] = -frames[chart.frame]
            across, down = chart.place[chart.patch].T
            patches[:, self.light] = -light_terms(across, down).T
            patches[np.arange(x.size), self.patches.start + chart.patch] = -1
            logs_R = np.log(chart.reflectance)[chart.patch]
            rows = np.concatenate([rows, patches])
            wanted = np.concatenate([wanted, logs_R + logs[chart.frame] - np.log(x)])
            alike = np.concatenate([alike, np.ones(x.size)])
            uncertain = np.concatenate([uncertain, np.zeros(x.size)])
            spreads = [
                (np.concatenate([level, chart.level]), np.concatenate([variance, each]))
                for (level, variance), each in zip(
                    spreads, (chart.variance, np.zeros(x.size)), strict=True
                )
            ]
        self.rows, self.wanted, self.alike, self.spreads = rows, wanted, alike, spreads
        self.uncertain = uncertain
        self.expected_alike = matches.alike
        ends_run = (np.diff(matches.pairs) != 0) | (np.diff(matches.high) <= 0)
        self.starts = np.flatnonzero(ends_run) + 1
        self.groups = connected(matches, logs.size) if chart is None else [np.arange(logs.size)]
        self.patch_error = np.zeros(0) if chart is None else chart.error

    def variance(self, edges: FloatArray, log_E: FloatArray) -> FloatArray:
        """Return the variance of each row with a curve, (N,)."""
        spreads = (_slope(edges, log_E, at) ** 2 * spread for at, spread in self.spreads)
        return np.asarray(self.uncertain + sum(spreads))

    def unexplained(self, deviations: FloatArray) -> float:
        """Return the factor of the variances, and of the rows that count as one; 1 at least.

        What developed the pictures of a camera is no curve for each channel: errors are alike over
        many levels then, and a curve that is free enough follows them.

        Args:
            deviations: of the rows, which are matches alone, in their standard deviations
        """
        size = max(1.0, median(np.abs(deviations)) / NORMAL_MAD)
        within = np.clip(deviations, *(_MISFIT * size))
        alike = _alike(np.split(within, self.starts))
        return max(1.0, float(np.mean(within**2))) * max(1.0, alike / self.expected_alike)

    def curve(self, x: FloatArray) -> FloatArray:
        """Return the rows that give h at brightness x, (N, unknowns)."""
        rows = np.zeros((x.size, self.size))
        rows[:, :COEFFICIENTS] = self.knots.basis(x)
        return rows

    def known_beforehand(self, logs: FloatArray, exposure_error: float) -> FloatArray:
        """Return the precision matrix of exposures, light and patches, (unknowns, unknowns).

        The exposures have no error in the direction of the logarithms: that would be a power.  In
        each group of frames: what no match connects with them says nothing of their power.
        """
        light = np.array(CHART_LIGHT)[: self.light.stop - self.light.start]
        errors = np.concatenate([np.full(logs.size, exposure_error), light, self.patch_error])
        precision = np.zeros((self.size, self.size))
        precision[COEFFICIENTS:, COEFFICIENTS:] = np.diag(errors**-2.0)
        for group in self.groups:
            power = np.zeros(logs.size)
            power[group] = logs[group] - logs[group].mean()
            if power.any():
                block = np.outer(power, power) / (power @ power) / _TREND**2
                precision[self.frames, self.frames] += block
        return precision


def _alike(runs: Sequence[FloatArray]) -> float:
    """Return how many neighbours in runs of errors count as one.

    It is 1 plus twice their correlations, up to where these end.
    """
    square = float(np.mean(np.square(np.concatenate(runs))))
    number = 1.0
    for lag in range(1, max(map(len, runs))):
        products = [run[lag:] * run[:-lag] for run in runs if len(run) > lag]
        if (mean := float(np.mean(np.concatenate(products)))) <= 0:
            break
        number += 2 * mean / square
    return number


class _Prior(NamedTuple):
    """What is expected of h, and how the fit is done.

    Attributes:
        order: derivative of h that is small
        smoothness: weight of the integral of its square
        adapted: rounds with a prior that follows the curve.  More of these do not help: they take
            the error of a round for curvature
        floor: relative error of a match that the histograms do not explain
        knots: of the spline
        numbers: that it takes to describe a curve, beyond those of the smoothest prior
    """

    order: int
    smoothness: float
    adapted: int
    floor: float
    knots: Knots
    numbers: int = 0

    def roughness(self) -> tuple[FloatArray, FloatArray]:
        """Return the rows that give the weighted derivatives of h, and the brightness of each."""
        rows = np.diff(np.eye(COEFFICIENTS), self.order, axis=0)
        rows *= math.sqrt(self.smoothness) / self.knots.step ** (self.order - 0.5)
        places = np.arange(len(rows)) + self.order / 2 - 1  # in knots
        fine = np.linspace(0, 1, 4001)  # at which the places of knots are looked up
        return rows, np.interp(places, self.knots.before(fine), fine)


#: Where only a chart says something about h; of few levels, which show no shoulder; of many levels;
#: and where exposures are so far apart that they show little of the curvature of h: there a curve
#: with a toe and a shoulder must explain the frames better, as a response of more numbers.  The
#: numbers are those of the least errors in tests/bench/bench_response.py.
_CHART = _Prior(2, 1.0, 0, 0.003, Knots(0.0))
_FEW_LEVELS = _Prior(3, 0.01, 2, 0.001, Knots(0.0))
_MANY_LEVELS = _Prior(3, 0.1, 2, 0.001, Knots(0.5))
_FAR_APART = (
    _Prior(2, 40.0, 0, 0.003, Knots(0.0)),
    _Prior(3, 1.0, 2, 0.003, Knots(0.5), NUMBERS),
)
#: Levels from which there are many, and the factor between exposures from which they are far apart.
_MANY, _FAR = 60, 5.0


def _priors(matches: Matches, logs: FloatArray, edges: FloatArray) -> Sequence[_Prior]:
    if not matches.low.size:
        return [_CHART]
    if edges[-1] < _MANY:
        return [_FEW_LEVELS]
    groups = connected(matches, logs.size)
    steps = np.concatenate([np.diff(np.unique(logs[group])) for group in groups])
    is_far = steps.size > 0 and median(steps) > math.log(_FAR)
    return _FAR_APART if is_far else [_MANY_LEVELS]


def connected(matches: Matches, count: int) -> list[NDArray[np.intp]]:
    """Return the positions of the frames of each group that matches connect."""
    group = np.arange(count)
    for short, long in {*zip(matches.short.tolist(), matches.long.tolist(), strict=True)}:
        group[group == group[long]] = group[short]
    return [np.flatnonzero(group == each) for each in np.unique(group)]


def _expected(bends: FloatArray, log_E: FloatArray | None) -> FloatArray:
    """Return the weight of each difference of the prior, by it, or with ln E by those around."""
    if log_E is None:
        return np.asarray(1 / np.maximum(1.0, np.abs(bends) / _BEND))
    return np.asarray(_ADAPTED / (_around(log_E) @ bends**2 + _LEAST_CURVED))


def _around(log_E: FloatArray) -> FloatArray:
    """Return the matrix of weighted means over places within about `_AROUND` in ln E, (N, N)."""
    near = np.exp(-((log_E[:, None] - log_E) ** 2) / (2 * _AROUND**2))
    return np.asarray(near / near.sum(axis=1, keepdims=True))


def _slope(known: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    width = max(1.0, known[-1] / NOISE_STEPS)
    ends = [np.interp(at + side * width / 2, known, values) for side in (-1, 1)]
    return np.asarray((ends[1] - ends[0]) / width)
