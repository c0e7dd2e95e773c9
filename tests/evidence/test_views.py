"""Photographs that do not show what the others of a set show are found by their fine structure."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.views import likenesses, unlike_each_other, unlike_others
from camctl.model.response.camera import standard_response

Light = NDArray[np.float64]
EXPOSURES = (1.0, 2.0, 4.0, 8.0, 16.0)
ROWS, COLUMNS = 320, 480


def scene(seed: int = 0) -> Light:
    """Return irradiance over three decades with fine and coarse structure, (rows, columns)."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.normal(size=(4, 6)), (COLUMNS, ROWS), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(size=(ROWS, COLUMNS)), (0, 0), 1.5)
    E = np.exp(1.2 * coarse + 1.5 * fine)
    return np.asarray(E / np.quantile(E, 0.995))


def gravel() -> Light:
    """Return irradiance with fine structure of high contrast everywhere, (rows, columns)."""
    light = np.exp(1.2 * blurred(np.random.default_rng(0).normal(size=(ROWS, COLUMNS))) * 7.1)
    return np.asarray(light / np.quantile(light, 0.995))


def blurred(light: Light, sigma: float = 2.0) -> Light:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    return np.asarray(cv2.GaussianBlur(light, (0, 0), sigma))


def bracket(
    changed: int | None = None,
    change: Callable[[Light], Light] = lambda light: light,
    exposures: tuple[float, ...] = EXPOSURES,
    electrons: float = 5000,
    shown: Callable[[], Light] = scene,
) -> list[Patches]:
    """Return patches of photographs of which one shows something else."""
    rng, light = np.random.default_rng(1), shown()
    levels = standard_response("srgb", 8).levels
    found = []
    for k, exposure in enumerate(exposures):
        E = (change(light) if k == changed else light) * exposure / 4
        E = E + np.sqrt(E / electrons) * rng.normal(size=E.shape)
        codes = np.searchsorted(levels, np.clip(E, 0, 1.001), side="right")
        found.append(sample_patches([codes], 255))
    return found


def test_exposures_of_one_scene_are_alike() -> None:
    found = likenesses(bracket(), 1, 0, 255)
    assert len(found) >= 7
    assert all(0.95 < each.sharpness < 1.05 and each.is_same for each in found.values())
    assert unlike_others(found, 5) == {}
    assert unlike_each_other(found, 5) is None


def test_noise_makes_no_other_view() -> None:
    """Of ISO 12,800: 12 levels in the dark photographs."""
    found = likenesses(bracket(electrons=60), 1, 0, 255)
    assert unlike_others(found, 5) == {}
    assert unlike_each_other(found, 5) is None


@pytest.mark.parametrize("place", some(range(5), every=2))
def test_another_view_is_named(place: int) -> None:
    """In turn a picture that is mirrored, upside down, or of another scene."""
    changes: list[Callable[[Light], Light]] = [
        lambda light: light[:, ::-1],
        lambda light: light[::-1, ::-1],
        lambda light: scene(7),
    ]
    change = changes[place % 3]
    found = unlike_others(likenesses(bracket(place, change), 1, 0, 255), 5)
    assert {k: each.code for k, each in found.items()} == {place: "other_view"}
    assert found[place].frames == (place,)


@pytest.mark.parametrize("place", some(range(5), every=2))
def test_a_photograph_out_of_focus_is_named(place: int) -> None:
    found = unlike_others(likenesses(bracket(place, blurred), 1, 0, 255), 5)
    assert {k: each.code for k, each in found.items()} == {place: "blurred"}
    assert (found[place].value or 1) < 0.9


@pytest.mark.parametrize("place", some(range(4), every=3))
def test_strong_blur_is_named_where_it_changes_brightness(place: int) -> None:
    """Of the brightest photograph it is not: noise of the darker ones may look the same."""
    patches = bracket(place, partial(blurred, sigma=4.0), shown=gravel)
    found = likenesses(patches, 1, 0, 255)
    assert min(each.resting for pair, each in found.items() if place in pair) < 0.9
    named = unlike_others(found, 5)
    assert {k: each.code for k, each in named.items()} == {place: "blurred"}


@pytest.mark.parametrize("share", [0.2, 0.45])
@pytest.mark.parametrize("place", range(3))
def test_a_large_thing_that_moved_is_no_other_view(place: int, share: float) -> None:
    def covered(light: Light) -> Light:
        changed = light.copy()
        changed[:, : round(share * COLUMNS)] = scene(3)[:, : round(share * COLUMNS)]
        return changed

    found = likenesses(bracket(place, covered, (1.0, 2.0, 4.0)), 1, 0, 255)
    assert unlike_others(found, 3) == {}
    assert unlike_each_other(found, 3) is None


def test_a_thing_that_alone_has_fine_structure_is_no_other_view() -> None:
    """All of the structure moves, and none of it correlates."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")

    def fog(light: Light) -> Light:
        return np.asarray(cv2.GaussianBlur(light, (0, 0), 30))

    def crossing(light: Light, left: int) -> Light:
        changed = fog(light)
        changed[60:260, left : left + 140] = light[:200, left : left + 140]
        return changed

    patches = [
        bracket(0, partial(crossing, left=left), (exposure,))[0]
        for left, exposure in ((20, 2.0), (170, 4.0), (320, 8.0))
    ]
    found = likenesses(patches, 1, 0, 255)
    assert found
    assert unlike_others(found, 3) == {}
    assert unlike_each_other(found, 3) is None


def test_of_two_photographs_none_is_the_odd_one() -> None:
    found = likenesses(bracket(1, lambda light: light[:, ::-1], (1.0, 2.0)), 1, 0, 255)
    assert unlike_others(found, 2) == {}
    assert unlike_each_other(found, 2) == (0, 1)


def test_photographs_smaller_than_a_patch_with_structure_are_not_compared() -> None:
    patches = [sample_patches([np.full((9, 9), level, np.uint8)], 255) for level in (20, 40)]
    assert likenesses(patches, 1, 0, 255) == {}


def test_noise_does_not_hide_another_view() -> None:
    """Of ISO 3,200, mirrored: its fine structure is noise in the darker ones."""
    found = likenesses(bracket(2, lambda light: light[:, ::-1], electrons=300), 1, 0, 255)
    assert {k: each.code for k, each in unlike_others(found, 5).items()} == {2: "other_view"}
