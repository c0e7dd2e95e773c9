"""Conversion gain and read noise that fit the variance of noise against brightness.

A weighted fit of all patches of all pairs, by `camctl.calibration.noise.curve`.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import certain, chi_squared_limit
from camctl.calibration.light import moved
from camctl.calibration.limits import DIM, LEAST_PATCHES, ROUNDS
from camctl.calibration.noise.curve import LEAST_VARIANCE, NoiseCurve, TransferCurve
from camctl.calibration.noise.pairs import PairPatches
from camctl.errors import DataError
from camctl.model.quantiles import Z_95
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import CLIPPING_SIGMAS

#: Relative change at which a fit ends, and at which its start is near enough.
_CONVERGED, _NEAR = 1e-7, 1e-2
#: Patches with a mean above this share of white are not used for a start.
_BRIGHT = 0.7
#: Where a response is curved or noise is cut at black, patches with contrast that would change the
#: variance by this share are not used, nor those with a contrast above this share of their mean.
_MOST_CURVED, _MOST_CONTRAST = 0.03, 0.06
#: Least ratio of the brightest to the darkest tenth of the patches.
_LEAST_RANGE = 3.0
#: Groups of brightness in which the fit is compared with the measured variance.
_GROUPS = 20
#: The same from which nothing is measured through a measured response.
_MOST_MISFIT = 30.0


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A fit of the photon transfer curve of one gain.

    Attributes:
        inverse_k: levels per electron
        read_squared: squared read noise, levels squared; noise can make it negative
        covariance: (2, 2) of both, errors of the response included
        shifts: (errors, 2) of both by each independent error of the response, one deviation large
        misfit: mean square deviation of groups of brightness from the fit, over its expectation
        patches: number used
        moved_share: share of the patches left out because their variance is too large
        means: brightness above black of the groups, DN
        variances: measured there, DN squared
        expected: by the fit, DN squared
    """

    inverse_k: float
    read_squared: float
    covariance: FloatArray
    shifts: FloatArray
    misfit: float
    patches: int
    moved_share: float
    means: FloatArray
    variances: FloatArray
    expected: FloatArray

    @property
    def conversion(self) -> tuple[float, float, float]:
        """Electrons of a level: value, and both ends of the 95 % interval."""
        half = Z_95 * math.sqrt(self.covariance[0, 0])
        low = self.inverse_k - half
        return (
            1 / self.inverse_k,
            1 / (self.inverse_k + half),
            1 / low if low > 0 else math.inf,
        )

    @property
    def read_noise(self) -> tuple[float, float, float]:
        """Read noise in electrons: value, and both ends of the 95 % interval."""
        # The squared noise in electrons, to first order in both errors.
        squared = self.read_squared / self.inverse_k**2
        slope = np.array([-2 * squared / self.inverse_k, 1 / self.inverse_k**2])
        half = Z_95 * math.sqrt(float(slope @ self.covariance @ slope))
        # An estimate below 0 counts as 0: the interval must not end below what is possible.
        squared = max(0.0, squared)
        value, low, high = (math.sqrt(max(0.0, squared + turn)) for turn in (0, -half, half))
        return value, low, high


def combine_fits(fits: Sequence[NoiseFit]) -> NoiseFit:
    """Return the weighted mean of the fits of the channels of one gain.

    Their noise is independent; the errors of their responses are taken for the same.
    """
    inverses = [np.linalg.inv(fit.covariance) for fit in fits]
    covariance = np.linalg.inv(np.sum(inverses, axis=0))
    values = [
        inverse @ (fit.inverse_k, fit.read_squared)
        for inverse, fit in zip(inverses, fits, strict=True)
    ]
    inverse_k, read_squared = covariance @ np.sum(values, axis=0)
    weights = [covariance @ inverse for inverse in inverses]
    shifts = np.sum(
        [fit.shifts @ weight.T for weight, fit in zip(weights, fits, strict=True)], axis=0
    )
    covariance = shifts.T @ shifts + np.sum(
        [
            weight @ (fit.covariance - fit.shifts.T @ fit.shifts) @ weight.T
            for weight, fit in zip(weights, fits, strict=True)
        ],
        axis=0,
    )
    joined = [
        np.concatenate([getattr(fit, name) for fit in fits])
        for name in ("means", "variances", "expected")
    ]
    order = np.argsort(joined[0])
    return NoiseFit(
        float(inverse_k),
        float(read_squared),
        covariance,
        shifts,
        max(fit.misfit for fit in fits),
        sum(fit.patches for fit in fits),
        max(fit.moved_share for fit in fits),
        *(each[order] for each in joined),
    )


def fit_noise(curve: NoiseCurve, patches: PairPatches, white: float) -> NoiseFit:
    """Return the noise that fits the patches of pairs with one gain.

    Args:
        curve: of the camera
        patches: of one or more channels
        white: white level above black, DN

    Raises:
        DataError: too few patches are usable, or show no photon noise
    """
    patches = patches.part(curve.is_known(patches.mean))
    found = _start(curve, patches, white)
    # The medians of groups of brightness are a start that moving objects do not disturb.
    medians = _medians(patches.part(patches.mean < _BRIGHT * white))
    for _ in range(ROUNDS):
        before, (found, _) = found, _round(curve.shape(*found), medians, found)
        if abs(found[0] - before[0]) < _NEAR * found[0]:
            break
    for _ in range(ROUNDS):
        shape = curve.shape(*found)
        used, is_moved = _suitable(shape, patches, white)
        _check(patches, used, is_moved, white)
        part = patches.part(used)
        before, (found, terms) = found, _round(shape, part, found)
        if abs(found[0] - before[0]) < _CONVERGED * found[0]:
            break
    scores, normal, weight, residual = terms
    expected = part.variance - residual
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (scores.T @ scores) @ inverse
    misfit, groups = _groups(part, expected, weight, shape.share_used(part) >= 1)
    is_misfit = misfit > chi_squared_limit(_GROUPS - 2)
    if is_misfit:
        covariance = covariance * misfit
    if curve.response.deviation is not None and misfit > _MOST_MISFIT:
        raise DataError(
            f"the noise does not follow the measured response (misfit {misfit:.0f})",
            hint="measure the response again, with more frames or a scene with more shades",
            remedies={"calibrate_response": None},
        )
    # What the noise contradicts by more than its scatter is a response worse than stated.
    shifts = _shifts(curve, part, found)
    shifts[1:] *= math.sqrt(misfit) if is_misfit else 1.0
    return NoiseFit(
        found[0],
        found[1],
        covariance + shifts.T @ shifts,
        shifts,
        misfit,
        int(np.count_nonzero(used)),
        float(np.count_nonzero(is_moved) / np.count_nonzero(used | is_moved)),
        *groups,
    )


def _shifts(curve: NoiseCurve, patches: PairPatches, found: tuple[float, float]) -> FloatArray:
    """Return how the errors of the response change the parameters, and how its scale does."""
    here, _ = _round(curve.shape(*found), patches, found)
    others = [_round(each.shape(*found), patches, found)[0] for each in curve.varied()]
    scale = curve.response.scale_error
    return np.array(
        [(scale * found[0], 2 * scale * found[1]), *(np.subtract(each, here) for each in others)]
    )


def _suitable(
    shape: TransferCurve, patches: PairPatches, white: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which patches are used, and which of the suitable ones are not: something moved."""
    expected = shape.variances(patches)
    noise = np.maximum(expected, LEAST_VARIANCE)
    deviation = np.sqrt((2 * noise**2 + noise / 2) / patches.freedom)
    reach = CLIPPING_SIGMAS * np.sqrt(patches.spread + noise / 2)
    suitable = (shape.share_used(patches) > 0) & (patches.mean + reach < white)
    even = patches.spread < np.square(_MOST_CONTRAST * patches.mean) + 0.75 * noise
    even &= np.abs(shape.bend(patches)) <= _MOST_CURVED * noise
    # On a straight response contrast does not matter but where samples are cut at black.
    suitable &= even | (shape.is_straight & (patches.mean - reach > shape.lowest))
    # A variance has the skewness of a chi-squared one (Cornish and Fisher's first term).
    z = certain(patches.mean.size)
    most = z + (z**2 - 1) * np.sqrt(8 / patches.freedom) / 6
    is_moved = suitable & (patches.variance > expected + most * deviation)
    return suitable & ~is_moved, is_moved


def _medians(patches: PairPatches) -> PairPatches:
    """Return the medians of groups of patches of like brightness, as patches."""
    order = np.array_split(np.argsort(patches.mean), _GROUPS)
    groups = [patches.part(rows) for rows in order]
    return PairPatches(
        *(
            np.array([np.median(getattr(group, each.name)) for group in groups])
            for each in fields(PairPatches)
        )
    )


def _round(
    shape: TransferCurve, patches: PairPatches, found: tuple[float, float]
) -> tuple[tuple[float, float], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the parameters after a step of Gauss and Newton, and the terms of its equations."""
    scores, design, weight, residual = _scores(shape, patches)
    normal = design.T @ (weight[:, None] * design)
    step = np.linalg.lstsq(normal, scores.sum(axis=0), rcond=None)[0]
    # A step is at most a factor of 4: the curve is far from straight far from the solution.
    inverse_k = min(max(found[0] + float(step[0]), found[0] / 4), 4 * found[0])
    return (inverse_k, found[1] + float(step[1])), (scores, normal, weight, residual)


def _start(curve: NoiseCurve, patches: PairPatches, white: float) -> tuple[float, float]:
    """Return a start: photon noise alone, which half of the brighter patches exceed."""
    bright = patches.part((patches.mean > DIM * white) & (patches.mean < _BRIGHT * white))
    if bright.mean.size < LEAST_PATCHES:
        raise DataError(
            f"only {bright.mean.size} patches are between 8 % and 70 % of full scale",
            hint="add pairs of frames with exposures between, or use a scene with more shades",
        )
    candidates = np.geomspace(1e-5, 1e2, 43).tolist()

    def below(inverse_k: float) -> float:  # it grows with the noise
        expected = np.interp(bright.mean, *curve.moments(inverse_k, 0.0))
        return float(np.mean(bright.variance <= expected))

    return candidates[min(bisect_left(candidates, 0.5, key=below), len(candidates) - 1)], 0.0


def _check(
    patches: PairPatches, used: NDArray[np.bool_], is_moved: NDArray[np.bool_], white: float
) -> None:
    """Raise `DataError` unless the patches that are used suffice for a fit."""
    count = int(np.count_nonzero(used))
    if np.count_nonzero(is_moved) > max(count, LEAST_PATCHES):
        share = np.count_nonzero(is_moved) / np.count_nonzero(used | is_moved)
        raise moved(
            f"{share:.0%} of the picture differs between two frames of a pair by more than noise"
        )
    if count < LEAST_PATCHES:
        raise DataError(
            f"the noise can be measured in {count} of {patches.mean.size} patches: the others are "
            "black, saturated, or have less noise than rounding shows",
            hint="use a scene with many smooth shades, a higher gain, or more bits",
        )
    dark, bright = np.quantile(patches.mean[used], [0.1, 0.9])
    if bright < _LEAST_RANGE * max(dark, white / 1000):
        raise DataError(
            f"the frames show brightness from {dark / white:.1%} to {bright / white:.1%} of full "
            "scale only",
            hint="add pairs of shorter and of longer exposures: photon noise differs from read "
            "noise by its growth with the light",
        )


def _scores(
    shape: TransferCurve, patches: PairPatches
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the terms of the normal equations, the design, the weights and the residuals.

    A patch's mean has noise, too: where the scene has few shades near black, the brightness of the
    darkest patches is too dark on average, and of other patches too bright.  The first term of its
    expansion is subtracted.
    """
    h = np.sqrt(np.maximum(shape.variances(patches), LEAST_VARIANCE) / (2 * (patches.freedom + 1)))
    sides = []
    for turn in (-1, 1):
        near = patches.shifted(turn * h)
        design, weight = shape.design(near)
        sides.append((design * weight[:, None], shape.variances(near)))
    design, weight = shape.design(patches)
    residual = patches.variance - shape.variances(patches)
    dilution = (sides[1][0] - sides[0][0]) * (sides[1][1] - sides[0][1])[:, None] / 4
    return design * (weight * residual)[:, None] + dilution, design, weight, residual


def _groups(
    patches: PairPatches, expected: FloatArray, weight: FloatArray, counts: NDArray[np.bool_]
) -> tuple[float, tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the misfit, and mean, variance and expectation of groups of like brightness."""
    # Where in a level the light is averages out over whole levels.
    if not counts.any():
        counts = np.ones_like(counts)
    edges = np.unique(np.ceil(np.quantile(patches.mean[counts], np.linspace(0, 1, _GROUPS + 1))))
    if edges[0] <= 0:  # around a black level, to which noise below it belongs
        edges = np.concatenate([[-np.inf], edges[edges > 0]])
    place = np.where(counts, np.searchsorted(edges, patches.mean), 0)
    order = [np.flatnonzero(place == k) for k in range(1, edges.size)]
    order = [rows for rows in order if rows.size > 1]
    fields = (patches.mean, patches.variance, expected)
    means, variances, fitted = (
        np.array([np.average(values[rows], weights=weight[rows]) for rows in order])
        for values in fields
    )
    residual = patches.variance - expected
    errors = []
    for rows in order:
        share = weight[rows] / weight[rows].sum()
        scatter = np.sqrt(np.sum(np.square(share * residual[rows])))
        errors.append(float(share @ residual[rows]) / max(float(scatter), 1e-12))
    misfit = float(np.square(errors).sum() / max(1, len(order) - 2))
    return misfit, (means, variances, fitted)
