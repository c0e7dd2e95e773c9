"""The errors of a picture of the simulated camera, measured against the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.desired import DesiredResponse
from camctl.pictures.mosaic import colour_of
from camctl.pictures.render import FULL_CODE
from camctl.records.report import CaptureReport
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.view import View

BINS = 64
"""Parts of u that count alike; a part with fewer than `_FEWEST` samples is left out."""

_FEWEST = 16  # samples: a mean square of 16 errors is known to 35 %, sqrt(2 / 16)


@dataclass(frozen=True)
class Decade:
    """The error in one decade of irradiance.

    Attributes:
        low, high: its ends, relative to full scale of the shortest exposure
        share: of the scene's samples
        relative_error: root mean square of estimate / truth - 1
    """

    low: float
    high: float
    share: float
    relative_error: float


def scene_truth(camera: SimulatedCamera) -> NDArray[np.float64]:
    """Return E of each sample for an exposure of one second at gain 1, in front of the lens."""
    sensor = camera.sensor
    photons_s = View.of(camera.scene, sensor).light.astype(np.float64)
    return photons_s * (sensor.quantum_efficiency / sensor.full_scale_e)


def native_samples(report: CaptureReport) -> NDArray[np.float64]:
    """Return u of each sample of the sensor: of a mosaic, only what was not interpolated."""
    image, layout = report.image(), report.layout
    if layout.is_mosaic and image.ndim == 3:
        native = np.empty(image.shape[:2], image.dtype)
        for row in (0, 1):
            for column in (0, 1):
                colour = colour_of(layout, row, column)
                native[row::2, column::2] = image[row::2, column::2, colour]
        image = native
    return image / FULL_CODE


def _inside(desired: DesiredResponse, E: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray((desired.e_min <= E) & (E < 1))


def _bins(desired: DesiredResponse, E: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.minimum((desired.u(E) * BINS).astype(np.intp), BINS - 1)


def covered_parts(desired: DesiredResponse, E: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which parts of u the scene has, (BINS,)."""
    counts = np.bincount(_bins(desired, E[_inside(desired, E)]), minlength=BINS)
    return np.asarray(counts >= _FEWEST)


def measured_levels(
    desired: DesiredResponse, E: NDArray[np.float64], u: NDArray[np.float64]
) -> float:
    """Return (12 mse)^(-1/2) of estimates `u`, where every covered part of u counts alike."""
    inside = _inside(desired, E)
    E, u = E[inside], u[inside]
    bins = _bins(desired, E)
    squares = np.bincount(bins, (u - desired.u(E)) ** 2, minlength=BINS)
    counts = np.bincount(bins, minlength=BINS)
    covered = counts >= _FEWEST
    if not covered.any():
        return math.nan
    return float((12 * np.mean(squares[covered] / counts[covered])) ** -0.5)


def decade_errors(
    desired: DesiredResponse, E: NDArray[np.float64], u: NDArray[np.float64]
) -> list[Decade]:
    """Return the relative error in each decade of irradiance, from 1 down."""
    estimate = desired.inverse(u)
    found = []
    for place in range(math.ceil(-math.log10(desired.e_min) - 1e-9)):
        low, high = max(10.0 ** -(place + 1), desired.e_min), 10.0**-place
        inside = (low <= E) & (high > E)
        relative = estimate[inside] / E[inside] - 1
        error = float(np.sqrt(np.mean(relative**2))) if relative.size else math.nan
        found.append(Decade(low, high, float(inside.mean()), error))
    return found


def median_decade(decades: tuple[Decade, ...]) -> Decade:
    """Return the decade with the median of the errors of several captures."""
    return replace(decades[0], relative_error=median(each.relative_error for each in decades))
