"""Charge that spills over from highlights must not bend the response."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.calibration.response import estimate
from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.calibration.response.spill import SampleGrid, grid_counts
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray

STOPS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
BLACK, WHITE = 64, 4095


def light(rng: np.random.Generator) -> FloatArray:
    """Return shades over three decades that rise along rows, with dark and bright columns."""
    rows, columns = np.mgrid[0:240, 0:320]
    logs = rows / 240 * 4 + 2 * np.sin(columns / 25) + rng.normal(0, 0.02, (240, 320))
    return np.asarray(np.exp(logs - logs.max()))


def series_of(blooming: float, seed: int = 0) -> Series:
    """Return a bracket of a linear 12-bit camera, with photon and read noise."""
    rng = np.random.default_rng(seed)
    E = light(rng)
    series = Series(Layout.MONO, 12, BLACK, WHITE, phase=0.5, levels_are_stated=True)
    full = 8000.0
    for exposure in STOPS:
        charge = np.maximum(rng.normal(E * exposure * full, np.sqrt(E * exposure * full)), 0)
        flowing = np.maximum(charge - full, 0) * blooming
        charge = np.minimum(charge, full)
        carried = np.zeros(charge.shape[1])
        for row in range(len(charge)):  # down the column, into each well that is not full
            carried += flowing[row]
            taken = np.minimum(carried, full - charge[row])
            charge[row] += taken
            carried -= taken
        for row in range(len(charge) - 1, -1, -1):  # the rest of the charge flows up
            taken = np.minimum(carried, full - charge[row])
            charge[row] += taken
            carried -= taken
        dn = BLACK + charge / full * (WHITE - BLACK + 1) + rng.normal(0, 2, charge.shape) + 0.5
        series.add(np.clip(dn, 0, WHITE).astype(np.uint16), exposure, f"exposure {exposure:g}")
    return series


def largest_error(series: Series) -> tuple[float, bool]:
    """Return the largest relative error of irradiance, and whether charge was seen to spill."""
    estimate = estimate_response(series)
    brightness = np.linspace(0.03, 0.85, 50)
    (channel,) = estimate.record.channels
    curve = np.interp(brightness, channel.brightness, channel.irradiance) / brightness
    spills = "saturation" in [each.details.get("what") for each in estimate.findings]
    return float(np.abs(curve / curve.mean() - 1).max()), spills


def test_charge_that_spills_over_does_not_bend_the_response(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    series = series_of(0.02)
    error, spills = largest_error(series)
    assert spills
    assert error < 0.005
    monkeypatch.setattr(estimate, "spills_over", lambda *_: False)
    assert largest_error(series)[0] > 0.02


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_nothing_is_left_out_where_nothing_spills_over(seed: int) -> None:
    error, spills = largest_error(series_of(0, seed))
    assert not spills
    assert error < 0.005


@pytest.mark.parametrize("layout", [Layout.MONO, Layout.RGGB, Layout.RGB])
def test_samples_near_saturation_in_either_frame_are_left_out_of_both(layout: Layout) -> None:
    shape = (20, 30, 3) if layout is Layout.RGB else (20, 30)
    dark, lit = np.full(shape, 1, np.uint8), np.full(shape, 2, np.uint8)
    lit[10, 10] = 255
    grids = [SampleGrid.of(frame, layout) for frame in (dark, lit)]
    counts = np.sum(
        [
            grid_counts(grids, [colour], np.array([0, 1, 2, 3, 255]), below=255)
            for colour in range(len(grids[0].planes))
        ],
        axis=0,
    )
    left = dark.size - 5 * 3 * (3 if layout is Layout.RGB else 1)
    assert counts.tolist() == [[0, left, 0, 0, 0], [0, 0, left, 0, 0]]


def test_a_large_frame_is_sampled_on_a_grid() -> None:
    grid = SampleGrid.of(np.zeros((1500, 2000), np.uint8), Layout.MONO)
    assert grid.planes[0].shape == grid.peaks[0].shape == (512, 512)
