"""All calibrations of a camera in one go, and what a capture then promises and keeps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camctl.calibration.noise.dark import measure_dark
from camctl.calibration.noise.shooting import measure_noise
from camctl.calibration.steps import StepOptions, StepResult, calibrate, dark_step, noise_step
from camctl.captures.sequencer import capture
from camctl.errors import CameraDisconnectedError
from camctl.exposure.goal import CaptureRequest
from camctl.model.response.camera import srgb_to_linear
from camctl.profiles.calibrated import open_camera
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.profile import Profile, change_profile, load_profile
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import Scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor
from camctl.studies.scene_errors import measured_levels, native_samples, scene_truth

UNKNOWN = {"sensor": "consumer", "scene": "ramp", "size": "160x120", "unknown": True}


def measured(**options: Any) -> dict[str, StepResult]:
    """Calibrate a simulated camera that states little; return the results by name."""
    given = {**UNKNOWN, **options}
    steps = calibrate(lambda parts: open_camera("sim", given, profile=parts), StepOptions())
    return {step.name: step for step in steps}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, StepResult]]:
    """The results of one calibration; its profile is that of the tests that use this fixture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        yield measured()


@pytest.fixture
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def kept(**options: Any) -> tuple[Profile, str]:
    """Return the profile of the camera, and its mode."""
    with open_camera("sim", {**UNKNOWN, **options}, profile="none") as camera:
        return load_profile(camera.info), exposure_mode(camera.controls)


@pytest.mark.slow
def test_everything_is_measured_and_kept(results: dict[str, StepResult]) -> None:
    assert [step.problem for step in results.values()] == [None] * len(results)
    assert "1 to 2 frames" in (results["control delay"].result or "")
    profile, mode = kept()
    assert list(profile.delays) == ["rgb8-160x120-10"]
    assert list(profile.responses) == list(profile.exposures) == list(profile.noises) == [mode]


@pytest.mark.slow
@pytest.mark.usefixtures("results")
def test_a_calibrated_camera_makes_the_linear_picture_that_it_promises() -> None:
    with open_camera("sim", UNKNOWN) as camera:
        report = capture(camera, CaptureRequest("linear", 256.0, count=3))
        light = scene_truth(camera._camera)  # type: ignore[attr-defined]  # the simulated one
    light *= min(frame.applied.exposure for frame in report.frames)
    promised = report.plan.desired.u(np.clip(light, 0, 1)).mean(axis=0)
    found = (report.image() / 65535).mean(axis=0)
    inside = light.mean(axis=0) < 0.98
    assert inside.mean() > 0.5
    assert np.abs(found - promised)[inside].max() <= 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("results")
@pytest.mark.parametrize(("response", "dynamic_range"), [("linear", 256.0), ("gamma", 1000.0)])
def test_effective_levels_are_those_that_a_calibrated_camera_promises(
    response: str, dynamic_range: float
) -> None:
    """Within 5 %; `tests/bench/bench_profile.py` does this with every simulated sensor.

    A response whose dark part the scene does not have, such as log, cannot be measured in it.
    """
    with open_camera("sim", UNKNOWN) as camera:
        report = capture(camera, CaptureRequest(response, dynamic_range, count=3))
        light = scene_truth(camera._camera)  # type: ignore[attr-defined]  # the simulated one
    light *= min(frame.applied.exposure for frame in report.frames)
    measured = measured_levels(report.plan.desired, light, native_samples(report))
    assert report.achieved.noise is not None
    assert report.plan.effective_levels == pytest.approx(measured, rel=0.05)
    assert report.achieved.effective_levels == pytest.approx(measured, rel=0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("results")
def test_an_earlier_result_stays_where_a_step_fails() -> None:
    before = kept()[0].responses
    assert measured(scene="uniform")["response"].result is None
    assert kept()[0].responses == before


@pytest.mark.slow
@pytest.mark.usefixtures("own_profiles")
def test_wrong_shutter_times_do_not_bend_the_response() -> None:
    faults = Faults(shutter_offset_s=0.0002)
    results = measured(faults=faults)
    assert "response, round 2" in results
    with open_camera("sim", UNKNOWN, faults=faults) as camera:
        levels = camera.controls.levels.levels
    true = srgb_to_linear(np.arange(1, 256) / 256)
    assert levels[15:] == pytest.approx(true[15:], rel=0.02)


@pytest.mark.usefixtures("own_profiles")
def test_a_step_that_fails_does_not_keep_the_others_from_running() -> None:
    results = measured(scene="uniform", size="64x48")
    assert results["control delay"].result is not None
    response = results["response"]
    assert response.result is None
    assert response.problem is not None
    assert "only from" in response.problem  # of the first try, not of that with more frames
    assert response.hint
    exposures = results["exposures"]
    assert exposures.result is None
    for step, name in ((exposures, "exposure"), (results["noise"], "noise")):
        assert step.problem == (
            "the response of the camera is only assumed, and without the true one its "
            f"{name} cannot be measured"
        )
    assert not kept(size="64x48")[0].exposures


@pytest.mark.usefixtures("own_profiles")
def test_a_camera_that_cannot_be_opened_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_self: object) -> None:
        raise CameraDisconnectedError("the camera was unplugged", hint="plug it in")

    monkeypatch.setattr(SimulatedCamera, "_open", broken)
    with pytest.raises(CameraDisconnectedError):
        measured()


@pytest.mark.usefixtures("own_profiles")
@pytest.mark.parametrize("is_covered", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_covered_lens_shows_the_dark_signal(is_covered: bool) -> None:
    sensor = load_sensor("mobile")
    lit = np.geomspace(2e3, 2e5, 160 * 120, dtype=np.float32).reshape(120, 160)
    with SimulatedCamera(Scene("shades", lit), sensor) as camera:

        def cover() -> bool:
            if is_covered:
                cap = Scene("cap", np.full_like(lit, 1e-9))
                camera._renderer = Renderer(View.of(cap, sensor), sensor)
            return is_covered

        options = StepOptions(longest_s=1.0, cover=cover)
        assert dark_step(camera, options, None) is None  # without noise nothing is known
        change_profile(camera.info, noise_step(camera, options, None).keep)
        found = dark_step(camera, options, None)
        profile = load_profile(camera.info)
        mode = exposure_mode(camera.controls)
    assert (found is not None) == is_covered
    if found is not None:
        found.keep(profile)
        dark = profile.noises[mode].dark
        assert dark is not None
        assert dark.dark_current_e_s.value == pytest.approx(3 * 2 ** (15 / 8), rel=0.1)
        assert dark.hot_pixels


@pytest.mark.slow
@pytest.mark.usefixtures("own_profiles")
def test_the_pattern_of_the_dark_current_is_distinguished_from_that_of_the_offsets() -> None:
    sensor = load_sensor("security")
    cap = Scene("cap", np.full((240, 320), 1e-9, np.float32))
    lit = np.geomspace(2e2, 2e4, cap.irradiance.size, dtype=np.float32).reshape(240, 320)
    with SimulatedCamera(Scene("shades", lit), sensor) as camera:
        noise = measure_noise(camera)
    with SimulatedCamera(cap, sensor) as camera:
        dark = measure_dark(camera, noise)
    assert dark.dcnu_e_s is not None
    true = sensor.noise_model
    assert dark.dcnu_e_s.value == pytest.approx(true.dcnu_e_s, rel=0.03)
    assert dark.dsnu_e.value == pytest.approx(true.dsnu_e, rel=0.1)
    model = noise.model_copy(update={"dark": dark}).noise_model()
    assert model.dcnu_e_s == dark.dcnu_e_s.value


@pytest.mark.slow
@pytest.mark.usefixtures("own_profiles")
def test_a_lens_that_is_not_covered_is_said_to_be_open() -> None:
    given = {**UNKNOWN, "sensor": "mobile", "scene": "tile-floor"}
    options = StepOptions(longest_s=0.3, cover=lambda: True)
    steps = calibrate(lambda parts: open_camera("sim", given, profile=parts), options)
    (dark,) = (step for step in steps if step.name == "dark signal")
    assert dark.result is None
    assert "is not dark" in (dark.problem or "")
    assert "lens cap" in dark.hint
