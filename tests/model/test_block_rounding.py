"""What JPEG files make of noise, beside the files of a library."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.model.block_rounding import BlockRounding


def blocks_of(pixels: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return blocks of 8 x 8 pixels, (blocks, 64)."""
    rows, columns = (length // 8 for length in pixels.shape)
    blocks = pixels.reshape(rows, 8, columns, 8).swapaxes(1, 2)
    return blocks.reshape(-1, 64).astype(np.float64)


@pytest.mark.parametrize("noise", [1.0, 1.5, 3.0, 7.0])
@pytest.mark.parametrize("quality", [90, 95, 98])
def test_a_file_changes_noise_as_its_steps_say(quality: int, noise: float) -> None:
    rng = np.random.default_rng(0)
    mean = 120 + rng.uniform(-0.5, 0.5, (64, 64)).repeat(8, axis=0).repeat(8, axis=1)
    pixels = np.rint(mean + noise * rng.standard_normal(mean.shape)).astype(np.uint8)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    steps = image.open(io.BytesIO(data)).quantization[0]
    file = BlockRounding(tuple(float(each) for each in steps))
    decoded = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), 0))
    variances = blocks_of(decoded).var(axis=1, ddof=1)
    before = np.array([noise**2 + 1 / 12])
    # 4,096 blocks show the mean to 0.3 to 1 %, and the deviation to 1.1 % and more.
    assert variances.mean() == pytest.approx(file.within(before)[0], rel=0.03)
    scatter = file.scatter(before)[0] * np.sqrt(2 / 63)
    assert variances.std() == pytest.approx(scatter, rel=0.06)
    errors = np.var(decoded - mean)
    assert errors == pytest.approx(file.error(np.array([noise**2]))[0], rel=0.05, abs=0.1)


def test_contrast_leaves_errors_of_whole_steps() -> None:
    file = BlockRounding((8.0,) * 64)
    few = np.array([0.25])
    assert file.error(few)[0] < 0.2
    even = BlockRounding((8.0,) * 64, contrast=1.0)
    assert even.error(few)[0] == pytest.approx(0.25 + 1 / 12 + 64 / 12, rel=0.02)
