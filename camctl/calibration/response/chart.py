"""Charts with patches of known reflectance: in a file, or found by OpenCV's `mcc`; in frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import certain
from camctl.calibration.limits import DARK
from camctl.calibration.response.fit import ChartSamples
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.findings import Finding
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.system.input_files import read_input_text
from camctl.system.picture_operations import required_opencv

#: Fewest patches, also of those that a frame exposes well: their slope has an error with three.
_LEAST_PATCHES = 3
#: Standard deviation of the logarithm of a stated reflectance.
_STATED_ERROR = 0.02
#: Neutral patches of the Macbeth chart: Munsell N 9.5, 8, 6.5, 5, 3.5, and 2 (McCamy, Marcus and
#: Davidson 1976).  Relative error of each, and light that a surface reflects as a mirror does.
_GREYS = (0.900, 0.591, 0.362, 0.198, 0.090, 0.031)
_GREY_ERROR, _GLARE = 0.015, 0.0015
#: Share of the light of the strongest channel by which a coloured patch may differ in another
#: camera, whose colour filters differ from sRGB.
_FILTER_ERROR = 0.15
#: Reflectance of patches that have none in a colour of sRGB.
_LEAST_REFLECTANCE = 0.003
#: Weights of R, G and B in a monochrome camera, about.
_MONO = (0.3, 0.4, 0.3)
#: Side of a patch that is used, as a share of its width: within the patch also where it is turned.
_INNER = 0.5
#: Longest side of the picture in which a chart is looked for, pixels, and exponents of brightness:
#: OpenCV's detector expects about sRGB.
_DETECTED_SIZE, _ENCODINGS = 1600, (1.0, 1 / 2.2)
#: Share of the samples that are black and white in that picture.
_RANGE = (0.002, 0.998)
#: Error of the reflectance from which there is a note.
_NOTED = 0.1


@dataclass(frozen=True)
class ChartPatch:
    """A rectangle of one reflectance in all frames.

    Attributes:
        x, y: upper left corner, pixels from the corner of the frame
        width, height: pixels
        reflectance: in R, G, and B, in any unit
        error: standard deviations of their logarithms
    """

    x: float
    y: float
    width: float
    height: float
    reflectance: tuple[float, float, float]
    error: tuple[float, float, float]

    def channel(self, name: str) -> tuple[float, float]:
        """Return reflectance and error in channel R, G, B or Y."""
        if name != "Y":
            k = "RGB".index(name)
            return self.reflectance[k], self.error[k]
        return float(np.dot(_MONO, self.reflectance)), min(self.error)


def read_patches(path: Path) -> tuple[ChartPatch, ...]:
    """Return the patches that a text file lists: x, y, width, height, reflectance in each line.

    The reflectance is one number, or three for R, G and B.  Text after # is ignored.

    Raises:
        DataError: the file cannot be read, or a line is invalid; says which
    """
    patches = []
    for number, line in enumerate(read_input_text(path, "patches").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words:
            patches.append(_patch(words, f"{path}, line {number}"))
    if len(patches) < _LEAST_PATCHES:
        raise DataError(
            f"{path} has {len(patches)} patches: expected {_LEAST_PATCHES} or more",
            hint="give one patch a line: x, y, width, height, reflectance",
        )
    return tuple(patches)


def _patch(words: Sequence[str], where: str) -> ChartPatch:
    try:
        numbers = [float(word) for word in words[:8]]
    except ValueError:
        numbers = []
    if len(numbers) not in (5, 7):
        raise DataError(
            f"{where}: expected 5 or 7 numbers",
            hint="give x, y, width, height in pixels, and one reflectance, or three for R, G and B",
        )
    x, y, width, height, *reflectance = numbers
    if not (min(x, y) >= 0 and min(width, height) >= 1 and math.isfinite(sum(numbers[:4]))):
        raise DataError(
            f"{where}: invalid rectangle {' '.join(words[:4])}",
            hint="give x, y, width, height in pixels, from the upper left corner",
        )
    if not all(1e-6 <= each <= 1e6 for each in reflectance):
        raise DataError(
            f"{where}: invalid reflectance {' '.join(words[4:])}", hint="give numbers from 0 to 1"
        )
    red, green, blue = reflectance * (3 // len(reflectance))
    return ChartPatch(x, y, width, height, (red, green, blue), (_STATED_ERROR,) * 3)


def find_macbeth(frames: Sequence[NDArray[Any]], layout: Layout) -> tuple[ChartPatch, ...]:
    """Return the 24 patches of a Macbeth chart, found in the frame in which it is clearest.

    Args:
        frames: of one scene
        layout: pixel layout

    Raises:
        DataError: there is no such chart in any frame
    """
    found = [
        candidate
        for frame in frames
        for encoding in _ENCODINGS
        if (candidate := _detect(_picture(frame, layout, encoding))) is not None
    ]
    if not found:
        raise DataError(
            "no Macbeth chart was found in any frame",
            hint="let a chart of 24 patches, well exposed in a frame, fill half of the picture, or "
            "list its patches",
            remedies={"patches": None},
        )
    _, corners, colours = min(found, key=lambda each: each[0])
    scale = np.array(frames[0].shape[1::-1])
    patches = []
    for k, (corner, colour) in enumerate(zip(corners * scale, colours, strict=True)):
        sides = np.linalg.norm(np.roll(corner, -1, axis=0) - corner, axis=1)
        size = _INNER * float(sides.min())
        x, y = (corner.mean(axis=0) - size / 2).tolist()
        red, green, blue = colour.tolist()
        errors = (_FILTER_ERROR * colour.max() / colour).tolist()
        if k >= len(colours) - len(_GREYS):
            red = green = blue = _GREYS[k - len(colours) + len(_GREYS)]
            errors = [math.hypot(_GREY_ERROR, _GLARE / red)] * 3
        patches.append(ChartPatch(x, y, size, size, (red, green, blue), tuple(errors)))
    return tuple(patches)


def _picture(frame: NDArray[Any], layout: Layout, encoding: float) -> NDArray[np.uint8]:
    """Return a frame in 8-bit B, G, R, of limited size, from its darkest to its brightest parts."""
    cv2 = required_opencv("finding a colour chart")
    planes = layout.planes(frame)
    if layout.is_mosaic:
        letters = np.array(list(layout.upper()))
        planes = [
            np.mean([planes[k] for k in np.flatnonzero(letters == letter)], axis=0)
            for letter in "RGB"
        ]
    planes = [planes[0]] * 3 if len(planes) == 1 else list(planes)
    scale = min(1.0, _DETECTED_SIZE / max(planes[0].shape))
    small = [
        cv2.resize(plane.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        for plane in planes
    ]
    stacked = np.stack(small[::-1], axis=2)
    black, white = np.quantile(stacked, _RANGE)
    light = np.clip((stacked - black) / max(1.0, white - black), 0, 1)
    return np.asarray(np.rint(255 * light**encoding), np.uint8)


def _detect(picture: NDArray[np.uint8]) -> tuple[float, FloatArray, FloatArray] | None:
    """Return how badly a chart fits, the corners of its patches, and their colours; None if none.

    The corners are shares of the picture's size, (24, 4, 2); the colours are linear, (24, 3).
    """
    cv2 = required_opencv("finding a colour chart")
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    try:
        if not detector.process(picture, 1):
            return None
    except cv2.error:  # OpenCV fails on some pictures without a chart
        return None
    chart = detector.getBestColorChecker()
    corners = np.asarray(chart.getColorCharts(), np.float64).reshape(-1, 4, 2)
    references = np.asarray(detector.getRefColors(), np.float64).reshape(-1, 3)[:, ::-1]
    colours = np.maximum(srgb_to_linear(references / 255), _LEAST_REFLECTANCE)
    centres = np.rint(corners.mean(axis=1)).astype(np.intp)
    rows, columns = picture.shape[:2]
    if np.any(centres < 0) or np.any(centres >= (columns, rows)):
        return None
    greys = picture[centres[-len(_GREYS) :, 1], centres[-len(_GREYS) :, 0]].mean(axis=1)
    if not np.all(np.diff(greys) <= 0):
        return None
    return float(chart.getCost()), corners / (columns, rows), colours


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
            if level < DARK * span or samples.max() >= series.white:
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
    if deviations[worst] < certain(errors.size) or abs(errors[worst]) < _NOTED:
        return []
    return [
        Finding(
            code="chart_contradicts",
            value=float(np.expm1(errors[worst])),
            details={"patch": worst + 1, "channel": channel},
        )
    ]
