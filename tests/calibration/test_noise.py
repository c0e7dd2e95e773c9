"""Measuring the noise of simulated cameras whose noise is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

import camctl
from camctl.calibration.noise.curve import NoiseCurve
from camctl.calibration.noise.estimate import NoiseFrames, estimate_noise, same_response
from camctl.calibration.noise.shooting import measure_noise
from camctl.errors import CaptureError, DataError
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.response.camera import CameraResponse, linear_response, standard_response
from camctl.profiles.noise import Figure, NoiseRecord
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.motion import Lamps
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import load_sensor

#: An interval of 95 % has half a width of 1.96 standard errors; one of 2.5 times that is missed
#: once in a million.
_REACH = 2.5


def measure(sensor: str, scene: str = "tile-floor", **options: object) -> NoiseRecord:
    with camctl.open_camera("sim", scene=scene, sensor=sensor, size="320x240") as camera:
        return measure_noise(camera, **options)  # type: ignore[arg-type]  # only in tests


def contains(figure: Figure, true: float, reach: float = _REACH) -> bool:
    """Return whether a number is in the interval, widened by a factor."""
    low = figure.value - reach * (figure.value - figure.low)
    high = figure.value + reach * (figure.high - figure.value)
    return low <= true <= high


def bare_frames(
    pixels: list[tuple[NDArray[np.uint8], float]], layout: Layout = Layout.MONO
) -> NoiseFrames:
    frames = NoiseFrames(layout, 0, 255, same_response(linear_response(8), layout))
    for each, time_s in pixels:
        frames.add(each, ExposureSetting(time_s))
    return frames


def ramp_pairs(
    times: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0), electrons: float = 20.0
) -> list[tuple[NDArray[np.uint8], float]]:
    """Return pairs of frames of a ramp with photon noise, and their times."""
    random = np.random.default_rng(5)
    light = np.broadcast_to(np.geomspace(4, 200, 320), (160, 320))
    frames = []
    for time_s in times:
        for _ in (0, 1):
            levels = random.poisson(light * time_s * electrons) / electrons
            levels += random.normal(0, 0.8, light.shape)
            frames.append((np.clip(np.floor(levels + 0.5), 0, 255).astype(np.uint8), time_s))
    return frames


@pytest.mark.parametrize(
    ("sensor", "scene"),
    [
        ("standard", "tile-floor"),  # 8 bits, linear, noise below a third of a level in the dark
        pytest.param("consumer", "tile-floor", marks=pytest.mark.slow),  # sRGB, cut at black
        pytest.param("phone", "room", marks=pytest.mark.slow),  # Bayer mosaic, black level
        pytest.param("webcam", "colour-chart", marks=pytest.mark.slow),  # RGB, cut at black
        ("machine-vision", "tile-floor"),  # 12 bits, mono
    ],
)
def test_figures_agree_with_the_sensor(sensor: str, scene: str) -> None:
    record = measure(sensor, scene, exposures=8)
    true = load_sensor(sensor)
    noise = true.noise_model
    for each in record.gains:
        conversion = noise.conversion_e_per_dn / each.gain
        assert contains(each.conversion_e_per_dn, conversion)
        assert contains(each.read_noise_e, noise.read_noise(each.gain))
        assert each.conversion_e_per_dn.value == pytest.approx(conversion, rel=0.02)
    assert contains(record.full_well_e, true.electrons_per_dn * (true.white - true.black))
    assert record.saturates
    assert record.prnu is None
    assert record.dark is None
    assert abs(record.correlation or 0) < 0.03


def test_prnu_is_measured_on_a_flat_field() -> None:
    record = measure("ccd", "uniform", is_flat=True)
    assert record.prnu is not None
    assert contains(record.prnu, load_sensor("ccd").pixels.prnu)
    assert record.prnu.high - record.prnu.low < 0.1 * record.prnu.value


def test_rounding_of_an_even_light_does_not_count_as_noise() -> None:
    """Where little noise meets one brightness, its place within a level sets the variance."""
    record = measure("standard", "uniform", is_flat=True)
    reference = record.reference
    assert contains(reference.conversion_e_per_dn, 39.0625, reach=1.5)
    assert reference.read_noise_e.low <= 3.0 <= reference.read_noise_e.high
    assert reference.read_noise_e.high > 3.0
    assert record.saturates


def test_moving_object_does_not_bias_the_noise() -> None:
    record = measure("standard", "moving-target")
    assert contains(record.reference.conversion_e_per_dn, 39.0625)
    assert abs(record.correlation or 0) < 0.05


def test_frames_are_paired_in_any_order() -> None:
    frames = ramp_pairs()
    adjacent = estimate_noise(bare_frames(frames))
    interleaved = estimate_noise(bare_frames(frames[::2] + frames[1::2]))
    assert interleaved.gains == adjacent.gains
    assert contains(adjacent.reference.conversion_e_per_dn, 20.0)
    assert contains(adjacent.reference.read_noise_e, 16.0)


def test_flickering_light_is_corrected_and_noted() -> None:
    y, x = np.mgrid[0:240, 0:320] / 320
    light = np.exp(1.5 * np.sin(9 * x) + np.sin(7 * y) - 2).astype(np.float32)
    scene = Scene("lamps", light, photons_per_unit=1e6, lamps=Lamps(50, 0.1))
    with SimulatedCamera(scene, load_sensor("standard")) as camera:
        record = measure_noise(camera, longest_s=0.1)
    assert contains(record.reference.conversion_e_per_dn, 39.0625)
    assert "light_varies" in [each.code for each in record.findings]


def test_filtered_frames_are_reported() -> None:
    def smooth(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        wide = pixels.astype(np.float64)
        return ((wide + np.roll(wide, 1, axis=1)) / 2 + 0.5).astype(np.uint8)

    frames = [(smooth(pixels), time_s) for pixels, time_s in ramp_pairs(electrons=4.0)]
    record = estimate_noise(bare_frames(frames))
    assert record.correlation == pytest.approx(0.5, abs=0.1)
    found = [each.value for each in record.findings if each.code == "noise_filtered"]
    assert found == [record.correlation]


@pytest.mark.parametrize(
    ("pairs", "problem"),
    [
        ([(np.full((80, 80), 255, np.uint8), 1.0)] * 2, "saturated everywhere"),
        ([(np.zeros((80, 80), np.uint8), 1.0)] * 2, "black"),
        (ramp_pairs()[:1] * 2, "same picture"),
        (ramp_pairs()[::2], "no two of the 4 frames"),
        ([(ramp_pairs()[0][0], 1.0), (ramp_pairs()[0][0][:90], 1.0)], "320 x 90"),
        (
            [
                (each if k % 2 else np.roll(each, 160, axis=1), t)
                for k, (each, t) in enumerate(ramp_pairs())
            ],
            "moved|light changes",
        ),
        ([(np.minimum(each, 20), t) for each, t in ramp_pairs((0.1,))], "patches are between"),
    ],
    ids=["saturated", "black", "duplicate", "unpaired", "sizes", "moved", "dark"],
)
def test_unsuitable_frames_are_refused(
    pairs: list[tuple[NDArray[np.uint8], float]], problem: str
) -> None:
    with pytest.raises(DataError, match=problem) as caught:
        estimate_noise(bare_frames(pairs))
    assert caught.value.hint


@pytest.mark.parametrize(("scene", "longest_s"), [("stars", 0.01), ("tile-floor", 0.001)])
def test_too_little_light_is_refused(scene: str, longest_s: float) -> None:
    with pytest.raises(CaptureError, match="too dark") as caught:
        measure("standard", scene, longest_s=longest_s)
    assert caught.value.hint


def test_camera_without_noise_is_refused() -> None:
    with pytest.raises(DataError, match="same picture"):
        measure("ideal-8")


@pytest.mark.parametrize(
    ("response", "black"),
    some(
        [
            (standard_response("srgb", 8), 0),
            (linear_response(8), 0),
            (linear_response(10, phase=0.5, levels=959), 64),
            (standard_response("power", 10), 0),
        ],
        every=2,
    ),
    ids=["srgb", "linear", "black level", "power"],
)
def test_variance_of_brightness_agrees_with_random_electrons(
    response: CameraResponse, black: int
) -> None:
    """Clipping at black, rounding, slope and curvature: against numbers drawn at random."""
    electrons, read = 20.0 * 256 / (response.M + 1), 8.0
    full = response.M + 1
    first = response.levels[1] - response.levels[0]
    below = response.levels[0] - first * np.arange(black, 0, -1)
    steps = np.concatenate([below, response.levels])
    mean, variance = NoiseCurve(response, black).moments(1 / electrons, (read / electrons) ** 2)
    random = np.random.default_rng(3)
    for signal in (15.0, 60.0, 400.0, 2000.0):
        found, expected = [], []
        level = max(3, int(np.searchsorted(response.levels, signal / electrons / full)))
        ends = response.levels[level : level + 2] * electrons * full
        for light in np.linspace(
            ends[0], ends[1], 24, endpoint=False
        ):  # evenly spread within a level
            drawn = random.poisson(light, 40_000) + random.normal(0, read, 40_000)
            brightness = np.searchsorted(steps, drawn / electrons / full, side="right") - black
            found.append(brightness.var())
            expected.append(np.interp(brightness.mean(), mean, variance))
        error = math.sqrt(2 / (24 * 40_000))
        assert np.mean(found) == pytest.approx(np.mean(expected), rel=4 * error + 0.004)


def through_curve(error: float, deviation: float, scale_error: float) -> NoiseRecord:
    """Return the noise of a linear camera whose measured curve is wrong by a share of its light.

    The error is at the darker levels: it changes the slope, and with it electrons per level.
    """
    real = linear_response(8)
    wrong = real.levels * np.exp(error * np.interp(np.log(real.levels), [-4.0, -1.0], [1.0, 0.0]))
    found = replace(real, levels=wrong, deviation=np.full(255, deviation), scale_error=scale_error)
    frames = bare_frames(ramp_pairs())
    frames.responses = same_response(found, Layout.MONO)
    return estimate_noise(frames)


def test_the_error_of_a_measured_response_is_in_the_intervals() -> None:
    exact = through_curve(0.0, 0.0, 0.0).reference.conversion_e_per_dn
    known = through_curve(0.06, 0.03, 0.0)
    assert contains(known.reference.conversion_e_per_dn, 20.0, reach=1)
    assert contains(known.reference.read_noise_e, 16.0, reach=1)
    scale = through_curve(0.0, 0.0, 0.05)
    of_scale = scale.reference.conversion_e_per_dn
    assert (of_scale.high - of_scale.low) / exact.value == pytest.approx(0.196, rel=0.1)
    full = scale.full_well_e
    assert (full.high - full.low) / full.value == pytest.approx(0.196, rel=0.1)


def test_parts_where_the_response_is_not_known_are_left_out() -> None:
    real = linear_response(8)
    levels = np.where(real.levels > 0.5, 0.5 + 2 * (real.levels - 0.5), real.levels)
    deviation = np.where(real.levels > 0.5, np.inf, 0.001)
    frames = bare_frames(ramp_pairs())
    frames.responses = same_response(replace(real, levels=levels, deviation=deviation), Layout.MONO)
    assert contains(estimate_noise(frames).reference.conversion_e_per_dn, 20.0)


def test_noise_that_contradicts_a_measured_response_is_refused() -> None:
    with pytest.raises(DataError, match="the noise does not follow the measured response"):
        through_curve(0.8, 0.01, 0.0)
