"""Errors for unsuitable exposure series, and curves with a sharp shoulder."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.calibration.response import estimate_response
from camctl.calibration.response_series import Series
from camctl.controls import Layout
from camctl.errors import DataError
from camctl.response.camera import FloatArray
from sim.scenes.drawings import DRAWINGS

STOPS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)


def curve(light: FloatArray) -> FloatArray:
    """Return the brightness of a film: a power, and a sharp shoulder near full scale."""
    power = light**0.5 / 0.95
    bent = power - 0.018 * np.logaddexp(0, (power - 0.95) / 0.02)
    return np.asarray(bent / (1 / 0.95 - 0.018 * np.logaddexp(0, (1 / 0.95 - 0.95) / 0.02)))


def shoot(E: FloatArray, exposure: float, seed: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    charge = 1e4 * E * exposure
    charge = charge + np.sqrt(charge + 25) * rng.normal(size=E.shape)
    brightness = curve(np.clip(charge / 1e4, 0, 1))
    return np.clip(np.floor(brightness * 256), 0, 255).astype(np.uint8)


def room() -> FloatArray:
    light = np.asarray(DRAWINGS["room"](240, 320))
    light = light.mean(axis=2)
    return np.asarray(light / np.quantile(light, 0.98))


def shades() -> FloatArray:
    """Return light over three decades, whose neighbours differ little."""
    rows, columns = np.mgrid[0:240, 0:320]
    logs = 5 * rows / 240 + 2 * np.sin(columns / 25) + np.sin(columns / 7 + rows / 11) / 2
    return np.asarray(np.exp(logs - np.quantile(logs, 0.98)))


def series_of(frames: list[NDArray[np.uint8]]) -> Series:
    series = Series(Layout.MONO, 8, levels_are_stated=True)
    for k, (frame, exposure) in enumerate(zip(frames, STOPS, strict=True)):
        series.add(frame, exposure, f"frame {k}")
    return series


def test_a_camera_that_moved_is_not_taken_for_wrong_exposures() -> None:
    """Even where histograms stay as they are: what leaves at an edge comes in at the other."""
    frames = [
        np.roll(shoot(room(), exposure, k), (7 * k, -11 * k), (0, 1))
        for k, exposure in enumerate(STOPS)
    ]
    with pytest.raises(DataError, match=r"frame 0 and frame 1 do not show the same: .* moved"):
        estimate_response(series_of(frames))


def test_a_frame_is_darker_by_less_than_all_of_its_light() -> None:
    wrong = [exposure / (1.8 if k == 3 else 1) for k, exposure in enumerate(STOPS)]
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(wrong)]
    with pytest.raises(DataError, match=r"frame 3 is 44% darker than its exposure 1 says"):
        estimate_response(series_of(frames))


def test_a_sharp_shoulder_is_followed() -> None:
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(STOPS)]
    (channel,) = estimate_response(series_of(frames)).record.channels
    brightness = np.linspace(0.05, 0.98, 100)
    light = np.linspace(0, 1, 10_000)
    true = np.interp(brightness, curve(light), light)
    found = np.interp(brightness, channel.brightness, channel.irradiance)
    slope = np.gradient(brightness, np.log(true))
    errors = np.log(found / true)
    errors -= np.average(errors, weights=slope**2)  # the unit of the light is free
    assert (
        np.sqrt(np.mean((errors * slope) ** 2)) < 0.00026
    )  # 0.00030 with knots that are wide at the shoulder
