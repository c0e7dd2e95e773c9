"""Which frames keep few samples of the differences of colours, and what that loses."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from camctl.evidence.chroma import chroma_variance, has_few_chroma_samples, patch_chroma_variance
from camctl.evidence.patches import sample_patches
from camctl.interface.controls import Layout
from camctl.model.colour_rounding import ColourRounding

Picture = NDArray[np.uint8]
FEW = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420


def picture(noise: float) -> Picture:
    """Return squares of many colours, as sharp as a lens shows them."""
    rng = np.random.default_rng(0)
    colours = rng.uniform(40, 190, (16, 24, 1)) * rng.uniform(0.8, 1.2, (16, 24, 3))
    squares = np.kron(colours, np.ones((11, 11, 1)))
    squares = np.asarray(cv2.GaussianBlur(squares, (0, 0), 1.0), np.float64)
    return np.clip(squares + rng.normal(0, noise, squares.shape), 0, 255).astype(np.uint8)


def encoded(pixels: Picture, quality: int, factor: int = FEW) -> bytes:
    """Return a JPEG file, with a factor of OpenCV."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
    return cv2.imencode(".jpg", pixels[..., ::-1], options)[1].tobytes()


def kept(pixels: Picture, factor: int, quality: int = 95) -> Picture:
    """Return a picture as a JPEG file keeps it."""
    data = np.frombuffer(encoded(pixels, quality, factor), np.uint8)
    return np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1]


def variance(pixels: Picture) -> NDArray[np.float32]:
    """Return the variance of the errors of colours of each cell, (3, rows, columns)."""
    planes = np.moveaxis(pixels, 2, 0)
    return chroma_variance(
        [np.stack([p[k::2, m::2] for k in (0, 1) for m in (0, 1)]) for p in planes]
    )


@pytest.mark.parametrize(
    ("factor", "is_few"),
    [
        (None, False),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444, False),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422, True),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, True),
    ],
)
def test_few_samples_are_seen(factor: int | None, is_few: bool) -> None:
    found = picture(3.0) if factor is None else kept(picture(3.0), factor)
    rows, columns, _ = found.shape
    in_the_dark = np.pad(found, ((0, 4 * rows), (0, 4 * columns), (0, 0)), constant_values=2)
    for each in (found, found[1:, 1:], in_the_dark):  # wherever a border was cut off
        patches = sample_patches(Layout.RGB.planes(each), 255)
        assert has_few_chroma_samples([patches], 242) is is_few


def test_what_is_lost_is_estimated() -> None:
    before = picture(0.0)
    after = kept(before, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, 98)
    real = np.square(after.astype(float) - before)
    found = variance(after).repeat(2, axis=1).repeat(2, axis=2)
    for channel in range(3):
        assert 0.4 < found[channel].mean() / real[..., channel].mean() < 2.5


def test_patches_tell_what_their_cells_do() -> None:
    after = kept(picture(0.0), cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420)
    patches = sample_patches(Layout.RGB.planes(after), 255)
    ratio = patch_chroma_variance(patches).reshape(3, -1).mean(axis=1)
    ratio /= variance(after).mean(axis=(1, 2))
    assert np.all((ratio > 0.5) & (ratio < 3))


def test_noise_of_smooth_colours_is_less_contrast() -> None:
    quality, rng = 98, np.random.default_rng(1)
    smooth = np.linspace(100, 140, 256)[:, np.newaxis, np.newaxis] * (1.1, 1.0, 0.9)
    noisy = np.rint(smooth + rng.normal(0, 2.0, (256, 256, 3))).astype(np.uint8)
    after = kept(noisy, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, quality)
    planes = np.moveaxis(after, 2, 0)
    cells = [np.stack([p[k::2, m::2] for k in (0, 1) for m in (0, 1)]) for p in planes]
    steps = [
        tuple(np.ravel(each).astype(float))
        for each in Image.open(io.BytesIO(encoded(noisy, quality))).quantization.values()  # type: ignore[attr-defined]
    ]
    file = ColourRounding(steps[0], chroma_steps=steps[1], colour=1)
    noise = np.array(file.cells(np.full(256, 4 + 1 / 12)), np.float32)
    without, found = (chroma_variance(cells, each) for each in (None, noise))
    assert (found.mean(axis=(1, 2)) < 0.65 * without.mean(axis=(1, 2))).all()
