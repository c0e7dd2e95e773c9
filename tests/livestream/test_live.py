"""The live effective camera: light, masks and exposures of its results, and what may go wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_cameras import GIVEN, gradient

import camctl
from camctl.errors import CameraDisconnectedError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.controls import ExposureSetting
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Live
from camctl.messages.plain import sentence
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import load_sensor

SHAPE = 60, 80


@contextmanager
def camera(
    light: NDArray[np.float32] | None = None, *, sensor: str = "standard", **faults: object
) -> Iterator[SimulatedCamera]:
    scene = Scene("test", gradient(*SHAPE) if light is None else light, photons_per_unit=2e7)
    with SimulatedCamera(scene, load_sensor(sensor), faults=Faults(**faults)) as opened:  # type: ignore[arg-type]
        yield opened


def results(live: Live, count: int) -> list[LiveResult]:
    return list(islice(live, count))


@pytest.mark.parametrize(
    "sensor",
    [
        "standard",
        "webcam",
        pytest.param("phone", marks=pytest.mark.slow),
        pytest.param("machine-vision", marks=pytest.mark.slow),
    ],
)
def test_each_frame_completes_a_result_of_the_right_light(sensor: str) -> None:
    colours = 3 if sensor in ("webcam", "phone") else 1
    truth = gradient(*SHAPE, low=0.02)
    light = truth if colours == 1 else np.repeat(truth[..., None], 3, axis=2)
    with camera(light, sensor=sensor) as opened:
        request = CaptureRequest(count=3)
        with camctl.live(opened, request) as live:
            before = opened.device.upcoming
            some = results(live, 12)
            taken = opened.device.upcoming - before
    assert [each.number for each in some] == list(range(12))
    assert taken <= 12 + 3 + opened.controls.delay_frames + 1 if opened.controls.delay_frames else 0
    assert live.lost == 0
    last = some[-1]
    assert {each.setting for each in last.exposures} == set(last.plan.settings)
    assert not any(each.is_old for each in last.exposures)
    wanted = light if last.irradiance.ndim == 3 else truth
    within = (last.mask & 3) == 0
    assert within.mean() > 0.9
    errors = (last.irradiance - wanted)[within] / last.sd[within]
    assert abs(errors.mean()) < 0.5
    assert 0.8 < errors.std() < 1.3
    assert ((last.mask & 4) > 0).mean() < 0.004  # nothing moves
    assert last.image.dtype == np.uint16
    assert np.corrcoef(last.image.ravel(), np.log(last.irradiance.ravel()))[0, 1] > 0.98


def test_results_of_an_exchange_have_the_light_of_the_mixed_exposures() -> None:
    truth = gradient(*SHAPE, low=0.02)
    with camera(truth, dropped_frames=[14]) as opened, camctl.live(opened, GIVEN) as live:
        results(live, 5)
        live.change(CaptureRequest(base_s=0.002, ratios=(1, 3, 9, 27), dynamic_range=256))
        some = results(live, 14)
        live.change(CaptureRequest(base_s=0.008, ratios=(1, 8), dynamic_range=256))
        some += results(live, 14)
    assert [each.number for each in some] == list(range(5, 33))
    counts = [len(each.exposures) for each in some]
    assert sorted(set(counts)) == [2, 3, 4]
    assert counts == [*sorted(counts[:14]), *sorted(counts[14:], reverse=True)]
    plans = {tuple(each.plan for each in one.exposures) for one in some}
    assert any(len(set(each)) == 2 for each in plans)
    for each in some:
        within = (each.mask & 3) == 0
        errors = (each.irradiance - truth)[within] / each.sd[within]
        assert abs(errors.mean()) < 1
        assert errors.std() < 1.5


def test_a_lost_frame_leaves_the_older_one_and_is_marked() -> None:
    with camera(dropped_frames=[9]) as opened, camctl.live(opened, GIVEN) as live:
        some = results(live, 20)
    marked = [each for each in some if any(slot.is_old for slot in each.exposures)]
    assert marked
    assert live.lost == 1
    assert not any(slot.is_old for slot in some[-1].exposures)
    assert max(each.age_s for each in marked) > max(
        each.age_s for each in some if each not in marked
    )


def test_a_moving_thing_is_marked_and_its_lag_stated() -> None:
    dim = np.full(SHAPE, 0.003, np.float32)
    bright = dim.copy()
    bright[20:30, 20:30] = 0.009
    with camera(dim) as opened, camera(bright) as other, camctl.live(opened, GIVEN) as live:
        results(live, 3)
        opened._renderer = other._renderer
        during, *_, after = results(live, 6)
    inside = np.zeros(SHAPE, np.bool_)
    inside[20:30, 20:30] = True
    moved = (during.mask & 4) > 0
    assert moved[inside].mean() > 0.95
    assert moved[~inside].mean() < 0.01
    assert during.age_s == pytest.approx(max(slot.age_s for slot in during.exposures))
    assert during.age_s > 0.05
    assert ((after.mask & 4) > 0).mean() < 0.005


def test_exposures_follow_the_light_and_stay_when_it_stays() -> None:
    truth = gradient(*SHAPE, low=0.05)
    with camera(truth) as opened, camera(truth * 8) as brighter:
        before = opened._renderer
        with camctl.live(opened, CaptureRequest(count=3)) as live:
            first = results(live, 40)[-1]
            assert live.plan == first.plan  # nothing was exchanged
            opened._renderer = brighter._renderer
            bright = results(live, 100)[-1]
            opened._renderer = before
            last = results(live, 60)[-1]
    bases = [each.plan.settings[0].time_s for each in (first, bright, last)]
    assert 5 < bases[0] / bases[1] < 12
    assert 0.7 < bases[2] / bases[0] < 1.4
    assert (bright.mask & 2).mean() < 0.01
    assert np.median(bright.irradiance / truth) == pytest.approx(8, rel=0.02)


def test_light_out_of_reach_is_a_finding() -> None:
    dim, bright = (np.full(SHAPE, light, np.float32) for light in (0.1, 1e6))
    with camera(dim) as opened, camera(bright) as brighter, camctl.live(opened) as live:
        results(live, 3)
        opened._renderer = brighter._renderer
        last = results(live, 80)[-1]
    words = {finding.code: sentence(finding) for finding in last.findings}
    assert words["light_above_range"].startswith("100 % of the picture is brighter")


def test_what_is_saturated_in_each_frame_is_marked() -> None:
    light = gradient(*SHAPE) / np.float32(10)
    light[:10] = 100
    with camera(light) as opened, camctl.live(opened, GIVEN) as live:
        last = results(live, 3)[-1]
    assert ((last.mask[:10] & 2) > 0).all()
    assert np.isinf(last.sd[:10]).all()
    assert not (last.mask[10:] & 2).any()


def test_dark_light_is_a_finding() -> None:
    request = CaptureRequest(base_s=0.05, ratios=(1, 2), dynamic_range=16)
    dark = gradient(*SHAPE, low=1e-5)
    with camera(dark) as opened, camctl.live(opened, request) as live:
        words = {each.code: sentence(each) for each in results(live, 40)[-1].findings}
    assert "darker than its range of 1:16" in words["light_below_range"]


def test_light_that_is_seen_below_the_range_counts_as_darker() -> None:
    request = CaptureRequest(base_s=0.004, ratios=(1, 16), dynamic_range=16)
    light = gradient(*SHAPE, low=0.01)
    with camera(light) as opened:
        (frame,) = opened.shoot([ExposureSetting(0.004)])
        with camctl.live(opened, request) as live:
            last = results(live, 40)[-1]
    middle = SHAPE[0] // 2  # not saturated
    shown = (frame.pixels[middle].mean() - frame.black) / (frame.white - frame.black)
    truth = light * shown / light[middle].mean()  # 1 saturates the shortest exposure
    (found,) = (each for each in last.findings if each.code == "light_below_range")
    assert found.value is not None
    assert found.value == pytest.approx((truth < 1 / 16).mean(), abs=0.01)
    assert (last.mask & 1).mean() < found.value / 2


def test_frames_that_keep_contradicting_are_one_finding() -> None:
    """Settled at each exposure, the camera gets another light in each frame."""
    random = np.random.default_rng(0)
    with camera(late_frames=1) as opened:
        steady = opened._renderer
        renderers = [steady]
        for factor in (0.2, 5.0):
            scene = Scene("other", factor * gradient(*SHAPE), photons_per_unit=2e7)
            with SimulatedCamera(scene, load_sensor("standard")) as other:
                renderers.append(other._renderer)
        with camctl.live(opened, GIVEN) as live:
            results(live, 60)  # it settles
            for _ in range(150):
                opened._renderer = renderers[random.integers(3)]
                last = next(live)
    found = [each for each in last.findings if each.code == "light_varies"]
    assert [sentence(each) for each in found] == [
        "frames contradict their exposures: the light changes from one frame to the next"
    ]


def test_frames_at_the_lowest_level_do_not_contradict_their_exposures() -> None:
    """Where noise is below a step, samples of little light are all 0: they show no ratio."""
    request = CaptureRequest(base_s=9e-5, ratios=(1, 196 / 9, 4632 / 9), dynamic_range="high")
    with (
        camctl.open_camera("sim", scene="tile-floor", size="320x240", time="virtual") as opened,
        camctl.live(opened, request) as live,
    ):
        last = results(live, 40)[-1]
    assert not {"stream_settles", "light_varies"} & {each.code for each in last.findings}
    assert live.lost == 0


def test_a_change_that_cannot_be_met_leaves_the_stream_as_it_was() -> None:
    truth = gradient(*SHAPE, low=0.05)
    request = CaptureRequest(count=3)
    with (
        camera(truth) as opened,
        camera(truth * 8) as brighter,
        camctl.live(opened, request) as live,
    ):
        first = results(live, 40)[-1]
        for _ in range(3):
            live.change(CaptureRequest(base_s=5.0, ratios=(1, 4)))
            refused = results(live, 20)[-1]
        assert refused.plan == first.plan
        assert sum(each.code == "note" for each in refused.findings) == 1
        opened._renderer = brighter._renderer
        bright = results(live, 100)[-1]
    assert 5 < first.plan.settings[0].time_s / bright.plan.settings[0].time_s < 12


def test_a_rate_that_shortens_the_exposures_is_named() -> None:
    with (
        camera(gradient(*SHAPE) / np.float32(100)) as opened,
        camctl.live(opened, CaptureRequest(count=3), fps=12) as live,
    ):
        (found,) = [each for each in next(live).findings if each.code == "base_shortened"]
    assert sentence(found).endswith("so that the longest one leaves 12 results a second")


@pytest.mark.parametrize("sensor", ["standard", "webcam"])
def test_a_rate_leaves_the_shortest_exposure_as_the_light_allows(sensor: str) -> None:
    """The ratios of the table would need a longest exposure of seconds: others take less."""
    light = gradient(*SHAPE) / np.float32(20)
    light = light if sensor == "standard" else np.repeat(light[..., None], 3, axis=2)
    with (
        camera(light, sensor=sensor) as opened,
        camctl.live(opened, CaptureRequest(), fps=12) as live,
    ):
        plan = next(live).plan
    assert plan.metering is not None
    assert plan.settings[0].time_s > 0.8 * plan.metering.limit_s
    assert max(each.time_s for each in plan.settings) == pytest.approx(1 / 12, rel=0.01)
    assert not {"base_shortened", "steps_cost_levels"} & {each.code for each in plan.findings}


@pytest.mark.parametrize("scene", ["room", "night-street"])
def test_metering_is_as_fast_as_the_stream(scene: str) -> None:
    """Longer frames, for which the first picture would wait, show nothing that it can."""
    with camctl.open_camera("sim", scene=scene, size="64x48") as opened:
        taken = []
        preview = opened.preview  # type: ignore[attr-defined]

        def noted(setting: ExposureSetting) -> Any:
            taken.append(setting.time_s)
            return preview(setting)

        opened.preview = noted  # type: ignore[attr-defined]
        with camctl.live(opened, fps=20) as live:
            next(live)
    assert len(taken) > 1
    assert max(taken) <= 1 / 20 + 1e-9


def test_a_dim_scene_is_live_with_gain() -> None:
    """At gain 1 its brightest light has 0.8 % of the levels."""
    light = np.repeat(gradient(*SHAPE)[..., None], 3, axis=2) / np.float32(10_000)
    with (
        camera(light, sensor="webcam") as opened,
        camctl.live(opened, CaptureRequest(), fps=20) as live,
    ):
        some = results(live, 40)
    assert max(each.setting.gain for each in some[-1].exposures) == 8


def test_a_wrong_control_delay_is_settled() -> None:
    with camera(late_frames=1) as opened, camctl.live(opened, GIVEN) as live:
        some = results(live, 60)
    assert "stream_settles" in {finding.code for finding in some[-1].findings}
    last = some[-1]
    errors = (last.irradiance - gradient(*SHAPE)) / last.sd
    assert np.abs(np.median(errors)) < 0.5


def test_the_stream_goes_on_after_the_camera_was_unplugged() -> None:
    with camera(unplug_after=12) as opened, camctl.live(opened, GIVEN) as live:
        some = results(live, 30)
    assert [each.number for each in some] == list(range(30))
    gaps = np.diff([each.time_s for each in some])
    assert (gaps > 0).all()


def test_a_camera_that_stays_away_is_an_error() -> None:
    with camera(unplug_after=6) as opened:

        def stays_away() -> None:
            raise CameraDisconnectedError("it is gone", hint="plug it in")

        live = camctl.live(opened, GIVEN, patience_s=3)
        opened._open = stays_away  # type: ignore[method-assign]
        with live, pytest.raises(CameraDisconnectedError):
            results(live, 30)


def test_noise_that_is_unknown_is_measured_in_the_stream() -> None:
    scene = Scene("test", gradient(240, 320, low=0.02), photons_per_unit=2e7)
    opened = SimulatedCamera(scene, load_sensor("standard"), is_unknown=True)
    with opened, camctl.live(opened, GIVEN) as live:
        some = results(live, 30)
    assert np.isnan(some[0].sd).all()
    assert not np.isnan(some[-1].sd).any()


def test_arrays_are_reused_on_request() -> None:
    with camera() as opened:
        with camctl.live(opened, GIVEN, reuse=True) as live:
            first, second = (next(live).irradiance for _ in range(2))
        assert first is second
        with camctl.live(opened, GIVEN) as live:
            first, second = (next(live).irradiance for _ in range(2))
        assert not np.shares_memory(first, second)
        assert len(list(opened.shoot([ExposureSetting(0.004)]))) == 1  # it is free again


def test_invalid_requests_are_refused_before_the_first_frame() -> None:
    with camera() as opened:
        with pytest.raises(UsageError):
            camctl.live(opened, GIVEN, fps=500)
        with pytest.raises(UsageError):
            camctl.live(opened, GIVEN, fps=0)
        with pytest.raises(UsageError):
            camctl.live(opened, GIVEN, policy="some")  # type: ignore[arg-type]
        long = CaptureRequest(base_s=0.5, ratios=(1,), dynamic_range=16)
        with pytest.raises(camctl.CamctlError), camctl.live(opened, long, fps=10) as live:
            next(live)

        class Still:
            info, controls, clock = opened.info, opened.controls, opened.clock

        with pytest.raises(UsageError):
            camctl.live(Still())  # type: ignore[arg-type]
