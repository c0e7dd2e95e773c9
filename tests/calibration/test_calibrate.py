"""`camctl.calibrate` on simulated cameras whose properties are known, and on arrays."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.calibration.results import StillTiming
from camctl.model.response.camera import srgb_to_linear
from camctl.sim.sensors.sensor import load_sensor

TIMES = (1 / 64, 1 / 16, 1 / 4)


@pytest.fixture(autouse=True)
def no_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def open_sim(sensor: str, scene: str = "tile-floor", **options: Any) -> camctl.Camera:
    return camctl.open_camera("sim", scene=scene, sensor=sensor, size="320x240", **options)


def levels_of(controls: camctl.ExposureControls) -> dict[str, Any]:
    return {"black": controls.black, "white": controls.white, "layout": controls.layout}


SCENE = np.geomspace(1e-3, 1, 160) * np.random.default_rng(2).uniform(0.9, 1.1, (120, 160))
"""Light with shades over three decades; at 1 a frame of the first time just saturates."""


def curved_frames(levels: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    """Return frames of `SCENE` by these thresholds."""
    found = [np.searchsorted(levels, SCENE * each * 64, side="right") for each in TIMES]
    return [each.clip(0, 255).astype(np.uint8) for each in found]


SRGB = np.append(srgb_to_linear(np.arange(1, 256) / 256), np.inf)


def test_the_module_is_imported_when_it_is_named() -> None:
    assert camctl.calibrate.__name__ == "camctl.calibrate"
    measures = ["colour", "dark", "delay", "exposure", "noise", "response"]
    assert camctl.calibrate.__all__ == measures


def test_emva_figures_and_report() -> None:
    with open_sim("machine-vision") as camera:
        found = camctl.calibrate.noise(camera, count=6)
    true = load_sensor("machine-vision")
    noise = true.noise_model
    full = true.electrons_per_dn * (true.white - true.black)
    least = math.hypot(noise.read_noise(1.0), noise.conversion_e_per_dn / math.sqrt(12)) + 0.5
    figures = {(each.symbol, each.unit): each.value for each in found.emva_figures()}
    assert figures["K", "DN/e-"] == pytest.approx(1 / noise.conversion_e_per_dn, rel=0.02)
    assert figures["sigma_d", "e-"] == pytest.approx(noise.read_noise(1.0), rel=0.05)
    assert figures["mu_e.sat", "e-"] == pytest.approx(full, rel=0.02)
    assert figures["DR", "dB"] == pytest.approx(20 * math.log10(full / least), abs=0.3)
    assert figures["SNR_max", "bit"] == pytest.approx(math.log2(math.sqrt(full)), abs=0.03)
    lines = found.emva_report().splitlines()
    assert lines[0].startswith("# EMVA 1288: camctl simulated machine-vision")
    assert sum(line.startswith("| overall system gain | K |") for line in lines) == 1
    assert any(line.startswith("Not measured: quantum efficiency") for line in lines)
    points = sum(len(each.curve) for each in found.gains)
    assert sum(line.startswith("| ") for line in lines) == len(figures) + points + 1 + len(
        found.gains
    )


def test_response_of_arrays() -> None:
    of_arrays = camctl.calibrate.response(curved_frames(SRGB), TIMES)
    (channel,) = of_arrays.channels
    middle = srgb_to_linear((np.arange(20, 255) + 0.5) / 256)
    ratio = np.array(channel.levels)[20:255] / middle
    assert ratio.max() / ratio.min() < 1.03
    curve = of_arrays.camera_response()
    combined = camctl.combine(curved_frames(SRGB), TIMES, response=curve)
    light = combined.irradiance / SCENE / 64
    inside = (combined.mask == 0) & (SCENE > 0.02)
    assert np.median(light[inside]) == pytest.approx(1, rel=0.05)
    assert np.std(np.log(light[inside])) < 0.02


def test_unknown_exposures_of_arrays_are_estimated() -> None:
    found = camctl.calibrate.response(curved_frames(SRGB), estimate_ratios=True)
    assert found.exposures[2] > found.exposures[1] > found.exposures[0] == 1
    assert [each.code for each in found.findings] == ["exponent_unknown"]


def test_exposures_of_a_capture_and_of_arrays() -> None:
    with open_sim("phone") as camera:
        report = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 2, 4)))
        controls = camera.controls
    of_capture = camctl.calibrate.exposure(report)
    assert [each.factor for each in of_capture.times] == pytest.approx([1.0] * 3, rel=0.01)
    assert of_capture.camera == report.camera
    frames = [report.frame(k) for k in range(3)]
    times = [frame.applied_s for frame in report.frames]
    wrong = [times[0], times[1] * 1.1, times[2]]
    found = camctl.calibrate.exposure(frames, wrong, **levels_of(controls))
    assert found.times[1].factor / found.times[0].factor == pytest.approx(1 / 1.1, rel=0.01)
    assert any(each.contradicts_label for each in found.times)


def test_exposures_of_arrays_of_shifted_samples() -> None:
    """A truncating quantiser loses half a step of 64, not half a level of 16 bits."""
    light = np.tile(np.geomspace(0.5, 500, 200), (150, 1))
    frames = [np.minimum(light * each, 1023).astype(np.uint16) for each in TIMES]
    plain = camctl.calibrate.exposure(frames, TIMES, white=1023)
    shifted = [each * np.uint16(64) for each in frames]
    found = camctl.calibrate.exposure(shifted, TIMES, white=1023 * 64)
    for one, other in zip(found.times, plain.times, strict=True):
        assert (one.factor, one.low, one.high) == pytest.approx(
            (other.factor, other.low, other.high)
        )


@pytest.mark.parametrize(("late", "dtype"), [(-1, np.uint8), (2, np.uint8), (3, np.uint16)])
def test_delay_of_arrays(late: int, dtype: type[np.unsignedinteger]) -> None:
    """Also of few levels in 16 bits, such as those of a camera of 10 bits."""
    exposures = [1.0] * 6 + [4.0] * 8 + [1.0] * 8 + [4.0] * 8
    effective = [exposures[min(max(0, k - late), 29)] for k in range(30)]
    frames = [np.full((8, 8), round(40 * each), dtype) for each in effective]
    found = camctl.calibrate.delay(frames, exposures)
    assert not isinstance(found, StillTiming)
    assert (found.frames, found.smallest, found.largest, found.trials) == (late, late, late, 3)
    assert found.timing is None


def test_a_frame_with_two_exposures_is_a_finding() -> None:
    exposures = [1.0] * 4 + [4.0] * 5 + [1.0] * 5
    light = [40] * 5 + [100] + [160] * 3 + [40] * 5
    frames = [np.full((8, 8), each, np.uint8) for each in light]
    found = camctl.calibrate.delay(frames, exposures)
    assert (found.frames, found.mode) == (None, "")
    assert [(each.code, each.value) for each in found.findings] == [("delay_irregular", 1)]


@pytest.mark.parametrize(
    ("frames", "exposures", "message"),
    [
        ([40] * 8, [1.0] * 8, "0 changes of the exposure"),
        ([40] * 9, [1.0] * 3 + [4.0] * 3 + [1.0] * 3, "hardly changes"),
        ([40] * 8 + [160] + [40] * 6, [1.0] * 5 + [4.0] * 5 + [1.0] * 5, "too late"),
        ([40] * 8, [1.0] * 7, "invalid number of exposures"),
    ],
)
def test_frames_that_show_no_delay(frames: list[int], exposures: list[float], message: str) -> None:
    arrays = [np.full((8, 8), each, np.uint8) for each in frames]
    with pytest.raises(camctl.CamctlError, match=message):
        camctl.calibrate.delay(arrays, exposures)


def test_what_is_not_known_of_arrays_is_asked_for() -> None:
    frames = [np.zeros((16, 16), np.uint16)] * 4
    with pytest.raises(camctl.UsageError, match="exposures of the frames are not known"):
        camctl.calibrate.noise(frames)
    with pytest.raises(camctl.UsageError, match="white level of 16-bit frames"):
        camctl.calibrate.noise(frames, [1.0] * 4)
    for black, white in ((300, 255), (-3, 4095), (0, 70_000)):
        with pytest.raises(camctl.UsageError, match=f"invalid levels: black {black} and white"):
            camctl.calibrate.noise(frames, [1.0] * 4, black=black, white=white)
    with pytest.raises(camctl.UsageError, match="invalid black level 64"):
        camctl.calibrate.noise(frames, [1.0] * 4, black=64.5, white=4095)  # type: ignore[arg-type]
    real = camctl.linear_response(8)
    with pytest.raises(camctl.UsageError, match="255 levels, and white - black is 4095"):
        camctl.calibrate.noise(frames, [1.0] * 4, white=4095, response=real)


def test_levels_may_be_numbers_of_an_array() -> None:
    rng = np.random.default_rng(0)
    light = np.geomspace(10, 900, 64 * 64).reshape(64, 64)
    times = [0.01, 0.02, 0.04] * 2
    frames = [
        (rng.poisson(light * time_s * 1000) / 10 + rng.normal(64, 1, light.shape)).astype(np.uint16)
        for time_s in times
    ]
    found = []
    for width in (int, np.uint16):
        levels: Any = {"black": width(64), "white": width(4095)}
        measured = camctl.calibrate.noise(frames, times, **levels)
        noise = measured.noise_model()
        found.append((noise, camctl.combine(frames, times, **levels).irradiance.tolist()))
    assert found[0] == found[1]
    assert noise.conversion_e_per_dn == pytest.approx(10, rel=0.02)
    assert noise.read_noise(1.0) == pytest.approx(10, rel=0.05)
    with pytest.raises(camctl.UsageError, match="do not say which camera"):
        measured.save()


@pytest.mark.slow
def test_plots_are_files(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    with open_sim("phone") as camera:
        noise = camctl.calibrate.noise(camera, count=4)
        exposure = camctl.calibrate.exposure(camera, repeats=2, longest_s=0.05)
    noise.plot(tmp_path / "noise.svg")
    exposure.plot(tmp_path / "exposure.svg")
    camctl.calibrate.response(curved_frames(SRGB), TIMES).plot(tmp_path / "response.svg")
    texts = {path.stem: path.read_text() for path in tmp_path.glob("*.svg")}
    assert "variance, DN squared" in texts["noise"]
    assert "true over stated exposure" in texts["exposure"]
    assert "irradiance" in texts["response"]
