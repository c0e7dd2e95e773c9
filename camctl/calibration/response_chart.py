"""What a chart in the frames of an exposure series says about the response."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.chart import ChartPatch
from camctl.calibration.response_fit import ChartSamples
from camctl.calibration.response_series import Series
from camctl.errors import DataError
from camctl.findings import Finding

#: Brightness, share of full scale, from which a patch is used: below, noise and clipping distort.
_DARKEST = 0.02
#: Patches that must be neither black nor saturated in some frame.
_LEAST_PATCHES = 3
#: Errors of the reflectance from which there is a note, in standard deviations and in all.
_NOTED_DEVIATIONS, _NOTED = 3.0, 0.1


def chart_samples(
    frames: Sequence[NDArray[Any]], series: Series, patches: Sequence[ChartPatch], channel: str
) -> ChartSamples:
    """Return the brightness of each patch in each frame in which it is well exposed.

    Args:
        frames: of the series
        series: gives layout, black level, and white level
        patches: of the chart
        channel: name of the channel

    Raises:
        DataError: a patch is outside of the frames, or too few patches are well exposed
    """
    found: list[tuple[int, int, float, float]] = []
    span = series.white - series.black
    for number, frame in enumerate(frames):
        planes = series.layout.planes(frame)
        for place, patch in enumerate(patches):
            samples = np.concatenate(
                [
                    _inside(patch, plane, frame.shape)
                    for letter, plane in zip(series.colours(), planes, strict=True)
                    if letter == channel
                ]
            )
            if samples.size == 0:
                raise DataError(
                    f"the patch at {patch.x:.0f}, {patch.y:.0f} has no pixels in frames of "
                    f"{frame.shape[1]} x {frame.shape[0]}",
                    hint="check the rectangles: x, y, width, height, from the upper left corner",
                )
            level = float(samples.mean()) - series.black
            if level < _DARKEST * span or samples.max() >= series.white:
                continue
            # Without noise all samples are rounded alike; with noise, rounding averages out.
            noise = float(samples.var())
            rounding = min(1.0, 0.25 / max(noise, 1e-9)) / 12
            found.append((number, place, level, noise / samples.size + rounding))
    seen = {place for _, place, _, _ in found}
    if len(seen) < _LEAST_PATCHES:
        raise DataError(
            f"{len(seen)} of {len(patches)} patches of the chart are neither black nor saturated: "
            f"{_LEAST_PATCHES} or more are needed",
            hint="expose so that the white patch is just below saturation in a frame",
        )
    number_, place_, level_, variance_ = (np.array(column) for column in zip(*found, strict=True))
    centres = np.array([(each.x + each.width / 2, each.y + each.height / 2) for each in patches])
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    known = np.array([patch.channel(channel) for patch in patches])
    return ChartSamples(
        frame=number_.astype(np.intp),
        patch=place_.astype(np.intp),
        level=level_,
        variance=variance_,
        place=(centres - middle) / max(1.0, float(np.abs(centres - middle).max())),
        reflectance=known[:, 0],
        error=known[:, 1],
    )


def _inside(patch: ChartPatch, plane: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the samples of a plane in a patch, (N,); none where it is not inside the frame."""
    down, across = (shape[axis] / plane.shape[axis] for axis in (0, 1))
    left, right = (round(each / across) for each in (patch.x, patch.x + patch.width))
    top, bottom = (round(each / down) for each in (patch.y, patch.y + patch.height))
    if min(left, top) < 0 or right > plane.shape[1] or bottom > plane.shape[0]:
        return plane[:0].ravel()
    return plane[top:bottom, left:right].ravel()


def chart_findings(chart: ChartSamples, errors: NDArray[np.float64], channel: str) -> list[Finding]:
    """Return a finding on the patch that contradicts the others most, if it does."""
    deviations = np.abs(errors) / chart.error
    worst = int(np.argmax(deviations))
    if deviations[worst] < _NOTED_DEVIATIONS or abs(errors[worst]) < _NOTED:
        return []
    return [
        Finding(
            code="chart_contradicts",
            value=float(np.expm1(errors[worst])),
            details={"patch": worst + 1, "channel": channel},
        )
    ]
