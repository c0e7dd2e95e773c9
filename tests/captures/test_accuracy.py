"""Predicted accuracy against simulated cameras before known scenes; see `tests/bench` for more."""

from __future__ import annotations

import numpy as np
import pytest
from accuracy import NEAR_SATURATION, NOMINAL, radiance_errors, sensor_without_lens, shoot_ramp
from numpy.typing import NDArray

from camctl.exposure.goal import CaptureRequest
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import load_sensor


@pytest.mark.parametrize(
    ("sensor", "response", "ratios"),
    [
        ("standard", "log", (1, 9.91, 88.38)),
        ("standard", "linear", (1, 1.003, 2.985)),
        pytest.param("webcam", "gamma", (1, 3.094), marks=pytest.mark.slow),
        ("consumer", "log", (1, 20.24)),  # an sRGB curve
        ("phone", "log", (1, 2, 4, 8)),  # a mosaic, and noise below the black level
        pytest.param("machine-vision", "gamma", (1, 1.003, 5.146), marks=pytest.mark.slow),
        pytest.param("complete", "linear", (1, 2, 4, 8), marks=pytest.mark.slow),
        ("ideal-8", "log", (1, 9.91, 88.38)),
    ],
)
def test_predicted_effective_levels_are_those_measured_in_the_image(
    sensor: str, response: str, ratios: tuple[float, ...]
) -> None:
    camera = sensor_without_lens(sensor)
    report, measured = shoot_ramp(camera, response, 1000.0, ratios, rows=150)
    # 60,000 samples: the measurement itself is within 0.6 % in 95 of 100 cases.
    assert measured == pytest.approx(report.achieved.effective_levels, rel=0.02)


def smooth_light(rows: int, columns: int) -> NDArray[np.float32]:
    """Return light over four decades, smooth, as of a dark interior with bright windows."""
    y, x = np.mgrid[0:rows, 0:columns] / rows
    waves = np.sin(7 * x + 3 * y) + np.sin(13 * y - 5 * x + 1) + 0.5 * np.sin(31 * x * y)
    return np.asarray(np.exp(2.2 * waves), np.float32)


@pytest.mark.parametrize(
    "name", ["tile-floor", "ramp", pytest.param("interior", marks=pytest.mark.slow)]
)
def test_intervals_contain_the_irradiance_as_often_as_they_state(name: str) -> None:
    scene = (
        Scene(name, smooth_light(160, 200), photons_per_unit=1e4)
        if name == "interior"
        else load_scene(name, (160, 200))
    )
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 9.0, 90.0))
    errors = radiance_errors(scene, load_sensor("standard"), request, [0.0, 0.1, 0.2])
    for part, where in errors.parts().items():
        samples = np.count_nonzero(where)
        assert samples > 4000
        for share, nominal in zip(errors.shares(where), NOMINAL, strict=True):
            chance = 3 * np.sqrt(nominal * (1 - nominal) / samples)
            assert abs(share - nominal) < 0.01 + chance, part


@pytest.mark.slow
def test_intervals_near_saturation_are_neither_wide_nor_narrow() -> None:
    stops = [0.5 + step / 8 for step in range(8)]  # each is a plan of its own, which takes a second
    errors = radiance_errors(
        load_scene("ramp", (120, 400)), load_sensor("standard"), CaptureRequest(), stops
    )
    near = errors.E >= NEAR_SATURATION
    samples = np.count_nonzero(near)
    assert samples > 4000
    # Of samples that noise saturates nothing is known.  The others are too bright less often, so
    # that more of them lie within one standard deviation: 71.4 % when this was written.
    for share, nominal, cut in zip(errors.shares(near), NOMINAL, (0.02, 0.0), strict=True):
        chance = 3 * np.sqrt(nominal * (1 - nominal) / samples)
        assert abs(share - nominal - cut) < 0.015 + chance
