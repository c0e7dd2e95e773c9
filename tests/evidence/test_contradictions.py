"""Places at which one photograph contradicts the others of its series."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.evidence.contradictions import contradictions
from camctl.evidence.patches import sample_patches
from camctl.findings import Finding
from camctl.model.response.camera import standard_response
from camctl.model.sensor import SensorModel

RESPONSE = standard_response("srgb", 8)
SCALE = SensorModel(RESPONSE, 0)
TIMES = (1.0, 2.0, 4.0, 8.0, 16.0)


def found(changes: dict[int, tuple[int, int, float]]) -> list[Finding]:
    """Return the findings in a series of which photographs have a square of another light.

    `changes` gives its top row, left column and light by the position of a photograph; it has 60
    pixels a side.
    """
    rng = np.random.default_rng(5)
    scene = np.exp(rng.normal(-3.5, 1, (24, 32, 3))).repeat(16, 0).repeat(16, 1)
    patches = []
    for k, time_s in enumerate(TIMES):
        light: NDArray[np.float64] = scene.copy()
        if k in changes:
            top, left, other = changes[k]
            light[top : top + 60, left : left + 60] = other
        exposed = light * time_s / 4
        noisy = exposed + np.sqrt(exposed / 5000) * rng.normal(size=light.shape)
        pixels = np.searchsorted(RESPONSE.levels, noisy, side="right").astype(np.uint8)
        patches.append(sample_patches([pixels[..., c] for c in range(3)], 255))
    return contradictions(TIMES, patches, SCALE, [(384, 512)] * 3)


def test_photographs_of_one_scene_do_not_contradict_each_other() -> None:
    """Nor do patches of which the longer ones saturate some samples."""
    assert found({}) == []


@pytest.mark.parametrize(
    ("changed", "light"), some([(0, 0.12), (1, 0.004), (2, 0.12), (3, 0.12), (4, 0.004)], every=4)
)
def test_the_photograph_and_the_place_are_named(changed: int, light: float) -> None:
    (finding,) = found({changed: (200, 300, light)})
    assert (finding.code, finding.frames) == ("part_differs", (changed,))
    place = finding.place
    assert place is not None
    edges = [place.left, place.right, place.top, place.bottom]
    assert edges == pytest.approx([300, 360, 200, 260], abs=26)


def test_two_of_five_photographs_with_the_same_change_are_not_named() -> None:
    assert found({1: (200, 300, 0.1), 2: (200, 300, 0.1)}) == []
