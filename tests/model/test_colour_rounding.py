"""What JPEG files make of the noise of colours, beside the files of a library."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.evidence.lost_detail import chroma_steps
from camctl.model.colour_rounding import ColourRounding, phase_variance

#: Frames of one colour each, and pixels on each of their sides.
FRAMES, SIDE = 60, 96


def blocks_of(pixels: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return blocks of 8 x 8 pixels, (blocks, 64)."""
    count = SIDE // 8
    blocks = pixels.reshape(count, 8, count, 8).swapaxes(1, 2)
    return blocks.reshape(-1, 64).astype(np.float64)


@pytest.mark.parametrize(
    ("quality", "noise", "ratios"),
    [
        (90, 1.5, (3.0, 1.0, 0.5)),
        (90, 7.0, (1.0, 1.0, 1.0)),
        (98, 1.5, (1.0, 1.0, 1.0)),
        (98, 3.0, (3.0, 1.0, 0.5)),
    ],
)
def test_a_file_changes_the_noise_of_colours_as_its_steps_say(
    quality: int, noise: float, ratios: tuple[float, float, float]
) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    rng = np.random.default_rng(0)
    each = noise * np.sqrt(np.array(ratios) / min(ratios))
    variances: list[list[NDArray[np.float64]]] = [[], [], []]
    for _ in range(FRAMES):
        mean = rng.uniform(100, 140, 3)
        pixels = np.rint(mean + each * rng.standard_normal((SIDE, SIDE, 3))).astype(np.uint8)
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        data = cv2.imencode(".jpg", pixels[..., ::-1], options)[1].tobytes()
        decoded = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), 1))[..., ::-1]
        for colour, found in enumerate(variances):
            found.append(blocks_of(decoded[..., colour]).var(axis=1, ddof=1))
    tables = image.open(io.BytesIO(data)).quantization
    steps, chroma = (tuple(float(step) for step in tables[at]) for at in (0, 1))
    for colour, found in enumerate(variances):
        others = tuple(ratio / ratios[colour] for ratio in ratios)
        file = ColourRounding(steps, chroma_steps=chroma, colour=colour, noise=others)
        before = np.array([each[colour] ** 2 + 1 / 12])
        every = np.concatenate(found)
        # 8,640 blocks show the mean to 0.5 %; rounding of Cb and of Cr is the same in all blocks of
        # a frame.
        assert every.mean() == pytest.approx(file.within(before)[0], rel=0.05)
        if noise >= 3:
            scatter = file.scatter(before)[0] * np.sqrt(2 / 63)
            assert every.std() == pytest.approx(scatter, rel=0.06)


@pytest.mark.parametrize("colour", [0, 1, 2])
def test_errors_of_colours_hold_what_rounding_does_to_whole_blocks(colour: int) -> None:
    rng = np.random.default_rng(1)
    steps = (2.0,) * 64
    file = ColourRounding(steps, chroma_steps=steps, colour=colour)
    square = 0.0
    for _ in range(FRAMES):
        mean = rng.uniform(80, 120, 3)
        pixels = np.rint(mean + 4 * rng.standard_normal((SIDE, SIDE, 3))).astype(np.uint8)
        decoded = np.asarray(_through(pixels, 2))
        square += float(np.mean((decoded[..., colour] - mean[colour]) ** 2)) / FRAMES
    # Decoders round Y, Cb, Cr and the colour.
    decoding = (2 + (1.402**2, 0.344136**2 + 0.714136**2, 1.772**2)[colour]) / 12
    assert square == pytest.approx(file.error(np.array([16.0]))[0] + decoding, rel=0.03)


def _through(pixels: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Return what a file with one step for all frequencies makes of colours."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    file = io.BytesIO()
    tables = {0: [step] * 64, 1: [step] * 64}
    image.fromarray(pixels).save(file, "JPEG", qtables=tables, subsampling="4:2:0")
    return np.asarray(image.open(file).convert("RGB"))


@pytest.mark.parametrize("quality", [75, 90, 98])
def test_steps_of_chroma_are_those_of_a_library(quality: int) -> None:
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
    data = io.BytesIO()
    image.new("RGB", (16, 16)).save(data, "JPEG", quality=quality)
    tables = image.open(data).quantization
    found = chroma_steps(np.array(tables[0], np.float64))
    # Encoders round each step, and the scale is known from rounded steps.
    assert np.abs(found - np.array(tables[1])).max() <= 1


def test_rounding_depends_on_the_phase_where_noise_is_small() -> None:
    rng = np.random.default_rng(2)
    variance = np.array([0.0, 0.1, 0.3]) ** 2
    phases = (np.arange(64) + 0.5) / 64
    for noise, found in zip(np.sqrt(variance), phase_variance(variance), strict=True):
        rounded = np.rint(phases[:, np.newaxis] + noise * rng.standard_normal((64, 20000)))
        assert rounded.var(axis=1).var() == pytest.approx(found, rel=0.05, abs=1e-9)
