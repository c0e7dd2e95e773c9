"""The noise in the frames of an exposure series, and how it shifts matched brightness levels.

Noise carries samples across a level in both directions, in different numbers.  With noise of the
variance s(E) = a E + b, a density p of the logarithms of the light in a frame, and its logarithmic
slope q, the samples below E have light below E (1 + d) with

    d = (a q / E + b (q - 1) / E^2) / 2,

to second order in the noise.  Dark levels of short exposures are shifted more than in long
ones, by 1 % where a level has 100 electrons.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.limits import DARK, LEAST_PATCHES, ROUNDS
from camctl.calibration.response.fit import ResponseFit
from camctl.calibration.response.matches import Matches
from camctl.calibration.response.series import Series
from camctl.model.response.camera import FloatArray

#: Factor of the noise of a patch in which something moved.
_MOVED = 2.0
#: Width over which the density of ln(light) is smoothed.
_WIDTH = 0.25
#: Light from which a frame is saturated too near for a slope: the shorter exposure shows it.
_NEAR_SATURATION = 0.4
#: Largest shift that the second order describes.
_MOST = 0.05


def correct_matches(matches: Matches, series: Series, channel: str, fit: ResponseFit) -> Matches:
    """Return the matches with what noise shifts them by; unchanged where noise cannot be measured.

    Args:
        matches: of one channel
        series: the frames, of a scene that did not move
        channel: its name
        fit: a first estimate of the response
    """
    photon, read = _light_noise(series, channel, fit)
    if not photon + read > 0:
        return matches
    low, high = (
        np.interp(level, fit.edges, fit.irradiance) for level in (matches.low, matches.high)
    )
    slope = np.zeros(low.size)
    counts = series.counts_between(channel, series.black + fit.edges)
    for frame in range(len(series.exposures)):
        at_high = (matches.long == frame) & (high < _NEAR_SATURATION)
        at_low = (matches.short == frame) & (high >= _NEAR_SATURATION)
        for rows, light in ((at_high, high), (at_low, low)):
            slope[rows] = _slope(counts[frame], fit.irradiance, light[rows])
    both = [
        np.clip((photon * slope / light + read * (slope - 1) / light**2) / 2, -_MOST, _MOST)
        for light in (low, high)
    ]
    return dataclasses.replace(matches, shift=both[1] - both[0])


def _slope(counts: NDArray[np.int64], irradiance: FloatArray, at: FloatArray) -> FloatArray:
    """Return the slope of the logarithm of the density of ln(light) in a frame."""
    middle = np.log(irradiance[1:] * irradiance[:-1]) / 2
    inside = counts[1:-1]
    away = (middle - np.log(at)[:, None]) / _WIDTH
    weight = np.exp(-np.square(away) / 2) * inside
    return np.asarray((weight * away).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9) / _WIDTH)


def _light_noise(series: Series, channel: str, fit: ResponseFit) -> tuple[float, float]:
    """Return a and b of the variance of the light, 1 at full scale; 0 where they are unknown.

    The light of patches in neighbouring exposures differs by noise alone, and by rounding.
    """
    rows, measured = [], []
    steps = np.gradient(fit.light)
    for pair in series.neighbours(channel, DARK):
        light = fit.light[pair.levels]
        ratio = fit.exposures[pair.short] / fit.exposures[pair.long]
        scales = np.array([1.0, ratio])[:, None]
        rounding = (np.square(scales[..., None] * steps[pair.levels]).mean(axis=2) / 12).sum(axis=0)
        both = (scales**2 * light.mean(axis=2)).sum(axis=0)
        rows.append(np.stack([both, np.full(both.size, 1 + ratio**2)], axis=1))
        measured.append((light[0] - ratio * light[1]).var(axis=1, ddof=1) - rounding)
    design, variance = np.concatenate(rows), np.concatenate(measured)
    if variance.size < LEAST_PATCHES:
        return 0.0, 0.0
    found = np.array([max(0.0, float(np.median(variance / design[:, 0]))), 0.0])
    for _ in range(ROUNDS):
        expected = np.maximum(design @ found, 1e-12)
        kept = (variance < _MOVED * expected) / expected
        found = np.linalg.lstsq(design * kept[:, None], variance * kept, rcond=None)[0]
        if found[1] < 0:
            found = np.array([float(np.median((variance / design[:, 0])[kept > 0])), 0.0])
        found = np.maximum(found, 0.0)
    return float(found[0]), float(found[1])
