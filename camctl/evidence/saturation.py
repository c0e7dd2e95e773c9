"""The brightness at which frames saturate, where it is not the stated white level.

Pixels of many sensors are full before the converter ends.  Where shorter frames show that a place
saturates a frame, its samples then have one brightness below white, however much light there is;
with a wrong exposure they would follow the light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches
from camctl.evidence.ratio_check import SIGNIFICANCE, significant_sigmas
from camctl.findings import Finding
from camctl.model.quantiles import NORMAL_MAD, student
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.sensor import CLIPPING_SIGMAS


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


def level_finding(level: int, white: int, remedies: dict[str, Any] | None = None) -> Finding:
    """Return that frames saturate at `level`, below the stated `white`."""
    return Finding(
        code="levels_found",
        value=level,
        details={"level": "white", "largest": white},
        remedies=remedies or {},
    )


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
        shown = light[frames[k]]
        certain = least * exposures[k] > 1
        if certain.any():
            logs = np.log([mean[certain] * exposures[k], np.maximum(shown[certain], high[0])])
            found.append(_Full(frames[k][certain], *logs - np.median(logs, axis=1, keepdims=True)))
        # Neighbours differ by texture, too: this is at least the noise.
        steps = np.square(np.diff(shown, axis=1))
        noise = np.sqrt(steps.sum(axis=1, keepdims=True) / (2 * max(1, steps.shape[1])))
        at_least = (shown - CLIPPING_SIGMAS * noise) / exposures[k]
        mean = np.where(at_least > least, shown / exposures[k], mean)
        least = np.maximum(at_least, least)
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
