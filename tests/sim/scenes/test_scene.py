"""Scenes: what they claim, and one clear line for each bad one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.errors import DataError, UsageError
from sim.scenes.drawings import DRAWINGS
from sim.scenes.scene import (
    HIGHLIGHT_PHOTONS_S,
    LUMINANCE,
    PHOTONS,
    RELATIVE,
    Scene,
    load_scene,
    scene_names,
)


@pytest.mark.parametrize("name", scene_names())
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (48, 64), (61, 37)])
def test_every_built_in_scene_is_light_at_any_size(name: str, shape: tuple[int, int]) -> None:
    scene = load_scene(name, shape)
    assert scene.shape == shape
    assert scene.irradiance.dtype == np.float32
    assert np.all(np.isfinite(scene.irradiance))
    assert np.all(scene.irradiance > 0)
    assert scene.unit in (PHOTONS, LUMINANCE)
    assert scene.photons_per_unit == 1.0


def test_names_are_those_of_the_paper_and_the_hard_ones() -> None:
    assert set(scene_names()) == {
        "ball",
        "cloth",
        "colour-chart",
        "moving-target",
        "night-street",
        "ramp",
        "room",
        "stars",
        "tile-floor",
        "uniform",
    }
    for name in scene_names():
        assert load_scene(name, (6, 8)).name == name


def test_ramp_is_linear() -> None:
    light = load_scene("ramp", (5, 100)).irradiance / HIGHLIGHT_PHOTONS_S
    assert np.allclose(light, (np.arange(100) + 0.5) / 100, rtol=1e-6)


def test_uniform_is_uniform() -> None:
    assert np.unique(load_scene("uniform", (5, 7)).irradiance).tolist() == [HIGHLIGHT_PHOTONS_S]


def test_tile_floor_runs_over_a_thousand_to_one_between_its_own_tiles() -> None:
    light = load_scene("tile-floor", (480, 640)).irradiance
    assert light.ndim == 2
    near, far = np.median(light[-60:, :60]), np.median(light[:60, -60:])
    assert near / far > 1000


def test_room_has_a_window_ten_thousand_times_its_dark_corner() -> None:
    scene = load_scene("room", (480, 640))
    assert scene.is_coloured
    low, high = np.quantile(scene.irradiance, [0.02, 0.99])
    assert high / low > 10_000


def test_ball_is_matte_but_for_a_highlight() -> None:
    light = load_scene("ball", (480, 640)).irradiance.max(axis=2) / HIGHLIGHT_PHOTONS_S
    assert light.max() > 5
    assert 0.0005 < np.mean(light > 1) < 0.01


def test_cloth_is_white_and_soft() -> None:
    light = load_scene("cloth", (480, 640)).irradiance / HIGHLIGHT_PHOTONS_S
    assert np.median(light) > 0.4
    assert np.abs(np.diff(light, axis=1)).max() < 0.1


def test_a_scene_looks_alike_at_another_size() -> None:
    for name in scene_names():
        small = load_scene(name, (60, 80)).irradiance
        large = load_scene(name, (240, 320)).irradiance
        small, large = np.log(np.atleast_3d(small)), np.log(np.atleast_3d(large))
        binned = large.reshape(60, 4, 80, 4, -1).mean(axis=(1, 3))
        assert np.median(np.abs(small - binned)) < 0.1, name


def test_an_unknown_name_is_told_the_near_ones() -> None:
    with pytest.raises(UsageError, match="did you mean tile-floor"):
        load_scene("tilefloor")


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (-1, 5)])
def test_a_size_without_pixels_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(UsageError, match="1 or more"):
        load_scene("ramp", shape)


def test_a_gigantic_scene_is_refused_before_it_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    def must_not_run(rows: int, columns: int) -> np.ndarray:
        raise AssertionError("drawn")

    monkeypatch.setitem(DRAWINGS, "ramp", must_not_run)
    with pytest.raises(DataError, match="GiB"):
        load_scene("ramp", (1_000_000, 1_000_000))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.full((2, 3), np.nan), "6 of 6 pixels are NaN"),
        (np.array([[1.0, np.inf]]), "1 of 2 pixels is infinite"),
        (np.array([[1.0, 1e300]]), "beyond float32"),
        (np.array([[1.0, -2.0, -1.0]]), "2 of 3 pixels are negative.*clip"),
        (np.zeros((2, 2)), "nothing in it"),
        (np.zeros((0, 2)), "nothing in it"),
        (np.ones(5), "its array is 5;"),
        (np.float64(5), "a single number"),
        (np.ones((2, 2, 4)), "2 x 2 x 4"),
        (np.array([["a"]]), "not numbers"),
        (np.array([[1j]]), "not numbers"),
    ],
)
def test_bad_light_is_one_clear_line(bad: np.ndarray, message: str) -> None:
    with pytest.raises(DataError, match=message) as error:
        Scene("s", bad)
    assert "\n" not in str(error.value)


@given(st.integers(1, 30), st.integers(1, 30), st.data())
def test_the_number_of_bad_pixels_is_told_exactly(
    rows: int, columns: int, data: st.DataObject
) -> None:
    light = np.ones((rows, columns, 3), dtype=np.float32)
    bad = data.draw(st.integers(1, rows * columns))
    light.reshape(-1, 3)[:bad, data.draw(st.integers(0, 2))] = -1
    with pytest.raises(DataError, match=f"{bad} of {rows * columns} pixels"):
        Scene("s", light)


def test_one_channel_may_stand_last() -> None:
    assert Scene("s", np.ones((4, 5, 1), dtype=np.float32)).irradiance.shape == (4, 5)


def test_a_relative_map_is_lit_so_that_its_highlights_are_bright(tmp_path: Path) -> None:
    light = np.geomspace(1e-5, 1e3, 10_000, dtype=np.float32).reshape(100, 100)
    np.save(tmp_path / "map.npy", light)
    scene = load_scene(tmp_path / "map.npy")
    assert scene.unit == RELATIVE
    assert np.array_equal(scene.irradiance, light)
    highlight = np.quantile(light, 0.999)
    assert scene.photons_per_unit * highlight == pytest.approx(HIGHLIGHT_PHOTONS_S)


def test_a_file_has_a_size_of_its_own(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.ones((3, 3)))
    with pytest.raises(UsageError, match="size of its own"):
        load_scene(tmp_path / "map.npy", (5, 5))
