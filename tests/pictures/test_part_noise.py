"""The noise of colours that JPEG files keep, beside the noise that was put into them."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import camctl

ELECTRONS, READ = 12.0, 1.5
EXPOSURES = (1.0, 2.0, 4.0, 8.0)


def photographs(quality: int, gains: tuple[float, float, float]) -> list[NDArray[np.uint8]]:
    """Return JPEG photographs of smooth colours by a linear camera of 256 levels.

    Args:
        quality: of the files
        gains: that red, green and blue were multiplied by after they were read
    """
    rng = np.random.default_rng(0)
    across, down = np.meshgrid(np.linspace(0, 1, 512), np.linspace(0, 1, 384))
    light = 6 * 20 ** across[..., np.newaxis] * (1 + down[..., np.newaxis] * (0.3, 0, -0.3))
    found = []
    for exposure in EXPOSURES:
        electrons = rng.poisson(light * exposure * ELECTRONS / gains)
        levels = electrons / ELECTRONS * gains + READ * rng.standard_normal(light.shape) * gains
        pixels = np.clip(np.floor(levels), 0, 255).astype(np.uint8)
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        data = cv2.imencode(".jpg", pixels[..., ::-1], options)[1]
        found.append(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])
    return found


@functools.cache
def noise_of(
    quality: int, gains: tuple[float, float, float]
) -> tuple[tuple[camctl.FrameNoise, ...], ...]:
    """Return the noise that is found in the photographs, of each frame and channel."""
    return camctl.combine(photographs(quality, gains), EXPOSURES).noise


@pytest.mark.parametrize("quality", [95, 98])
def test_noise_of_colours_is_found_as_it_was_before_the_file(quality: int) -> None:
    found = noise_of(quality, (1, 1, 1))
    green = found[1][0]
    assert green.electrons_per_level == pytest.approx(ELECTRONS, rel=0.1)
    assert green.read_noise_levels == pytest.approx(READ, rel=0.1)
    # Of their own noise, red and blue show less: most of what they have is in brightness.
    for colour in (0, 2):
        assert found[colour][0].electrons_per_level == pytest.approx(ELECTRONS, rel=0.25)


def test_more_noise_of_red_by_a_white_balance_is_found() -> None:
    even, red = (noise_of(98, (gain, 1, 1)) for gain in (1, 2))
    own, other = (
        each[0][0].electrons_per_level / each[1][0].electrons_per_level for each in (red, even)
    )
    assert own < 0.85 * other
