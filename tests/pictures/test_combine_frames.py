"""Frames of unusual cameras, and exposures that are not as stated, combined."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import camctl
from camctl.model.noise import FrameNoise, NoiseModel


@pytest.mark.filterwarnings("error")
def test_exposures_a_million_apart_overflow_nothing() -> None:
    rng = np.random.default_rng(0)
    light = np.exp(rng.uniform(np.log(1e-9), np.log(0.9), (64, 64)))
    means = [light * exposure * 256 for exposure in (1, 1e6)]
    levels = [rng.normal(mean, np.sqrt(mean / 20 + 0.3)) for mean in means]
    frames = [np.clip(np.floor(each), 0, 255).astype(np.uint8) for each in levels]
    assert np.isfinite(camctl.combine(frames, (1, 1e6)).irradiance).all()


@pytest.mark.parametrize("noise", [None, FrameNoise(20.0, 0.8)])
@pytest.mark.parametrize("times", [(1, 4, 16), (16, 1, 4), (1, 1)])
def test_an_exposure_that_is_5_percent_longer_is_found(
    times: tuple[int, ...], noise: FrameNoise | None
) -> None:
    rng = np.random.default_rng(5)
    light = np.tile(np.geomspace(0.004, 0.9, 256), (128, 1))
    true = [*times[:-1], 1.05 * times[-1]]
    for exposures, factors in ((times, ()), (true, (1.05,))):
        levels = [rng.poisson(light * each * 256 * 20) / 20 for each in exposures]
        read = [each + rng.normal(0, 0.8, light.shape) for each in levels]
        frames = [np.clip(np.floor(each), 0, 255).astype(np.uint8) for each in read]
        found = camctl.combine(frames, times, noise=noise).findings
        differs = [each for each in found if each.code == "exposure_differs"]
        assert {len(times) - 1} & {k for each in differs for k in each.frames} == (
            {len(times) - 1} if factors else set()
        )
        for each in differs:
            assert each.value is not None
            assert max(each.value, 1 / each.value) == pytest.approx(1.05, abs=0.01)
        assert "moved" not in [each.code for each in found]


def test_noise_of_hundreds_of_16_bit_levels_is_measured() -> None:
    """An EMCCD or an InGaAs camera has it: 30 electrons, a tenth of an electron a level."""
    rng = np.random.default_rng(5)
    light = np.tile(np.geomspace(0.004, 0.9, 256), (128, 1))
    frames = []
    for exposure in (1, 4, 16):
        levels = rng.poisson(light * exposure * 61536 * 0.1) / 0.1
        levels += rng.normal(0, 300, light.shape) + 4000
        frames.append(np.clip(np.floor(levels), 0, 65535).astype(np.uint16))
    found = camctl.combine(frames, (1, 4, 16), black=4000, white=65535)
    z = ((found.irradiance - light) / found.sd)[found.mask == 0]
    assert 0.97 < z.std() < 1.03
    assert np.mean(found.mask & 4 > 0) < 0.002


def test_differences_of_pixels_stay_in_the_deviation_beside_full_scale() -> None:
    rng = np.random.default_rng(2)
    light = np.tile(np.linspace(0.21, 0.26, 64), (400, 1))  # the longer frame saturates at 0.25
    pixels = light * rng.normal(1, 0.02, light.shape)
    noise = FrameNoise(3.0, 5.0, prnu=0.02)
    frames = []
    for exposure in (1, 4):
        levels = rng.poisson(pixels * exposure * 3840 * 3) / 3 + rng.normal(0, 5, light.shape)
        frames.append(np.clip(np.floor(levels) + 256, 0, 4095).astype(np.uint16))
    found = camctl.combine(frames, (1, 4), black=256, white=4095, noise=noise)
    z = (found.irradiance - light) / found.sd
    assert 0.95 < z.std() < 1.05


def test_a_black_level_is_the_mean_of_dark_frames() -> None:
    """A converter that rounds to a black level of 64: the light of dark parts is right."""
    rng = np.random.default_rng(0)
    exposures = (1, 4, 16)
    light = np.tile(np.geomspace(0.002, 0.02, 64), (400, 1))
    means = [light * exposure * 960 for exposure in exposures]
    levels = [rng.poisson(6 * mean) / 6 + rng.normal(64, 0.9, light.shape) for mean in means]
    frames = [np.clip(np.rint(each), 0, 1023).astype(np.uint16) for each in levels]
    found = camctl.combine(frames, exposures, black=64, white=1023, noise=FrameNoise(6.0, 0.9))
    error = float(np.mean(found.irradiance - light))
    deviation = float(np.sqrt(np.mean(np.square(found.sd)) / light.size))
    assert abs(error) < 4 * deviation  # 37 of them with steps that truncate


@pytest.mark.parametrize("noise", [None, NoiseModel(20.0, ((1.0, 16.0),))])
def test_noise_of_frames_that_differ_in_gain_is_that_of_each(noise: NoiseModel | None) -> None:
    """Without the gains the deviations of dark light were 2.4 times too small."""
    rng = np.random.default_rng(2)
    rows, columns = np.mgrid[0:240, 0:320]
    light = 0.9 * np.exp(-2.5 * (1 + np.sin(columns / 40) * np.cos(rows / 35)))
    frames = []
    for gain in (1, 4, 16):
        levels = rng.poisson(light * 256 * 20) / 20 + rng.normal(0, 0.8, light.shape)
        frames.append(np.clip(np.floor(gain * levels), 0, 255).astype(np.uint8))
    found = camctl.combine(frames, (1, 4, 16), noise=noise, gains=(1, 4, 16))
    z = (found.irradiance - light) / found.sd
    for low, high in ((0, 0.02), (0.02, 0.1), (0.1, 0.3), (0.3, 1)):
        part = (light > low) & (light <= high) & (found.mask == 0)
        assert 0.9 < np.std(z[part]) < 1.1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (2, 1), (1, 300, 3)])
def test_pictures_may_be_one_pixel_high_or_wide(shape: tuple[int, ...]) -> None:
    light = np.linspace(0.1, 0.9, int(np.prod(shape))).reshape(shape)
    frames = [np.floor(256 * light / part).astype(np.uint8) for part in (4, 1)]
    found = camctl.combine(frames, (0.25, 1))
    np.testing.assert_allclose(found.irradiance, light, rtol=0.1)
    assert found.mask.max() == 0


def test_exposures_may_be_fractions_or_come_one_by_one() -> None:
    frames = [np.full((16, 16), level, np.uint8) for level in (20, 80)]
    usual = camctl.combine(frames, (1 / 60, 1 / 15)).irradiance
    for exposures in ((Fraction(1, 60), Fraction(1, 15)), (each for each in (1 / 60, 1 / 15))):
        assert np.array_equal(camctl.combine(frames, exposures).irradiance, usual)  # type: ignore[arg-type]
