"""What files lose of fine detail, told from their own pixels."""

from __future__ import annotations

import io
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from camctl.evidence.lost_detail import LEVELS, frequencies, lost_details, quantisation
from camctl.evidence.patches import SIDE

Floats = NDArray[np.float32]


def texture(noise: float, seed: int) -> NDArray[np.uint8]:
    """Return detail of all sizes, more of it in some places than in others."""
    rng = np.random.default_rng(0)
    found = np.zeros((384, 512))
    for octave in range(1, 7):
        grains = rng.normal(0, 5, (384 >> octave, 512 >> octave))
        found += cv2.resize(grains, (512, 384), interpolation=cv2.INTER_CUBIC)
    where = cv2.resize(rng.lognormal(0, 1, (6, 8)), (512, 384), interpolation=cv2.INTER_CUBIC)
    found = found * np.maximum(where, 0)
    found = 128 + 100 * np.tanh(found / 100)
    found += np.random.default_rng(seed).normal(0, noise, found.shape)
    return np.rint(found).astype(np.uint8)


def kept(pixels: NDArray[np.uint8], quality: int) -> tuple[NDArray[np.uint8], NDArray[np.int_]]:
    """Return the picture as a JPEG file keeps it, and the steps of the file."""
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    steps = Image.open(io.BytesIO(data.tobytes())).quantization[0]  # type: ignore[attr-defined]
    return np.asarray(cv2.imdecode(data, 0), np.uint8), np.array(steps)


def blocks_of(pixels: NDArray[np.generic]) -> Floats:
    rows, columns = (length // SIDE for length in pixels.shape)
    blocks = pixels.reshape(rows, SIDE, columns, SIDE).swapaxes(1, 2)
    return blocks.reshape(-1, SIDE, SIDE).astype(np.float32)


@pytest.mark.parametrize(("quality", "noise"), [(75, 3.0), (90, 0.7), (95, 3.0)])
def test_what_two_files_lose_alike_is_known_from_one(quality: int, noise: float) -> None:
    scene = np.asarray(texture(0, 0), np.float64)
    errors = [kept(texture(noise, seed), quality)[0] - scene for seed in (1, 2)]
    both = blocks_of(errors[0] * errors[1]).mean(axis=(1, 2))
    pixels = kept(texture(noise, 1), quality)[0]
    known = np.full(LEVELS, math.hypot(noise, 12**-0.5))
    steps = quantisation([frequencies(blocks_of(pixels))])
    assert steps is not None
    (detail,) = lost_details([blocks_of(pixels)], steps, [known])
    found = detail.of_picture(*[pixels.astype(np.float32)] * 2).ravel()
    for some in (found >= 0, found > np.quantile(found, 0.8)):
        expected, real = (each[some].mean() + noise**2 for each in (found, both))
        assert expected == pytest.approx(real, rel=0.25)


@pytest.mark.parametrize("quality", [75, 90, 95])
def test_steps_are_seen_in_the_pixels(quality: int) -> None:
    pixels, steps = kept(texture(0.7, 1), quality)
    found = quantisation([frequencies(blocks_of(pixels))])
    assert found is not None
    # Those that no block shows are known from the others.
    np.testing.assert_allclose(found[1:], steps[1:], rtol=0.04)


def test_without_blocks_nothing_is_known() -> None:
    pixels = kept(texture(0.7, 1), 90)[0]
    for each in (texture(0.7, 1), pixels[3:-5, 2:-6]):
        assert quantisation([frequencies(blocks_of(each))]) is None
