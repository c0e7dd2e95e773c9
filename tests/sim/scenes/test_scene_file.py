"""Scene files: units, lamps and targets, and one line of error for each invalid one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.sim.data_files import built_in_files, read_text
from camctl.sim.scenes.motion import Lamps, PwmLamps
from camctl.sim.scenes.scene import LUMINANCE, PHOTONS, SceneFile, load_scene, scene_names

VALID: dict[str, Any] = {"name": "mine", "picture": "wall", "photons_s": 2e5}


def written(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({**VALID, **changes}))
    return path


def test_the_built_in_scenes_are_scene_files() -> None:
    files = built_in_files("scenes")
    assert tuple(sorted(files)) == scene_names()
    for name, text in files.items():
        file = read_text(SceneFile, text, source=name)
        assert file.name == name
        assert file.what


def test_a_scene_is_in_photons_or_candela(tmp_path: Path) -> None:
    photons = load_scene(written(tmp_path), (12, 16))
    assert photons.unit == PHOTONS
    change = {"photons_s": None, "luminance_cd_m2": 40}
    candela = load_scene(written(tmp_path, **change), (12, 16))
    assert candela.unit == LUMINANCE
    assert np.allclose(photons.irradiance / 2e5, candela.irradiance / 40, rtol=1e-6)


def test_the_size_is_that_of_the_caller_else_of_the_file_else_the_usual_one(tmp_path: Path) -> None:
    assert load_scene(written(tmp_path), usual=(10, 20)).shape == (10, 20)
    assert load_scene(written(tmp_path, shape=[5, 6]), usual=(10, 20)).shape == (5, 6)
    assert load_scene(written(tmp_path, shape=[5, 6]), (7, 8)).shape == (7, 8)


def test_lamps_and_a_target_are_read(tmp_path: Path) -> None:
    lamps, target = {"mains_hz": 60, "depth": 0.3}, {"size": 0.5, "crossing_s": -4.0}
    scene = load_scene(written(tmp_path, lamps=lamps, target=target), (40, 80))
    assert isinstance(scene.lamps, Lamps)
    assert scene.lamps.flicker_hz == 120
    assert scene.target is not None
    assert scene.target.velocity_px_s == -20
    assert scene.target.cover.shape == (20, 20)
    assert 1e5 < scene.target.light.max() <= 2e5


def test_switched_lamps_are_read(tmp_path: Path) -> None:
    lamps = {"pwm_hz": 200, "duty": 0.3, "depth": 0.9}
    assert load_scene(written(tmp_path, lamps=lamps), (4, 8)).lamps == PwmLamps(200, 0.3, 0.9)
    for wrong in ({"pwm_hz": 200}, {"mains_hz": 50, "pwm_hz": 200, "duty": 0.3}, {"duty": 0.3}):
        with pytest.raises(DataError, match="give either mains_hz, or pwm_hz and duty"):
            load_scene(written(tmp_path, lamps={**wrong, "depth": 0.9}))


def test_a_radiance_map_beside_the_file_gets_the_units_of_the_file(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.geomspace(1, 1000, 600).reshape(20, 30))
    scene = load_scene(written(tmp_path, picture="map.npy"))
    assert scene.shape == (20, 30)
    highlight = np.quantile(scene.irradiance, 0.999)
    assert highlight == pytest.approx(2e5, rel=1e-3)
    with pytest.raises(UsageError, match=r"map\.npy has its own size, \d+x\d+; leave the size out"):
        load_scene(written(tmp_path, picture="map.npy"), (5, 5))
    with pytest.raises(DataError, match=r"none\.exr: No such file"):
        load_scene(tmp_path / "none.exr", (5, 5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"picture": "wal"}, "picture: unknown drawing 'wal'; did you mean wall"),
        ({"photons_s": None}, "give either photons_s or luminance_cd_m2"),
        ({"luminance_cd_m2": 3}, "give either photons_s or luminance_cd_m2"),
        ({"photons_s": -1}, "photons_s: input should be greater than 0"),
        ({"lamps": {"mains_hz": 50, "depth": 1.5}}, "lamps.depth: input should be less than"),
        ({"lamps": {"mains_hz": 0, "depth": 0.5}}, "lamps.mains_hz: input should be greater"),
        ({"target": {"crossing_s": 0}}, "target: crossing_s is less than a millisecond"),
        ({"target": {"sise": 1}}, "target.sise: unknown field"),
        ({"shape": [0, 5]}, "shape.0: input should be greater than or equal to 1"),
    ],
)
def test_an_invalid_scene_file_is_one_line_of_error(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = written(tmp_path, **change)
    with pytest.raises(DataError) as error:
        load_scene(path)
    assert f"{path}: {message}" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_drawing_larger_than_memory_is_refused_before_it_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"GiB of memory, but [0-9.]+ GiB are available"):
        load_scene(written(tmp_path, shape=[1_000_000, 1_000_000]))


def test_the_brightest_diffuse_part_has_the_luminance_of_the_file() -> None:
    chart = load_scene("colour-chart", (48, 72)).irradiance / 120
    assert chart.max() == pytest.approx(0.9, abs=0.01)
    grey = chart[42, 6::12].mean(axis=1)
    assert np.all(np.diff(grey) < 0)  # the last row is from white to black
    night = load_scene("night-street", (120, 160))
    bright = np.quantile(night.irradiance, [0.5, 0.9999]) / 8
    assert bright[0] < 1 < 500 < bright[1]
