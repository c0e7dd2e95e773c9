"""The noise that a capture shows in its own pixels, compared with the noise that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some
from small_cameras import WrappedCamera, gradient, small_camera

import camctl
from camctl.captures import outputs
from camctl.captures.sequencer import capture
from camctl.evidence import noise
from camctl.evidence.noise import fit_noise, measure_noise
from camctl.evidence.patches import Patches
from camctl.exposure.goal import CaptureRequest
from camctl.interface.controls import ExposureControls
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise, MeasuredNoise, NoiseModel
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.response.desired import desired_response
from camctl.records.report import CaptureReport

REQUEST = CaptureRequest("log", 1000.0, 3, ratios=(1, 9, 80))
RESPONSE, LOG = linear_response(8), desired_response("log", 1000.0)
EXPOSURES = (1.0, 9.0, 80.0)


class StatingCamera(WrappedCamera):
    """A simulated camera that states another noise than it has."""

    stated: NoiseModel | None = None

    @property
    def controls(self) -> ExposureControls:
        """The controls of the camera, with the stated noise."""
        return replace(super().controls, noise=self.stated)


def captured(stated: NoiseModel | None, sensor: str = "standard") -> CaptureReport:
    with small_camera(sensor, gradient(480, 160)) as camera:
        stating = StatingCamera(camera)
        stating.stated = stated
        return capture(stating, replace(REQUEST, base_s=0.01))


def measured_in(report: CaptureReport) -> MeasuredNoise:
    assert report.achieved.measured is not None
    return report.achieved.measured


@pytest.mark.parametrize("sensor", some(["standard", "webcam", "phone", "machine-vision"], every=2))
def test_pixels_show_the_predicted_accuracy(sensor: str) -> None:
    with small_camera(sensor, gradient(480, 160)) as camera:
        report = capture(camera, REQUEST)
    measured, predicted = measured_in(report), report.achieved.effective_levels
    difference = abs(measured.effective_levels - predicted)
    assert difference < max(0.02 * predicted, 3 * measured.uncertainty) < 0.05 * predicted
    assert measured.electrons_per_level == pytest.approx(camera.sensor.electrons_per_dn, rel=0.05)
    assert not any(each.code == "noise_differs" for each in report.findings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "scene"),
    [("ideal-6", "night-street"), ("ideal-6", "tile-floor"), ("ideal-12", "room")],
)
def test_quantisers_that_nothing_dithers_are_not_taken_for_noise(sensor: str, scene: str) -> None:
    with camctl.open_camera("sim", sensor=sensor, scene=scene, size="320x240", seed=3) as camera:
        report = camctl.capture(camera, CaptureRequest())
    assert not any(each.code == "noise_differs" for each in report.findings)


def test_a_wrong_noise_model_is_reported() -> None:
    right = captured(NoiseModel(10000 / 256, ((1.0, 3.0),)))
    wrong = captured(NoiseModel(3 * 10000 / 256, ((1.0, 3.0),)))
    measured = measured_in(wrong)
    assert wrong.achieved.effective_levels > 1.3 * right.achieved.effective_levels
    assert measured.effective_levels == pytest.approx(right.achieved.effective_levels, rel=0.02)
    assert not any(each.code == "noise_differs" for each in right.findings)
    (differs,) = [each for each in wrong.findings if each.code == "noise_differs"]
    assert differs.value == measured.effective_levels
    assert differs.details == {"predicted": wrong.achieved.effective_levels}


def test_unknown_noise_is_measured() -> None:
    report = captured(None)
    achieved = report.achieved
    assert achieved.noise is None
    assert report.plan.noise is None
    assert achieved.effective_levels == achieved.effective_levels_noise_free
    assert report.plan.effective_levels == report.plan.effective_levels_noise_free
    known = captured(NoiseModel(10000 / 256, ((1.0, 3.0),)))
    assert measured_in(report).effective_levels == pytest.approx(
        known.achieved.effective_levels, rel=0.02
    )
    assert not any(each.code == "noise_differs" for each in report.findings)


def patches(
    light: NDArray[np.float64],
    electrons: float,
    seed: int = 0,
    *,
    exposures: Sequence[float] = EXPOSURES,
    read_noise: float = 0.3,
    response: CameraResponse = RESPONSE,
) -> list[Patches]:
    """Return frames of (patches, samples) light with photon noise and read noise, levels."""
    rng = np.random.default_rng(seed)
    frames = []
    for exposure in exposures:
        signal = rng.poisson(exposure * light * 256 * electrons) / electrons
        signal += read_noise * rng.standard_normal(light.shape)
        frames.append(np.searchsorted(response.levels, signal / 256, "right").astype(np.uint16))
    return frames


def measure(
    frames: Sequence[Patches], exposures: Sequence[float] = EXPOSURES
) -> MeasuredNoise | None:
    noise = [FrameNoise(np.inf, 0.0)] * 3
    return measure_noise(RESPONSE, LOG, frames, exposures, noise, [1.0] * 3)


LIGHT = np.geomspace(1e-3, 1, 600)[:, np.newaxis] * np.linspace(0.97, 1.03, 64)


def test_moving_objects_do_not_count_as_noise() -> None:
    still = patches(LIGHT, 40.0)
    moving = [frame.copy() for frame in still]
    rng = np.random.default_rng(3)
    for frame in moving[1:]:
        places = rng.permutation(600)[:120]
        frame[places, :32] = np.minimum(frame[places, :32] + 40, 255)
    expected, found = measure(still), measure(moving)
    assert expected is not None
    assert found is not None
    assert expected.electrons_per_level == pytest.approx(40, rel=0.05)
    assert expected.read_noise_levels == pytest.approx(0.3, abs=0.06)
    assert found.effective_levels == pytest.approx(expected.effective_levels, rel=0.03)


def test_noise_is_limited_at_the_gain_of_each_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs of ISO 200 in a wrong response ended in an invalid number of electrons."""
    found = noise.NoiseFit(np.array([2000.0, 1.0]), [np.array([2500.0, 1.0])], 100, 0.0, 1.0)
    monkeypatch.setattr(noise, "fit_noise", lambda *_: found)
    stated = [FrameNoise(np.inf, 0.0)] * 3
    measured = measure_noise(RESPONSE, LOG, patches(LIGHT, 40.0), EXPOSURES, stated, [2.0] * 3)
    assert measured is None or measured.effective_levels > 0


def test_uncertainty_is_the_scatter_of_repeated_captures() -> None:
    found = [measure(patches(LIGHT[::4], 40.0, seed)) for seed in range(16)]
    levels = [each.effective_levels for each in found if each is not None]
    stated = np.median([each.uncertainty for each in found if each is not None])
    assert len(levels) == 16
    assert 0.4 < stated / np.std(levels, ddof=1) < 2.5


@pytest.mark.parametrize(
    ("ratio", "contrast"),
    [
        (27.0, 0.08),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((27.0, 0.0), (35.0, 0.0), (35.0, 0.08))
        ),
    ],
)
def test_frames_with_little_light_in_common_say_how_uncertain_they_are(
    ratio: float, contrast: float
) -> None:
    """Both are in range for light of 4 to 8 levels, with noise of a third of a step."""
    light = np.geomspace(1e-4, 1, 1500)[:, np.newaxis] * np.linspace(1 - contrast, 1 + contrast, 64)
    exposures = (1.0, ratio, ratio**2)
    camera = EffectiveCamera.of(RESPONSE, exposures)
    truth = Posterior(camera, LOG, [FrameNoise(39.0, 0.08)] * 3).inverse.effective_levels
    found = [
        measure(patches(light, 39.0, seed, exposures=exposures, read_noise=0.08), exposures)
        for seed in range(12)
    ]
    measured = [each for each in found if each is not None]
    errors = np.array([each.effective_levels - truth for each in measured])
    stated = np.median([each.uncertainty for each in measured])
    assert len(measured) > 8
    assert not any(each.contradicts(truth) for each in measured)
    assert 0.4 < stated / np.sqrt(np.mean(errors**2)) < 2.5


@pytest.mark.slow
@pytest.mark.parametrize("read_noise", [0.05, 0.1])
def test_uncertainty_covers_what_quantisers_without_dither_have_in_common(
    read_noise: float,
) -> None:
    errors = []
    for ratio in (3.0, 10.0, 30.0):
        exposures = (1.0, ratio, ratio**2)
        camera = EffectiveCamera.of(RESPONSE, exposures)
        noise = [FrameNoise(200.0, read_noise)] * 3
        truth = Posterior(camera, LOG, noise).inverse.effective_levels
        for seed, contrast in enumerate([0.0, 0.08] * 3):
            light = np.geomspace(1e-3, 1, 1500)[:, np.newaxis]
            light = light * np.linspace(1 - contrast, 1 + contrast, 64)
            frames = patches(light, 200.0, seed, exposures=exposures, read_noise=read_noise)
            found = measure(frames, exposures)
            assert found is not None
            errors.append(abs(found.effective_levels - truth) / found.uncertainty)
    assert np.mean(np.array(errors) < 2) > 0.85  # of 18; 0.95 is expected


@pytest.mark.parametrize("contrast", [0.0, 0.03, 0.08])
def test_noise_far_below_a_step_is_measured(contrast: float) -> None:
    """All samples of a patch are rounded alike there: its spread depends on its light."""
    light = np.geomspace(1e-3, 1, 1500)[:, np.newaxis] * np.linspace(1 - contrast, 1 + contrast, 64)
    measured = measure(patches(light, 200.0, read_noise=0.05))
    assert measured is not None
    assert measured.electrons_per_level == pytest.approx(200, rel=0.12)
    assert measured.read_noise_levels < 0.1


@pytest.mark.parametrize(
    ("ratio", "count", "power", "electrons", "read_noise"),
    [
        (24.6, 3, 1.2, 11.7, 0.98),  # what is not clipped in two frames has 4 to 9 levels
        (1.55, 9, 1.2, 16.2, 0.94),  # the light is as noisy in the longer frame
        (1.83, 8, 0.75, 15.7, 0.98),  # steps are as wide as 4 levels
        (1.42, 8, 0.75, 54.4, 0.58),
    ],
)
def test_noise_is_exact_whatever_the_steps_and_exposures_are(
    ratio: float, count: int, power: float, electrons: float, read_noise: float
) -> None:
    response = CameraResponse((np.arange(1, 256) / 256) ** power, "curved")
    # Most patches of a picture are dark.
    light = np.geomspace(2e-3, 1, 3000)[:, np.newaxis] ** 1.5 * np.linspace(0.99, 1.01, 64)
    exposures = [ratio**k for k in range(count)]
    fits = [
        fit_noise(
            response,
            patches(
                light,
                electrons,
                seed,
                exposures=exposures,
                read_noise=read_noise,
                response=response,
            ),
            exposures,
            [1.0] * count,
            0,
        )
        for seed in range(3)
    ]
    found = np.array([fit.noise for fit in fits if fit is not None])
    assert len(found) == 3
    np.testing.assert_allclose(1 / found[:, 0], electrons, rtol=0.07)
    np.testing.assert_allclose(np.sqrt(found[:, 1]), read_noise, rtol=0.035)


def test_a_curved_camera_has_an_uncertainty_of_like_size() -> None:
    # At the ends of its curve a level spans much light: those do not hide the scatter.
    found = {}
    for sensor in ("consumer", "standard"):
        with small_camera(sensor, gradient(480, 160)) as camera:
            measured = measured_in(capture(camera, replace(REQUEST, response="linear")))
        found[sensor] = measured.uncertainty / measured.effective_levels
    assert 0.2 < found["consumer"] / found["standard"] < 5


def test_frames_that_do_not_overlap_show_nothing() -> None:
    assert measure(patches(LIGHT[:40], 40.0)) is None
    assert measure(patches(np.full((600, 64), 1e-4), 40.0)) is None


@pytest.mark.parametrize("scene", some(["moving-target", "tile-floor"], every=2))
def test_noise_beside_a_thing_that_moves_contradicts_nothing(
    scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where most of the rest is saturated in the longer frames, the patches may be those of it."""
    found = MeasuredNoise(6.2, 0.2, 0.4, 0.1, 8000)
    monkeypatch.setattr(outputs, "measure_noise", lambda *_: found)
    with camctl.open_camera("sim", scene=scene, size="320x240") as camera:
        report = camctl.capture(camera, CaptureRequest(dynamic_range="auto", count=3))
    assert report.movement is not None
    moves = scene == "moving-target"
    assert report.movement.is_local == moves
    assert report.achieved.measured == (None if moves else found)
    assert any("frames show" in warning for warning in report.warnings) != moves


def test_what_is_asked_again_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan, and the picture that is made after it, fit the noise of the same samples."""
    samples, gains, fitted = patches(LIGHT, 40.0), [1.0] * len(EXPOSURES), []
    solve = noise._least_squares

    def counted(*arguments: Any) -> Any:
        fitted.append(arguments)
        return solve(*arguments)

    monkeypatch.setattr(noise, "_least_squares", counted)

    def fit(samples: Sequence[Patches]) -> Any:
        fitted.clear()
        found = fit_noise(RESPONSE, samples, EXPOSURES, gains, 0)
        assert found is not None
        return found.noise.tolist()

    first = fit([each.copy() for each in samples])
    assert fitted
    assert fit([each.copy() for each in samples]) == first
    assert not fitted
    assert fit(patches(LIGHT, 40.0, 1)) != first
    assert fitted
