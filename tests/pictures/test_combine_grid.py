"""Frames of 10 bits that are shifted into 16 bits, combined."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.model.noise import FrameNoise, NoiseModel

TIMES = (1.0, 4.0, 16.0)
BLACK, STEP, WHITE = 16, 64, 1023
ELECTRONS = 400.0
LIGHT = np.tile(np.geomspace(0.3, WHITE - BLACK, 512), (128, 1))  # levels at exposure 1


def shot(read_noise: float = 0.1, seed: int = 0) -> list[NDArray[Any]]:
    """Return frames of 10 bits whose noise is a small part of a level in the dark."""
    rng = np.random.default_rng(seed)
    frames = []
    for time in TIMES:
        levels = rng.poisson(LIGHT * time * ELECTRONS) / ELECTRONS
        levels += rng.normal(0, read_noise, LIGHT.shape) + BLACK
        frames.append(np.clip(np.rint(levels), 0, WHITE).astype(np.uint16))
    return frames


def shifted(frames: list[NDArray[Any]], first: int = 0) -> list[NDArray[Any]]:
    return [each * np.uint16(STEP) + np.uint16(first) for each in frames]


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("first", [0, 23])
def test_standard_deviations_are_true(is_known: bool, first: int) -> None:
    noise = FrameNoise(ELECTRONS / STEP, 0.1 * STEP) if is_known else None
    black, white = BLACK * STEP + first, WHITE * STEP + first
    found = camctl.combine(shifted(shot(), first), TIMES, black=black, white=white, noise=noise)
    light = LIGHT * STEP / (white - black + 1)
    z = (found.irradiance - light) / found.sd
    dark_to_bright = [
        part[np.isfinite(part) & (marks & 3 == 0)].std()
        for part, marks in zip(np.split(z, 8, axis=1), np.split(found.mask, 8, axis=1), strict=True)
    ]
    assert min(dark_to_bright) > 0.85
    assert max(dark_to_bright) < 1.07
    assert np.mean(found.mask & 4 > 0) < 0.002
    assert not found.findings


@pytest.mark.parametrize(
    ("is_known", "white", "method"),
    [
        (True, 65472, "likelihood"),
        (False, 65535, "likelihood"),
        (False, 65472, "likelihood"),
        (True, 65535, "sum"),
        (False, 65472, "sum"),
    ],
)
def test_they_give_what_10_bits_give(is_known: bool, white: int, method: str) -> None:
    """White is the largest value of 10 bits, or of 16 bits, which some drivers put there."""
    frames = shot(0.8)
    noises = (NoiseModel(ELECTRONS, ((1.0, 320.0),)), NoiseModel(ELECTRONS / STEP, ((1.0, 320.0),)))
    known = noises if is_known else (None, None)
    plain = camctl.combine(frames, TIMES, black=BLACK, white=WHITE, noise=known[0], method=method)
    given = shifted(frames)
    if white == 65535:
        given = [np.where(each == WHITE * STEP, np.uint16(white), each) for each in given]
    found = camctl.combine(
        given, TIMES, black=BLACK * STEP, white=white, noise=known[1], method=method
    )
    unit = (WHITE - BLACK + 1) * STEP / (white - BLACK * STEP + 1)
    for one, other in ((found.irradiance, plain.irradiance), (found.sd, plain.sd)):
        np.testing.assert_allclose(one, other * np.float32(unit), rtol=1e-5)
    assert (found.mask == plain.mask).all()
    assert (found.sum == plain.sum.astype(np.uint32) * STEP).all()
    assert found.findings == plain.findings
    for one_noise, other_noise in zip(found.noise, plain.noise, strict=True):
        electrons = other_noise[0].electrons_per_level / STEP
        assert one_noise[0].electrons_per_level == pytest.approx(electrons)
        read_noise = other_noise[0].read_noise_levels * STEP
        assert one_noise[0].read_noise_levels == pytest.approx(read_noise)
        assert one_noise[0].black == BLACK * STEP


def test_levels_that_frames_show_are_those_of_16_bits() -> None:
    frames = [np.minimum(each, 900) for each in shot(0.8)]
    plain = camctl.combine(frames, TIMES, black=12, white=WHITE).findings
    found = camctl.combine(shifted(frames), TIMES, black=12 * STEP, white=65535).findings
    assert [each.details["level"] for each in plain] == ["black", "white"]
    assert [each.value for each in found] == [(each.value or 0) * STEP for each in plain]
    assert [each.details["stated"] for each in found] == [12 * STEP, 65535]


def test_colours_with_curves_of_their_own() -> None:
    frames = [np.stack([each] * 3, axis=-1) for each in shot(0.8)]
    curves = [camctl.standard_response("linear", 16) for _ in range(3)]
    found = camctl.combine(shifted(frames), TIMES, response=curves)
    plain = camctl.combine(frames, TIMES, response="linear", white=WHITE)
    used = found.mask & 3 == 0
    np.testing.assert_allclose(found.irradiance[used], plain.irradiance[used], rtol=1e-2)
