"""The exponent of a response whose exposures are not known.

The frames show a curve E and exposures t only up to a common exponent g: E^g and t^g fit as well
(Mitsunaga and Nayar, "Radiometric Self Calibration", CVPR 1999).  Patches of known reflectance
decide; without them, the expectation that the curve is about as steep as sRGB.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camctl.calibration.limits import OUTLIER, ROUNDS
from camctl.calibration.response.fit import (
    CHART_LIGHT,
    REFERENCE,
    ChartSamples,
    ResponseFit,
    light_terms,
)
from camctl.model.response.camera import srgb_to_linear

#: Brightness, share of full scale, at which the steepness is compared with sRGB, and the
#: relative standard deviation of the exponent (tests/bench/bench_response.py).
STEEP, _STEEP_ERROR = 0.05, 0.2


@dataclass(frozen=True)
class Exponent:
    """An exponent of irradiance and exposures, and its relative standard deviation."""

    value: float
    error: float


def expected_exponent(fit: ResponseFit) -> Exponent:
    """Return the exponent that makes the response of a fit about as steep as sRGB."""
    srgb = math.log(srgb_to_linear(np.array(STEEP)))
    return Exponent(srgb / fit.log_at(STEEP), _STEEP_ERROR)


def exponent_of_chart(fit: ResponseFit, chart: ChartSamples) -> Exponent:
    """Return the exponent that explains the patches of a chart under slightly uneven light.

    Args:
        fit: the response and the exposures for some exponent
        chart: patches, at least three
    """
    logs = np.interp(chart.level, fit.edges, np.log(fit.irradiance))
    logs -= np.log(fit.exposures)[chart.frame]
    seen = np.unique(chart.patch)
    light = np.array([logs[chart.patch == each].mean() for each in seen])
    across, down = chart.place[seen].T
    rows = np.stack([light, *-light_terms(across, down)], axis=1)
    wanted = np.log(chart.reflectance[seen])
    known = np.diag([0.0, *np.array(CHART_LIGHT) ** -2.0])
    weights = chart.error[seen] ** -2.0
    for _ in range(ROUNDS):
        square = (rows.T * weights) @ rows + known
        found = np.linalg.solve(square, rows.T @ (weights * wanted))
        deviations = np.abs(rows @ found - wanted) / chart.error[seen]
        weights = chart.error[seen] ** -2.0 / np.maximum(1.0, deviations / OUTLIER)
    misfit = max(1.0, float(np.mean(np.minimum(deviations, OUTLIER) ** 2)))
    error = math.sqrt(float(np.linalg.inv(square)[0, 0]) * misfit)
    return Exponent(float(found[0]), error / max(float(found[0]), 1e-9))


def common_exponent(found: Sequence[Exponent]) -> Exponent:
    """Return the weighted mean of the exponents of the channels, which have the same exposures.

    Its error is the least error of a channel: a wrong chart or expectation is wrong in all.
    """
    errors = np.array([each.error for each in found])
    value = np.average([each.value for each in found], weights=errors**-2)
    return Exponent(float(value), float(errors.min()))


def with_exponent_error(fit: ResponseFit, error: float) -> ResponseFit:
    """Return a fit whose deviations include `error`, the relative one of the exponent."""
    distance = np.log(fit.irradiance) - fit.log_at(REFERENCE)
    deviation = np.hypot(fit.deviation, error * distance)
    return dataclasses.replace(fit, deviation=deviation)
