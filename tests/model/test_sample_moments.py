"""Moments of the light of samples, beside those of simulated samples."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.sample_moments import SampleMoments, range_means
from camctl.model.sensor import SensorModel

#: Steps of 4 levels at black and of less than one at white.
COARSE = CameraResponse((np.arange(1, 256) / 256) ** 0.75, "coarse at black")


@pytest.mark.parametrize("real", [COARSE, linear_response(8)])
@pytest.mark.parametrize("noise", [FrameNoise(20.0, 1.2), FrameNoise(60.0, 0.4)])
@pytest.mark.parametrize("step", [0.5, 1.0, 1.75, 20.25, 200.0])
def test_moments_are_those_of_samples(real: CameraResponse, noise: FrameNoise, step: float) -> None:
    full, sensor, moments = real.M + 1, SensorModel(real, 0), SampleMoments(real, 0)
    light = float(np.interp(step, np.arange(full), np.append(0.0, real.levels)))
    rng = np.random.default_rng(0)
    spread = np.sqrt(sensor.variance(np.array([light]), noise))
    seen = sensor.light[
        np.searchsorted(real.levels, light + spread * rng.normal(size=400_000), "right")
    ]
    place = moments.places(np.array([light]))
    error, square, variance = range_means(moments.table(noise), place - 1e-6, place + 1e-6)[:, 0]
    unit = float(seen.std()) + 1 / full / 100
    assert error == pytest.approx(seen.mean() - light, abs=0.02 * unit)
    assert square == pytest.approx(error**2, abs=0.002 * unit**2)
    assert variance == pytest.approx(seen.var(), abs=0.03 * unit**2)


def test_many_values_are_as_good_as_single_ones() -> None:
    real = linear_response(16)
    noise = FrameNoise(0.1, 40.0)
    moments = SampleMoments(real, 0)
    expected = SensorModel(real, 0).variance(np.array([0.25, 0.5]), noise)
    places = moments.places(np.array([0.25, 0.5]))
    variance = range_means(moments.table(noise), places - 0.01, places + 0.01)[2]
    np.testing.assert_allclose(variance, expected, rtol=0.002)


def test_means_of_ranges_are_those_of_lines_between_places() -> None:
    table = np.array([[0.0, 1.0, 4.0, 4.0]])
    low, high = np.array([0.0, 0.5, 1.25]), np.array([1.0, 1.5, 3.0])
    fine = [
        np.interp(np.linspace(a, b, 20001), range(4), table[0]).mean()
        for a, b in zip(low, high, strict=True)
    ]
    np.testing.assert_allclose(range_means(table, low, high)[0], fine, rtol=1e-4)
