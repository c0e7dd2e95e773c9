"""The effective camera is a camera: the conformance suite, a capture with it, its options."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from still_scene import open_before, waves

import camctl
from camctl.errors import CamctlError
from camctl.interface.camera import Camera
from camctl.livestream.camera import EffectiveOptions, StreamingEffectiveCamera
from camctl.sim.camera import SimulatedCamera
from camctl.testing.conformance import CameraConformance


class TestEffective(CameraConformance):
    """Over a simulated camera; full scale of its planned exposure is at irradiance 1.2."""

    response = "log"
    sensor = "standard"
    simulated: SimulatedCamera

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_camera(self) -> Camera:
        self.simulated = open_before(waves(), self.sensor)
        options = EffectiveOptions(
            response=self.response,  # type: ignore[arg-type]
            range="medium",
            base=0.02,
            fps=0.2,
        )
        return StreamingEffectiveCamera(self.simulated, options)

    def unplug(self, camera: Camera) -> None:
        self.simulated.device.unplug()

    def silence(self, camera: Camera) -> None:
        self.simulated.device.freeze()


class TestEffectiveLinear(TestEffective):
    response = "linear"


def test_a_capture_with_it_has_the_light_of_the_scene() -> None:
    options = {"scene": "ramp", "size": "64x48", "range": "medium", "bits": "12", "fps": "5"}
    with camctl.open_camera("effective:sim", options) as camera:
        assert camera.info.id == "effective:sim"
        report = camctl.capture(camera, camctl.CaptureRequest(count=1, dynamic_range=256))
        one = report.radiance()
    with camctl.open_camera("sim", scene="ramp", size="64x48") as below:
        truth = below.scene.irradiance  # type: ignore[attr-defined]
    bright = truth > 0.05 * truth.max()
    assert np.median(one[bright] / truth[bright]) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("faults", ["drop@9", "unplug@20"])
def test_it_streams_at_the_rate_of_the_camera_below(faults: str) -> None:
    """Each frame of that one completes a result; a frame is lost, or the camera unplugged."""
    options = {
        **{"scene": "ramp", "size": "64x48", "range": "low", "base": "0.004", "fps": "2"},
        "faults": faults,
    }
    with camctl.open_camera("effective:sim", options) as camera:
        below = camera.camera  # type: ignore[attr-defined]
        truth = below.scene.irradiance
        request = camctl.CaptureRequest(base_s=0.004, ratios=(1, 4), dynamic_range=256)
        with camctl.live(camera, request, fps=2) as live:
            some = list(islice(live, 3))
            before = below.device.upcoming
            some += islice(live, 40)
            taken = below.device.upcoming - before
        assert [each.number for each in some] == list(range(43))
        if faults == "drop@9":
            assert taken <= 43
            assert 1 <= live.lost <= 2
        assert len(list(camera.shoot([some[0].plan.settings[0]]))) == 1  # it is free again
    last = some[-1]
    bright = truth > 0.05 * truth.max()
    assert np.median(last.irradiance[bright] / truth[bright]) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("fps", [None, 20.0, 30.0])
def test_its_rate_is_that_of_the_camera_below(fps: float | None) -> None:
    """It was opened for 10 frames a second: its longest exposure is longer than 1/20 s."""
    options = {"scene": "ramp", "size": "64x48", "range": "low", "bits": "8"}
    with camctl.open_camera("effective:sim", options) as camera:
        assert isinstance(camera, StreamingEffectiveCamera)
        assert max(each.time_s for each in camera.plan.settings) > 1 / 20
        with camctl.live(camera, fps=fps) as live:
            results = list(islice(live, 90))
            stated = live.planner.rate(results[-1].plan.settings)
            made_of = camera.settings_below(results[-1].plan.settings)
    wanted = live.planner.fps
    assert wanted == (fps or 10)
    assert max(each.time_s for each in made_of) <= 1.02 / wanted
    times_s = [each.time_s for each in results if each.plan is results[-1].plan][3:]
    assert len(times_s) > 30
    taken_s = times_s[-1] - times_s[0]
    assert (len(times_s) - 1) / taken_s == pytest.approx(stated, rel=0.05)
    assert stated >= wanted * 0.98


def test_a_rate_above_that_of_the_camera_below_is_refused() -> None:
    options = {"scene": "ramp", "size": "64x48", "range": "low", "bits": "8"}
    with (
        camctl.open_camera("effective:sim", options) as camera,
        pytest.raises(CamctlError, match=r"40 results a second .* the camera sends 30"),
    ):
        camctl.live(camera, fps=40)


def test_exposures_that_cannot_be_as_short_as_a_rate_asks_are_refused() -> None:
    """It is up to 6 stops shorter than planned."""
    options = {"scene": "ramp", "size": "64x48", "range": "low", "bits": "8", "base": "0.1"}
    with (
        camctl.open_camera("effective:sim", {**options, "fps": "0.1"}) as camera,
        pytest.raises(CamctlError, match="leaves fewer than 30 results a second"),
        camctl.live(camera, fps=30),
    ):
        pass


def test_the_rate_of_a_stream_shortens_its_exposures_once() -> None:
    """It was opened for 10 frames a second, and 20 results shorten its exposures again."""
    scene = {"scene": "night-street", "size": "320x240", "bits": "8"}
    with camctl.open_camera("effective:sim", scene) as camera:
        (opened,) = [each for each in camera.controls.findings if each.code == "base_shortened"]
        with camctl.live(camera, fps=20) as live:
            result = next(live)
        made_of = camera.settings_below(result.plan.settings)  # type: ignore[attr-defined]
    assert "setting_differs" not in {each.code for each in result.findings}
    (found,) = [each for each in result.findings if each.code == "base_shortened"]
    assert found.details["results_per_second"] == 20
    assert opened.details["results_per_second"] == 10
    allowed_s = [each.value * 2 ** each.details["stops"] for each in (opened, found)]  # type: ignore[operator]
    assert allowed_s[0] == pytest.approx(allowed_s[1], rel=1e-6)
    assert found.value == result.plan.base_s
    assert len(result.exposures) == 1  # each of its frames has several
    times_s = sorted(each.time_s for each in made_of)  # of which the two last ones ended later
    assert sum(times_s[:2]) * 0.99 <= result.age_s <= sum(times_s[1:]) * 1.01
    assert result.image.max() > 0.75 * 65535


def test_opencv_s_class_takes_it() -> None:
    options = {"scene": "ramp", "size": "64x48", "bits": "8"}
    capture = camctl.VideoCapture("effective:sim", options=options)
    for _ in range(4):
        found, picture = capture.read()
        assert found
        assert picture is not None
        assert picture.std() > 10
    capture.release()


@pytest.mark.parametrize(
    ("address", "options"),
    [
        ("effective:", {}),
        ("effective:none", {}),
        ("effective:sim", {"n": "0"}),
        ("effective:sim", {"response": "other"}),
        ("effective:sim", {"unknown_option": "1"}),
    ],
)
def test_what_cannot_be_opened_is_an_error(address: str, options: dict[str, str]) -> None:
    with pytest.raises(CamctlError):
        camctl.open_camera(address, options)
