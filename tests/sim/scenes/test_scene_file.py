"""Scene files: real units, lamps and targets, and one line for each bad one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from sim.scenes.scene import LUMINANCE, PHOTONS, Scene, load_scene, scene_names
from sim.scenes.scene_file import read_scene_file

PLAIN: dict[str, Any] = {"name": "mine", "picture": "wall", "photons_s": 2e5}


def written(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({**PLAIN, **changes}))
    return path


def test_the_scenes_that_come_with_the_program_are_such_files() -> None:
    from importlib import resources

    folder = resources.files("sim") / "scenes"
    for name in scene_names():
        file = read_scene_file((folder / f"{name}.json").read_text(), source=name)
        assert file.name == name
        assert file.what


def test_a_scene_has_its_unit(tmp_path: Path) -> None:
    photons = load_scene(written(tmp_path), (12, 16))
    assert photons.unit == PHOTONS
    change = {"photons_s": None, "luminance_cd_m2": 40}
    candela = load_scene(written(tmp_path, **change), (12, 16))
    assert candela.unit == LUMINANCE
    assert np.allclose(photons.irradiance / 2e5, candela.irradiance / 40, rtol=1e-6)


def test_a_size_comes_from_the_caller_the_file_or_the_sensor(tmp_path: Path) -> None:
    assert load_scene(written(tmp_path), usual=(10, 20)).shape == (10, 20)
    assert load_scene(written(tmp_path, shape=[5, 6]), usual=(10, 20)).shape == (5, 6)
    assert load_scene(written(tmp_path, shape=[5, 6]), (7, 8)).shape == (7, 8)


def test_lamps_and_targets(tmp_path: Path) -> None:
    lamps, target = {"mains_hz": 60, "depth": 0.3}, {"size": 0.5, "crossing_s": -4.0}
    scene = load_scene(written(tmp_path, lamps=lamps, target=target), (40, 80))
    assert scene.lamps is not None
    assert scene.lamps.flicker_hz == 120
    assert scene.target is not None
    assert scene.target.velocity_px_s == -20
    assert scene.target.cover.shape == (20, 20)
    assert 1e5 < scene.target.light.max() <= 2e5


def test_a_radiance_map_beside_the_file(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.geomspace(1, 1000, 600).reshape(20, 30))
    scene = load_scene(written(tmp_path, picture="map.npy"))
    assert scene.shape == (20, 30)
    highlight = np.quantile(scene.irradiance, 0.999)
    assert highlight == pytest.approx(2e5, rel=1e-3)
    with pytest.raises(UsageError, match="size of its own"):
        load_scene(written(tmp_path, picture="map.npy"), (5, 5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"picture": "wal"}, "did you mean wall"),
        ({"photons_s": None}, "either photons_s or luminance_cd_m2"),
        ({"luminance_cd_m2": 3}, "either photons_s or luminance_cd_m2"),
        ({"photons_s": -1}, "photons_s: "),
        ({"photons_s": float("nan")}, "photons_s: "),
        ({"lamps": {"mains_hz": 50, "depth": 1.5}}, "lamps.depth: "),
        ({"lamps": {"mains_hz": 0, "depth": 0.5}}, "lamps.mains_hz: "),
        ({"target": {"crossing_s": 0}}, "less than a millisecond"),
        ({"target": {"sise": 1}}, "target.sise: "),
        ({"shape": [0, 5]}, "shape.0: "),
        ({"lamp": {}}, "lamp: "),
    ],
)
def test_a_bad_scene_is_one_line(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message) as error:
        load_scene(written(tmp_path, **change))
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_files_that_are_no_scene(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        load_scene(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(DataError, match="not JSON, line 1"):
        load_scene(tmp_path / "bad.json")


def test_a_gigantic_file_is_refused_before_it_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="GiB are there"):
        load_scene(written(tmp_path, shape=[1_000_000, 1_000_000]))


def test_the_brightest_diffuse_part_is_1_in_each_drawing() -> None:
    chart = load_scene("colour-chart", (48, 72)).irradiance / 120
    assert chart.max() == pytest.approx(0.9, abs=0.01)
    grey = chart[42, 6::12].mean(axis=1)
    assert np.all(np.diff(grey) < 0)  # the last row goes from white to black
    night: Scene = load_scene("night-street", (120, 160))
    bright = np.quantile(night.irradiance, [0.5, 0.9999]) / 8
    assert bright[0] < 1 < 500 < bright[1]
