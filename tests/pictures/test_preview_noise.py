"""What the preview filters out: noise that pixels have of their own, no details and no grain."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from picture_parts import light_of

from camctl.pictures.preview import renditions
from camctl.system.picture_operations import box_means

RNG = np.random.default_rng(3)
SHAPE = (240, 320, 3)
LEVEL = np.geomspace(0.02, 1.0, SHAPE[1])[:, np.newaxis] * np.array([0.7, 1.0, 0.5])


def changes(light: NDArray[np.floating], stated: float) -> NDArray[np.floating]:
    """Return by how many nepers the light that is shown differs from the light."""
    found = np.log(renditions(light_of(light, stated)).light / light)
    return np.asarray(found - np.median(found))


@pytest.mark.parametrize("stated", [0.1, 0.6])
def test_an_error_that_neighbours_share_removes_no_details(stated: float) -> None:
    """The error of a response is the same in a window: its pixels have less noise than that."""
    detail = np.ones(SHAPE[:2])
    detail[:120] = np.exp(0.08 * (np.indices((120, 320)).sum(axis=0) % 2))
    shared = RNG.normal(0, 1, SHAPE).astype(np.float32)
    for _ in range(3):
        shared = box_means(shared, 30)
    shared *= stated / shared.std()
    pixels = RNG.normal(0, 0.002, SHAPE)
    light = LEVEL * detail[..., np.newaxis] * np.exp(shared + pixels)
    assert np.percentile(np.abs(changes(light, stated)), 95) < 0.01  # of 0.04


def test_details_that_the_channels_have_in_common_stay_in_their_noise() -> None:
    """A channel alone could not tell them from its noise."""
    steps = RNG.normal(0, 0.08, (80, 107)).repeat(3, 0).repeat(3, 1)[:240, :320, np.newaxis]
    steps[:, 200:] = 0
    light = LEVEL * np.exp(steps)
    noisy = light * np.exp(RNG.normal(0, 0.06, SHAPE))
    shown = np.log(renditions(light_of(noisy, 0.06)).light / light)
    textured, flat = shown[10:-10, 10:190], shown[10:-10, 210:-10]
    assert flat.std() < 0.35 * 0.06
    assert (textured - textured.mean()).std() < 0.6 * 0.06


def test_noise_of_the_pixels_is_filtered_out_beside_rough_places() -> None:
    """The smoothest windows show how large it is, here in light of each brightness."""
    rough = np.zeros(SHAPE[:2])
    rough[::60] = 1
    rough = box_means(rough.astype(np.float32), 6) > 0
    light = LEVEL * np.exp(RNG.normal(0, 0.3, SHAPE[:2]) * rough)[..., np.newaxis]
    noisy = light * np.exp(RNG.normal(0, 0.1, SHAPE))
    shown = np.log(renditions(light_of(noisy, 0.1)).light / light)
    inner = box_means(rough.astype(np.float32), 4) == 0
    assert inner.mean() > 0.1
    assert (shown[inner] - np.median(shown[inner])).std() < 0.45 * 0.1


def test_one_channel_has_no_differences() -> None:
    grey = np.broadcast_to(LEVEL[:, 1], SHAPE[:2])
    noisy = grey * np.exp(RNG.normal(0, 0.1, SHAPE[:2]))
    shown = np.log(renditions(light_of(noisy, 0.1)).light[..., 0] / grey)
    assert (shown - np.median(shown))[10:-10, 10:-10].std() < 0.35 * 0.1
