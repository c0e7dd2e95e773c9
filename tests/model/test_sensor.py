"""The sensor model's prediction of one frame by another one."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.model.distribution import NoisyFrame
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, linear_response, standard_response
from camctl.model.sensor import SensorModel

#: Three levels of it coincide, as in a measured response with a flat part.
FLAT = CameraResponse(np.array([0.1, 0.2, 0.2, 0.2, 0.4, 0.7, 0.9]), "flat")
NOISE = FrameNoise(electrons_per_level=20.0, read_noise_levels=0.5)


@pytest.mark.parametrize("real", [linear_response(8), standard_response("srgb", 8), FLAT])
@pytest.mark.parametrize("black", [0, 3])
@pytest.mark.parametrize("ratio", [1.0, 1.003, 4.0, 1e4])
@pytest.mark.parametrize("noise", [None, NOISE])
def test_predictions_are_finite(
    real: CameraResponse, black: int, ratio: float, noise: FrameNoise | None
) -> None:
    """Equal exposures without noise predict each sample exactly, and levels may coincide."""
    found = SensorModel(real, black).neighbour(ratio, noise, noise)
    for table in (found.mean, found.own, found.shared, found.skewness):
        assert table.shape == (real.M + black + 1,)
        assert np.all(np.isfinite(table))
    assert np.all(found.own >= 0)
    assert np.all(found.shared >= 0)


def test_noise_has_the_same_unit_in_all_models() -> None:
    """Its levels are those of the linear scale, also where a curve is saturated before its end."""
    real = CameraResponse(0.9 * standard_response("srgb", 8).levels, "saturated early")
    light = np.array([0.01, 0.3, 0.8])
    exact = NoisyFrame.of(real, 1.0, NOISE).deviation(light)
    np.testing.assert_allclose(SensorModel(real, 0).variance(light, NOISE), exact**2)
