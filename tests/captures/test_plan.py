"""From wanted ratios to settings that a camera really has."""

import math
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from camctl.captures.plan import check_ratios, plan_capture, relative
from camctl.captures.report import read_report
from camctl.captures.request import CaptureRequest
from camctl.captures.sequencer import capture
from camctl.captures.setting_selection import BASE_SLACK_STOPS, SettingChooser
from camctl.controls import Choices, ExposureControls, ExposureSetting, Layout, Steps
from camctl.errors import CaptureError, DataError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import xi
from camctl.exposure.table import ExposureTable
from camctl.response.camera import linear_response
from camctl.response.desired import desired_response

THIRDS = Choices(tuple(2.0 ** (k / 3) for k in range(-36, 16)))
HUNDRED_US = Steps(1e-4, 10.0, 1e-4)
PRINTED = {
    "linear": (1.0, 1.003, 2.985),
    "gamma": (1.0, 1.003, 5.146),
    "log": (1.0, 9.91, 88.38),
}


def controls_of(time_s, **more):
    return ExposureControls(time_s, (4, 4), Layout.MONO, 8, white=255, **more)


def chooser_of(time_s, ratios, response="log", request=None, **more):
    real, desired = linear_response(8), desired_response(response, 1000.0)

    def quality(settings):
        camera = EffectiveCamera.of(real, relative(settings))
        return xi(camera, desired, len(ratios) * real.M)

    request = request or CaptureRequest(response, 1000.0, len(ratios))
    chooser = SettingChooser(controls_of(time_s, **more), request, ratios, quality)
    return chooser, quality


@pytest.mark.parametrize("response", PRINTED)
@pytest.mark.parametrize("time_s", [THIRDS, HUNDRED_US], ids=["thirds", "100us"])
@pytest.mark.parametrize("limit_s", [0.0033, 0.0333])
def test_never_worse_than_the_nearest_ratios(response, time_s, limit_s):
    chooser, quality = chooser_of(time_s, PRINTED[response], response)
    chosen = chooser.best(limit_s, 400)
    base = time_s.between(time_s.minimum, limit_s, 1)[0]
    nearest = [ExposureSetting(time_s.nearest(base * ratio)) for ratio in PRINTED[response]]
    assert quality(chosen) <= quality(nearest)
    assert all(time_s.nearest(s.time_s) == s.time_s for s in chosen)
    assert chosen[0].time_s <= limit_s


def test_a_finer_base_is_used_where_it_helps():
    # At 3.3 ms one step of 100 us is 3 %: there the interleave of 1.003 is lost whatever the base.
    chooser, quality = chooser_of(HUNDRED_US, PRINTED["linear"], "linear")
    fine, coarse = quality(chooser.best(0.0333, 400)), quality(chooser.best(0.0033, 400))
    assert fine < coarse


def test_time_comes_first_then_gain_then_the_aperture_if_asked():
    time_s, gain = Steps(1e-3, 0.1, 1e-5), Steps(1.0, 8.0, 0.01)
    ratios = (1.0, 10.0, 40.0)
    chooser, _ = chooser_of(time_s, ratios, gain=gain)
    short, middle, long = chooser.best(0.01, 400)
    assert (short.gain, middle.gain) == (1.0, 1.0)
    assert long.time_s <= 0.1
    assert long.time_s >= 0.099
    assert long.exposure / short.exposure == pytest.approx(40, rel=0.01)

    chooser, _ = chooser_of(time_s, (1.0, 200.0), gain=gain)
    with pytest.raises(CaptureError, match=r"200 x .* beyond the camera's controls"):
        chooser.best(0.01, 400)
    lens = Choices((4.0, 5.6, 8.0))
    request = CaptureRequest("log", 1000.0, 2, use_aperture=True)
    chooser, _ = chooser_of(time_s, (1.0, 200.0), request=request, gain=gain, f_number=lens)
    short, long = chooser.best(0.01, 400)
    assert short.f_number == 8.0
    assert long.f_number < 8.0
    assert long.exposure / short.exposure == pytest.approx(200, rel=0.02)


def test_beyond_the_controls_names_the_nearest_and_the_way_out():
    chooser, _ = chooser_of(Steps(1e-4, 1.0, 1e-4), (1.0, 2.0, 500.0))
    with pytest.raises(CaptureError) as failure:
        chooser.best(0.01, 400)
    message = str(failure.value)
    assert "exposure 500 x 0.01 s" in message
    assert "the nearest possible is 100 x" in message
    assert f"--compensation {math.log2(100 / 500):.1f}" in message


def test_whole_flicker_periods_are_preferred_and_the_rest_is_said(make_camera):
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0), base_s=0.004, mains_hz=50.0)
    with make_camera() as camera:
        plan = plan_capture(camera, request)
    assert [s.time_s for s in plan.settings] == pytest.approx([0.004, 0.02, 0.06])
    assert any("0.004 s is no whole number of the lamps' flicker" in w for w in plan.warnings)
    assert not any("0.02 s is no whole" in w for w in plan.warnings)


def test_given_ratios_are_kept(make_camera):
    with make_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, ratios=(4.0, 1.0, 2.0)))
    assert plan.ratios == (1.0, 2.0, 4.0)
    assert plan.exposures == pytest.approx((1.0, 2.0, 4.0), rel=1e-3)


def test_a_base_out_of_reach_is_refused_with_the_nearest(make_camera):
    with make_camera() as camera, pytest.raises(CaptureError, match="nearest possible is 60 s"):
        plan_capture(camera, CaptureRequest(ratios=(1.0,), base_s=100.0))
    with make_camera() as camera, pytest.raises(UsageError, match="seconds above 0"):
        plan_capture(camera, CaptureRequest(ratios=(1.0,), base_s=-1.0))


def test_coarse_steps_are_said_to_cost_levels(make_camera):
    with make_camera(line_s=1e-3, time_minimum_s=1e-3) as camera:
        request = CaptureRequest("linear", 256.0, 3, base_s=0.003)
        plan = plan_capture(camera, request)
    assert any("the wanted ratios would give" in warning for warning in plan.warnings)


def test_compensation_shifts_the_shortest_exposure(make_camera):
    with make_camera() as camera:
        plain = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0)))
        darker = plan_capture(camera, CaptureRequest(ratios=(1.0, 2.0), compensation_stops=-2.0))
    stops = math.log2(darker.base_s / plain.base_s)
    assert stops == pytest.approx(-2, abs=BASE_SLACK_STOPS)
    assert darker.metering.limit_s == pytest.approx(plain.metering.limit_s, rel=0.03)


@pytest.mark.parametrize("ratios", [(), (1.0, 0.0), (1.0, -2.0), (math.nan,), (math.inf, 1.0)])
def test_ratios_that_make_no_sense_are_usage_errors(ratios):
    with pytest.raises(UsageError):
        check_ratios(ratios)


@given(
    minimum=st.floats(1e-6, 1e-2),
    span=st.floats(1, 1e4),
    steps=st.integers(1, 5000),
    value=st.floats(1e-7, 1e3),
    count=st.integers(1, 6),
)
def test_every_setting_on_offer_is_one_the_camera_accepts(minimum, span, steps, value, count):
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


def test_controls_refuse_what_the_camera_lacks():
    controls = controls_of(HUNDRED_US)
    with pytest.raises(UsageError, match="cannot set f_number"):
        controls.check(ExposureSetting(0.01, f_number=4.0))
    controls.check(ExposureSetting(0.01))
    assert replace(controls, gain=Steps(1, 4)).gain.nearest(9.0) == 4


class Dial:
    """A camera with a dial of shutter times in place of even steps."""

    def __init__(self, camera, times):
        self._camera = camera
        self.controls = replace(camera.controls, time_s=times)

    def __getattr__(self, name):
        return getattr(self._camera, name)


def test_a_dial_is_searched_not_rounded(make_camera):
    times = Choices(tuple(2.0 ** (k / 3) for k in range(-33, 10)))
    for response in PRINTED:
        with make_camera() as camera:
            request = CaptureRequest(response, 1000.0, 3, base_s=2.0**-6)
            plan = plan_capture(Dial(camera, times), request)
        assert {s.time_s for s in plan.settings} <= set(times.values)
        base = plan.settings[0].time_s
        nearest = [ExposureSetting(times.nearest(base * r)) for r in plan.ratios]
        desired, real = desired_response(response, 1000.0), linear_response(8)
        rounded = xi(EffectiveCamera.of(real, relative(nearest)), desired, plan.levels_wanted)
        assert plan.xi <= rounded + 1e-9


def test_a_dial_that_ends_goes_on_with_gain(make_camera):
    times = Choices(tuple(2.0 ** (k / 3) for k in range(-33, -9)))
    with make_camera(gain_maximum=16.0, gain_step=1.0) as camera:
        request = CaptureRequest("log", 1000.0, 3, base_s=2.0**-6)
        plan = plan_capture(Dial(camera, times), request)
    assert plan.settings[-1].time_s == times.maximum
    assert plan.settings[-1].gain > 1
    assert plan.settings[0].gain == 1


@pytest.mark.parametrize("budget_s", [0.08, 0.5, 5.0])
def test_a_time_budget_is_kept_and_used(make_camera, budget_s):
    with make_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("log", 1000.0, 3, time_budget_s=budget_s))
        free = plan_capture(camera, CaptureRequest("log", 1000.0, 3))
    assert plan.shutter_s <= budget_s
    assert plan.shutter_s >= 0.9 * min(budget_s, free.shutter_s)
    assert plan.xi >= free.xi * 0.99


def test_a_time_budget_that_is_too_short_says_the_least(make_camera):
    request = CaptureRequest("log", 1000.0, 3, time_budget_s=0.01)
    with make_camera() as camera, pytest.raises(UsageError, match=r"the least is 0\.0[56]"):
        plan_capture(camera, request)


def test_a_tolerance_takes_the_fewest_exposures(make_camera):
    request = CaptureRequest("log", 1000.0, 6, tolerance=20.0, levels_wanted=200.0)
    with make_camera() as camera:
        plan = plan_capture(camera, request)
        real, desired = camera.controls.levels, plan.desired
    assert plan.xi <= 20.5  # the camera's steps cost a little of what the ratios promise
    fewer = look_up(real, desired, len(plan.ratios) - 1, levels_wanted=200.0)
    assert fewer.xi > 20.0
    with make_camera() as camera, pytest.raises(UsageError, match=r"more than 0\.1"):
        plan_capture(camera, replace(request, count=2, tolerance=0.1))
    with make_camera() as camera, pytest.raises(UsageError, match="number of levels wanted"):
        plan_capture(camera, replace(request, levels_wanted=None))


def test_the_automatic_response_follows_the_light(make_camera, tmp_path):
    light = np.full((60, 80), 1.0, np.float32)
    light[:, 8:] = np.geomspace(0.004, 0.008, 60 * 72).reshape(60, 72)
    request = CaptureRequest("auto", 1000.0, 3)
    with make_camera(light=light) as camera:
        report = capture(camera, request, tmp_path / "out")
    desired = report.plan.desired
    # Nine tenths of the pixels lie within one stop: they get far more than its share of 10 stops.
    assert desired.u(0.009) - desired.u(0.0035) > 0.35
    image = tifffile.imread(tmp_path / "out" / "image.tiff")
    assert np.quantile(image, 0.8) - np.quantile(image, 0.02) > 0.3 * 65535
    assert read_report(tmp_path / "out").plan == report.plan


def test_wishes_that_do_not_go_together_are_refused(make_camera):
    with make_camera() as camera:
        with pytest.raises(UsageError, match="follows the metered light"):
            plan_capture(camera, CaptureRequest("auto", 1000.0, 3, base_s=0.01))
        with pytest.raises(UsageError, match="leave --table out"):
            plan_capture(camera, CaptureRequest("auto", 1000.0, 3), table=ExposureTable())
        with pytest.raises(UsageError, match="leave one of them out"):
            plan_capture(
                camera, CaptureRequest(time_budget_s=1.0, tolerance=1.0, levels_wanted=10.0)
            )
        with pytest.raises(DataError, match="has no row"):
            plan_capture(camera, CaptureRequest(), table=ExposureTable())


def test_where_all_bases_are_alike_the_longest_is_taken(make_camera):
    with make_camera() as camera:
        plan = plan_capture(camera, CaptureRequest("linear", 256.0, 1))
        step = camera.controls.time_s.step
    assert 0 <= plan.metering.limit_s - plan.base_s < step
