"""From requested ratios to settings that a camera really has."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from sampling import some
from small_cameras import WrappedCamera, small_camera

from camctl.captures.metering import meter_light
from camctl.captures.plan import plan_capture, plan_for
from camctl.captures.sequencer import capture
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.objective import xi
from camctl.exposure.search.best import Search
from camctl.exposure.search.settings import (
    BASE_SLACK_STOPS,
    SettingChooser,
    reach_shadows,
    relative_exposures,
)
from camctl.exposure.table import ExposureTable
from camctl.interface.controls import (
    Choices,
    Control,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.records.folder_store import read_capture
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

THIRDS = Choices(tuple(2.0 ** (k / 3) for k in range(-36, 16)))
HUNDRED_US = Steps(1e-4, 10.0, 1e-4)
PRINTED = {
    "linear": (1.0, 1.003, 2.985),
    "gamma": (1.0, 1.003, 5.146),
    "log": (1.0, 9.91, 88.38),
}
Quality = Callable[[Sequence[ExposureSetting]], float]


def controls_of(
    time_s: Control, gain: Control | None = None, f_number: Control | None = None
) -> ExposureControls:
    return ExposureControls(
        time_s,
        (4, 4),
        Layout.MONO,
        8,
        white=255,
        gain=gain or Choices((1.0,)),
        f_number=f_number,
        response_origin=ResponseOrigin.STATED,
    )


def chooser_of(
    controls: ExposureControls,
    ratios: tuple[float, ...],
    response: str = "log",
    request: CaptureRequest | None = None,
) -> tuple[SettingChooser, Quality]:
    real, desired = linear_response(8), desired_response(response, 1000.0)

    def quality(settings: Sequence[ExposureSetting]) -> float:
        camera = EffectiveCamera.of(real, relative_exposures(settings))
        return xi(camera, desired, len(ratios) * real.M)

    request = request or CaptureRequest(response, 1000.0, len(ratios))
    return SettingChooser(controls, request, ratios, quality), quality


@pytest.mark.parametrize("response", PRINTED)
@pytest.mark.parametrize("time_s", [THIRDS, HUNDRED_US], ids=["thirds", "100us"])
@pytest.mark.parametrize("limit_s", [0.0033, 0.0333])
def test_chosen_settings_are_never_worse_than_the_nearest_ratios(
    response: str, time_s: Control, limit_s: float
) -> None:
    chooser, quality = chooser_of(controls_of(time_s), PRINTED[response], response)
    chosen = chooser.best(limit_s, 400)
    base = time_s.between(time_s.minimum, limit_s, 1)[0]
    nearest = [ExposureSetting(time_s.nearest(base * ratio)) for ratio in PRINTED[response]]
    assert quality(chosen) <= quality(nearest)
    assert all(time_s.nearest(s.time_s) == s.time_s for s in chosen)
    assert chosen[0].time_s <= limit_s


def test_longer_base_gives_finer_steps() -> None:
    # At 3.3 ms one step of 100 us is 3 %: there the interleave of 1.003 is lost whatever the base.
    chooser, quality = chooser_of(controls_of(HUNDRED_US), PRINTED["linear"], "linear")
    fine, coarse = quality(chooser.best(0.0333, 400)), quality(chooser.best(0.0033, 400))
    assert fine < coarse


def test_time_is_used_first_then_gain_then_the_aperture_on_request() -> None:
    time_s, gain = Steps(1e-3, 0.1, 1e-5), Steps(1.0, 8.0, 0.01)
    chooser, _ = chooser_of(controls_of(time_s, gain), (1.0, 10.0, 40.0))
    short, middle, long = chooser.best(0.01, 400)
    assert (short.gain, middle.gain) == (1.0, 1.0)
    assert long.time_s <= 0.1
    assert long.time_s >= 0.099
    assert long.exposure / short.exposure == pytest.approx(40, rel=0.01)

    given_base = CaptureRequest("log", 1000.0, 2, base_s=0.01)
    chooser, _ = chooser_of(controls_of(time_s, gain), (1.0, 200.0), request=given_base)
    with pytest.raises(CaptureError, match=r"200 x .* beyond the camera's controls"):
        chooser.best(0.01, 400)
    lens = Choices((4.0, 5.6, 8.0))
    request = CaptureRequest("log", 1000.0, 2, use_aperture=True)
    chooser, _ = chooser_of(controls_of(time_s, gain, lens), (1.0, 200.0), request=request)
    short, long = chooser.best(0.01, 400)
    assert short.f_number == 8.0
    assert long.f_number is not None
    assert long.f_number < 8.0
    assert long.exposure / short.exposure == pytest.approx(200, rel=0.02)


def test_exposure_beyond_the_controls_names_the_nearest_and_what_to_do() -> None:
    request, times = CaptureRequest("log", 1000.0, 3, base_s=0.01), Steps(1e-4, 1.0, 1e-4)
    chooser, _ = chooser_of(controls_of(times), (1.0, 2.0, 500.0), request=request)
    with pytest.raises(CaptureError) as failure:
        chooser.best(0.01, 400)
    assert "the largest possible is 100 x" in failure.value.hint
    assert failure.value.remedies == {"base_s": pytest.approx(1.0 / 500)}
    chooser, _ = chooser_of(controls_of(times), (1.0, 2.0, 500.0))  # metered: it is shortened
    short, _, long = chooser.best(0.01, 400)
    assert short.time_s <= 0.002
    assert long.exposure / short.exposure == pytest.approx(500, rel=0.01)


def test_whole_flicker_periods_are_preferred_and_others_cause_a_warning() -> None:
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0), base_s=0.004, mains_hz=50.0)
    with small_camera() as camera:
        plan = plan_capture(camera, request)
    assert [s.time_s for s in plan.settings] == pytest.approx([0.004, 0.02, 0.06])
    (flicker,) = [each for each in plan.findings if each.code == "flicker"]
    assert (flicker.value, flicker.details) == (0.004, {"period_s": 0.01})


def test_given_ratios_are_sorted_and_kept() -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, ratios=(4.0, 1.0, 2.0)))
    assert plan.ratios == (1.0, 2.0, 4.0)
    assert plan.exposures == pytest.approx((1.0, 2.0, 4.0), rel=1e-3)


def test_base_out_of_reach_is_refused_with_the_nearest() -> None:
    request = CaptureRequest(ratios=(1.0,), base_s=100.0)
    with small_camera() as camera, pytest.raises(CaptureError, match="nearest possible is 60 s"):
        plan_capture(camera, request)


def test_base_between_the_cameras_steps_causes_a_warning() -> None:
    request = CaptureRequest(ratios=(1.0,), base_s=0.0025)
    with small_camera(line_s=1e-3, time_minimum_s=1e-3) as camera:
        plan = plan_capture(camera, request)
    (differs,) = [each for each in plan.findings if each.code == "setting_differs"]
    assert differs.value == 0.003
    assert differs.details == {"field": "base_s", "requested": 0.0025}


def test_coarse_steps_cause_a_warning_with_the_levels_they_cost() -> None:
    with small_camera(line_s=1e-3, time_minimum_s=1e-3) as camera:
        request = CaptureRequest("linear", 256.0, 3, base_s=0.003, objective="xi")
        plan = plan_capture(camera, request)
    (costs,) = [each for each in plan.findings if each.code == "steps_cost_levels"]
    possible = costs.details["possible"]
    assert isinstance(possible, float)
    assert costs.value == plan.effective_levels < 0.9 * possible


@pytest.mark.parametrize("stops", [-20.0, -64.0])
def test_compensation_beyond_the_camera_is_a_finding_with_numbers(stops: float) -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0), compensation_stops=stops))
        assert plan.base_s == camera.controls.time_s.minimum
    (differs,) = [each for each in plan.findings if each.code == "setting_differs"]
    details, possible = differs.details, differs.details["possible_stops"]
    assert (details["field"], details["stops"]) == ("compensation_stops", stops)
    assert (differs.value, details["least_s"], details["most_s"]) == (1e-5, 1e-5, 60.0)
    assert isinstance(possible, float)
    assert stops < possible < 0
    assert differs.remedies == {"compensation_stops": math.ceil(10 * possible) / 10}


def test_compensation_within_the_camera_is_no_warning() -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0), compensation_stops=-1.0))
    assert not [each for each in plan.findings if each.code == "setting_differs"]


def test_compensation_shifts_the_shortest_exposure() -> None:
    with small_camera() as camera:
        plain = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0)))
        darker = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0), compensation_stops=-2.0))
    stops = math.log2(darker.base_s / plain.base_s)
    assert stops == pytest.approx(-2, abs=BASE_SLACK_STOPS)
    assert plain.metering is not None
    assert darker.metering is not None
    assert darker.metering.limit_s == pytest.approx(plain.metering.limit_s, rel=0.03)


@given(
    minimum=st.floats(1e-6, 1e-2),
    span=st.floats(1, 1e4),
    steps=st.integers(1, 5000),
    value=st.floats(1e-7, 1e3),
    count=st.integers(1, 6),
)
def test_every_setting_that_a_control_offers_is_accepted(
    minimum: float, span: float, steps: int, value: float, count: int
) -> None:
    control = Steps(minimum, minimum * (1 + span), minimum * span / steps)
    offered = [control.nearest(value), *control.near(value, count)]
    offered += control.between(value, value * 10, count)
    controls = controls_of(control)
    for time_s in offered:
        controls.check(ExposureSetting(time_s))
    assert len(control.near(value, count)) == min(count, steps + 1)
    assert all(
        value * (1 - 1e-6) <= t <= value * 10 * (1 + 1e-6)
        for t in control.between(value, value * 10, count)
    )


def test_setting_of_a_control_that_the_camera_lacks_is_refused() -> None:
    controls = controls_of(HUNDRED_US)
    with pytest.raises(UsageError, match="cannot set f_number"):
        controls.check(ExposureSetting(0.01, f_number=4.0))
    controls.check(ExposureSetting(0.01))
    assert replace(controls, gain=Steps(1, 4)).gain.nearest(9.0) == 4


@pytest.mark.parametrize("response", some(PRINTED, every=3))
def test_list_of_shutter_times_is_searched_not_rounded_to(response: str) -> None:
    times = Choices(tuple(2.0 ** (k / 3) for k in range(-20, 10, 2)))
    with small_camera() as camera:
        request = CaptureRequest(response, 1000.0, 3, base_s=2.0**-6)
        plan = plan_capture(WrappedCamera(camera, times), request)
    assert {s.time_s for s in plan.settings} <= set(times.values)
    base = plan.settings[0].time_s
    nearest = [ExposureSetting(times.nearest(base * r)) for r in plan.ratios]
    desired, real = desired_response(response, 1000.0), linear_response(8)
    rounded = xi(EffectiveCamera.of(real, relative_exposures(nearest)), desired, plan.levels_wanted)
    assert plan.xi <= rounded + 1e-9


def test_gain_extends_a_list_of_shutter_times() -> None:
    times = Choices(tuple(2.0 ** (k / 3) for k in range(-33, -9)))
    with small_camera(gain_maximum=16.0, gain_step=1.0) as camera:
        request = CaptureRequest("log", 1000.0, 3, base_s=2.0**-6)
        plan = plan_capture(WrappedCamera(camera, times), request)
    assert plan.settings[-1].time_s == times.maximum
    assert plan.settings[-1].gain > 1
    assert plan.settings[0].exposure == pytest.approx(2.0**-6)  # at a gain that takes less time


def test_tolerance_takes_the_fewest_exposures() -> None:
    request = CaptureRequest("log", 1000.0, 6, tolerance=20.0, levels_wanted=200.0)
    with small_camera() as camera:
        plan = plan_capture(camera, request)
        real, desired = camera.controls.levels, plan.desired
    assert plan.xi <= 20.5  # the camera's steps cost a little of what the ratios give
    fewer = look_up(real, desired, len(plan.ratios) - 1, levels_wanted=200.0)
    assert fewer.xi > 20.0
    impossible = replace(request, count=2, tolerance=0.1)
    message = r"2 exposures leave .* of 200 levels missing, more than 0\.1; allow more exposures"
    with small_camera() as camera, pytest.raises(UsageError, match=message):
        plan_capture(camera, impossible)


def test_automatic_response_follows_the_light(tmp_path: Path) -> None:
    light = np.full((60, 80), 1.0, np.float32)
    light[:, 8:] = np.geomspace(0.004, 0.008, 60 * 72).reshape(60, 72)
    request = CaptureRequest("auto", 1000.0, 3)
    with small_camera(light=light) as camera:
        report = capture(camera, request, tmp_path / "out")
    desired = report.plan.desired
    # Nine tenths of the pixels are within one stop: they get far more than its share of 10 stops.
    assert desired.u(0.009) - desired.u(0.0035) > 0.35
    image = tifffile.imread(tmp_path / "out" / "image.tiff")
    assert np.quantile(image, 0.8) - np.quantile(image, 0.02) > 0.3 * 65535
    assert read_capture(tmp_path / "out").plan == report.plan


@pytest.mark.parametrize("request_", [CaptureRequest("auto"), CaptureRequest(time_budget_s=1.0)])
def test_table_cannot_be_used_where_ratios_depend_on_the_light(request_: CaptureRequest) -> None:
    with small_camera() as camera, pytest.raises(UsageError, match="a table has no exposures for"):
        plan_capture(camera, request_, table=ExposureTable())


def test_table_without_a_row_for_the_request_is_an_error() -> None:
    with small_camera() as camera, pytest.raises(DataError, match="the given table has no row for"):
        plan_capture(camera, CaptureRequest(), table=ExposureTable())


def test_longest_of_equally_good_bases_is_taken() -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("linear", 256.0, 1))
        times = camera.controls.time_s
    assert isinstance(times, Steps)
    assert plan.metering is not None
    assert 0 <= plan.metering.limit_s - plan.base_s < times.step


@pytest.mark.parametrize("count", [2, 3, 6])
@pytest.mark.parametrize("dynamic_range", [1000.0, 1e5])
def test_longest_exposure_reaches_the_darkest_light(count: int, dynamic_range: float) -> None:
    """It gets two levels there, and no gap is left between the exposures."""
    controls = controls_of(Steps(1e-4, 1000.0, 1e-4))
    chosen = (ExposureSetting(0.01, 1.0),) * count
    found = reach_shadows(
        controls, CaptureRequest(), desired_response("linear", dynamic_range), chosen
    )
    assert found is not None
    settings, ratios = found
    exposures = relative_exposures(settings)
    levels = controls.levels.levels
    assert exposures[-1] * controls.levels.M / dynamic_range == pytest.approx(2, rel=0.02)
    assert exposures == pytest.approx(ratios, rel=0.02)
    assert len(settings) == count
    steps = np.array(exposures[1:]) / exposures[:-1]
    if count > 2:
        assert steps.max() <= float(levels[-1] / levels[0]) / 8 * 1.02


def test_exposures_that_reach_the_darkest_light_or_are_fixed_stay() -> None:
    controls = controls_of(Steps(1e-4, 1000.0, 1e-4), gain=Choices((1.0, 2.0, 4.0)))
    desired = desired_response("linear", 1000.0)
    short = (ExposureSetting(0.01, 1.0), ExposureSetting(0.02, 1.0))
    long = (ExposureSetting(0.01, 1.0), ExposureSetting(0.05, 1.0))
    assert reach_shadows(controls, CaptureRequest(), desired, long) is None
    assert reach_shadows(controls, CaptureRequest(), desired, short[:1]) is None
    assert reach_shadows(controls, CaptureRequest(time_budget_s=1.0), desired, short) is None
    # The camera's longest time and highest gain are the end.
    brief = controls_of(Steps(1e-4, 0.01, 1e-4), gain=Choices((1.0, 2.0, 4.0)))
    found = reach_shadows(brief, CaptureRequest(), desired, (ExposureSetting(0.01, 1.0),) * 2)
    assert found is not None
    assert found[0][-1] == ExposureSetting(0.01, 4.0)
    assert reach_shadows(brief, CaptureRequest(), desired, found[0]) is None


def test_a_plan_is_not_predicted_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What a plan says of its accuracy is kept on disk, also where times are rounded."""
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path))
    request = CaptureRequest(time_budget_s=2.0)
    with SimulatedCamera(load_scene("tile-floor"), load_sensor("webcam"), seed=0) as camera:
        light = meter_light(camera, request)
        first = plan_for(camera.controls, Search(camera.controls, request), light)
        predicted = Mock(side_effect=AssertionError("predicted once more"))
        monkeypatch.setattr("camctl.exposure.search.front.noisy_effective_levels", predicted)
        monkeypatch.setattr("camctl.exposure.evaluation.noisy_effective_levels", predicted)
        again = plan_for(camera.controls, Search(camera.controls, request), light)
    assert again == first
    predicted.assert_not_called()
