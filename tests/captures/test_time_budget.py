"""A capture chosen for a time budget is announced with a time, and takes one, within the budget."""

from __future__ import annotations

from dataclasses import replace

import pytest

import camctl
from camctl.errors import CaptureError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.best import within_budget
from camctl.exposure.search.front import Front
from camctl.exposure.search.wall_time import predicted_wall_s, time_costs
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.model.noise import NoiseModel

STREAM = ExposureControls(
    Steps(1e-4, 10.0, 1e-4),
    (24, 32),
    Layout.MONO,
    8,
    white=255,
    delay_frames=2,
    frame_interval_s=0.1,
    timing=CaptureTiming(lead_frames=0.5, readout_s=0.02),
    noise=NoiseModel(39.0625, ((1.0, 3.0),)),
    response_origin=ResponseOrigin.STATED,
)
VARYING = replace(
    STREAM,
    delay_frames=None,
    timing=CaptureTiming(0.0, 0.02, lead_frames=0.5, old_frames=2.0, unsettled_frames=1.0),
)
STILL = replace(STREAM, delay_frames=None, frame_interval_s=0.0)
CAMERAS = {
    "stream": STREAM,
    "varying delay": VARYING,
    "still": replace(STILL, timing=CaptureTiming(0.3, 0.1, 0.5)),
    "still, overlapping": replace(STILL, timing=CaptureTiming(0.3, 0.1, 0.5, overlaps=True)),
    "still, not timed": replace(STILL, timing=None),
}


@pytest.mark.parametrize(
    ("sensor", "budget_s", "objective"),
    [
        ("webcam", 5 / 30, "accuracy"),  # the least: three frames after a control delay of two
        pytest.param("webcam", 5 / 30, "xi", marks=pytest.mark.slow),
        pytest.param("webcam", 0.3, "accuracy", marks=pytest.mark.slow),
        pytest.param("standard", 0.3, "xi", marks=pytest.mark.slow),
        pytest.param("consumer", 1.6, "xi", marks=pytest.mark.slow),
        pytest.param("consumer", 3.0, "accuracy", marks=pytest.mark.slow),
    ],
)
def test_what_is_announced_and_taken_is_within_the_budget(
    sensor: str, budget_s: float, objective: str
) -> None:
    request = CaptureRequest("log", 256.0, 3, time_budget_s=budget_s, objective=objective)
    with camctl.open_camera("sim", sensor=sensor, size="32x24") as camera:
        is_constant = camera.controls.delay_frames is not None
        report = camctl.capture(camera, request)
    planned_s = report.timing["planned_wall_s"]
    assert report.plan.wall_s == planned_s <= budget_s * (1 + 1e-8)
    if is_constant:  # otherwise the delay is known on average
        assert report.timing["actual_wall_s"] <= budget_s * (1 + 1e-8)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("times", [(0.03,), (0.02, 0.08), (0.05, 0.4, 0.05), (0.2, 0.3, 1.5)])
def test_costs_are_the_predicted_time(name: str, times: tuple[float, ...]) -> None:
    controls = CAMERAS[name]
    settings = [ExposureSetting(time_s) for time_s in times]
    costs = time_costs(controls, before=None, shortest_s=times[0])
    predicted_s = predicted_wall_s(controls, settings)
    assert costs.fixed + costs.total(times) == pytest.approx(predicted_s)
    assert costs.shutter(costs.total(times), len(times)) >= sum(times) - 1e-9


@pytest.mark.parametrize("dynamic_range", [128.0, 4096.0])
def test_a_budget_is_used_up_where_the_delay_varies(dynamic_range: float) -> None:
    """Also by exposures that are longer than a frame interval, each of which is waited for."""
    request = CaptureRequest("log", dynamic_range, time_budget_s=5.0)
    with camctl.open_camera("sim", sensor="consumer", size="32x24") as camera:
        assert camera.controls.delay_frames is None
        plan = camctl.plan_capture(camera, request)
    assert plan.wall_s is not None
    assert 4.7 < plan.wall_s <= 5.0 * (1 + 1e-8)


def test_fewer_exposures_are_estimated_where_each_takes_a_frame() -> None:
    request = CaptureRequest("log", 256.0, time_budget_s=0.75)
    desired = request.desired
    assert desired is not None
    free = Front(STREAM, desired, 0.02, request=request).estimated_levels
    given = [
        Front(STREAM, desired, 0.02, request=replace(request, count=n)).estimated_levels
        for n in (1, 2, 3, 4, 5)
    ]
    assert free is not None
    assert given[4] is None  # five frames and the delay take longer
    assert free == pytest.approx(max(each for each in given if each is not None), rel=2e-3)


def test_exposures_within_a_frame_are_free() -> None:
    """As long as a frame lasts anyway, its exposure costs no time: it is used up."""
    with camctl.open_camera("sim", sensor="webcam", size="32x24") as camera:
        interval_s = camera.controls.frame_interval_s
        request = CaptureRequest(
            "log", 256.0, 2, base_s=interval_s / 4, time_budget_s=4.001 * interval_s
        )
        plan = camctl.plan_capture(camera, request)
    assert plan.settings[-1].time_s == pytest.approx(interval_s, rel=0.01)


def test_an_accuracy_is_reached_in_the_least_time_until_the_last_frame() -> None:
    """More exposures of less shutter time in all are no gain where each takes a frame."""
    with camctl.open_camera("sim", sensor="webcam", size="32x24") as camera:
        request = CaptureRequest("log", 256.0, accuracy=40.0)
        plan = camctl.plan_capture(camera, request)
    assert plan.effective_levels >= 40
    assert plan.wall_s is not None
    assert plan.wall_s < 0.18  # the set of least shutter time takes 0.187 s


def test_less_is_asked_for_until_the_settings_fit() -> None:
    asked: list[float] = []

    def choose(allowed: CaptureRequest) -> tuple[tuple[ExposureSetting, ...], tuple[float, ...]]:
        assert allowed.time_budget_s is not None
        asked.append(allowed.time_budget_s)
        return (ExposureSetting(min(0.5, allowed.time_budget_s)),), (1.0,)

    request = CaptureRequest(time_budget_s=1.0)
    found, _ = within_budget(request, request, choose, lambda chosen: chosen[0].time_s + 0.6)
    assert found[0].time_s + 0.6 <= 1.0
    assert asked == sorted(asked, reverse=True)
    with pytest.raises(CaptureError, match=r"no settings of this camera .* fit into 1 s"):
        within_budget(request, request, choose, lambda chosen: 1.5)


@pytest.mark.parametrize("objective", ["accuracy", "xi"])
def test_a_budget_that_only_the_shutter_times_fit_into_is_refused(objective: str) -> None:
    request = CaptureRequest("log", 256.0, 2, time_budget_s=0.1, objective=objective)
    with (
        camctl.open_camera("sim", sensor="webcam", size="32x24") as camera,
        pytest.raises(UsageError, match=r"0\.133\d* s"),
    ):
        camctl.plan_capture(camera, request)
