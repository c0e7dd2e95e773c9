"""The predicted time of a capture, compared with the time that each kind of camera takes."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import coolpix_bench
import ptp_bench
import pytest
import v4l2_model
from hypothesis import given
from hypothesis import strategies as st
from sampling import some

import camctl
from camctl.drivers.v4l2.camera import V4l2Camera
from camctl.exposure.search.wall_time import predicted_wall_s, wall_time_findings
from camctl.interface.camera import Camera
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.profiles.profile import DelayRecord, change_profile
from camctl.records.report import CaptureReport
from camctl.streaming.control_delay import ControlDelay, DelayOrigin

TIMES = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)


@pytest.fixture(autouse=True)
def profiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))


RATIOS = (1.0, 3.0, 9.0, 27.0, 81.0)


def captured(camera: Camera, ratios: tuple[float, ...], **more: Any) -> CaptureReport:
    return camctl.capture(camera, camctl.CaptureRequest(ratios=ratios, **more))


def error(report: CaptureReport) -> float:
    """Return the relative error of the planned time."""
    return report.timing["planned_wall_s"] / report.timing["actual_wall_s"] - 1


@pytest.mark.parametrize(
    ("sensor", "count"),
    some(
        [("standard", 1), ("standard", 5), ("machine-vision", 2), ("phone", 3), ("webcam", 5)],
        every=2,
    ),
)
def test_a_constant_delay_is_predicted_exactly_in_virtual_time(sensor: str, count: int) -> None:
    for ratios in (RATIOS[:count], (1.0,) * count):
        with camctl.open_camera("sim", sensor=sensor, size="32x24") as camera:
            report = captured(camera, ratios)
        assert report.clock == "virtual"
        assert error(report) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("sensor", ["standard", "webcam"])
def test_no_capture_waits_for_the_long_exposures_before_it(sensor: str) -> None:
    """Metering of a dark scene ends with an exposure of seconds, as does the capture before."""
    with camctl.open_camera("sim", sensor=sensor, scene="night-street", size="64x48") as camera:
        request = camctl.CaptureRequest("log", 256.0, ratios=(1.0, 20.0))
        for _ in range(2):
            began_s = camera.clock.now()
            plan = camctl.plan_capture(camera, request)
            assert camera.clock.now() - began_s > 1.0
            report = camctl.capture(camera, request, plan=plan)
            assert error(report) == pytest.approx(0, abs=1e-6)
            interval_s, delay = camera.controls.frame_interval_s, camera.controls.delay_frames
            assert delay is not None
            slots_s = sum(max(each.time_s, interval_s) for each in plan.settings)
            assert report.timing["actual_wall_s"] == pytest.approx(slots_s + delay * interval_s)


@pytest.mark.parametrize(("late", "is_warned"), [(0, False), (1, False), (9, True)])
def test_a_capture_that_takes_another_time_than_planned_warns(late: int, is_warned: bool) -> None:
    """A difference of a frame is within what a plan can know: a request comes at any time in one.

    In virtual time a request comes at the begin of a frame, so that one frame of six is too much.
    """
    with camctl.open_camera("sim", sensor="standard", size="32x24") as camera:
        request = camctl.CaptureRequest(ratios=RATIOS[:2], base_s=0.01)
        plan = camctl.plan_capture(camera, request)
        assert plan.wall_s is not None
        interval_s = camera.controls.frame_interval_s
        moved = replace(plan, wall_s=plan.wall_s - late * interval_s / 10)
        report = camctl.capture(camera, request, plan=moved)
    found = [each for each in report.findings if each.code == "time_differs"]
    assert bool(found) is is_warned
    assert len(found) <= 1


@pytest.mark.parametrize(
    ("actual_s", "differs"), [(0.36, True), (0.75, False), (0.85, False), (1.2, True)]
)
def test_a_stream_of_unknown_delay_is_compared_in_both_directions(
    actual_s: float, *, differs: bool
) -> None:
    """Exposures within a frame take one frame each, whenever they settle: no time is unknown."""
    timing = ControlDelay(0, 6, DelayOrigin.ASSUMED).timing(0.0)
    times = Steps(1e-4, 1 / 30, 1e-4)
    controls = ExposureControls(
        times,
        (4, 4),
        Layout.MONO,
        8,
        white=255,
        frame_interval_s=1 / 30,
        timing=timing,
        response_origin=ResponseOrigin.STATED,
    )
    settings = [ExposureSetting(time_s) for time_s in (0.001, 0.004, 0.02)]
    planned_s = predicted_wall_s(controls, settings)
    assert planned_s == pytest.approx(0.8)
    found = wall_time_findings(controls, settings, planned_s=planned_s, actual_s=actual_s)
    assert [each.code for each in found] == ["time_differs"] * differs
    assert [each.value for each in found] == [actual_s] * differs


@pytest.mark.slow
def test_a_varying_delay_is_predicted_on_average() -> None:
    """The consumer sensor needs 1 or 2 frames: which of them have the old exposure is random."""
    reports = []
    for seed in range(24):
        with camctl.open_camera("sim", sensor="consumer", size="32x24", seed=seed) as camera:
            reports.append(captured(camera, RATIOS[:3]))
    assert abs(fmean(error(report) for report in reports)) < 0.05
    assert not any(each.code == "time_differs" for report in reports for each in report.findings)
    with camctl.open_camera("sim", sensor="consumer", size="32x24") as camera:
        # With exposures below the frame interval, each takes three frames whatever the delay is.
        # A base is given, since metering may end with a longer exposure that the first frames have.
        report = captured(camera, (1.0, 1.0, 1.0), base_s=0.03)
        assert error(report) == pytest.approx(0, abs=1e-6)


def test_a_resumed_capture_plans_what_is_missing(tmp_path: Path) -> None:
    stop_after = iter([False, True])
    with camctl.open_camera("sim", size="32x24") as camera:
        request = camctl.CaptureRequest(ratios=RATIOS[:4])
        with pytest.raises(camctl.InterruptedCaptureError):
            camctl.capture(camera, request, tmp_path / "c", cancelled=lambda: next(stop_after))
        report = camctl.resume(camera, tmp_path / "c")
        missing = report.plan.settings[2:]
        assert report.timing["planned_wall_s"] == predicted_wall_s(camera.controls, missing)


def delayed_model(delay: int | None) -> tuple[v4l2_model.Model, V4l2Camera]:
    """Return a model of a webcam, and an open camera that knows its delay unless it is None."""
    model = v4l2_model.Model(delay=delay or 2)

    def open_() -> V4l2Camera:
        return V4l2Camera(v4l2_model.PATH, clock=model.clock, kernel=model).open()

    if delay is not None:
        with open_() as camera:
            record = DelayRecord(
                frames=delay, smallest=delay, largest=delay, trials=9, measured_at="now"
            )
            mode = camera.mode
            change_profile(camera.info, lambda profile: profile.delays.update({mode: record}))
    return model, open_()


@pytest.mark.parametrize(("delay", "count"), some(product((None, 0, 1, 3), (1, 3, 6)), every=4))
def test_v4l2_takes_the_predicted_time_on_average(delay: int | None, count: int) -> None:
    """A request comes at any time within a frame: the mean is predicted, to a tenth of a frame."""
    phase = random.Random(count)
    model, camera = delayed_model(delay)
    with camera:
        settings = [ExposureSetting(camera.controls.time_s.nearest(t)) for t in TIMES[:count]]
        taken = []
        for _ in range(60):
            model.clock.sleep_until(model.clock.now() + phase.uniform(0.05, 3))
            began_s = model.clock.now()
            list(camera.shoot(settings))
            taken.append(model.clock.now() - began_s)
        predicted = predicted_wall_s(camera.controls, settings)
        assert fmean(taken) == pytest.approx(predicted, abs=0.2 * model.interval_s)
        assert max(taken) - min(taken) < 1.5 * model.interval_s


@pytest.mark.parametrize(
    "config",
    some(
        [
            {},
            {"delay_s": 0.4},
            {"delay_s": 0.2, "object_bytes": 8_000_000},
            {"delay_s": 0.2, "object_bytes": 8_000_000, "overlap": False},
            {"vendor": "canon"},
        ],
        every=2,
        first=1,
    ),
    ids=str,
)
@pytest.mark.usefixtures("cv2")  # the virtual camera makes JPEG files
def test_ptp_is_timed_by_its_first_capture(config: dict[str, Any]) -> None:
    with ptp_bench.camera_on(**config) as (camera, _):
        first = captured(camera, RATIOS[:3], base_s=1 / 500)
        assert not first.plan.is_wall_known
        assert error(first) <= 0
        report = captured(camera, RATIOS, base_s=1 / 500)
        assert report.plan.is_wall_known
        assert abs(error(report)) < 0.05  # its events are polled


@pytest.mark.usefixtures("cv2")  # the virtual camera makes JPEG files
def test_the_times_of_a_still_camera_are_in_its_profile() -> None:
    pair = ptp_bench.bench(delay_s=0.4)
    with pair.camera() as camera:
        captured(camera, RATIOS[:3], base_s=1 / 500)
    with pair.camera() as camera:
        report = captured(camera, RATIOS[:4], base_s=1 / 500)
    assert report.plan.is_wall_known
    assert abs(error(report)) < 0.01


@pytest.mark.usefixtures("cv2")  # the virtual camera makes JPEG files
def test_coolpix_knows_its_line_and_is_timed_by_its_first_capture() -> None:
    with (
        coolpix_bench.virtual_coolpix(delay_s=0.4) as device,
        coolpix_bench.coolpix_on(device) as camera,
    ):
        captured(camera, RATIOS[:2], base_s=1 / 500)
        assert abs(error(captured(camera, RATIOS[:4], base_s=1 / 500))) < 0.01


@given(
    st.lists(st.floats(1e-4, 10), min_size=1, max_size=6),
    st.floats(0, 2),
    st.floats(0, 2),
    st.floats(0, 2),
)
def test_a_download_during_the_next_exposure_never_takes_longer(
    times: list[float], settling_s: float, readout_s: float, download_s: float
) -> None:
    def predicted(*, overlaps: bool) -> float:
        timing = CaptureTiming(settling_s, readout_s, download_s, overlaps)
        controls = ExposureControls(
            Steps(1e-4, 10),
            (1, 1),
            Layout.MONO,
            8,
            white=255,
            timing=timing,
            response_origin=ResponseOrigin.STATED,
        )
        return predicted_wall_s(controls, [ExposureSetting(time_s) for time_s in times])

    least = sum(times) + len(times) * settling_s + download_s
    one_after_the_other = least + (len(times) - 1) * download_s + len(times) * readout_s
    assert predicted(overlaps=False) == pytest.approx(one_after_the_other)
    assert least * (1 - 1e-9) <= predicted(overlaps=True) <= predicted(overlaps=False) * (1 + 1e-9)
