"""What is found on the pixels of photographs before they are merged."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.captures.photograph_alignment import misaligned
from camctl.captures.photograph_checks import Sight, unstated
from camctl.captures.photographs import Photograph


def test_a_shift_is_that_of_the_whole_picture_where_tiles_have_lines_of_one_direction() -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    rng = np.random.default_rng(1)
    across, down = (
        np.convolve(rng.normal(0, 50, length + 4), np.full(5, 0.2), "valid")
        for length in (480, 360)
    )
    scene = np.full((360, 480), 110.0) + across
    scene[:, 320:] = 110 + down[:, np.newaxis]
    photographs = [Photograph("a", 1.0), Photograph("b", 1.25)]
    sights = []
    for photograph, shift in zip(photographs, ((0, 0), (5, 9)), strict=True):
        light = np.roll(scene, shift, (0, 1)) * photograph.time_s
        noisy = np.clip(np.rint(light + rng.normal(0, 2, scene.shape)), 0, 255)
        sights.append(Sight.of(photograph, noisy.astype(np.uint8), 255))
    (line,) = misaligned(sights)
    assert line.startswith("b is shifted against a by about +9 columns and +5 rows")


def test_what_only_some_photographs_state_is_named() -> None:
    alike = [Photograph("a", 1.0, 2.0, 8.0, iso=200.0), Photograph("b", 2.0, 2.0, 8.0, iso=200.0)]
    assert unstated(alike) == []
    assert unstated([Photograph("a", 1.0), Photograph("b", 2.0)]) == []
    lines = unstated([*alike, Photograph("c", 4.0, 1.0, 8.0), Photograph("d", 8.0, 2.0, iso=200.0)])
    assert lines == [
        "c states no ISO speed, and others do: ISO 100 is assumed",
        "d states no f-number, and others do: f/1 is assumed",
    ]


def bracket(shifted: int | None, columns: int = 9) -> list[Sight]:
    """Return a bracket of a scene with few lights, in which noise hides most of the rest."""
    rng = np.random.default_rng(2)
    scene = np.exp(rng.normal(0, 1, (45, 60)).repeat(8, 0).repeat(8, 1)) * 8
    sights = []
    for k, time_s in enumerate((1.0, 2.0, 4.0, 8.0)):
        light = np.roll(scene, columns, 1) if k == shifted else scene
        noisy = np.clip(np.rint(light * time_s / 4 + 13 + rng.normal(0, 2, scene.shape)), 0, 255)
        sights.append(Sight.of(Photograph(f"p{k}", time_s), noisy.astype(np.uint8), 255))
    return sights


@pytest.mark.parametrize("shifted", [0, 1, 2, 3])
def test_the_photograph_that_is_not_where_the_others_are_is_named(shifted: int) -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    (line,) = misaligned(bracket(shifted))
    assert line.startswith(f"p{shifted} is shifted against p")
    assert "by about +9 columns" in line


def test_noise_is_no_shift() -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    assert misaligned(bracket(None)) == []
