"""Colours of JPEG files that have as many samples of Cb and Cr as of brightness (4:4:4)."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import camctl

#: What `cv2.IMWRITE_JPEG_SAMPLING_FACTOR` has for 4:4:4, and for 4:2:0.
_ALL, _FEW = 0x111111, 0x221111
_EXPOSURES = tuple(1.7**k for k in range(10))
_ELECTRONS, _READ = 40.0, 0.7


def scene() -> NDArray[np.float64]:
    """Return light with fine and coarse detail, of colours and of brightness."""
    rng = np.random.default_rng(2)
    light = np.empty((256, 384, 3))
    common = rng.normal(0, 1, (2, 256, 384))
    for colour, level in enumerate((0.012, 0.009, 0.006)):
        fine = cv2.GaussianBlur(common[0] + rng.normal(0, 0.7, (256, 384)), (0, 0), 1.0)
        coarse = cv2.GaussianBlur(common[1] + rng.normal(0, 0.7, (256, 384)), (0, 0), 24)
        light[..., colour] = level * np.exp(0.9 * fine + 20 * coarse)
    return light


def files(
    light: NDArray[np.float64],
    quality: int,
    sampling: int = _ALL,
    exposures: tuple[float, ...] = _EXPOSURES,
) -> list[NDArray[np.uint8]]:
    """Return photographs as their files keep them."""
    real, rng = camctl.standard_response("srgb", 8), np.random.default_rng(0)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    found = []
    for exposure in exposures:
        x = rng.poisson(exposure * light * 256 * _ELECTRONS) / (256 * _ELECTRONS)
        x += rng.normal(0, _READ / 256, light.shape)
        pixels = np.searchsorted(real.levels, x, "right").astype(np.uint8)
        data = cv2.imencode(".jpg", pixels[..., ::-1], options)[1]
        found.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    return found


@pytest.mark.parametrize("quality", [80, 90])
def test_what_files_of_all_chroma_lose_alike_is_part_of_the_standard_deviation(
    quality: int,
) -> None:
    """Errors were up to 3.7 times as large as their `sd`."""
    light = scene()
    found = camctl.combine(files(light, quality), _EXPOSURES, response="srgb")
    z = np.abs((found.irradiance - light) / found.sd)[found.mask & 3 == 0]
    z = z[np.isfinite(z)]
    assert z.size > light.size / 2
    assert 0.85 < np.sqrt(np.mean(z**2)) < 1.15
    assert 0.62 < np.mean(z < 0.99446) < 0.78


@pytest.mark.parametrize("least", [1 << 60, pytest.param(1, marks=pytest.mark.slow)])
def test_samples_near_white_count_as_far_as_the_rounding_of_their_file_lets_them(
    monkeypatch: pytest.MonkeyPatch, least: int
) -> None:
    """Those within 5 % of white were left out: light had 6 times the error of a little less."""
    monkeypatch.setattr("camctl.pictures.chroma_light._WORTH_LOADING", least)
    light = np.asarray(5 * cv2.GaussianBlur(scene(), (0, 0), 2), np.float64)
    exposures = 1.0, 16.0
    frames = files(light, 98, exposures=exposures)
    found = camctl.combine(frames, exposures, response="srgb")
    below, near, beside = (
        (frames[1] >= first) & (frames[1] < end)
        for first, end in ((225, 242), (243, 248), (248, 255))
    )
    errors = np.log(found.irradiance / light)
    assert np.std(errors[near]) < 1.5 * np.std(errors[below])
    z = ((found.irradiance - light) / found.sd)[beside & (found.mask & 3 == 0)]
    assert 0.85 < np.std(z[np.isfinite(z)]) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("sampling", [_ALL, _FEW])
def test_light_of_few_colours_is_that_of_numpy_where_it_is_compiled(
    monkeypatch: pytest.MonkeyPatch, sampling: int
) -> None:
    """Compiled code stated deviations by a noise that is not known."""
    pytest.importorskip("numba")
    frames = [each[:63, :95] for each in files(scene()[:64, :96], 85, sampling)]
    found = []
    for least in (1 << 60, 1):
        monkeypatch.setattr("camctl.pictures.chroma_light._WORTH_LOADING", least)
        found.append(
            camctl.combine(frames, _EXPOSURES, response="srgb", few_chroma_samples=sampling == _FEW)
        )
    numpy, compiled = found
    assert np.isnan(numpy.sd).any()
    known = np.isfinite(numpy.sd)
    assert np.array_equal(known, np.isfinite(compiled.sd))
    np.testing.assert_allclose(compiled.sd[known], numpy.sd[known], rtol=1e-3)
    np.testing.assert_allclose(compiled.irradiance, numpy.irradiance, rtol=1e-3)
