"""The black and the white level that frames show, where they are not the stated ones.

A linear camera whose black level is not known has frames that differ from their exposures by one
brightness, wherever they are compared; with a wrong exposure they would differ by a share of it.

Pixels of many sensors are full before the converter ends.  Where shorter frames show that a place
saturates a frame, its samples then have one brightness below white, however much light there is;
with a wrong exposure they would follow the light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import weighted_median
from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import SIGNIFICANCE, significant_sigmas
from camctl.findings import Detail, Finding
from camctl.interface.controls import ExposureControls, Layout
from camctl.model.quantiles import NORMAL_MAD, student
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.sample_grid import SampleGrid
from camctl.model.sensor import CLIPPING_SIGMAS, RESPONSE_ERROR
from camctl.system.picture_operations import looked_up


class _Full(NamedTuple):
    """Samples of a frame that must be white, by shorter frames; all (samples,).

    Attributes:
        samples: DN
        expected: logarithm of the light in shorter frames, over its median
        seen: the same in this frame
    """

    samples: NDArray[np.uint16]
    expected: FloatArray
    seen: FloatArray


class _Offsets(NamedTuple):
    """Black levels that a pair of frames shows; all (patches,), DN.

    Attributes:
        shown: mean over a patch, above the stated black level
        error: its standard deviation
        linearity: what the error of the response adds to it, which all patches have in common
        brightness: of the shorter frame, above the stated black level
    """

    shown: FloatArray
    error: FloatArray
    linearity: FloatArray
    brightness: FloatArray


def black_level(
    frames: Sequence[Patches],
    exposures: Sequence[float],
    response: CameraResponse,
    black: int,
    white: int,
    tests: int = 1,
) -> int | None:
    """Return the mean brightness without light, if it is not `black`.

    The frames a and b of exposures 1 and r have samples A = d + x and B = d + r x, or noise: d is
    (r A - B) / (r - 1) in every patch, and in every pair.  Where not black but exposures are wrong,
    that is a share of A - `black` that the patches of a pair have in common.  The more probable of
    both counts.

    Args:
        frames: patches of all colours, (patches, samples) of each frame
        exposures: of the frames, in any common unit
        response: of the camera, white - black levels
        black: stated brightness without light, DN
        white: brightness from which samples are saturated, DN
        tests: over which the significance level is divided

    Returns:
        None where the frames have the black level `black`, or do not show another one, and where
        the response is not linear
    """
    steps = np.diff(response.levels)
    if steps.size == 0 or np.ptp(steps) > 1e-6 * steps[0]:
        return None
    pairs = [
        pair
        for a, b in pairwise(np.argsort(exposures, kind="stable").tolist())
        if (ratio := exposures[b] / exposures[a]) > 1
        and (pair := _offsets(frames[a], frames[b], ratio, black, white)).shown.size
    ]
    if len(pairs) < (2 if black else 1):  # one may also have light that was in one frame alone
        return None
    shown, error, linearity, _ = (np.concatenate(each) for each in zip(*pairs, strict=True))
    offset = _weighted_mean(shown, error)
    of_black = _misfit(shown - offset, error)
    of_exposures = sum(
        _misfit(each.shown - each.brightness * _share(each), each.error) for each in pairs
    )
    is_likelier = of_exposures - of_black > -2 * math.log(SIGNIFICANCE / tests)
    # If noise is all that remains, as many patches are inside the quartiles as outside.
    outside = np.count_nonzero(np.abs(shown - offset) > NORMAL_MAD * error)
    fits = outside <= (len(shown) + significant_sigmas(tests) * math.sqrt(len(shown))) / 2
    # A stated black level is a whole number; one of a converter that truncates is up to 1/2 less.
    least = 0.5 + significant_sigmas(tests) * _deviation(error, linearity)
    agree = all(
        abs(_weighted_mean(each.shown, each.error) - offset)
        <= significant_sigmas(tests * len(pairs)) * _deviation(each.error, each.linearity) + 0.5
        for each in pairs
    )
    is_other = abs(offset) > least if black else offset > least
    found = black + round(offset)
    is_sure = is_other and is_likelier and fits and agree
    return found if is_sure and 0 < found < white else None


def black_of_colours(
    frames: Sequence[Patches],
    exposures: Sequence[float],
    layout: Layout,
    responses: Sequence[CameraResponse],
    black: int,
    white: int,
) -> list[Finding]:
    """Return which colours have another black level than `black`, as `black_level` finds it.

    Args:
        frames: patches of all colours, colour by colour, (patches, samples) of each frame
        exposures: of the frames, in any common unit
        layout: of the frames; without colours there are no findings
        responses: of the camera, one or those of R, G and B, white - black levels
        black: stated brightness without light, DN
        white: brightness from which samples are saturated, DN
    """
    planes = str(layout).upper()
    if layout is Layout.MONO or any(len(each) % len(planes) for each in frames):
        return []
    parts, findings = [np.split(each, len(planes)) for each in frames], []
    of_colours = responses if len(responses) == 3 else [*responses] * 3
    for colour, response in zip("RGB", of_colours, strict=True):
        places = [place for place, each in enumerate(planes) if each == colour]
        some = [np.concatenate([each[place] for place in places]) for each in parts]
        found = black_level(some, exposures, response, black, white, tests=3)
        if found is not None:
            findings.append(level_finding("black", found, black, colour=colour))
    return findings


def _offsets(a: Patches, b: Patches, ratio: float, black: int, white: int) -> _Offsets:
    """Return the black levels that patches of two frames show which are not clipped in them."""
    used = (b.max(axis=1) < white) & ~(_may_be_cut(a) | _may_be_cut(b))
    one, other = (each[used].astype(np.float64) - black for each in (a, b))
    levels = (ratio * one - other) / (ratio - 1)
    # Their rounding may be one error of all samples, and the response another.
    rounding = (ratio**2 + 1) / 12 / (ratio - 1) ** 2
    linearity = RESPONSE_ERROR * other.mean(axis=1) / (ratio - 1)
    error = np.sqrt(levels.var(axis=1) / levels.shape[1] + rounding + linearity**2)
    return _Offsets(levels.mean(axis=1), error, linearity, one.mean(axis=1))


def _may_be_cut(frame: Patches) -> NDArray[np.bool_]:
    """Return in which patches noise may have been cut off at 0."""
    levels = frame.astype(np.float64)
    return np.asarray(levels.mean(axis=1) <= CLIPPING_SIGMAS * _noise(levels))


def _noise(levels: FloatArray) -> FloatArray:
    """Return at least the standard deviation of the noise of patches, (patches,).

    Neighbours differ by texture, too.
    """
    steps = np.square(np.diff(levels, axis=1))
    return np.asarray(np.sqrt(steps.sum(axis=1) / (2 * max(1, steps.shape[1]))))


def _weighted_mean(values: FloatArray, error: FloatArray) -> float:
    """Return the weighted mean of the values that are near their weighted median."""
    near = weighted_median(values, error**-2)
    kept = np.abs(values - near) < CLIPPING_SIGMAS * error
    weights = np.where(kept, error**-2, 0)
    return float(np.average(values, weights=weights)) if kept.any() else near


def _deviation(error: FloatArray, linearity: FloatArray) -> float:
    """Return the standard deviation of the weighted mean of values with these errors."""
    weights = error**-2
    return math.hypot(weights.sum() ** -0.5, np.average(linearity, weights=weights))


def _share(pair: _Offsets) -> float:
    """Return the share of the brightness by which the frames of a pair differ, if one does."""
    bright = pair.brightness > 0
    at = pair.brightness[bright]
    return _weighted_mean(pair.shown[bright] / at, pair.error[bright] / at) if bright.any() else 0.0


def _misfit(residuals: FloatArray, error: FloatArray) -> float:
    """Return the sum of their squares; things that moved count as little as they may."""
    return float(np.minimum(np.square(residuals / error), CLIPPING_SIGMAS**2).sum())


def saturation_level(
    frames: Sequence[Patches],
    exposures: Sequence[float],
    response: CameraResponse,
    black: int,
    white: int,
) -> int | None:
    """Return the brightness from which samples are saturated, if it lies below `white`.

    Args:
        frames: patches of all colours that have this response, (patches, samples) of each frame
        exposures: of the frames, in any common unit
        response: of the camera, white - black levels
        black: brightness without light, DN
        white: brightness from which samples are stated to be saturated, DN

    Returns:
        None where the frames saturate at `white`, or do not show where they do
    """
    # So many samples at `white` are above any lower level of saturation.
    size = sum(frame.size for frame in frames)
    if sum(np.count_nonzero(frame >= white) for frame in frames) > SIGNIFICANCE * size:
        return None
    found = _full(frames, exposures, response, black)
    if not found:
        return None
    samples = np.concatenate([each.samples for each in found])
    middle = float(np.median(samples))
    # They are rounded: half of them differ from the middle by half a level more, at most.
    spread = CLIPPING_SIGMAS * (float(np.median(np.abs(samples - middle))) + 0.5) / NORMAL_MAD
    if not black < middle - spread < middle + spread < white or not _are_constant(found):
        return None
    full, above = (
        sum(np.count_nonzero(frame >= level) for frame in frames)
        for level in (middle - spread, middle + spread)
    )
    return None if above > SIGNIFICANCE * full else math.floor(middle - spread)


def other_levels(
    frames: Sequence[Patches], exposures: Sequence[float], controls: ExposureControls
) -> list[Finding]:
    """Return that frames of a camera, as patches, show another black or white level than it has.

    The black level of all colours, or else of some.
    """
    known = frames, exposures, controls.levels, controls.black, controls.white
    if (black := black_level(*known)) is not None:
        is_assumed = any("option:black" in each.remedies for each in controls.findings)
        remedies = {"option:black": str(black)} if is_assumed else {}
        return [level_finding("black", black, controls.black, remedies)]
    responses = controls.responses or (controls.levels,)
    levels = controls.black, controls.white
    if of_colours := black_of_colours(frames, exposures, controls.layout, responses, *levels):
        return of_colours
    white = saturation_level(*known)
    return [] if white is None else [level_finding("white", white, controls.white)]


def level_finding(
    level: Literal["black", "white"],
    value: int,
    stated: int,
    remedies: dict[str, Any] | None = None,
    colour: str | None = None,
) -> Finding:
    """Return that frames, or one colour of them, show another level than the stated one."""
    details: dict[str, Detail] = {"level": level, "stated": stated}
    if colour is not None:
        details["colour"] = colour
    return Finding(code="levels_found", value=value, details=details, remedies=remedies or {})


def of_samples(findings: Sequence[Finding], grid: SampleGrid, black: int) -> list[Finding]:
    """Return findings of levels in codes as those of samples, which are stated to have `black`."""
    stated = {"black": black, "white": grid.white}
    return [
        each.model_copy(
            update={
                "value": grid.level(round(each.value or 0)),
                "details": each.details | {"stated": stated[str(each.details["level"])]},
            }
        )
        for each in findings
    ]


def _full(
    frames: Sequence[Patches],
    exposures: Sequence[float],
    response: CameraResponse,
    black: int,
) -> list[_Full]:
    """Return what must be white in each frame, if anything: light of the shorter ones tells."""
    low, high = response.gaps
    light = np.concatenate((np.zeros(black), (low + high) / 2))
    found = []
    least, mean = np.zeros((2, *frames[0].shape))  # irradiance of each sample, by the frames so far
    for k in np.argsort(exposures, kind="stable").tolist():
        shown = looked_up(light, frames[k])
        certain = least * exposures[k] > 1
        if certain.any():
            logs = np.log([mean[certain] * exposures[k], np.maximum(shown[certain], high[0])])
            found.append(_Full(frames[k][certain], *logs - np.median(logs, axis=1, keepdims=True)))
        at_least = shown - CLIPPING_SIGMAS * _noise(shown)[:, None]
        at_least /= exposures[k]
        np.divide(shown, exposures[k], out=mean, where=at_least > least)
        np.maximum(at_least, least, out=least)
    return found


def _are_constant(found: Sequence[_Full]) -> bool:
    """Return whether light that must be white has one brightness, and does not follow the light.

    The brighter half of the samples is compared with the darker one: what they differ by in the
    frame itself is 0 if it is saturated, and the same as in shorter frames if its exposure is
    wrong.  The nearer one of the two counts, if noise does not explain it.
    """
    expected, seen = (np.concatenate(each) for each in list(zip(*found, strict=True))[1:])
    bright = expected > np.median(expected)
    count = len(bright)
    if count < 4 or not bright.any():
        return False
    run, rise = (np.median(each[bright]) - np.median(each[~bright]) for each in (expected, seen))
    halves = (seen[bright], seen[~bright])
    away = np.concatenate([np.abs(half - np.median(half)) for half in halves])
    spread = float(np.median(away)) / NORMAL_MAD
    # The error of the median of normal variables is sqrt(pi / 2) times that of their mean.
    error = spread * math.sqrt(math.pi / 2 * count / (bright.sum() * (~bright).sum()))
    return bool(rise + student(significant_sigmas(1), count - 2) * error < run / 2)
