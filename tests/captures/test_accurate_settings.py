from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_cameras import small_camera

import camctl
from camctl.captures.plan import plan_capture
from camctl.errors import UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.best import objective_of
from camctl.exposure.search.wall_time import gain_choices
from camctl.interface.controls import Choices, ExposureControls, Layout, ResponseOrigin, Steps
from camctl.model.noise import NoiseModel

NOISE = NoiseModel(39.0, ((1.0, 3.0),))


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "exposure"


def controls_with(noise: NoiseModel | None) -> ExposureControls:
    return ExposureControls(
        Steps(1e-4, 10.0, 1e-4),
        (4, 4),
        Layout.MONO,
        8,
        white=255,
        noise=noise,
        response_origin=ResponseOrigin.STATED,
    )


@pytest.mark.parametrize(
    ("fields", "noise", "expected"),
    [
        ({}, NOISE, "accuracy"),
        ({}, None, "xi"),
        ({"objective": "xi"}, NOISE, "xi"),
        ({"accuracy": 50.0}, NOISE, "accuracy"),
        ({"tolerance": 5.0, "levels_wanted": 100.0}, NOISE, "xi"),
        ({"levels_wanted": 100.0}, NOISE, "xi"),
        ({"ratios": (1.0, 2.0)}, NOISE, "xi"),
        ({"use_aperture": True}, NOISE, "xi"),
    ],
)
def test_accuracy_decides_where_the_noise_is_known(
    fields: dict[str, Any], noise: NoiseModel | None, expected: str
) -> None:
    request = CaptureRequest(**fields)
    assert objective_of(request, controls_with(noise), has_table=False) == expected


def test_a_table_means_xi() -> None:
    controls = controls_with(NOISE)
    assert objective_of(CaptureRequest(), controls, has_table=True) == "xi"
    with pytest.raises(UsageError, match=r"a table has exposures chosen by xi"):
        objective_of(CaptureRequest(objective="accuracy"), controls, has_table=True)


@pytest.mark.parametrize("fields", [{"objective": "accuracy"}, {"accuracy": 50.0}])
def test_accuracy_without_known_noise_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="the noise of this camera is unknown"):
        objective_of(CaptureRequest(**fields), controls_with(None), has_table=False)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"objective": "speed"}, "unknown objective 'speed'"),
        ({"objective": "xi", "accuracy": 50.0}, "cannot be reached with the objective 'xi'"),
        ({"accuracy": 0.0}, "invalid accuracy 0: expected a number of effective levels"),
        ({"accuracy": "many"}, "invalid accuracy 'many'"),
        ({"objective": "accuracy", "ratios": (1, 2)}, "cannot be combined with ratios"),
        ({"accuracy": 5.0, "levels_wanted": 9.0}, "cannot be combined with levels wanted"),
        ({"objective": "accuracy", "use_aperture": True}, "cannot be combined with use aperture"),
    ],
)
def test_contradicting_requests_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        CaptureRequest(**fields)


@pytest.mark.slow
def test_a_time_budget_chooses_the_count_unless_it_is_given() -> None:
    with small_camera() as camera:
        free = plan_capture(camera, CaptureRequest("linear", 100.0, time_budget_s=0.3))
        given = plan_capture(camera, CaptureRequest("linear", 100.0, 2, time_budget_s=0.3))
    assert len(given.settings) == 2
    assert len(free.settings) > 3
    assert max(free.wall_s or math.inf, given.wall_s or math.inf) <= 0.3
    assert free.effective_levels > 1.5 * given.effective_levels


def test_gain_is_raised_within_a_budget_below_the_exposures_at_gain_1() -> None:
    with small_camera("webcam") as camera:
        free = plan_capture(camera, CaptureRequest("log", 1000.0, 2))
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, 2, time_budget_s=0.15))
    assert plan.wall_s is not None
    assert plan.wall_s <= 0.15 * (1 + 1e-8)  # `time_budget` allows for rounding in float64
    assert max(setting.gain for setting in free.settings) == 1
    assert max(setting.gain for setting in plan.settings) > 1


def test_an_accuracy_is_reached_by_the_plan() -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, 3, accuracy=70.0))
        slower = plan_capture(camera, CaptureRequest("log", 1000.0, 3))
    assert 69.5 <= plan.effective_levels < 75
    assert plan.shutter_s < slower.shutter_s


def test_shutter_times_are_whole_flicker_periods() -> None:
    with small_camera() as camera:
        request = CaptureRequest("log", 1000.0, 2, base_s=0.02, mains_hz=50.0)
        plan = plan_capture(camera, request)
    periods = np.array([setting.time_s for setting in plan.settings]) / 0.01
    assert periods == pytest.approx(np.round(periods))
    assert plan.warnings == ()


def test_gain_choices_are_doublings_of_the_smallest() -> None:
    assert gain_choices(Steps(1.0, 16.0, 0.0625)) == (1.0, 2.0, 4.0, 8.0, 16.0)
    assert gain_choices(Choices((1.0,))) == (1.0,)
    assert gain_choices(Choices((2.0, 3.0, 8.0))) == (2.0, 3.0, 8.0)


@pytest.mark.parametrize(
    "sensor",
    [
        "consumer",
        pytest.param("complete", marks=pytest.mark.slow),
        pytest.param("security", marks=pytest.mark.slow),
    ],
)
def test_the_settings_reach_the_accuracy_and_not_only_the_times_before_rounding(
    sensor: str,
) -> None:
    with camctl.open_camera("sim", scene="room", sensor=sensor) as camera:
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, accuracy=60.0))
    assert 60.0 <= plan.effective_levels < 60.5
