"""The darkest light that photographs show, which decides the range of their picture."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.model.response.camera import linear_response
from camctl.photographs.merge import darkest_light

BLACK, TIMES = 512, (0.01, 0.04, 0.16)
LEVELS = linear_response(12)
RNG = np.random.default_rng(4)


def found(light: NDArray[np.floating], noise: float, dead: float = 0.0) -> float:
    """Return the darkest light of photographs of patches; full scale in 1 s is 1.

    Args:
        light: of the samples, (patches, samples)
        noise: standard deviation of all samples, levels
        dead: share of the samples that are 0 whatever the light is
    """
    broken = RNG.random(light.shape) < dead
    patches = [
        np.where(
            broken,
            0,
            np.clip(BLACK + 4096 * light * time + RNG.normal(0, noise, light.shape), 0, 4607),
        )
        for time in TIMES
    ]
    controls = SimpleNamespace(black=BLACK, plane_levels=[LEVELS])
    camera = cast(Any, SimpleNamespace(controls=controls, times_s=TIMES))
    return darkest_light(camera, [np.rint(each).astype(np.uint16) for each in patches])


SCENE = np.geomspace(1e-5, 90.0, 800)[:, np.newaxis].repeat(64, axis=1)
"""Of a hundredth of a level in the longest photograph to nearly white in the shortest one."""


@pytest.mark.parametrize("noise", [4.0, 20.0])
def test_light_below_the_noise_of_the_longest_photograph_is_not_shown(noise: float) -> None:
    assert found(SCENE, noise) == pytest.approx(noise / 4096 / TIMES[-1], rel=0.2)


def test_without_noise_half_a_level_is_the_darkest() -> None:
    assert found(SCENE, 0.0) == pytest.approx(0.5 / 4096 / TIMES[-1], rel=0.01)


def test_light_above_the_noise_and_faults_of_pixels_do_not_change_it() -> None:
    bright = SCENE[SCENE[:, 0] > 0.5]
    expected = float(np.quantile(bright, 0.005))
    assert found(bright, 4.0) == pytest.approx(expected, rel=0.1)
    assert found(bright, 4.0, dead=0.002) == pytest.approx(expected, rel=0.2)
