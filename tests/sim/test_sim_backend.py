"""The backend of the simulated camera and its options."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camctl.errors import CamctlError, CameraNotFoundError, DataError, UsageError
from camctl.interface.backends import list_cameras
from camctl.interface.clock import RealClock, VirtualClock
from camctl.interface.controls import ExposureSetting, Layout
from camctl.profiles.calibrated import open_camera
from camctl.sim.backend import SimulatedBackend, SimulatedOptions
from camctl.sim.scenes.scene import scene_of


def test_backend_is_found_through_its_entry_point() -> None:
    cameras = list_cameras()
    assert "sim" in [camera.id for camera in cameras]
    with open_camera("sim") as camera:
        assert camera.info.id == "sim"
        assert camera.info in cameras


def test_default_scene_and_sensor() -> None:
    with SimulatedBackend().open("", {}) as camera:
        assert (camera.scene.name, camera.sensor.name) == ("tile-floor", "standard")
        assert camera.controls.shape == camera.sensor.shape
        assert isinstance(camera.clock, VirtualClock)


def test_options_are_used() -> None:
    options = {
        "scene": "room",
        "sensor": "phone",
        "seed": "7",
        "size": "64x48",
        "time": "real",
    }
    with SimulatedBackend().open("", options) as camera:
        assert camera.controls.shape == (48, 64)
        assert camera.controls.layout is Layout.RGGB
        assert isinstance(camera.clock, RealClock)


def test_tolerance_is_divided_among_the_frames_of_a_sequence() -> None:
    for text, allowed in (("0.4", 0.2), ("0", 0.0)):
        options = {"sensor": "complete", "size": "64x48", "tolerance": text}
        with SimulatedBackend().open("", options) as camera:
            for _ in camera.shoot([ExposureSetting(0.001), ExposureSetting(0.01)]):
                assert camera.last_plan is not None
                assert camera.last_plan.tolerance_dn == allowed


def test_seed_determines_the_noise() -> None:
    def picture(seed: str) -> np.ndarray:
        with SimulatedBackend().open("", {"size": "32x24", "seed": seed}) as camera:
            return next(
                camera.shoot([ExposureSetting(camera.controls.time_s.nearest(0.01))])
            ).pixels

    assert np.array_equal(picture("1"), picture("1"))
    assert not np.array_equal(picture("1"), picture("2"))


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"scence": "room"}, UsageError, "did you mean scene"),
        ({"scene": "rooom"}, UsageError, "did you mean room"),
        ({"sensor": "fone"}, UsageError, "did you mean phone"),
        ({"time": "fast"}, UsageError, "time=fast; input should be 'virtual' or 'real'"),
        ({"size": "640"}, UsageError, "size=640; write WIDTHxHEIGHT, such as 640x480"),
        ({"size": "999999x999999"}, DataError, "GiB"),
        ({"seed": "-1"}, UsageError, "seed=-1; input should be greater than or equal to 0"),
        ({"tolerance": "nan"}, UsageError, "=nan; input should be a finite number"),
        ({"scene": "no-such.hdr"}, DataError, "No such file"),
        ({"sensor": "no-such.json"}, DataError, "No such file"),
    ],
)
def test_invalid_options_raise_one_line(
    options: dict[str, str], kind: type[CamctlError], message: str
) -> None:
    with pytest.raises(kind, match=message) as error:
        SimulatedBackend().open("", options)
    assert "\n" not in str(error.value)


def test_address_is_refused() -> None:
    with pytest.raises(CameraNotFoundError, match="no camera sim:3 exists; its id is sim"):
        open_camera("sim:3")


def test_sizes_are_rows_and_columns() -> None:
    assert SimulatedOptions.parse({"size": "640x480"}).size == (480, 640)
    assert SimulatedOptions.parse({"size": " 12 X 7 "}).size == (7, 12)
    assert SimulatedOptions.parse({"size": (7, 12)}).size == (7, 12)


@pytest.mark.parametrize("as_scene", [False, True])
def test_an_array_is_a_scene(tmp_path: Path, *, as_scene: bool) -> None:
    light = np.geomspace(0.01, 3, 48 * 64).reshape(48, 64)
    np.save(tmp_path / "map.npy", light)
    setting, frames = ExposureSetting(0.01), []
    for scene in (
        str(tmp_path / "map.npy"),
        tmp_path / "map.npy",
        scene_of(light) if as_scene else light,
    ):
        with open_camera("sim", scene=scene, size="64x48") as camera:
            frames.append(next(camera.shoot([setting])).pixels)
    assert frames[0].max() > frames[0].min()
    assert np.array_equal(frames[0], frames[1])
    assert np.array_equal(frames[0], frames[2])


@pytest.mark.parametrize(
    ("scene", "size", "error"),
    [
        (np.ones((4, 5)), "4x5", "array has its own size, 5x4; leave the size out"),
        (-np.ones((4, 5)), None, "negative"),
        (np.ones(5), None, "invalid array shape"),
        (np.array([["a", "b"]]), None, "invalid data type"),
        (np.full((4, 5), np.nan), None, "NaN"),
        (np.zeros((4, 5)), None, "scene array"),
    ],
)
def test_an_array_that_is_no_scene_is_one_line(scene: object, size: str | None, error: str) -> None:
    with pytest.raises(CamctlError, match=error) as raised:
        open_camera("sim", scene=scene, size=size)
    assert "\n" not in str(raised.value)
