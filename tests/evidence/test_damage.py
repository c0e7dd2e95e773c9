"""Frames that were damaged on their way; things that move and noise are no damage."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.evidence.damage import damaged_share
from camctl.evidence.patches import sample_patches
from camctl.model.noise import FrameNoise

BITS, RATIO = 10, 4.0
WHITE = (1 << BITS) - 1
NOISE = FrameNoise(10.0, 1.0, black=0)


def scene(seed: int, contrast: float = 0.24, blur: float = 0.7) -> NDArray[np.float64]:
    """Return white noise behind the blur of a lens, pixels."""
    texture = np.random.default_rng(seed).uniform(0, contrast, (480, 640))
    return np.asarray(cv2.GaussianBlur(texture, (0, 0), blur) if blur else texture)


def shot(E: NDArray[np.float64], exposure: float, seed: int) -> NDArray[np.uint16]:
    """Return a frame with photon and read noise, by numpy's generators."""
    random = np.random.default_rng(seed)
    electrons = random.poisson(E * exposure * WHITE * NOISE.electrons_per_level)
    values = electrons / NOISE.electrons_per_level + random.normal(
        0, NOISE.read_noise_levels, E.shape
    )
    return np.clip(np.rint(values), 0, WHITE).astype(np.uint16)


def shares(frames: list[NDArray[np.uint16]]) -> list[float]:
    """Return which share of each of two frames shows no scene."""
    short, long = (sample_patches([each], WHITE) for each in frames)
    return [damaged_share(short, [long], WHITE + 1), damaged_share(long, [short], WHITE + 1)]


@pytest.mark.parametrize(("damaged", "share"), [(0, 0.1), (0, 1.0), (1, 0.1), (1, 0.5)])
def test_the_damaged_frame_is_found(damaged: int, share: float) -> None:
    frames = [shot(scene(1), exposure, k) for k, exposure in enumerate((1.0, RATIO))]
    rest = frames[damaged][round(480 * (1 - share)) :]
    rest[...] = np.random.default_rng(9).integers(0, WHITE, rest.shape, np.uint16, endpoint=True)
    found = shares(frames)
    assert found[damaged] == pytest.approx(share, rel=0.05)  # two tests of 1 % each; blocks of 8
    assert found[1 - damaged] == 0.0


@pytest.mark.parametrize("blur", [0.0, 0.5])
@pytest.mark.parametrize("contrast", [0.12, 1.0])
def test_texture_that_rests_or_moves_and_noise_are_no_damage(contrast: float, blur: float) -> None:
    """Without a blur, as by no lens, the other frame shows that it is texture: it rests."""
    texture = [scene(k, contrast, blur) for k in (1, 2)]
    after = texture[0].copy()
    if blur:
        after[100:300, 100:400] = texture[1][100:300, 100:400]  # as leaves in the wind
        after[320:420, 100:400] = 0.2  # a card without texture
    assert shares([shot(texture[0], 1.0, 1), shot(after, RATIO, 2)]) == [0.0, 0.0]
    assert shares([shot(texture[0], RATIO, 1), shot(after, RATIO**2, 2)]) == [0.0, 0.0]
