"""Built-in scenes are as their descriptions state; invalid irradiance is one line of error."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError
from camctl.interface.controls import Layout
from camctl.sim.scenes.drawings import DRAWINGS, Drawing
from camctl.sim.scenes.scene import (
    HIGHLIGHT_CD_M2,
    LUMINANCE,
    RELATIVE,
    Scene,
    load_scene,
    scene_names,
)
from camctl.sim.scenes.view import View
from camctl.sim.sensors.parts import Lens, Pixels
from camctl.sim.sensors.sensor import load_sensor


@pytest.mark.parametrize("name", scene_names())
@pytest.mark.parametrize(
    "shape", [(1, 1), (3, 2), (48, 64), (61, 37), (36, 64), (40, 200), (200, 40)]
)
def test_every_built_in_scene_is_positive_and_finite_at_any_size(
    name: str, shape: tuple[int, int]
) -> None:
    scene = load_scene(name, shape)
    assert scene.shape == shape
    assert scene.irradiance.dtype == np.float32
    assert np.all(np.isfinite(scene.irradiance))
    assert np.all(scene.irradiance > 0)
    assert scene.unit == LUMINANCE
    assert scene.photons_per_unit == 1.0


def test_scene_names() -> None:
    assert set(scene_names()) == {
        "ball",
        "cloth",
        "colour-chart",
        "grey-steps",
        "moving-target",
        "night-street",
        "outdoor-sun",
        "pwm-lamp",
        "ramp",
        "room",
        "slanted-edge",
        "stars",
        "tile-floor",
        "uniform",
    }
    for name in scene_names():
        assert load_scene(name, (6, 8)).name == name


def test_the_ramp_is_linear() -> None:
    light = load_scene("ramp", (5, 100)).irradiance / HIGHLIGHT_CD_M2
    assert np.allclose(light, (np.arange(100) + 0.5) / 100, rtol=1e-6)


def test_the_uniform_scene_is_uniform() -> None:
    assert np.unique(load_scene("uniform", (5, 7)).irradiance).tolist() == [
        np.float32(HIGHLIGHT_CD_M2)
    ]


def test_the_standard_sensor_sees_a_million_photons_of_the_usual_luminance() -> None:
    assert HIGHLIGHT_CD_M2 * load_sensor("standard").photons_per_candela == pytest.approx(1e6, 1e-6)


@pytest.mark.parametrize("name", scene_names())
def test_f_number_and_pitch_change_the_light_of_every_scene(name: str) -> None:
    sensor, scene = load_sensor("standard"), load_scene(name, (6, 8))
    wide = sensor.model_copy(update={"lens": Lens(f_number=2.0), "pixels": Pixels(pitch_um=6.9)})
    light, more = (View.of(scene, each).light for each in (sensor, wide))
    assert more == pytest.approx(16 * light, rel=1e-5)


def test_near_tiles_of_the_floor_are_a_thousand_times_as_bright_as_far_ones() -> None:
    light = load_scene("tile-floor", (480, 640)).irradiance
    assert light.ndim == 2
    near, far = np.median(light[-60:, :60]), np.median(light[:60, -60:])
    assert near / far > 1000


def test_the_window_of_the_room_is_ten_thousand_times_as_bright_as_its_corner() -> None:
    scene = load_scene("room", (480, 640))
    assert scene.is_coloured
    low, high = np.quantile(scene.irradiance, [0.02, 0.99])
    assert high / low > 10_000


def test_the_ball_is_matte_with_a_small_highlight() -> None:
    light = load_scene("ball", (480, 640)).irradiance.max(axis=2) / HIGHLIGHT_CD_M2
    assert light.max() > 5
    assert 0.0005 < np.mean(light > 1) < 0.01


def test_the_edge_is_slanted_by_5_degrees_and_each_pixel_has_the_mean_of_its_area() -> None:
    light = load_scene("slanted-edge", (200, 300)).irradiance / 200.0
    assert (light.min(), light.max()) == pytest.approx((0.25, 1.0))
    where = 300 - ((light - 0.25) / 0.75).sum(axis=1, dtype=np.float64)
    slope, middle = np.polyfit(np.arange(200) - 99.5, where, 1)
    assert slope == pytest.approx(-math.tan(math.radians(5)), rel=1e-4)
    assert middle == pytest.approx(150, abs=1e-3)


def test_the_grey_steps_have_equal_ratios_over_ten_thousand() -> None:
    light = load_scene("grey-steps", (80, 100)).irradiance / 2000.0
    steps = light[10::20, 10::20].ravel()
    assert steps == pytest.approx(np.geomspace(1, 1e-4, 20), rel=1e-5)


def test_the_sun_is_160000_times_as_bright_as_white() -> None:
    light = load_scene("outdoor-sun", (480, 640)).irradiance.max(axis=2)
    assert light.max() == pytest.approx(1.6e9, rel=0.01)
    assert 2e-5 < (light > 1e8).mean() < 5e-4
    assert 500 < np.median(light) < 10_000


def test_the_cloth_is_bright_and_has_no_edges() -> None:
    light = load_scene("cloth", (480, 640)).irradiance / HIGHLIGHT_CD_M2
    assert np.median(light) > 0.4
    assert np.abs(np.diff(light, axis=1)).max() < 0.1


def test_a_scene_is_alike_at_another_size() -> None:
    for name in scene_names():
        small = load_scene(name, (60, 80)).irradiance
        large = load_scene(name, (240, 320)).irradiance
        small, large = np.log(np.atleast_3d(small)), np.log(np.atleast_3d(large))
        binned = large.reshape(60, 4, 80, 4, -1).mean(axis=(1, 3))
        assert np.median(np.abs(small - binned)) < 0.1, name


def test_the_error_for_an_unknown_name_suggests_a_similar_one() -> None:
    with pytest.raises(UsageError, match="unknown scene 'tilefloor'; did you mean tile-floor"):
        load_scene("tilefloor")


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (-1, 5)])
def test_a_size_without_pixels_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(
        UsageError, match=f"invalid scene size {shape[1]}x{shape[0]}; both must be 1 or more"
    ):
        load_scene("ramp", shape)


@pytest.mark.parametrize("name", DRAWINGS)
def test_strips_of_a_drawing_are_the_whole_drawing(name: str) -> None:
    rows, columns = 203, 700  # three strips, the last one of other height
    whole = np.float32(7) * DRAWINGS[name](rows, columns)
    drawn = Drawing(name, rows, columns, 7.0).drawn()
    assert drawn.shape == whole.shape
    relative = whole / whole.max() * drawn.max()  # some drawings are scaled by their brightest part
    assert np.array_equal(drawn, whole) or np.allclose(drawn, relative, rtol=1e-6)


@pytest.mark.parametrize("name", ["tile-floor", "room"])
def test_a_drawn_scene_takes_little_more_memory_than_the_light_on_a_grey_sensor(name: str) -> None:
    sensor = load_sensor("standard").model_copy(update={"layout": Layout.MONO})
    load_scene(name, (2, 2))  # what is loaded once does not count
    tracemalloc.start()
    try:
        view = View.of(load_scene(name, (1500, 2000)), sensor)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert view.light.nbytes < most < view.light.nbytes + 10_000_000


def test_a_scene_larger_than_memory_is_refused_before_it_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def must_not_run(rows: int, columns: int, part: slice) -> NDArray[np.float32]:
        raise AssertionError("drawn")

    monkeypatch.setitem(DRAWINGS, "ramp", must_not_run)
    with pytest.raises(DataError, match="GiB"):
        load_scene("ramp", (1_000_000, 1_000_000))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.full((2, 3), np.nan), "6 of 6 pixels are NaN or infinite"),
        (np.array([[1.0, np.inf]]), "1 of 2 pixels is infinite or beyond float32"),
        (np.array([[1.0, 1e300]]), "1 of 2 pixels is infinite or beyond float32"),
        (np.array([[1.0, -2.0, -1.0]]), r"2 of 3 pixels are negative \(down to -2\)"),
        (np.zeros((2, 2)), "all pixels are 0"),
        (np.zeros((0, 2)), "the picture has no pixels"),
        (np.ones(5), r"invalid array shape \(5,\)"),
        (np.float64(5), r"invalid array shape \(\)"),
        (np.ones((2, 2, 4)), r"invalid array shape \(2, 2, 4\)"),
        (np.array([["a"]]), "invalid data type <U1"),
        (np.array([[1j]]), "invalid data type complex128"),
    ],
)
def test_invalid_irradiance_is_one_line_of_error(bad: NDArray[np.float32], message: str) -> None:
    with pytest.raises(DataError, match=f"^scene s: {message}") as error:
        Scene("s", bad)
    assert "\n" not in str(error.value)


@given(st.integers(1, 30), st.integers(1, 30), st.data())
def test_the_error_counts_invalid_pixels(rows: int, columns: int, data: st.DataObject) -> None:
    light = np.ones((rows, columns, 3), dtype=np.float32)
    bad = data.draw(st.integers(1, rows * columns))
    light.reshape(-1, 3)[:bad, data.draw(st.integers(0, 2))] = -1
    with pytest.raises(DataError, match=f"scene s: {bad} of {rows * columns} pixels"):
        Scene("s", light)


@pytest.mark.parametrize("photons", [0.0, -1.0, np.inf, np.nan])
def test_invalid_photons_per_unit_are_refused(photons: float) -> None:
    with pytest.raises(DataError, match="scene s: invalid photons_per_unit"):
        Scene("s", np.ones((2, 2), dtype=np.float32), photons_per_unit=photons)


def test_a_single_channel_may_be_the_last_axis() -> None:
    assert Scene("s", np.ones((4, 5, 1), dtype=np.float32)).irradiance.shape == (4, 5)


def test_the_highlight_of_a_radiance_map_gets_the_usual_luminance(tmp_path: Path) -> None:
    light = np.geomspace(1e-5, 1e3, 10_000, dtype=np.float32).reshape(100, 100)
    np.save(tmp_path / "map.npy", light)
    scene = load_scene(tmp_path / "map.npy")
    assert scene.unit == RELATIVE
    assert np.array_equal(scene.irradiance, light)
    highlight = np.quantile(light, 0.999)
    assert scene.photons_per_unit * highlight == pytest.approx(HIGHLIGHT_CD_M2)


def test_a_size_is_refused_for_a_radiance_map(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.ones((3, 3)))
    with pytest.raises(UsageError, match=r"map\.npy has its own size, \d+x\d+"):
        load_scene(tmp_path / "map.npy", (5, 5))
