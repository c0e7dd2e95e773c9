"""The colours of a camera from a Macbeth chart: a white balance and a 3 x 3 matrix.

What a patch shows is linear light, from all frames in which it is well exposed, and its error from
the noise of its samples.  The greys give the white balance; the matrix is fitted by least squares
in L*, a*, b*, where errors are about as large as they look, and keeps grey grey.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.response.chart import chart_samples, find_macbeth
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.colour import BT709_PRIMARIES, D65, rgb_to_xyz
from camctl.model.colour_difference import ciede2000, lab_of_xyz, xyz_of_lab
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel
from camctl.profiles.colour import ColourRecord

#: L*, a*, b* of the patches in the light D50: X-Rite, ColorChecker made before November 2014, from
#: dark skin to black, row by row.
REFERENCE = np.array(
    [
        (37.986, 13.555, 14.059),
        (65.711, 18.130, 17.810),
        (49.927, -4.880, -21.925),
        (43.139, -13.095, 21.905),
        (55.112, 8.844, -25.399),
        (70.719, -33.397, -0.199),
        (62.661, 36.067, 57.096),
        (40.020, 10.410, -45.964),
        (51.124, 48.239, 16.248),
        (30.325, 22.976, -21.587),
        (72.532, -23.709, 57.255),
        (71.941, 19.363, 67.857),
        (28.778, 14.179, -50.297),
        (55.261, -38.342, 31.370),
        (42.101, 53.378, 28.190),
        (81.733, 4.039, 79.819),
        (51.935, 49.986, -14.574),
        (51.038, -28.631, -28.638),
        (96.539, -0.425, 1.186),
        (81.257, -0.638, -0.335),
        (66.766, -0.734, -0.504),
        (50.867, -0.153, -0.270),
        (35.656, -0.421, -1.231),
        (20.461, -0.079, -0.973),
    ]
)
#: X, Y, Z of the light D50 (CIE 15:2004, table T.3).
_D50 = np.array([0.96422, 1.0, 0.82521])
#: The Bradford transformation from D50 to D65 (ICC.1:2022, annex E, inverted).
_D50_TO_D65 = np.linalg.inv(
    [[1.04788, 0.02292, -0.05022], [0.02959, 0.99048, -0.01707], [-0.00925, 0.01508, 0.75168]]
)
_GREYS = 6
#: Fewest patches for a matrix: six numbers, of three equations each patch, and as many to check.
_LEAST_PATCHES = 12
#: Standard deviation of a colour of one chart from those published, in L*, a*, b*: the mean
#: difference of 30 charts from their average (Pascale, RGB coordinates of the Macbeth ColorChecker,
#: 2006).
_CHART_ERROR = 1.0
#: Rounds of Gauss and Newton; the equations are nearly linear.
_ROUNDS = 20
#: Step of a numeric derivative.
_STEP = 1e-5

_Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PatchLight:
    """Linear light of patches of a chart.

    Attributes:
        patch: (N,) numbers of the patches, 0 first
        light: (N, 3) in R, G and B, in any unit
        variance: (N, 3) of it
    """

    patch: NDArray[np.intp]
    light: _Floats
    variance: _Floats


def reference_xyz() -> _Floats:
    """Return X, Y, Z of the patches with D65 as white, (24, 3); perfect white has Y = 1."""
    return np.asarray(xyz_of_lab(REFERENCE, _D50) @ _D50_TO_D65.T)


def measure_colour(
    frames: Sequence[NDArray[Any]], series: Series, responses: Sequence[CameraResponse]
) -> ColourRecord:
    """Return the colours that frames of a chart show.

    Args:
        frames: of the series
        series: gives layout, levels and exposures
        responses: of R, G and B

    Raises:
        DataError: there is no chart, or its patches are not well exposed
    """
    patches = find_macbeth(frames, series.layout)
    found = []
    for channel, response in zip("RGB", responses, strict=True):
        samples = chart_samples(frames, series, patches, channel)
        sensor = SensorModel(response, 0)
        codes = np.arange(sensor.light.size)
        exposure = np.array(series.exposures)[samples.frame]
        light = np.interp(samples.level, codes, sensor.light) / exposure
        slope = np.interp(samples.level, codes, np.gradient(sensor.light)) / exposure
        variance = np.maximum(samples.variance * slope**2, 1e-300)
        weights = np.bincount(samples.patch, 1 / variance, minlength=len(patches))
        sums = np.bincount(samples.patch, light / variance, minlength=len(patches))
        found.append((weights, sums))
    seen = np.flatnonzero(np.all([weights > 0 for weights, _ in found], axis=0))
    if len(seen) < _LEAST_PATCHES or seen[-1] < len(REFERENCE) - _GREYS:
        raise DataError(
            f"{len(seen)} of {len(patches)} patches of the chart are well exposed in R, G and B: "
            f"{_LEAST_PATCHES} or more are needed, greys among them",
            hint="expose so that the white patch is just below saturation in a frame",
        )
    weights, sums = (np.stack(each, axis=1)[seen] for each in zip(*found, strict=True))
    return fitted_colour(PatchLight(seen, sums / weights, 1 / weights))


def fitted_colour(seen: PatchLight) -> ColourRecord:
    """Return the white balance and the matrix that fit the light of patches best."""
    to_xyz = rgb_to_xyz(BT709_PRIMARIES, D65)
    white = to_xyz.sum(axis=1)
    known = reference_xyz()[seen.patch]
    wanted, luminance = lab_of_xyz(known, white), known[:, 1]
    is_grey = seen.patch >= len(REFERENCE) - _GREYS
    share = seen.light[is_grey] / luminance[is_grey, np.newaxis]
    relative = seen.variance[is_grey] / seen.light[is_grey] ** 2 + (_CHART_ERROR / 100) ** 2
    level = np.exp((np.log(share) / relative).sum(axis=0) / (1 / relative).sum(axis=0))
    balance = level[1] / level
    light = seen.light / level
    noise = np.sqrt(seen.variance) / level

    def lab(numbers: _Floats, values: _Floats) -> _Floats:
        matrix = _matrix(numbers[:6])
        return lab_of_xyz(np.exp(numbers[6]) * values @ matrix.T @ to_xyz.T, white)

    numbers = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS):
        now = lab(numbers, light)
        spread = [
            (lab(numbers, light + noise * np.eye(3)[channel]) - now) ** 2 for channel in range(3)
        ]
        weights = 1 / np.sqrt(_CHART_ERROR**2 + np.sum(spread, axis=0)).ravel()
        slopes = [
            (lab(numbers + _STEP * each, light) - now).ravel() / _STEP
            for each in np.eye(numbers.size)
        ]
        step = np.linalg.lstsq(
            np.stack(slopes, axis=1) * weights[:, np.newaxis],
            (wanted - now).ravel() * weights,
            rcond=None,
        )[0]
        numbers = numbers + step
        if float(np.abs(step).max()) < _STEP**2:
            break
    matrix = _matrix(numbers[:6])
    if not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1e3:
        raise DataError(
            "the patches of the chart show no colours that a matrix could mend",
            hint="light the chart evenly, and keep reflections away",
        )
    differences = ciede2000(lab(numbers, light), wanted)
    one, two, three = (tuple(row) for row in matrix.tolist())
    red, green, blue = balance.tolist()
    return ColourRecord(
        matrix=(one, two, three),
        white_balance=(red, green, blue),
        mean_difference=float(differences.mean()),
        largest_difference=float(differences.max()),
        patches=len(seen.patch),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _matrix(numbers: _Floats) -> _Floats:
    """Return the matrix of six numbers: its rows add up to 1."""
    red_green, red_blue, green_red, green_blue, blue_red, blue_green = numbers
    return np.array(
        [
            [1 - red_green - red_blue, red_green, red_blue],
            [green_red, 1 - green_red - green_blue, green_blue],
            [blue_red, blue_green, 1 - blue_red - blue_green],
        ]
    )
