"""Noise shifts matched levels; the correction takes the shift away."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.fit import ResponseFit
from camctl.calibration.response.matches import Matches, match_levels
from camctl.calibration.response.noise import correct_matches
from camctl.calibration.response.series import Series
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray
from camctl.sim.scenes.drawings import DRAWINGS

STOPS = (1.0, 2.0, 4.0, 8.0, 16.0)
EDGES = np.arange(1.0, 1024.0)
EXPOSURES = 2.0 ** np.arange(-3, 3)


def matches_of(full_well_e: float, read_e: float, slope: float) -> tuple[Matches, Matches]:
    """Return matches of a linear 10-bit camera before a scene, and the same corrected.

    `slope` is that of the logarithm of the density of ln(light).
    """
    rng = np.random.default_rng(1)
    rows, columns = 300, 400
    share = np.add.outer(np.arange(rows) / rows, np.arange(columns)) / columns
    low, high = 1e-3, 1.0
    E = (low**slope + share * (high**slope - low**slope)) ** (1 / slope)
    series = Series(Layout.MONO, 10, levels_are_stated=True)
    for k, exposure in enumerate(STOPS):
        charge = E * exposure * full_well_e
        charge = rng.normal(charge, np.sqrt(charge + read_e**2))
        dn = np.clip(charge / full_well_e * 1024, 0, 1023)
        series.add(dn.astype(np.uint16), exposure, f"frame {k}")
    counts = series.counts_between("Y", EDGES)
    matches = match_levels(lambda *pair: counts[list(pair)], STOPS, EDGES)
    irradiance: FloatArray = EDGES / 1024
    fit = ResponseFit(EDGES, irradiance, np.zeros(EDGES.size), np.array(STOPS), 0.0, np.zeros(0))
    return matches, correct_matches(matches, series, "Y", fit)


def error(matches: Matches) -> float:
    """Return the mean error of ln(irradiance) at dark levels."""
    ratio = np.array(STOPS)[matches.short] / np.array(STOPS)[matches.long]
    logs = np.log(matches.low / matches.high) - np.log(ratio) - matches.shift
    dark = (matches.low > 20) & (matches.low < 60)
    return float(np.mean(logs[dark]))


@pytest.mark.parametrize("slope", [0.5, 1.5])
@pytest.mark.parametrize(("full_well_e", "read_e"), [(4000.0, 5.0), (8000.0, 40.0)])
def test_the_shift_of_dark_levels_by_noise_is_corrected(
    full_well_e: float, read_e: float, slope: float
) -> None:
    raw, corrected = matches_of(full_well_e, read_e, slope)
    assert abs(error(raw)) > 0.001
    assert abs(error(corrected)) < abs(error(raw)) / 3


def test_frames_without_noise_are_not_changed() -> None:
    raw, corrected = matches_of(1e12, 0.0, 1.0)
    assert corrected.shift == pytest.approx(raw.shift, abs=1e-4)


def steep(E: FloatArray) -> FloatArray:
    """Return brightness, of which 40 % is below 1 % of the light, as of a measured curve."""
    return np.asarray(np.minimum(E / 0.0039, E**0.2))


def frames(brightness: Callable[[FloatArray], FloatArray], read_e: float) -> Series:
    """Return frames of a room, of 8 bits."""
    rng, series = np.random.default_rng(159), Series(Layout.MONO, 8, levels_are_stated=True)
    room = np.asarray(DRAWINGS["room"](240, 320)).mean(axis=2)
    room /= np.quantile(room, 0.98)
    for exposure in EXPOSURES:
        charge = room * exposure * 2e4
        charge = charge + np.sqrt(charge + read_e**2) * rng.normal(size=room.shape)
        level = 256 * brightness(np.clip(charge / 2e4, 0, 1))
        series.add(np.minimum(level, 255).astype(np.uint8), exposure, f"frame {exposure}")
    return series


def test_dark_levels_with_more_noise_than_light_do_not_bend_the_exposures() -> None:
    """Of 0.125 to 4 the pixels were said to say 0.12 to 0.9, as noise is clipped at black."""
    series = frames(steep, 5.0)
    assert 50 < series.darkest("Y") < 110
    found = estimate_response(series)
    curve = found.record.main_channel
    at = np.linspace(0.45, 0.95, 30)
    light = np.geomspace(1e-5, 1, 4000)
    errors = np.log(
        np.interp(at, curve.brightness, curve.irradiance) / np.interp(at, steep(light), light)
    )
    assert np.std(errors) < 0.02


def test_levels_that_noise_does_not_clip_are_all_used() -> None:
    gamma = lambda E: E ** (1 / 2.2)  # noqa: E731
    assert frames(gamma, 1.0).darkest("Y") < 8
