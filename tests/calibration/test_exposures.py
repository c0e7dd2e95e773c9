"""Measuring the true exposures of simulated cameras whose shutter times are not as stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.calibration.exposures import measure_exposures
from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.shooting import measure_response
from camctl.errors import CaptureError
from camctl.profiles.calibrated import open_camera
from camctl.profiles.exposures import ExposureRecord, exposure_mode
from camctl.profiles.profile import change_profile
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.motion import Lamps
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import load_sensor

OFFSET_S = 0.0005


@pytest.fixture
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))


def measure(
    scene: str = "tile-floor",
    sensor: str = "standard",
    offset_s: float = OFFSET_S,
    seed: int = 0,
    **options: object,
) -> ExposureRecord:
    faults = Faults(shutter_offset_s=offset_s)
    with camctl.open_camera(
        "sim", scene=scene, sensor=sensor, size="320x240", faults=faults, seed=seed
    ) as camera:
        return measure_exposures(camera, **options)  # type: ignore[arg-type]  # only in tests


def relative_errors(record: ExposureRecord, offset_s: float) -> NDArray[np.float64]:
    """Return the relative errors of the measured times, whose mean is 0."""
    true = np.array([1 + offset_s / each.value for each in record.times])
    logs = np.log([each.factor for each in record.times] / true)
    return np.asarray(logs - logs.mean())


@pytest.mark.parametrize(
    ("scene", "sensor"),
    [
        pytest.param("tile-floor", "standard", marks=pytest.mark.slow),  # 8 bits, linear
        ("tile-floor", "phone"),  # 10 bits, Bayer mosaic, black level
        pytest.param("tile-floor", "consumer", marks=pytest.mark.slow),  # 8 bits, non-linear
        pytest.param("colour-chart", "standard", marks=pytest.mark.slow),  # RGB
        pytest.param("tile-floor", "machine-vision", marks=pytest.mark.slow),  # 12 bits
    ],
)
def test_true_times_are_measured_to_a_thousandth(scene: str, sensor: str) -> None:
    record = measure(scene, sensor)
    assert len(record.times) > 10
    assert np.abs(relative_errors(record, OFFSET_S)).max() < 1e-3
    # The shortest time differs most from its label, and the label is found to be wrong.
    assert record.times[0].contradicts_label


def measure_both(sensor: str, seed: int, offset_s: float = 0.0) -> ExposureRecord:
    """Measure first the response of a camera that does not state it, and then its exposures."""
    options = {
        "scene": "ramp",
        "sensor": sensor,
        "size": "160x120",
        "seed": seed,
        "unknown": True,
        "faults": Faults(shutter_offset_s=offset_s),
    }
    with open_camera("sim", options, profile="none") as camera:
        response = estimate_response(measure_response(camera)).record
        mode = exposure_mode(camera.controls)
        change_profile(camera.info, lambda profile: profile.responses.update({mode: response}))
    with open_camera("sim", options, profile="response") as camera:
        return measure_exposures(camera)


@pytest.mark.slow
@pytest.mark.usefixtures("own_profiles")
def test_the_error_of_a_measured_response_is_in_the_intervals() -> None:
    cases = [("machine-vision", seed) for seed in range(4)] + [("webcam", 1)]
    records = [measure_both(*case) for case in cases]
    settings = [each for record in records for each in (*record.times, *record.gains)]
    assert len(settings) > 80
    assert np.mean([each.contradicts_label for each in settings]) <= 0.05


@pytest.mark.slow
@pytest.mark.usefixtures("own_profiles")
def test_a_label_that_is_wrong_by_a_hundredth_is_found_with_a_measured_response() -> None:
    record = measure_both("webcam", 0, offset_s=0.01 * 0.0011)
    assert record.times[0].value == pytest.approx(0.0011)
    assert record.times[0].contradicts_label


def test_true_labels_are_not_contradicted() -> None:
    record = measure("tile-floor", "phone", 0.0)
    assert sum(each.contradicts_label for each in record.times) <= 1  # 5 % of 18
    assert len(record.gains) > 3
    assert [each.factor for each in record.gains] == pytest.approx(
        [1.0] * len(record.gains), abs=3e-3
    )


def test_moving_object_does_not_bias_the_times() -> None:
    record = measure("moving-target")
    assert np.abs(relative_errors(record, OFFSET_S)).max() < 3e-3


def test_longest_time_is_respected() -> None:
    record = measure(longest_s=0.1)
    assert record.times[-1].value <= 0.1


def test_flickering_light_is_refused() -> None:
    y, x = np.mgrid[0:120, 0:160] / 160
    light = np.exp(np.sin(9 * x) + np.sin(7 * y) - 1).astype(np.float32)
    scene = Scene("lamps", light, photons_per_unit=1e7, lamps=Lamps(50, 0.4))
    with (
        SimulatedCamera(scene, load_sensor("standard")) as camera,
        pytest.raises(CaptureError, match="not steady"),
    ):
        measure_exposures(camera, longest_s=0.03)


@pytest.mark.parametrize(
    ("scene", "longest_s", "problem"),
    [("stars", 0.01, "too dark"), ("tile-floor", 0.002, "too dark")],
)
def test_unsuitable_light_is_refused(scene: str, longest_s: float, problem: str) -> None:
    with pytest.raises(CaptureError, match=problem) as caught:
        measure(scene, longest_s=longest_s)
    assert caught.value.hint
